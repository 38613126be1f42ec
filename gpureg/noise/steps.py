"""Steps along the axes of an array: slices, second differences, medians of three, dilation, means."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Flags = npt.NDArray[np.bool_]
# Smallest number of pixels that are measured, if there are so many.
AT_LEAST = 1000


def along(axis: int, start: int | None, stop: int | None, ndim: int) -> tuple[slice, ...]:
    """Return the index that takes start:stop of one axis and everything of the others."""
    index = [slice(None)] * ndim
    index[axis] = slice(start, stop)
    return tuple(index)


def second_difference(values: Array, axis: int, step: int = 1) -> Array:
    """Compute x[i - step] - 2 x[i] + x[i + step] along an axis, which becomes 2 step shorter."""
    ndim = values.ndim
    found: Array = values[along(axis, None, -2 * step, ndim)] + values[along(axis, 2 * step, None, ndim)]
    found -= 2 * values[along(axis, step, -step, ndim)]
    return found


def all_three(flags: Flags, axis: int) -> Flags:
    """Return where a cell and its two neighbours along an axis are True; the axis becomes 2 shorter."""
    ndim = flags.ndim
    found: Flags = flags[along(axis, None, -2, ndim)] & flags[along(axis, 2, None, ndim)]
    found &= flags[along(axis, 1, -1, ndim)]
    return found


def inner(values: Array, axes: Sequence[int]) -> Array:
    """Return the values without the first and the last cell of these axes, a view."""
    cut = [slice(None)] * values.ndim
    for axis in axes:
        cut[axis] = slice(1, -1)
    return values[tuple(cut)]


def median_of_three(values: Array, axis: int) -> Array:
    """Return the median of each cell and its two neighbours along an axis; cells at the ends do not change."""
    if values.shape[axis] < 3:
        return values
    ndim = values.ndim
    before, at, after = (values[along(axis, i, (i - 2) or None, ndim)] for i in range(3))
    found = values.copy()
    found[along(axis, 1, -1, ndim)] = np.maximum(np.minimum(before, at), np.minimum(np.maximum(before, at), after))
    return found


def dilated(flags: Flags, radius: int, axes: Sequence[int]) -> Flags:
    """Return the flags dilated by a box of this radius along the axes."""
    for axis in axes:
        found, ndim = flags.copy(), flags.ndim
        for k in range(1, min(radius, flags.shape[axis] - 1) + 1):
            found[along(axis, k, None, ndim)] |= flags[along(axis, None, -k, ndim)]
            found[along(axis, None, -k, ndim)] |= flags[along(axis, k, None, ndim)]
        flags = found
    return flags


def box_mean(values: Array, sides: Sequence[int]) -> Array:
    """Return the mean over a box around each cell; beyond the border the nearest cell counts."""
    from scipy import ndimage

    found: Array = ndimage.uniform_filter(values, sides, mode="nearest")
    return found


def halved(values: Array, axes: Sequence[int]) -> Array:
    """Return the means of pairs of cells along the axes; a last cell without a partner stays."""
    ndim = values.ndim
    for axis in axes:
        size = values.shape[axis]
        even = size // 2 * 2
        pairs = [list(along(axis, first, even, ndim)) for first in (0, 1)]
        for index, first in zip(pairs, (0, 1), strict=True):
            index[axis] = slice(first, even, 2)
        mean = 0.5 * (values[tuple(pairs[0])] + values[tuple(pairs[1])])
        values = mean if even == size else np.concatenate([mean, values[along(axis, size - 1, None, ndim)]], axis)
    return values


def doubled(values: Array, shape: Sequence[int], axes: Sequence[int]) -> Array:
    """Repeat each cell along the axes, the inverse of :func:`halved` in shape."""
    for axis in axes:
        values = np.repeat(values, 2, axis)[along(axis, 0, shape[axis], values.ndim)]
    return values


def smoothed(values: Array, axes: Sequence[int]) -> Array:
    """Return the values convolved with (1 4 6 4 1)/16 along the axes; two cells at each end are smoothed less."""
    ndim = values.ndim
    for axis in axes:
        for _ in range(2):
            found = values.copy()
            middle = found[along(axis, 1, -1, ndim)]
            middle *= 0.5
            middle += 0.25 * values[along(axis, None, -2, ndim)]
            middle += 0.25 * values[along(axis, 2, None, ndim)]
            values = found
    return values


def gradient_energy(values: Array, axes: Sequence[int]) -> Array:
    """Return the sum of the squared central differences along the axes; 0 at the ends of an axis for that axis."""
    found, ndim = np.zeros_like(values), values.ndim
    for axis in axes:
        slope = values[along(axis, 2, None, ndim)] - values[along(axis, None, -2, ndim)]
        slope *= slope
        slope *= 0.25
        found[along(axis, 1, -1, ndim)] += slope
    return found


def smallest(values: Array, count: int) -> npt.NDArray[np.intp]:
    """Return the indices of about `count` smallest values (n,); the bound comes from an even sample of 16,000."""
    if count >= values.size:
        return np.arange(values.size)
    sample = values[:: max(1, values.size // 16384)] if values.size > 40000 else values
    place = min(sample.size - 1, max(1, int(count / values.size * sample.size)))
    return np.flatnonzero(values <= np.partition(sample, place)[place])


def rms_of_smoothest(
    response: Array, valid: Flags, texture: Array, share: float, energy: float
) -> tuple[float, int, float]:
    """Return sigma, the number of pixels and their median texture, from the smoothest share of the valid pixels."""
    at = np.flatnonzero(valid)
    of = texture.ravel()[at]
    count = max(int(share * at.size), min(AT_LEAST, at.size // 2))
    chosen = smallest(of, count)
    squares = response.ravel()[at[chosen]].astype(np.float64) ** 2
    return math.sqrt(float(squares.mean()) / energy), int(chosen.size), float(np.median(of[chosen]))
