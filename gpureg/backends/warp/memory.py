"""Arrays on a Warp device: where there is no memory for one, that is a MemoryError."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from ..failures import out_of_memory

# What all allocators of Warp say.
_FULL = "Failed to allocate"


def zeros(shape: int | tuple[int, ...], dtype: Any, device: Any) -> Any:
    """Make an array of zeros."""
    return _made(wp.zeros, shape, dtype=dtype, device=device)


def empty(shape: int | tuple[int, ...], dtype: Any, device: Any) -> Any:
    """Make an array with any content."""
    return _made(wp.empty, shape, dtype=dtype, device=device)


def copied(values: Any, dtype: Any, shape: tuple[int, ...], device: Any) -> Any:
    """Copy a contiguous array of the host."""
    return _made(wp.array, values, dtype=dtype, shape=shape, device=device)


def _made(make: Callable[..., Any], *args: Any, **given: Any) -> Any:
    try:
        return make(*args, **given)
    except RuntimeError as error:
        if _FULL not in str(error):
            raise
        raise out_of_memory(given["device"], str(error)) from error
