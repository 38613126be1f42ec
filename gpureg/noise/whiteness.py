"""Tests that tell from a plane whether its noise is white: correlation, period 2, blocks of 8, stripes, impulses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .measure import SMOOTHEST
from .measured import Fields, Measured
from .steps import Array, Flags, all_three, second_difference, smallest

# Shortest side of a plane that is tested, and the distance of tested pixels from its border.
SHORTEST, _BORDER = 32, 6
# Steps of the second differences whose variances are compared.
_STEPS = (1, 2, 3, 6)
# Bounds of the tests. White noise gives 1.0 to 1.2 for q13 and q12, because smooth places are chosen.
_CORRELATED, _PERIOD_TWO, _BLOCKS, _STRIPES = 0.92, 1.35, 1.12, 0.08
# Standard error of q13 times the square root of the number of pixels, and how many of them it must be below the bound.
_ERROR, _ERRORS = 1.5, 2.5
# Below the first bound of q13 the noise may be correlated up to this ratio of q13 and q26: textures have 1.25 and more.
_STRONGLY, _ALIKE = 0.5, 1.15
# Impulses are said if the smoothest third of the windows has this share of them; texture makes false ones.
_IMPULSES, _IMPULSES_TEXTURED, _TEXTURED = 0.0025, 0.006, 0.06
# Impulses are said without the other tests, for which too few pixels are left, from this share on.
_MANY = 0.05
# The mean over sigma of Rician noise without signal, and how close to it the darkest windows must be.
_RAYLEIGH, _CLOSE = 1.91, 0.15
# Fewest second differences, and the energy of the gradient over sigma^2 above which there is hardly any noise to test.
_FEWEST, _NO_NOISE = 300, 1e4
# Steps count as at most so many sigma, so that a few edges of the scene do not decide.
_STEP = 4.0
# A phase of 8 must stand out by so many standard errors of the mean of |x|, which are 0.75 / sqrt(n).
_CERTAIN = 5 * 0.75
# Number of pieces of a line; a stripe is in all of them, an edge in a few.
_PIECES = 6
# Standard deviations of white noise that are taken off the products of the pieces.
_BY_CHANCE = 2.0


@dataclass(frozen=True)
class Whiteness:
    """What is not white in the noise of a plane, with the numbers of the tests.

    Attributes
    ----------
    correlated, periodic, blocks, stripes, impulses, rayleigh : bool
        Neighbouring values of noise are alike; rows or columns 2 apart are alike (a mosaic of colours); blocks of 8
        x 8; whole rows or columns are offset; single pixels stand out; noise of a magnitude, which is never negative.
    long_sigma : float
        Standard deviation of the noise from pixels 6 apart, in the image's units.
    blur : float
        Standard deviation in pixels of a Gaussian that makes white noise as correlated; 0 if it is not.
    stripe_rows, stripe_columns : float
        Standard deviation of the offsets of rows and of columns, over sigma; 0 unless they are certain.
    share_of_impulses : float
        Share of the impulses in the smoothest third of the windows.
    """

    correlated: bool
    periodic: bool
    blocks: bool
    stripes: bool
    impulses: bool
    rayleigh: bool
    long_sigma: float
    blur: float
    stripe_rows: float
    stripe_columns: float
    share_of_impulses: float


def whiteness(measured: Measured) -> Whiteness | None:
    """Test the noise of a plane; None if the plane is too small, has too few smooth pixels, or sparse counts."""
    fields = measured.fields
    if fields is None or measured.sparse or fields.values.ndim != 3 or min(fields.values.shape[1:]) < SHORTEST:
        return None
    ok = fields.usable & fields.centres
    texture = np.where(ok, fields.texture, np.inf)
    cut = np.s_[:, _BORDER:-_BORDER, _BORDER:-_BORDER]
    inner = texture[cut]
    known = np.flatnonzero(np.isfinite(inner))
    if known.size < 1000:
        return None
    of = inner.ravel()[known]
    chosen = known[smallest(of, max(int(SMOOTHEST * known.size), min(1000, known.size // 2)))]
    tile, row, column = np.unravel_index(chosen, inner.shape)
    at = np.ravel_multi_index((tile, row + _BORDER, column + _BORDER), fields.values.shape)
    variances = np.array([_variances(fields.values, at[_complete(ok, at, axis)], axis) for axis in (1, 2)])
    third, half = (float(np.quantile(of[:: max(1, of.size // 16384)], share)) for share in (1 / 3, 1 / 2))
    smooth = fields.texture <= third
    share = float(np.count_nonzero(fields.impulses & smooth)) / max(1, int(np.count_nonzero(smooth)))
    if np.isnan(variances).any():
        # so many impulses that hardly a pixel has all its neighbours
        return _only_impulses(share) if share > _MANY else None
    q12, q13, q26 = (
        float(np.sqrt(np.prod(variances[:, i] / np.maximum(variances[:, j], 1e-30))))
        for i, j in ((0, 1), (0, 2), (1, 3))
    )
    periodic = q12 > _PERIOD_TWO
    like = q13 < q26 * (_ALIKE if q13 < _STRONGLY else 1)  # texture has a larger q13 than q26
    bound = _CORRELATED * (1 - _ERRORS * _ERROR / math.sqrt(chosen.size))
    correlated = not periodic and q13 < bound and like and measured.texture < _NO_NOISE
    rows, columns = (_stripes(fields, axis) for axis in (1, 2))
    least = _IMPULSES if measured.texture < _TEXTURED else _IMPULSES_TEXTURED
    dark = float(np.median(fields.values.ravel()[at]))
    positive = fields.low >= 0 and measured.clipped_low < 0.01
    level = (dark * fields.scale + fields.offset) / (fields.sigma * fields.scale)
    return Whiteness(
        correlated=correlated,
        periodic=periodic,
        # what was a JPEG has few levels
        blocks=not periodic and fields.whole and max(_steps_by_phase(fields, half, axis) for axis in (1, 2)) > _BLOCKS,
        stripes=not periodic and max(rows, columns) > 0,
        # in a mosaic each pixel of a saturated colour is far from all its neighbours
        impulses=not correlated and not periodic and share > least,
        rayleigh=positive and abs(level - _RAYLEIGH) < _CLOSE,
        long_sigma=float(np.sqrt(np.mean(variances[:, 3]) * math.pi / 2 / 6)) * fields.scale,
        blur=_blur(q13) if correlated else 0.0,
        stripe_rows=rows,
        stripe_columns=columns,
        share_of_impulses=share,
    )


def _only_impulses(share: float) -> Whiteness:
    """Return the tests of a plane of which only the impulses can be told."""
    return Whiteness(
        correlated=False,
        periodic=False,
        blocks=False,
        stripes=False,
        impulses=True,
        rayleigh=False,
        long_sigma=0.0,
        blur=0.0,
        stripe_rows=0.0,
        stripe_columns=0.0,
        share_of_impulses=share,
    )


def _complete(ok: Flags, at: npt.NDArray[np.intp], axis: int) -> Flags:
    """Return at which of these pixels all pixels of the second differences count."""
    flat, stride = ok.ravel(), (ok.shape[2] if axis == 1 else 1)
    return np.asarray(np.logical_and.reduce([flat[at + sign * step * stride] for step in _STEPS for sign in (-1, 1)]))


def _variances(values: Array, at: npt.NDArray[np.intp], axis: int) -> list[float]:
    """Return the squared trimmed means of second differences |x[i - k] - 2 x[i] + x[i + k]| for each step k.

    NaN if there are too few.
    """
    if at.size < _FEWEST:
        return [math.nan] * len(_STEPS)
    flat, stride = values.ravel(), (values.shape[2] if axis == 1 else 1)
    own = 2 * flat[at]
    found = []
    for step in _STEPS:
        sizes = np.abs(flat[at - step * stride] + flat[at + step * stride] - own)
        found.append(float(np.minimum(sizes, 2.5 * max(float(sizes.mean()), 1e-30)).mean()) ** 2)
    return found


def _blur(ratio: float) -> float:
    """Return the Gaussian blur of white noise with this ratio of the variances of steps 1 and 3."""
    widths = np.linspace(0.05, 4, 400)

    def variance(step: int) -> npt.NDArray[np.float64]:
        # the correlation of blurred white noise at distance k is exp(-k^2 / 4 s^2)
        at: npt.NDArray[np.float64] = np.exp(-(step**2) / (4 * widths**2))
        return np.asarray(6 - 8 * at + 2 * np.exp(-((2 * step) ** 2) / (4 * widths**2)))

    return float(widths[np.argmin(np.abs(variance(1) / variance(3) - ratio))])


def _steps_by_phase(fields: Fields, bound: float, axis: int) -> float:
    """Return the largest mean step between neighbours at a phase modulo 8, over the median of the phases.

    Five standard errors are taken off.
    """
    values = fields.values
    one, other = (np.s_[:, 1:], np.s_[:, :-1]) if axis == 1 else (np.s_[:, :, 1:], np.s_[:, :, :-1])
    ok = fields.usable & fields.centres
    known = ok[one] & ok[other] & (fields.texture[one] < bound)
    steps = np.abs(values[one] - values[other])
    np.minimum(steps, _STEP * fields.sigma, out=steps)
    steps *= known
    across = (0, 3 - axis)
    total, count = steps.sum(axis=across, dtype=np.float64), known.sum(axis=across)
    sums = np.array([(total[phase::8].sum(), count[phase::8].sum()) for phase in range(8)])
    sums = sums[sums[:, 1] > 0]
    if len(sums) < 6:
        return 0.0
    means = sums[:, 0] / sums[:, 1]
    most = int(np.argmax(means))
    middle = float(np.median(means)) * (1 + _CERTAIN / math.sqrt(sums[most, 1]))
    return float(means[most]) / middle if middle > 0 else 0.0


def _stripes(fields: Fields, axis: int) -> float:
    """Return the standard deviation of the offsets of lines, over sigma; 0 unless they are certain.

    Second differences across the lines are averaged over pieces of a line. Products of pairs of pieces do not contain
    the variance of the means; the second smallest of 15 does not contain an edge that is in some of the pieces.
    """
    across = second_difference(fields.values, axis)
    known = all_three(fields.usable & fields.centres, axis)
    limit, bound = 6 * fields.sigma, 6 * fields.sigma**2
    across = np.clip(across, -limit, limit) * known
    along = 3 - axis
    pieces = [
        part.sum(axis=along, dtype=np.float64) / np.maximum(1, of.sum(axis=along))
        for part, of in zip(np.array_split(across, _PIECES, along), np.array_split(known, _PIECES, along), strict=True)
    ]
    products = sorted(
        float(np.clip(pieces[i] * pieces[j], -bound, bound).mean())
        for i in range(_PIECES)
        for j in range(i + 1, _PIECES)
    )
    # white noise gives products with this standard deviation
    lines, width = across.shape[axis] * across.shape[0], across.shape[along] / _PIECES
    chance = 6 / width / math.sqrt(lines) * fields.sigma**2
    certain = math.sqrt(max(products[1] - _BY_CHANCE * chance, 0.0) / 6) / fields.sigma
    return math.sqrt(max(products[1], 0.0) / 6) / fields.sigma if certain > _STRIPES else 0.0
