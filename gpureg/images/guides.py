"""Images that weights compare: guides, and images filled outside a mask; the contrast of an image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import unmasked
from ..graphs.grid import GridGraph
from ..noise.survey import spans_of
from ..weights import Patch, Smoothed, Weights, guided, patch_weights
from .noise import Noise
from .raster import Raster


def filled(f0: npt.NDArray[Any], inside: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
    """Replace the pixels outside the mask by the nearest ones inside, for patches that cover them."""
    from scipy import ndimage

    if not inside.any():
        return np.zeros_like(f0)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    spread: npt.NDArray[Any] = f0[tuple(nearest)]
    return spread


def for_a_guide(weights: Weights | npt.ArrayLike) -> Weights | npt.ArrayLike:
    """Return the rule's weights for a guide: no noise is subtracted and nothing blurred, as its noise is unknown."""
    found = patch_weights(weights)
    return replace(found[0], sigma=0.0) if found is not None and isinstance(found[0], Patch) else weights


def guided_by(
    weights: Weights | npt.ArrayLike, guide: npt.ArrayLike, grid: GridGraph, channel_axis: int | None
) -> Weights:
    """Return a weight function that compares a guide: an image of the grid's shape, with or without channels.

    Raises
    ------
    TypeError, ValueError
        Not a weight function, or a guide of another shape or with values that are not finite.
    """
    if not isinstance(weights, Weights):
        raise TypeError("a guide needs weights that are computed from it, such as gpureg.weights.bilateral(...)")
    values = guide_values(guide, grid, channel_axis)
    if isinstance(weights, Smoothed) and weights.opponent and values.shape[1] != 3:
        weights = replace(weights, opponent=False)
    return guided(weights, values)


def guide_values(guide: npt.ArrayLike, grid: GridGraph, channel_axis: int | None) -> npt.NDArray[Any]:
    """Return the values of a guide on the vertices of a grid, (n, q); outside the mask those of the nearest inside.

    Raises
    ------
    TypeError, ValueError
        A guide of another shape, or of no real numbers.
    """
    array = unmasked(guide, "guide")
    axis = -1 if channel_axis is None else channel_axis
    cells = array[..., None] if array.ndim == grid.ndim else np.moveaxis(array, axis, -1) if array.ndim else array
    if cells.shape[:-1] != grid.shape or array.dtype.kind not in "biuf":
        raise ValueError(
            f"guide must hold numbers on the image's {grid.shape} pixels, with channels or without; "
            f"got {array.dtype} of shape {array.shape}"
        )
    values: npt.NDArray[Any] = cells.astype(np.float64)
    if grid.mask is not None and not grid.mask.all():
        values = filled(values, grid.mask)
    return values.reshape(grid.n_vertices, -1)


def contrast(raster: Raster, noise: Noise, units: Sequence[float] | None = None) -> tuple[float, float]:
    """Estimate the range of the image without noise, over all channels in their units, and the share of equal values.

    The range is that of means of 7 pixels along each axis, where there is noise: areas of equal values, impulses and
    the outermost thousandths of the values do not count.
    """
    report = noise.report
    if report is None or not noise.estimated or len(report.channels) != raster.channels or not report.spans:
        ends, flat = spans_of(raster.values, raster.channel_axis, raster.inside)
    else:
        ends, flat = report.spans, min(channel.flat for channel in report.channels)
    known = [(low / unit, high / unit) for (low, high), unit in zip(ends, units or (1.0,) * len(ends), strict=True)]
    known = [(low, high) for low, high in known if math.isfinite(low) and high > low]
    if not known:
        return 0.0, flat
    if units is not None:
        return max(high - low for low, high in known), flat
    return max(high for _, high in known) - min(low for low, _ in known), flat
