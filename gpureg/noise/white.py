"""Estimate white noise in images."""

from __future__ import annotations

import math
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from ..checks import flag, integer
from ..doors import door, warn
from .blocks import LARGE
from .flat import flat_areas
from .steps import along
from .survey import measure_channels, root_mean_square


@overload
def estimate_noise(
    image: npt.ArrayLike,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    per_channel: Literal[False] = False,
) -> float: ...
@overload
def estimate_noise(
    image: npt.ArrayLike,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    per_channel: Literal[True],
) -> npt.NDArray[np.float64]: ...


@door
def estimate_noise(
    image: npt.ArrayLike,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    per_channel: bool = False,
) -> float | npt.NDArray[np.float64]:
    """Estimate the standard deviation of white Gaussian noise in an image, in the image's units.

    Parameters
    ----------
    image : array of two or more axes, not counting channels
        Of the axes with three pixels or more, the last three are a volume if the first of them has length 8 or more,
        otherwise the last two are a plane; other axes form a stack. Axes of length 1 do not matter.
    channel_axis : int, optional
        Axis of the channels; None for a grey image.
    mask : bool array, optional
        True at the pixels to use; NaN is allowed at the others.
    per_channel : bool, default False
        Return one value per channel instead of one for all.

    Returns
    -------
    float, or (channels,) float array
        Root mean square over a stack, and over channels unless `per_channel`. 0 means that there is no noise: the image
        has only areas of equal values, or no second differences. NaN means that the noise cannot be told.

    Raises
    ------
    TypeError, ValueError
        The image has fewer than two axes, or values that are not real and finite.

    Warns
    -----
    UserWarning
        The noise cannot be told: fewer than 50 pixels count, no axis has three pixels, hardly a pixel has neighbours
        that count, or every pixel is written twice.

    Notes
    -----
    Immerkaer's filter (Computer Vision and Image Understanding 64(2), 1996) takes second differences along every
    axis, which removes planes and functions of one coordinate. It is applied where texture is weakest, as Liu, Tanaka
    and Okutomi propose (IEEE TIP 22(12), 2013). Texture is the energy of the gradient of the Gaussian-smoothed image.
    It contains almost none of the frequencies of the filter, so that smooth regions are not chosen for little noise.
    Left out are areas of exactly equal values (2 x 2 numbers or 3 x 3 integers and more: noise is not equal), impulses,
    and the surroundings of pixels at the ends of the range, since clipping removed their noise. Where few pixels have
    all their neighbours, second differences along one axis are used. On ten photographs with sigma from 5 to 60 of 255,
    the error is at most 3 percent from 10 on, and 5 percent (root mean square) at 5, where their own grain is measured
    too; a texture that fills the picture is taken for noise. Of more than 2^19 pixels of a plane, or 2^21 of a
    volume, about as many are measured, in evenly spread tiles; of a series at least 16 planes. Correlated noise comes
    out too small, that of a mosaic of colours too large: :func:`describe_noise` says so.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.add.outer(np.arange(128.0), np.arange(128.0))
    >>> round(estimate_noise(ramp + np.random.default_rng(7).normal(0, 5, ramp.shape)), 1)
    5.0
    """
    per_channel = flag("per_channel", per_channel)
    check_channel_axis(image, channel_axis)
    channels = measure_channels(image, channel_axis, mask)
    sigmas, reasons = [], []
    for parts in channels:
        told = [part.sigma for part in parts if part.state != "cannot tell"]
        sigmas.append(root_mean_square(told))
        if not told:
            reasons.append(parts[0].why if parts else "no pixel counts")
    if reasons:
        which = "" if len(channels) == 1 else f" of {len(reasons)} of {len(channels)} channels"
        warn(f"the noise{which} cannot be told, the estimate is NaN: {reasons[0]}")
    if per_channel:
        return np.array(sigmas)
    return root_mean_square([sigma for sigma in sigmas if not math.isnan(sigma)])


def check_channel_axis(image: npt.ArrayLike, channel_axis: int | None) -> None:
    """Raise TypeError or ValueError if an image does not have this axis of channels."""
    if channel_axis is not None:
        ndim = np.ndim(image)
        integer("channel_axis", channel_axis, low=-ndim, high=ndim - 1)


def gradient_to_noise(
    array: npt.NDArray[Any], sigma: float, *, channel_axis: int | None, mask: npt.NDArray[np.bool_] | None
) -> float:
    """Estimate the root mean square of the clean image's differences between neighbours, divided by sigma.

    The variance of the noise, 2 sigma^2, is subtracted from the mean square of the noisy differences, down to 0. Areas
    of equal values do not count, and a difference counts as at most 4 times the 99th percentile, so that a few outliers
    do not decide.
    """
    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    whole = array.dtype.kind in "iub"
    axes = [axis for axis in range(cells.ndim - 1) if cells.shape[axis] > 1]
    rows = max(1, LARGE // max(1, cells[0].size))
    squares, counts = np.zeros(cells.ndim - 1), np.zeros(cells.ndim - 1)
    limit = _largest_step(cells, axes) / sigma
    for first in range(0, len(cells), rows):
        exact = cells[first : first + rows + 1]
        inside = np.ones(exact.shape[:-1], bool) if mask is None else mask[first : first + rows + 1]
        known = inside[..., None] & np.ones(exact.shape[-1], bool)
        known &= ~flat_areas(exact, known, range(exact.ndim - 1), whole=whole)[0]
        complete = bool(known.all())
        band = exact if exact.dtype == np.float32 else exact.astype(np.float64)
        for axis in axes:
            one, other = along(axis, 1, None, band.ndim), along(axis, None, -1, band.ndim)
            steps = band[one] - band[other]
            if not complete:
                steps = steps[known[one] & known[other]]
            steps *= 1 / sigma
            np.clip(steps, -limit, limit, out=steps)
            steps *= steps
            squares[axis] += float(np.sum(steps, dtype=np.float64))
            counts[axis] += steps.size
    total = sum(max(squares[axis] / counts[axis] - 2, 0.0) for axis in axes if counts[axis])
    return math.sqrt(total / max(1, cells.ndim - 1))


def _largest_step(cells: npt.NDArray[Any], axes: list[int]) -> float:
    """Return 4 times the 99th percentile of the differences between neighbours in some rows (infinite if it is 0)."""
    rows = cells[:: max(1, cells.size // LARGE)]
    found = math.inf
    sizes = [
        np.abs(rows[along(axis, 1, None, rows.ndim)].astype(np.float64) - rows[along(axis, None, -1, rows.ndim)])
        for axis in axes
        if rows.shape[axis] > 1 and (axis > 0 or len(rows) == len(cells))
    ]
    steps = np.concatenate([each.ravel()[:: max(1, each.size // 65536)] for each in sizes]) if sizes else np.empty(0)
    steps = steps[np.isfinite(steps)]
    if steps.size:
        found = 4 * float(np.percentile(steps[steps > 0], 99)) if (steps > 0).any() else math.inf
    return found
