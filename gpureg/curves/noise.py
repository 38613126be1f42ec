"""Estimate the noise along a curve: :func:`noise_along`."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray
from ..noise.graphs import MEDIAN

# With fewer vertices noise cannot be distinguished from shape.
TELLING = 12

# Half the number of vertices over which running medians are taken.
_WINDOW = 30
# The noise varies along a curve if the 95 % and the 5 % quantile of its running estimate differ by more than this.
_VARIES = 2.2
# Where more than this share of the second differences is 0, the curve is made of straight lines.
_STRAIGHT = 0.6
# A coordinate is blurred if another one has more than the first number times its noise, and it moved by more than the
# second number times its noise.
_UNEVEN, _MOVED = 3.0, 1.5


def running_median(values: FloatArray, closed: bool) -> FloatArray:
    """Compute the median of the 30 values on each side and the value itself, (n,)."""
    from scipy.ndimage import median_filter

    half = min(_WINDOW, (len(values) - 1) // 2)
    found: FloatArray = median_filter(values, size=2 * half + 1, mode="wrap" if closed else "mirror")
    return found


def _differences(x: FloatArray, order: int, closed: bool) -> FloatArray:
    """Compute differences of this order, relative to their deviation for white noise of sigma 1."""
    if closed:
        x = np.concatenate([x, x[:order]])
    found: FloatArray = np.diff(x, n=order, axis=0) / math.sqrt(math.comb(2 * order, order))
    return found


def running_noise(x: FloatArray, closed: bool) -> FloatArray:
    """Estimate the noise at each vertex, (n,): the least of running medians of differences of the orders 3 and 4."""
    best = np.full(len(x), math.inf)
    for order in (3, 4):
        # each coordinate by itself: one without noise, such as a height, must not hide that of the others
        squares = _differences(x, order, closed) ** 2 / MEDIAN**2
        if closed:
            squares = np.roll(squares, order // 2, axis=0)
        else:
            squares = np.pad(squares, ((order // 2, order - order // 2), (0, 0)), mode="edge")
        best = np.minimum(best, np.mean([running_median(square, closed) for square in squares.T], axis=0))
    noise: FloatArray = np.sqrt(best)
    return noise


def noise_along(x: FloatArray, closed: bool) -> FloatArray:
    """Estimate the noise at each vertex of a path or ring, (n,): one number, unless it varies by more than chance."""
    from scipy.ndimage import uniform_filter1d

    steps = np.abs(np.diff(x, axis=0))
    still = 1e-9 * float(steps.max())
    if _on_pixels(steps, still):
        return np.full(len(x), _pixel_noise(x, closed))
    middle = _middle_noise(x, closed)
    noise = running_noise(x, closed)
    low, high = np.quantile(noise, [0.05, 0.95])
    if middle and high < _VARIES * low:
        return np.full(len(x), middle)
    bends = np.linalg.norm(_differences(x, 2, closed), axis=1) <= still
    straight = np.roll(bends, 1) if closed else np.pad(bends, 1, mode="edge")
    size = 2 * min(_WINDOW, (len(x) - 1) // 2) + 1
    share = uniform_filter1d(straight.astype(np.float64), size, mode="wrap" if closed else "mirror")
    noise[(share > _STRAIGHT) | (noise <= still)] = 0
    return noise


def _middle_noise(x: FloatArray, closed: bool) -> float:
    """Estimate one noise level for a path or ring; 0 if more than half of it is free of noise."""
    each = np.median(np.abs(_differences(x, 4, closed)), axis=0) / MEDIAN
    middle = math.sqrt(float((each**2).mean()))
    return middle if middle > 1e-9 * float(np.abs(np.diff(x, axis=0)).max()) else 0.0


def _pixel_noise(x: FloatArray, closed: bool) -> float:
    """Estimate one noise level for the outline of pixels; 0 if most differences of the fourth order are."""
    return float(np.median(np.abs(_differences(x, 4, closed)))) / MEDIAN


def is_rounded(x: FloatArray, closed: bool) -> bool:
    """Return whether a curve was rounded to pixels and has noise: then repeats come from rounding, and count."""
    if len(x) < TELLING:
        return False
    steps = np.abs(np.diff(x, axis=0))
    still = 1e-9 * float(steps.max())
    return _on_pixels(steps, still) and _pixel_noise(x, closed) > 0


def _on_pixels(steps: FloatArray, still: float) -> bool:
    """Return whether the steps (s, d) of a curve are 0, 1 or 2 of one unit: the outline of pixels, not of noise."""
    if not (steps > still).any():
        return True
    unit = float(steps[steps > still].min())
    multiple = steps / unit
    whole = np.rint(multiple)
    return bool((np.abs(multiple - whole) < 1e-6).all() and whole.max() <= 2)


def blurred_axis(x: FloatArray, moves: FloatArray, closed: bool) -> tuple[int, int, float, float] | None:
    """Find the coordinate that moved by more than its noise, because another one has far more.

    Return it, the one with the most noise, and the noise of both; None if there is none, and for curves in the plane.
    `x` are the vertices, (n, d), and `moves`, (n, d), their displacements.
    """
    if x.shape[1] < 3 or len(x) < TELLING or not moves.any():
        return None
    noise = np.array([np.median(noise_along(column[:, None], closed)) for column in x.T])
    moved = np.median(np.abs(moves), axis=0) / MEDIAN
    high = int(noise.argmax())
    blurred = (noise[high] > _UNEVEN * noise) & (moved > _MOVED * noise)
    if not blurred.any():
        return None
    low = int(np.where(blurred, moved - _MOVED * noise, -1.0).argmax())
    return low, high, float(noise[low]), float(noise[high])
