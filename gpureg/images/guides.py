"""Images as functions on a grid and back: checked, with made-up values under a mask, guides, contrast."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import all_finite, unmasked
from .graphs.grid import GridGraph
from .weights import Patch, Smoothed, Weights, guided, patch_weights

# Pixels that are filtered at a time.
_BAND = 1 << 22


def checked(image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None) -> npt.NDArray[Any]:
    """`image` as an array, after checking values, axes and mask."""
    array = unmasked(image, "image")
    if array.dtype.kind not in "iuf":
        raise TypeError(f"image must hold integers or real numbers, got {array.dtype}")
    if channel_axis is not None and (isinstance(channel_axis, bool) or not isinstance(channel_axis, int | np.integer)):
        raise TypeError(f"channel_axis must be an integer, got {channel_axis!r}")
    if channel_axis is not None and not -array.ndim <= channel_axis < array.ndim:
        raise ValueError(f"channel_axis must lie in {-array.ndim}..{array.ndim - 1}, got {channel_axis}")
    cells = np.moveaxis(array, channel_axis, -1) if channel_axis is not None else array[..., None]
    if cells.ndim < 3:
        raise ValueError(f"image must have two or more axes besides the channels, got shape {array.shape}")
    if not array.size:
        raise ValueError(f"image is empty, shape {array.shape}")
    if mask is not None:
        inside = np.asarray(mask)
        if inside.dtype != np.bool_ or inside.shape != cells.shape[:-1]:
            raise ValueError(
                f"mask must be boolean of shape {cells.shape[:-1]}, got {inside.dtype} of shape {inside.shape}"
            )
        cells = cells[inside]
    if not all_finite(cells):
        bad = cells[~np.isfinite(cells)]
        raise ValueError(f"image must be finite, got {bad[0]} at {len(bad)} place(s); a mask can leave them out")
    return array


def pixels_of(
    array: npt.NDArray[Any], channel_axis: int | None, dtype: npt.DTypeLike | None
) -> npt.NDArray[np.floating[Any]]:
    """An image as floats in the type to compute in, its channels last."""
    wide = array.dtype.kind in "iu" and array.dtype.itemsize > 2
    kind = np.dtype(dtype) if dtype is not None else np.dtype(np.float64 if wide else np.float32)
    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    return cells.astype(np.result_type(kind, np.float32), copy=False)


def as_image(
    value: npt.NDArray[Any],
    array: npt.NDArray[Any],
    channel_axis: int | None,
    inside: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[Any]:
    """A regularized function as an image like `array`: its axes, its dtype, and its own pixels outside the mask."""
    image = value[..., 0] if channel_axis is None else np.moveaxis(value, -1, channel_axis)
    if array.dtype.kind in "iu" and image.dtype.kind == "f":
        limits = np.iinfo(array.dtype)
        np.clip(np.rint(image, out=image), limits.min, limits.max, out=image)
    image = np.ascontiguousarray(image).astype(array.dtype, copy=False)
    if inside is not None and not inside.all():
        outside = ~inside if channel_axis is None else np.expand_dims(~inside, channel_axis)
        image = np.where(outside, array, image)
    return image


def filled(f0: npt.NDArray[Any], inside: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
    """`f0` with pixels outside the mask replaced by the nearest inside, so that patches over them mean something."""
    from scipy import ndimage

    if not inside.any():
        return np.zeros_like(f0)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    spread: npt.NDArray[Any] = f0[tuple(nearest)]
    return spread


def for_a_guide(weights: Weights | npt.ArrayLike) -> Weights | npt.ArrayLike:
    """The rule's weights for a guide, of whose noise nothing is known: none is taken off, and nothing is blurred."""
    found = patch_weights(weights)
    return replace(found[0], sigma=0.0) if found is not None and isinstance(found[0], Patch) else weights


def guided_by(
    weights: Weights | npt.ArrayLike, guide: npt.ArrayLike, grid: GridGraph, channel_axis: int | None
) -> Weights:
    """A weight function that compares a guide: an image of the grid's shape, or with channels as the image has them.

    Raises
    ------
    TypeError, ValueError
        No weight function, or a guide of another shape, or not of finite numbers.
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


def contrast(array: npt.NDArray[Any], channel_axis: int | None, mask: npt.ArrayLike | None) -> float:
    """Range of the image without its noise: of a Gaussian-smoothed copy, over all channels."""
    from scipy import ndimage

    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    kind: Any = np.float64 if array.dtype.itemsize > 4 else np.float32
    if mask is not None:
        cells = filled(cells.astype(kind), np.asarray(mask))
    # Bands of rows with the filter's reach around them: the same values in little memory.
    spread, reach = 2.0, 8
    band = max(1, _BAND // max(1, cells[0].size))
    low, high = math.inf, -math.inf
    for first in range(0, len(cells), band):
        start, end = max(0, first - reach), min(len(cells), first + band + reach)
        part: Any = cells[start:end].astype(kind, copy=False)
        smooth = ndimage.gaussian_filter(part, (spread,) * (cells.ndim - 1) + (0.0,))[first - start :][:band]
        low, high = min(low, float(smooth.min())), max(high, float(smooth.max()))
    return high - low
