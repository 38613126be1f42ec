"""PSNR and SSIM of a denoised picture file against a clean one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import plot
from ..files.pictures import Picture, PictureError, read_picture
from .inputs import Inside
from .slices import Layout

Clean = tuple[npt.NDArray[Any], tuple[float, float]]
Quality = tuple[float, float]


def qualities(
    picture: Picture, layout: Layout, after: npt.NDArray[Any], clean: Clean, inside: Inside
) -> tuple[Quality, Quality]:
    """Return PSNR and SSIM of the input and of the output, counting the pixels that take part."""
    axes, (truth, limits) = picture.axes, clean
    axis = None if picture.channel_axis is None else -1
    found = inside.of(picture.pixels, {})
    valid = None if found is None or found.all() else layout.turned(found, axes.replace("C", ""))
    slices = (layout.turned(pixels, axes) for pixels in (picture.pixels, after))
    before, behind = (_quality(each, layout.turned(truth, axes), valid, limits, axis) for each in slices)
    return before, behind


def reference_of(picture: Picture, source: Path, path: Path) -> tuple[npt.NDArray[Any], tuple[float, float]]:
    """Read the clean picture, and return it with the range of values for the PSNR."""
    clean = read_picture(path, picture.axes if picture.is_stack else None).pixels
    if clean.shape != picture.pixels.shape:
        raise PictureError(f"the reference {path} has the shape {clean.shape}, {source} has {picture.pixels.shape}")
    whole = [array.dtype for array in (picture.pixels, clean) if array.dtype.kind == "u"]
    if len(set(whole)) > 1:
        raise PictureError(f"the reference {path} holds {clean.dtype}, {source} {picture.pixels.dtype}; convert one")
    if whole:
        return clean, (0, np.iinfo(whole[0]).max)
    finite = clean[np.isfinite(clean)]
    if not (finite.size and finite.max() > finite.min()):
        raise PictureError(f"the reference {path} has no range for the PSNR: its values are constant or not finite")
    return clean, (float(finite.min()), float(finite.max()))


def _quality(
    slices: npt.NDArray[Any],
    clean: npt.NDArray[Any],
    valid: npt.NDArray[np.bool_] | None,
    limits: tuple[float, float],
    axis: int | None,
) -> tuple[float, float]:
    """Compute the PSNR of all slices (s, ...), and the mean SSIM over slices and time."""
    if valid is not None:
        slices = np.where(valid if axis is None else valid[..., None], slices, np.nan)
    cells = slices.ndim - (axis is not None)
    try:
        if len(slices) == 1 and cells <= 4:
            return plot.quality(slices[0], clean[0], limits, channel_axis=axis)
        flat = (-1, *slices.shape[cells - 1 :])
        psnr, _ = plot.quality(slices.reshape(flat), clean.reshape(flat), limits, channel_axis=axis)
        parts = (array.reshape(-1, *array.shape[2 if cells == 5 else 1 :]) for array in (slices, clean))
        found = [plot.quality(one, other, limits, channel_axis=axis)[1] for one, other in zip(*parts, strict=True)]
    except ImportError as error:
        raise PictureError(f"--reference: {error}") from None
    known = [ssim for ssim in found if not math.isnan(ssim)]
    return psnr, sum(known) / len(known) if known else math.nan
