"""An image as a function on the cells of a grid, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import all_finite, unmasked


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
