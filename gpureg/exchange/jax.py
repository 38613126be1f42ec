"""Arrays of JAX."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import warp
from .libraries import Memory, Place, numpy_has, on_cuda


def to_host(array: Any, name: str) -> npt.NDArray[Any]:
    """Return a read-only view of an array on the CPU, a copy of one elsewhere; bfloat16 as float32."""
    _expect_values(array, name)
    return np.asarray(array if numpy_has(array.dtype) else array.astype(np.float32))


def to_library(value: npt.NDArray[Any], like: Any) -> Any:
    """Return an array on the device of `like`; float32 as the type of `like` if numpy has not this type."""
    import jax

    made = jax.device_put(value, min(like.devices(), key=lambda device: device.id))
    return made if numpy_has(like.dtype) or value.dtype != np.float32 else made.astype(like.dtype)


def to_warp(array: Any, name: str) -> Memory | None:
    """Return the memory of an array on a CUDA device."""
    _expect_values(array, name)
    return warp.memory_of(array) if place(array) is not None else None


def from_warp(numbers: Any, shape: tuple[int, ...], like: Any) -> Any:
    """Return an array; the stream of JAX waits for that of Warp."""
    import jax

    return jax.dlpack.from_dlpack(numbers).reshape(shape)


def _expect_values(array: Any, name: str) -> None:
    """Raise a TypeError for an array inside of a function that JAX traces."""
    import jax

    if isinstance(array, jax.core.Tracer):
        raise TypeError(
            f"{name} has no values inside jax.jit, jax.grad or jax.vmap: call gpureg outside, or by jax.pure_callback"
        )


def place(array: Any) -> Place | None:
    """Return the CUDA device of an array that lies on one device."""
    return on_cuda(array) if len(array.devices()) == 1 else None
