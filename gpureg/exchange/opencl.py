"""Arrays of PyOpenCL, ``pyopencl.array.Array``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .libraries import Memory, Place


def to_host(array: Any, name: str) -> npt.NDArray[Any]:
    """Return a copy, after the work on the array's queue and its events."""
    if array.flags.forc and array.queue is not None:
        found: npt.NDArray[Any] = array.get()
        return found
    import pyopencl as cl

    # pyopencl reads only contiguous arrays: we read all the memory between the first and the last number
    steps = [(size - 1) * stride for size, stride in zip(array.shape, array.strides, strict=True)]
    low = sum(min(step, 0) for step in steps)
    if not array.size:
        return np.empty(array.shape, array.dtype)
    span = np.empty(sum(max(step, 0) for step in steps) - low + array.dtype.itemsize, np.uint8)
    source = {"src_offset": array.offset + low, "wait_for": list(array.events), "is_blocking": True}
    cl.enqueue_copy(_queue(array), span, array.base_data, **source)
    return np.ndarray(array.shape, array.dtype, span, -low, array.strides)


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return an array in the context of `like`, on its queue."""
    from pyopencl import array

    return array.to_device(_queue(like), value, allocator=like.allocator)


def to_warp(array: Any, name: str) -> Memory | None:
    """Return None: OpenCL's memory is not Warp's."""
    return None


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Raise an error: Warp has no memory of OpenCL, so that `to_warp` gives none."""
    raise NotImplementedError("arrays of PyOpenCL share no memory with Warp: they pass through the host")


def place(array: Any) -> Place | None:
    """Return the OpenCL device of the array's queue, or the first of its context."""
    return Place("opencl", array.context.devices[0] if array.queue is None else array.queue.device)


def _queue(array: Any) -> Any:
    """Return the queue of an array, or a new one in its context."""
    import pyopencl as cl

    return cl.CommandQueue(array.context) if array.queue is None else array.queue
