"""An array on a device that a function computes with where it lies: :class:`Lent`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy.typing as npt

from .libraries import Library, Memory


@dataclasses.dataclass(frozen=True, eq=False)
class Lent:
    """An argument whose memory is that of an array of Warp: on a CUDA device, or made by Warp on the CPU.

    Attributes
    ----------
    library : Library
    given : object
        The array of the caller.
    memory : Memory
    to_host : callable
        Returns the argument as a numpy array.
    """

    library: Library
    given: Any
    memory: Memory
    to_host: Callable[[], npt.NDArray[Any]]

    def rows(self, channels: int, step: int) -> npt.NDArray[Any]:
        """Copy every `step`-th row of the array as (n, channels) to the host."""
        found: npt.NDArray[Any] = self.memory.numbers.reshape((-1, channels))[::step].numpy()
        return found

    def like(self, numbers: Any) -> Any:
        """Return an array of Warp, (size,), as one of the library with this shape."""
        return self.library.from_warp(numbers, self.memory.shape, self.given)
