"""Computations with a few numbers, in numpy."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import FloatArray
from ..scalars import (
    ACCEPTED,
    BEFORE,
    COEFFICIENTS,
    COUNT,
    GRAM,
    LEFT,
    MEMORY,
    MIXED,
    ONE,
    PLACES,
    PRODUCT,
    PRODUCTS,
    REJECTED,
    ROW,
    TAKEN,
    WORST,
)
from ..sums import Numbers
from .sums import NumpySums


def coefficients(gram: FloatArray, products: FloatArray, ridge: float) -> FloatArray:
    """Compute the c that minimises |r - dR c|, (k,), from dR' dR and dR' r; 0 for a column of zeros."""
    length = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = gram * scale[:, None] * scale
    found: FloatArray = scale * np.linalg.solve(scaled + ridge * len(gram) * np.eye(len(gram)), scale * products)
    return found


class NumpyScalars(NumpySums):
    """Computations with a few numbers."""

    def begin_scalars(self, numbers: Numbers) -> None:
        values = numbers.values
        values[ONE], values[COUNT], values[WORST] = 1, 0, 0

    def watch(self, numbers: Numbers, new: int, old: int) -> None:
        values = numbers.values
        after, before = float(values[new]), float(values[old])
        if not after <= before:
            quotient = after / before if before > 0 else math.inf
            values[WORST] = max(values[WORST], math.inf if math.isnan(quotient) else quotient)

    def mix_coefficients(self, numbers: Numbers, newest: int) -> None:
        values = numbers.values
        row, gram = values[ROW : ROW + PLACES], values[GRAM : GRAM + PLACES**2].reshape(PLACES, PLACES)
        products = values[PRODUCTS : PRODUCTS + PLACES]
        gram[newest], gram[:, newest] = row, row
        products += row  # the new residual is the last one plus the new difference
        products[newest] = values[PRODUCT]
        values[COUNT] = min(values[COUNT] + 1, MEMORY)
        # the oldest first
        used = (newest + 1 - np.arange(int(values[COUNT]), 0, -1)) % PLACES
        found = coefficients(gram[np.ix_(used, used)], products[used], self.ridge)
        values[COEFFICIENTS : COEFFICIENTS + PLACES] = 0
        values[COEFFICIENTS + used] = found

    def judge_mix(self, numbers: Numbers) -> None:
        values = numbers.values
        accepted = bool(values[MIXED] <= values[BEFORE])
        values[TAKEN], values[LEFT] = accepted, not accepted
        values[ACCEPTED if accepted else REJECTED] += 1
        if not accepted:
            values[COUNT] -= values[COUNT] // 2
