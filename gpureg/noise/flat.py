"""Find areas of exactly equal values: they hold no noise, and say nothing of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .steps import Array, Flags, along

# Side of a cube of equal values, for numbers and for integers; counts that are mostly 0 get larger cubes, until this
# share of the pixels is left.
# Values have few levels if there are at most so many of them for each value besides the most frequent one; a value of
# others was put there if it has this share of a sample.
_FEW_LEVELS, _REPEATED = 1 / 16, 5e-4
# Large areas have at least this side.
_LARGE = 8
# Whole numbers from 0 whose mean is smaller are counts of which many are 0.
FEW_COUNTS = 4.0
_SIDE, _SIDE_OF_INTEGERS, _LARGEST, _ENOUGH = 2, 3, 25, 0.95


def equal_cubes(values: Array, side: int, axes: Sequence[int]) -> Flags:
    """Return the cells inside a cube of this side along the axes whose values are exactly equal.

    A morphological opening: the running maximum equals the running minimum, dilated back. NaN equals nothing.
    """
    high = low = values
    ndim = values.ndim
    for axis in axes:
        own = min(side, values.shape[axis])
        many = values.shape[axis] - own + 1
        above, below = high[along(axis, 0, many, ndim)], low[along(axis, 0, many, ndim)]
        for i in range(1, own):
            above = np.maximum(above, high[along(axis, i, many + i, ndim)])
            below = np.minimum(below, low[along(axis, i, many + i, ndim)])
        high, low = above, below
    corner = high == low
    found = np.zeros(values.shape, bool)
    if not corner.any():
        return found
    found[tuple(slice(0, size) for size in corner.shape)] = corner
    for axis in axes:
        grown = found.copy()
        for i in range(1, min(side, values.shape[axis])):
            grown[along(axis, i, None, ndim)] |= found[along(axis, None, -i, ndim)]
        found = grown
    return found


def flat_areas(
    values: Array, good: Flags, axes: Sequence[int], *, whole: bool, counts: bool = False, least: int = 0
) -> tuple[Flags, int]:
    """Return the cells in areas of equal values, and the side of the cubes.

    Parameters
    ----------
    values, good : array, bool array
        The values, and which of them count.
    axes : sequence of int
    whole : bool
        Whether the values are whole numbers, of which some are equal by chance.
    counts : bool, default False
        Whether they are counts, of which many are 0 by chance.
    least : int, default 0
        Smallest side of the cubes.
    """
    side = max(least, _SIDE_OF_INTEGERS if whole else _SIDE)
    found = cubes_of(values, good, side, axes)
    if counts and not np.any(found & (values > 0)):
        enough = _ENOUGH * np.count_nonzero(good)
        while side < _LARGEST and np.count_nonzero(good & ~found) <= enough:
            side += 4
            found = cubes_of(values, good, side, axes)
    return found, side


def cubes_of(values: Array, good: Flags, side: int, axes: Sequence[int]) -> Flags:
    """Return the cells that count, inside a cube of equal values that count."""
    known: npt.NDArray[Any] = values
    if not good.all():
        known = np.where(good, values, np.nan)
    return equal_cubes(known, side, axes) & good


def are_counts(sample: Array, low: float) -> bool:
    """Return whether values are counts of which many are 0, from an even sample and the smallest value."""
    return low == 0 and float(sample.mean()) < FEW_COUNTS and bool(np.all(sample == np.round(sample)))


def put_there(sample: Array, low: float, high: float) -> tuple[bool, tuple[float, ...]]:
    """Return whether values have few levels, as whole numbers have, and which values may have been put there.

    These are the ends of the range of values of few levels, and those that many others have.
    """
    levels, counts = np.unique(sample, return_counts=True)
    most = int(counts.max(initial=0))
    if sample.dtype.kind in "iu" or np.all(levels == np.round(levels)):
        return True, (low, high)
    if len(levels) - 1 <= _FEW_LEVELS * (len(sample) - most) and len(levels) > 1:
        return True, (low, high)
    return False, tuple(levels[counts >= max(5, _REPEATED * len(sample))].tolist())


def large_side(values: Array, inside: Flags | None) -> int:
    """Return the side of large areas of equal values in an image of one channel."""
    good = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    known = values[good if inside is None else good & inside]
    counts = values.dtype.kind in "iu" and bool(known.size)
    counts = counts and are_counts(known[:: max(1, known.size // 16384)], float(known.min()))
    return _LARGEST if counts else _LARGE


def large_flat_areas(values: Array, inside: Flags | None, side: int) -> Flags:
    """Return the cells of an image of one channel in areas of equal values of this side, which hold no noise."""
    good = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, bool)
    if inside is not None:
        good &= inside
    axes = [axis for axis, size in enumerate(values.shape) if size >= 3]
    return cubes_of(values, good, side, axes[-3:])


def written_twice(values: Array, axes: Sequence[int]) -> int | None:
    """Return the axis along which every value is written twice, as nearest-neighbour enlargement does."""
    for axis in axes:
        index = list(along(axis, 0, values.shape[axis] // 2 * 2, values.ndim))
        even = values[tuple(index)]
        pairs = [list(along(axis, None, None, values.ndim)) for _ in range(2)]
        for first, pair in enumerate(pairs):
            pair[axis] = slice(first, None, 2)
        if np.array_equal(even[tuple(pairs[0])], even[tuple(pairs[1])]):
            return axis
    return None
