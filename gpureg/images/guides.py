"""Images that weights compare: guides, and images filled outside a mask; the contrast of an image."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import unmasked
from ..frame import limits
from ..graphs.grid import GridGraph
from ..weights import Patch, Smoothed, Weights, guided, patch_weights
from .raster import Raster

# Number of pixels filtered at a time.
_BAND = 1 << 22


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
    if isinstance(weights, Smoothed) and weights.opponent and values.shape[-1] != 3:
        weights = replace(weights, opponent=False)
    return guided(weights, values.reshape(grid.n_vertices, -1))


def contrast(raster: Raster) -> float:
    """Estimate the range of the image without noise: the range of a copy smoothed by a Gaussian, over all channels.

    Each channel is limited to the values that :func:`gpureg.frame.limits` finds, so that no single pixel decides.
    """
    from scipy import ndimage

    cells = raster.cells
    kind: Any = np.float64 if cells.dtype.itemsize > 4 else np.float32
    if raster.inside is not None:
        cells = filled(cells.astype(kind), raster.inside)
    ends = np.array(
        [
            limits(np.ravel(cells[..., c] if raster.inside is None else cells[..., c][raster.inside]))
            for c in range(cells.shape[-1])
        ]
    )
    # Bands of rows, extended by the radius of the filter, give the same values with less memory.
    spread, reach = 2.0, 8
    band = max(1, _BAND // max(1, cells[0].size))
    low, high = math.inf, -math.inf
    for first in range(0, len(cells), band):
        start, end = max(0, first - reach), min(len(cells), first + band + reach)
        part: Any = np.clip(cells[start:end].astype(kind, copy=False), *ends.T.astype(kind))
        smooth = ndimage.gaussian_filter(part, (spread,) * (cells.ndim - 1) + (0.0,))[first - start :][:band]
        low, high = min(low, float(smooth.min())), max(high, float(smooth.max()))
    return high - low
