"""Split an image into the planes and volumes in which its noise is measured."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import all_finite, unmasked
from .steps import Flags

# Three axes are a volume, not a stack of planes, if the first of them has at least this length.
_THICK = 8
# Planes of more pixels, and volumes of 4 times as many, are measured in evenly spread tiles, about as many pixels in
# all: for each number of axes, the number of tiles along an axis, and their side. Tiles start at multiples of 8, the
# side of the blocks of a JPEG. On mosaics of photographs tiles are within 1 percent of the estimate from all pixels.
LARGE, TILES = 1 << 19, {2: (8, 88), 3: (4, 32)}
_GRID = 8
# Of a series, evenly spread planes or volumes are measured: at least this number, and about so many pixels.
FEWEST, MOST = 16, 1 << 22


@dataclass(frozen=True, eq=False)
class Block:
    """A plane, a volume, or several tiles of one.

    Attributes
    ----------
    values : (b, ...) array
        The tiles, one after the other; b is 1 for a whole plane or volume.
    inside : (b, ...) bool array or None
        True at the pixels that count; None for all.
    """

    values: npt.NDArray[Any]
    inside: Flags | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        """The axes along which neighbours are compared: all but the first."""
        return tuple(range(1, self.values.ndim))

    @property
    def good(self) -> Flags:
        """True at the finite pixels inside the mask."""
        finite = np.isfinite(self.values) if self.values.dtype.kind == "f" else np.ones(self.values.shape, bool)
        return finite if self.inside is None else finite & self.inside


def channels_of(
    image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None
) -> tuple[list[npt.NDArray[Any]], Flags | None]:
    """Check an image, and return its channels and its mask.

    Raises
    ------
    TypeError, ValueError
        Fewer than two axes, values that are not real and finite inside the mask, a mask of another shape.
    """
    array = unmasked(image, "image")
    if array.dtype.kind not in "biuf":
        raise TypeError(f"image must hold real numbers, got {array.dtype}")
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    channels = [array] if channel_axis is None else list(np.moveaxis(array, channel_axis, 0))
    if not channels or channels[0].ndim < 2:
        raise ValueError(f"image must have two or more axes besides the channels, got shape {array.shape}")
    shape = channels[0].shape
    inside = None if mask is None else np.asarray(mask, bool)
    if inside is not None and inside.shape != shape:
        raise ValueError(f"mask must have the image's shape {shape}, got {inside.shape}")
    for channel in channels:
        if not all_finite(channel if inside is None else channel[inside]):
            raise ValueError("image must be finite inside the mask")
    return channels, inside


def measured_axes(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the axes of a plane or a volume; shorter axes than 3 cannot be measured, others form a stack."""
    usable = [axis for axis, size in enumerate(shape) if size >= 3]
    thick = len(usable) > 2 and shape[usable[-3]] >= _THICK
    return tuple(usable[-3 if thick else -2 :])


def blocks(channel: npt.NDArray[Any], inside: Flags | None) -> list[Iterator[Block]]:
    """Return the planes or volumes of a channel, each as an iterator that yields one block if a pixel counts.

    About 2^22 pixels of a series are measured, in at least 16 evenly spread planes.
    """
    if inside is not None:
        if not inside.any():
            return []
        box = tuple(_extent(inside, axis) for axis in range(inside.ndim))
        channel, inside = channel[box], None if inside[box].all() else inside[box]
    axes = measured_axes(channel.shape)
    last = tuple(range(-len(axes), 0))
    moved = np.moveaxis(channel, axes, last) if axes else channel[..., None]
    kept = None if inside is None else (np.moveaxis(inside, axes, last) if axes else inside[..., None])
    if len(axes) < 2:
        # single rows hold too few pixels to be measured one by one
        rows, known = moved.reshape(-1, moved.shape[-1]), None if kept is None else kept.reshape(-1, moved.shape[-1])
        step = max(1, rows.size // LARGE)
        return [iter((Block(rows[::step], None if known is None else known[::step]),))]
    stack = moved.shape[: -len(axes)]
    count, size = math.prod(stack), math.prod(moved.shape[-len(axes) :])
    some = min(count, max(FEWEST, MOST // size))
    chosen = sorted({count * i // some + count // (2 * some) for i in range(some)})
    places = [np.unravel_index(i, stack) if stack else () for i in chosen]
    return [_block(moved[place], None if kept is None else kept[place]) for place in places]


def _extent(inside: Flags, axis: int) -> slice:
    """Return the smallest slice of an axis that holds every True."""
    at = np.flatnonzero(inside.any(axis=tuple(other for other in range(inside.ndim) if other != axis)))
    return slice(int(at[0]), int(at[-1]) + 1)


def _block(values: npt.NDArray[Any], inside: Flags | None) -> Iterator[Block]:
    """Yield a plane or volume, or evenly spread tiles of a large one, if a pixel counts."""
    if inside is not None and not inside.any():
        return
    parts = list(tiles(values.shape))
    if len(parts) == 1:
        yield Block(values[None], None if inside is None else inside[None])
        return
    kept = [part for part in parts if inside is None or inside[part].any()]
    if kept:
        known = None if inside is None else np.stack([inside[part] for part in kept])
        yield Block(np.stack([values[part] for part in kept]), known)


def tiles(shape: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Yield the parts of a plane or volume to measure: all of it, or tiles of a large one."""
    if math.prod(shape) <= (LARGE if len(shape) == 2 else 4 * LARGE):
        yield tuple(slice(0, size) for size in shape)
        return
    number, side = TILES[len(shape)]
    sides = [min(size, side) for size in shape]
    starts = [
        sorted({(size - own) * i // (number - 1) // _GRID * _GRID for i in range(number)})
        for size, own in zip(shape, sides, strict=True)
    ]
    for corner in np.stack(np.meshgrid(*starts, indexing="ij"), axis=-1).reshape(-1, len(shape)).tolist():
        yield tuple(slice(begin, begin + own) for begin, own in zip(corner, sides, strict=True))
