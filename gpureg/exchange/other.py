"""Arrays of any other library that have ``__dlpack__`` or ``__cuda_array_interface__``."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import numpy.typing as npt

from . import warp
from .libraries import CUDA, HOST, Memory, Place, refuse_gradients


def to_host(array: Any, name: str) -> npt.NDArray[Any]:
    """Return a view of an array on the host, a copy of one on a CUDA device."""
    if getattr(array, "requires_grad", False) is True:
        refuse_gradients(name, f"{name}.detach()")
    device = _device(array)
    if device in CUDA:
        found: npt.NDArray[Any] = warp.of_cuda(array).numpy()
        return found
    if device not in HOST:
        raise TypeError(
            f"{name} is {_described(array)} on a device that gpureg cannot read (number {device} of DLPack): "
            "copy it to the host first"
        )
    try:
        return np.from_dlpack(array)
    except (BufferError, RuntimeError) as error:
        raise TypeError(
            f"{name} is {_described(array)} that numpy cannot read ({error}): convert it, for example to float32"
        ) from None


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return an array of the library if it has a function ``from_dlpack``; otherwise of numpy, or of Warp on CUDA."""
    return _made(value if (at := place(like)) is None else warp.to_cuda(value, at.device), like)


def _made(found: Any, like: Any) -> Any:
    """Return an array of numpy or Warp as one of the library of `like`, if this is possible."""
    if hasattr(like, "__array_namespace__"):
        make = getattr(like.__array_namespace__(), "from_dlpack", None)
    else:
        make = getattr(sys.modules.get(type(like).__module__.partition(".")[0]), "from_dlpack", None)
    return found if make is None else make(found)


def to_warp(array: Any, name: str) -> Memory | None:
    """Return the memory of an array on a CUDA device."""
    if getattr(array, "requires_grad", False) is True:
        refuse_gradients(name, f"{name}.detach()")
    return warp.memory_of(array) if _device(array) in CUDA else None


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Return an array of the library if it has a function ``from_dlpack``, otherwise of Warp."""
    return _made(numbers.reshape(shape), like)


def place(array: Any) -> Place | None:
    """Return the CUDA device of an array."""
    if _device(array) not in CUDA:
        return None
    return Place("cuda", int(warp.of_cuda(array).device.ordinal))


def _device(array: Any) -> int:
    """Return the kind of device, in the numbers of DLPack."""
    return int(array.__dlpack_device__()[0]) if hasattr(array, "__dlpack_device__") else min(CUDA)


def _described(array: Any) -> str:
    return f"an array of {type(array).__module__.partition('.')[0]} ({type(array).__name__})"
