"""Computations with a few numbers on the device, in OpenCL: launches of one work item."""

from __future__ import annotations

import numpy as np

from ..scalars import MEMORY, Scalars
from ..sums import Numbers
from .sums import OpenCLSums


class OpenCLScalars(OpenCLSums, Scalars):
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
        args = [np.int32(first), np.int32(second), self.real(self.ridge), numbers.values]
        self._launch("scalars", (f"-DTASK={task}", f"-DMEMORY={MEMORY}"), args, (1,), (1,))
