"""Arrays of CuPy."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from . import warp
from .libraries import Memory, Place, on_cuda


def to_host(array: Any, name: str) -> npt.NDArray[Any]:
    """Return a copy, after the work on the current stream of the array's device."""
    found: npt.NDArray[Any] = array.get()
    return found


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return an array on the device of `like`, made on its current stream."""
    import cupy

    with like.device:
        return cupy.asarray(value)


def to_warp(array: Any, name: str) -> Memory | None:
    """Return the memory of an array."""
    return warp.memory_of(array) if place(array) is not None else None


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Return an array; its current stream waits for that of Warp."""
    import cupy

    with like.device:
        return cupy.from_dlpack(numbers).reshape(shape)


def place(array: Any) -> Place | None:
    """Return the CUDA device; None with AMD's GPUs."""
    return on_cuda(array)
