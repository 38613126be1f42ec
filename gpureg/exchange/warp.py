"""Arrays of NVIDIA Warp; and memory of CUDA, which is read through Warp."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .libraries import Memory, Place, on_cuda, refuse_gradients

# CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL of the CUDA driver.
_DEVICE_ORDINAL = 9


def to_host(array: Any, name: str) -> npt.NDArray[Any]:
    """Return a view of an array on the CPU, a copy of one on a GPU; vectors have a last axis of components."""
    import warp as wp

    _refuse_gradients(array, name)
    if getattr(array.dtype, "_wp_scalar_type_", array.dtype) is getattr(wp, "bfloat16", None):
        raise TypeError(f"{name} has the type bfloat16, which numpy has not: convert it to float32")
    found: npt.NDArray[Any] = array.numpy()
    return found


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return an array on the device of `like`, of its vectors if the axes and the type are the same."""
    import warp as wp

    dtype = wp.dtype_from_numpy(value.dtype)
    vector = getattr(like.dtype, "_shape_", ())
    if vector and like.dtype._wp_scalar_type_ is dtype and value.ndim == like.ndim + len(vector):
        if value.shape[-len(vector) :] == tuple(vector):
            return _array(value, like.dtype, value.shape[: -len(vector)], like.device)
    return _array(value, dtype, value.shape, like.device)


def to_warp(array: Any, name: str) -> Memory | None:
    """Return the memory of an array; of one with other strides that of a copy in C order."""
    _refuse_gradients(array, name)
    return _memory(array)


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Return an array of numbers, (size,), as one like the given one, of its vectors if it has some."""
    import warp as wp

    vector = getattr(like.dtype, "_shape_", ())
    if not vector or numbers.dtype is not like.dtype._wp_scalar_type_:
        return numbers.reshape(shape)
    found = wp.array(ptr=numbers.ptr, dtype=like.dtype, shape=shape[: -len(vector)], device=numbers.device)
    # the memory lives as long as this array: what Warp does for views of its own
    found._ref = numbers
    return found


def _refuse_gradients(array: Any, name: str) -> None:
    if array.requires_grad:
        refuse_gradients(name, f"warp.clone({name}, requires_grad=False)")


def place(array: Any) -> Place | None:
    """Return the CUDA device of an array."""
    return on_cuda(array)


def of_cuda(array: Any) -> Any:
    """Return the memory of an object of another library on a CUDA device as a Warp array, without a copy.

    The stream of Warp waits for the one that the object names.
    """
    try:
        import warp as wp
    except ImportError:
        raise ImportError(
            f"reading {type(array).__name__} from a CUDA device needs Warp: pip install 'gpureg[warp]'"
        ) from None
    if hasattr(array, "__dlpack__"):
        return wp.from_dlpack(array)
    interface = array.__cuda_array_interface__
    if interface.get("mask") is not None:
        raise TypeError(f"{type(array).__name__} has a mask, which would be lost: pass its data, and mask= by itself")
    device = wp.get_device(f"cuda:{_device_of(int(interface['data'][0]))}")
    if interface.get("stream") is not None:
        device.stream.wait_stream(wp.Stream(device, cuda_stream=interface["stream"]))
    return wp.array(data=array, device=device, copy=False)


def memory_of(array: Any) -> Memory | None:
    """Return the memory of an object on a CUDA device; None without Warp, and for types that it has not."""
    try:
        return _memory(of_cuda(array))
    except (ImportError, RuntimeError, TypeError):
        # what is wrong is said when the array is read by the host
        return None


def _memory(array: Any) -> Memory | None:
    """Return the memory of a Warp array; None for an empty one, and for types that numpy has not."""
    import warp as wp

    kind = getattr(array.dtype, "_wp_scalar_type_", array.dtype)
    try:
        dtype = np.dtype(wp.dtype_to_numpy(kind))
    except TypeError:
        return None
    # numpy would take the bits for integers
    if not array.size or kind is getattr(wp, "bfloat16", None):
        return None
    whole = array.contiguous()
    shape = (*whole.shape, *getattr(array.dtype, "_shape_", ()))
    numbers = wp.array(ptr=whole.ptr, dtype=kind, shape=(math.prod(shape),), device=whole.device)
    # the memory lives as long as this array
    numbers._ref = whole
    return Memory(numbers, shape, dtype)


def to_cuda(value: npt.NDArray[Any], device: int) -> Any:
    """Return a copy of a host array on a CUDA device, as a Warp array."""
    import warp as wp

    return _array(value, wp.dtype_from_numpy(value.dtype), value.shape, f"cuda:{device}")


def _device_of(pointer: int) -> int:
    """Ask the driver for the number of the device on which memory lies."""
    from warp import get_cuda_devices

    if pointer == 0 or len(get_cuda_devices()) == 1:
        return 0
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        driver = ctypes.CDLL("nvcuda.dll")
    found = ctypes.c_int()
    if driver.cuPointerGetAttribute(ctypes.byref(found), _DEVICE_ORDINAL, ctypes.c_uint64(pointer)):
        raise TypeError("the CUDA driver does not know the memory of this array")
    return found.value


def _array(value: npt.NDArray[Any], dtype: Any, shape: tuple[int, ...], device: Any) -> Any:
    """Make a Warp array; on the CPU it uses the memory of `value`."""
    import warp as wp

    if not value.size:
        return wp.empty(shape, dtype=dtype, device=device)
    return wp.array(data=np.ascontiguousarray(value), dtype=dtype, shape=shape, device=device, copy=False)
