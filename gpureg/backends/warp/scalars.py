"""Computations with a few numbers on the device, in Warp: launches of one work item."""

from __future__ import annotations

import numpy as np
import warp as wp

from ...kernels.warp import scalars as kernel
from ..scalars import MEMORY, Scalars
from ..sums import Numbers
from .sums import WarpSums


class WarpScalars(WarpSums, Scalars):
    """Computations with a few numbers."""

    def begin_scalars(self, numbers: Numbers) -> None:
        self._compute(numbers, 0)

    def watch(self, numbers: Numbers, new: int, old: int) -> None:
        self._compute(numbers, 1, new, old)

    def mix_coefficients(self, numbers: Numbers, newest: int) -> None:
        self._compute(numbers, 2, newest)

    def judge_mix(self, numbers: Numbers) -> None:
        self._compute(numbers, 3)

    def _compute(self, numbers: Numbers, task: int, first: int = 0, second: int = 0) -> None:
        scratch = numbers.parts.get("least squares")
        if scratch is None:
            made = self.upload(np.zeros(MEMORY**2 + 2 * MEMORY), wp.float64)
            scratch = numbers.parts["least squares"] = made
        inputs = [first, second, self.ridge, scratch]
        self._launch((1,), kernel.make, (task, MEMORY), inputs, numbers.values, work=1)
