"""Measure how the variance of noise grows with the signal: :func:`fit_growth`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .graphs import MEDIAN
from .measured import Measured
from .steps import Array, inner

# Number of classes of brightness with equal numbers of pixels, the share of each that is measured, the smoothest, and
# the fewest pixels of a class; Huber's bound and the rounds of the fit of their line.
_CLASSES, _SHARE, _FEWEST, _HUBER, _ROUNDS = 24, 0.2, 100, 1.345, 10
# Bins of the histogram from which the classes follow.
_BINS = 1 << 14
# Most pixels that are sorted into classes.
_MOST = 200_000
# Brightnesses this close to an end of the range, in sigma, are left out if more than this share is clipped there.
_NEAR, _CLIPPED = 3.0, 0.005
# Growth is said if the slope is so many times its standard error, the variance grows by this factor from the 5th to the
# 95th percentile of brightness, and the rank correlation of classes and variances is at least this.
_SURE, _FACTOR, _RANKS = 5.0, 1.5, 0.6
# Growth is likely enough to look for impulses again with the line.
_LIKELY = 3.0


@dataclass(frozen=True)
class Growth:
    """The line variance = slope * mean + level, in the image's units, fitted to classes of brightness.

    Attributes
    ----------
    slope, level : float
        For photon noise the slope is the gain, and the level is read_noise^2 - gain * offset.
    error : float
        Standard error of the slope.
    factor : float
        Variance at the 95th percentile of brightness over that at the 5th.
    ranks : float
        Rank correlation of the brightness and the variance of the classes.
    mean_variance : float
        Mean variance of the classes.
    dark : float
        Brightness of the darkest 0.1 percent.
    """

    slope: float
    level: float
    error: float
    factor: float
    ranks: float
    mean_variance: float
    dark: float

    @property
    def is_likely(self) -> bool:
        """Whether the noise seems to grow with the signal."""
        return self.slope > _LIKELY * self.error

    @property
    def is_certain(self) -> bool:
        """Whether the noise grows with the signal beyond doubt."""
        return self.slope > _SURE * self.error and self.factor > _FACTOR and self.ranks > _RANKS


def fit_growth(cells: Sequence[Array]) -> Growth | None:
    """Fit the line to the cells of planes or volumes; None if too few pixels or brightnesses are left."""
    if not any(part.size for part in cells):
        return None
    cells = [part for part in cells if part.size]
    mean, square, texture = np.concatenate(cells, axis=1)
    if mean.size < _CLASSES * _FEWEST:
        return None
    means, variances, counts = _classes(mean, square, texture)
    if len(means) < 4 or means[-1] <= means[0] or not (np.isfinite(variances).all() and variances.mean() > 0):
        return None
    # the units of the data do not matter
    unit, middle = float(np.mean(variances)), float(np.mean(means))
    width = float(means[-1] - means[0])
    slope, level, error = _line((means - middle) / width, variances / unit, counts)
    slope, error, level = slope * unit / width, error * unit / width, level * unit
    some = mean[:: max(1, mean.size // 16384)]
    low, high = np.percentile(some, [5, 95]) - middle
    least = max(slope * low + level, 0.02 * unit)
    ranks = np.corrcoef(np.argsort(np.argsort(means)), np.argsort(np.argsort(variances)))[0, 1]
    return Growth(
        slope=slope,
        level=level - slope * middle,
        error=error,
        factor=(slope * high + level) / least,
        ranks=float(ranks),
        mean_variance=unit,
        dark=float(np.percentile(some, 0.1)),
    )


def cells_of(part: Measured, parts: int = 1) -> Array:
    """Return brightness, squared response and texture of valid pixels of a part, (3, n), in the image's units.

    Of several `parts`, each gives its share of the pixels that are used.
    """
    fields = part.fields
    if fields is None:
        return np.empty((3, 0))
    axes, scale = fields.axes, fields.scale
    smooth, texture = inner(fields.smooth, axes), inner(fields.texture, axes)
    valid = fields.valid
    if smooth.shape != valid.shape:
        return np.empty((3, 0))
    for end, clipped in ((fields.low, part.clipped_low), (fields.high, part.clipped_high)):
        if clipped > _CLIPPED:
            valid = valid & (np.abs(smooth - (end - fields.offset) / scale) > _NEAR * fields.sigma)
    at = np.flatnonzero(valid)
    at = at[:: at.size * parts // _MOST + 1]
    response = fields.response.ravel()[at].astype(np.float64)
    brightness = smooth.ravel()[at].astype(np.float64)
    brightness *= scale
    brightness += fields.offset
    with np.errstate(over="ignore", under="ignore"):  # values beyond 1e150 tell nothing
        response *= scale / 6.0 ** (len(axes) / 2)
        response *= response
    return np.stack([brightness, response, texture.ravel()[at]])


def _classes(mean: Array, square: Array, texture: Array) -> tuple[Array, Array, Array]:
    """Return brightness, variance and number of pixels, (k,) each, of the smoothest pixels of classes."""
    found = []
    for members in _of_equal_counts(mean):
        count = max(int(_SHARE * members.size), _FEWEST)
        if members.size >= _FEWEST:
            chosen = members[np.argpartition(texture[members], min(count, members.size - 1))[:count]]
            found.append((mean[chosen].mean(dtype=np.float64), square[chosen].mean(dtype=np.float64), chosen.size))
    means, variances, counts = np.array(found, np.float64).reshape(-1, 3).T
    return means, variances, counts


def _of_equal_counts(mean: Array) -> list[npt.NDArray[np.intp]]:
    """Return the indices of the pixels of each class of brightness: equal counts, up to a bin of the histogram."""
    low, high = float(mean.min()), float(mean.max())
    if high <= low:
        return []
    bins = ((mean - low) * (_BINS / (high - low))).astype(np.int32)
    np.minimum(bins, _BINS - 1, out=bins)
    cumulated = np.cumsum(np.bincount(bins, minlength=_BINS))
    # the class of a bin is that of its middle pixel
    middle = cumulated - 0.5 * np.diff(cumulated, prepend=0)
    of_bin = np.minimum(middle * (_CLASSES / mean.size), _CLASSES - 1).astype(np.uint8)
    of_pixel = of_bin[bins]
    order = np.argsort(of_pixel, kind="stable")
    return np.split(order, np.cumsum(np.bincount(of_pixel, minlength=_CLASSES))[:-1])


def _line(means: Array, variances: Array, counts: Array) -> tuple[float, float, float]:
    """Fit a line with weights from the scatter and Huber's weights; return slope, level and the slope's error.

    The variance of a mean of n squared responses is 3/n of its square: those of neighbouring pixels are correlated.
    """
    design = np.stack([means, np.ones_like(means)], axis=1)
    weights: npt.NDArray[np.float64] = counts / (3 * np.maximum(variances, 1e-12) ** 2)
    slope = level = error = 0.0
    for _ in range(_ROUNDS):
        covariance = np.linalg.inv(design.T @ (design * weights[:, None]))
        slope, level = (covariance @ (design.T @ (weights * variances))).tolist()
        model = np.maximum(slope * means + level, 0.02 * variances.max())
        scatter = model * np.sqrt(3 / counts)
        off = np.abs(variances - model) / scatter
        spread = max(1.0, float(np.median(off)) / MEDIAN)
        weights = np.minimum(1, _HUBER * spread / np.maximum(off, 1e-9)) / scatter**2
        error = float(np.sqrt(covariance[0, 0])) * spread
    return slope, level, error
