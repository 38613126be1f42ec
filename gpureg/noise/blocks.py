"""Measure noise in planes and volumes of an image."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import all_finite, unmasked

# Share of the pixels that is measured, the smoothest ones, and the smallest number of them.
SMOOTHEST, AT_LEAST = 0.1, 200
_SECOND_DIFFERENCE = (1.0, -2.0, 1.0)
# An image is a volume, not a stack of planes, if its third last axis has at least this length.
_THICK = 8
# Images of more pixels are measured in evenly spread tiles, about 2^22 pixels in all: for each number of axes, the
# number of tiles along an axis, and their side.
LARGE, TILES = 1 << 22, {2: (8, 256), 3: (4, 40)}
# Side of the window in which texture is averaged, for each number of axes.
WINDOW = {2: 7, 3: 5}
Block = tuple[npt.NDArray[Any], npt.NDArray[np.bool_] | None]


@dataclass(frozen=True)
class _Measured:
    """The measures of a part of a block, arrays of its shape: smoothed values, Immerkaer's response, texture, mask."""

    smooth: npt.NDArray[np.float64]
    response: npt.NDArray[np.float64]
    texture: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]


def blocks(image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None) -> Iterator[Iterator[Block]]:
    """Check an image, and yield for each channel its planes or volumes with a pixel inside the mask."""
    array = unmasked(image, "image")
    if array.dtype.kind not in "biuf":
        raise TypeError(f"image must hold real numbers, got {array.dtype}")
    channels = [array] if channel_axis is None else list(np.moveaxis(array, channel_axis, 0))
    if not channels or channels[0].ndim < 2:
        raise ValueError(f"image must have two or more axes besides the channels, got shape {array.shape}")
    shape = channels[0].shape
    inside = None if mask is None else np.asarray(mask, bool)
    if inside is not None and inside.shape != shape:
        raise ValueError(f"mask must have the image's shape {shape}, got {inside.shape}")
    thick = len(shape) > 2 and shape[-3] >= _THICK

    def blocks(channel: npt.NDArray[Any]) -> Iterator[Block]:
        cut = channel.reshape(-1, *shape[-3 if thick else -2 :])
        masks = [None] * len(cut) if inside is None else inside.reshape(cut.shape)
        for block, kept in zip(cut, masks, strict=True):
            known = block if kept is None else block[kept]
            if not all_finite(known):
                raise ValueError("image must be finite inside the mask")
            if known.size:
                yield block, kept

    return (blocks(channel) for channel in channels)


def samples(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Yield the parts of a block to measure: the whole block, or tiles of a large one."""
    if math.prod(shape) <= LARGE:
        yield tuple(slice(0, size) for size in shape)
        return
    tiles, side = TILES[len(shape)]
    starts = [sorted({(size - min(size, side)) * i // (tiles - 1) for i in range(tiles)}) for size in shape]
    for corner in np.stack(np.meshgrid(*starts, indexing="ij"), axis=-1).reshape(-1, len(shape)).tolist():
        yield tuple(slice(begin, begin + side) for begin in corner)


def top(block: npt.NDArray[Any], kept: npt.NDArray[np.bool_] | None) -> float:
    """Return the largest value inside the mask."""
    return float((block if kept is None else block[kept]).max())


def block_sigma(block: npt.NDArray[Any], mask: npt.NDArray[np.bool_] | None) -> float:
    """Estimate the standard deviation of the noise in a plane or a volume."""
    low = float((block if mask is None else block[mask]).min())
    responses, textures = [], []
    for part in measured(block, mask, (low, top(block, mask))):
        if not part.valid.any() and block.size <= LARGE:
            # A tiny picture, or one of few values. Repeated values are not noise, since values of noise differ.
            if (mask is None or mask.all()) and np.unique(block).size > block.size // 4:
                inner = part.response[(slice(1, -1),) * block.ndim]
                return float(np.median(np.abs(inner)) / 0.6744897501960817)  # the median of |x| for a standard normal x
            return 0.0
        responses.append(part.response[part.valid])
        textures.append(part.texture[part.valid])
    response, texture = np.concatenate([*responses, []]), np.concatenate([*textures, []])
    if not response.size:
        return 0.0
    return float(np.sqrt(np.mean(response[smoothest(texture, SMOOTHEST)] ** 2)))


def smoothest(texture: npt.NDArray[np.float64], share: float) -> npt.NDArray[np.intp]:
    """Return the indices of this share of the pixels, but at least AT_LEAST, with the weakest texture (n,)."""
    count = max(int(share * texture.size), min(AT_LEAST, texture.size))
    return np.argpartition(texture, min(count, texture.size - 1))[:count]


def measured(
    block: npt.NDArray[Any], mask: npt.NDArray[np.bool_] | None, extremes: tuple[float, float]
) -> Iterator[_Measured]:
    """Yield the measures of all parts; pixels near a pixel with a value of `extremes` do not count."""
    from scipy import ndimage

    if min(block.shape) < 3:
        return
    for part in samples(block.shape):
        values = block[part].astype(np.float64)
        kept = np.ones(values.shape, bool) if mask is None else mask[part]
        if not kept.any():
            continue
        values = np.where(kept, values, values[kept].mean())
        # The mask is the outer product of second differences, each of l2 norm sqrt(6).
        response: Any = values
        for axis in range(values.ndim):
            response = ndimage.correlate1d(response, _SECOND_DIFFERENCE, axis)
        smooth = ndimage.gaussian_filter(values, 1.0)
        slopes = (ndimage.correlate1d(smooth, (-0.5, 0.0, 0.5), axis) for axis in range(values.ndim))
        window = WINDOW[values.ndim]
        texture = ndimage.uniform_filter(sum(slope**2 for slope in slopes), window)
        left_out = np.isin(values, extremes) | ~kept
        valid = np.zeros(values.shape, bool)
        inner = (slice(1, -1),) * values.ndim  # the mask needs all neighbours
        valid[inner] = ~ndimage.maximum_filter(left_out, window)[inner]
        yield _Measured(smooth, response / 6.0 ** (values.ndim / 2), texture, valid)
