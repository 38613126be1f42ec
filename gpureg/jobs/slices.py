"""Divide a picture into slices, and find the pixels that are left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..files.picture import AXES
from ..files.pictures import Picture, PictureError, read_picture


@dataclass(frozen=True)
class Layout:
    """The use of the axes of a picture: axes of slices, axes of the grid, and the channels last.

    Attributes
    ----------
    through : str
        Letters of the axes whose slices are processed one by one.
    counts : tuple of int
        Number of slices along each of them.
    grid : str
        Letters of the axes of the graph.
    spacing : tuple of float or None
        Size of a pixel along each axis of the grid.
    """

    through: str
    counts: tuple[int, ...]
    grid: str
    spacing: tuple[float, ...] | None

    @property
    def several(self) -> str:
        """The letters of `through` with more than one slice."""
        return "".join(letter for letter, count in zip(self.through, self.counts, strict=True) if count > 1)

    def turned(self, array: npt.NDArray[Any], letters: str) -> npt.NDArray[Any]:
        """Return `array`, whose axes have these letters, as slices (s, ...); a view if possible."""
        order = [letters.index(letter) for letter in self.through + self.grid + "C" if letter in letters]
        turned = array.transpose(order)
        return turned.reshape(-1, *turned.shape[len(self.through) :])

    def turned_back(self, slices: Sequence[npt.NDArray[Any]], axes: str) -> npt.NDArray[Any]:
        """Join slices to an array whose axes have these letters."""
        letters = [letter for letter in self.through + self.grid + "C" if letter in axes]
        whole = slices[0] if len(slices) == 1 else np.stack(slices)
        return whole.reshape(*self.counts, *slices[0].shape).transpose([letters.index(letter) for letter in axes])


def layout_of(
    picture: Picture, source: Path, each: tuple[str, ...], spacing: tuple[float, ...] | Literal["file"] | None
) -> Layout:
    """Make the layout from `--each` and `--spacing` for the picture in `source`.

    Raises
    ------
    ValueError, PictureError
        An axis does not exist, or the number of sizes is wrong, or the file does not have them.
    """
    axes = picture.axes
    for letter in each:
        if letter not in axes:
            guess = "" if picture.tags.named else ", as the file names none; --axes TYX makes it a series"
            raise ValueError(f"--each {letter}: the axes of {source} are {axes}{guess}")
    joined = "".join(letter for letter in axes if letter not in {"C", *each})
    sizes: dict[str, float] | None = None
    if spacing == "file":
        sizes = picture.tags.sizes
        missing = ", ".join(letter for letter in joined if letter not in sizes)
        if missing == "T":
            raise PictureError(
                f"{source}: time has no size in the units of space; give the sizes along {', '.join(joined)} as "
                f"numbers (--spacing), or take the slices one by one (--each T)"
            )
        if missing:
            raise PictureError(
                f"{source} names no size of a voxel along {missing}; give the sizes along {', '.join(joined)} as "
                f"numbers, such as --spacing {','.join('1' * len(joined))}"
            )
    elif spacing is not None:
        if len(spacing) != len(joined):
            raise ValueError(
                f"--spacing has {len(spacing)} number(s); in {source} the graph has {len(joined)} axes: "
                f"{', '.join(joined)}"
            )
        sizes = dict(zip(joined, spacing, strict=True))
    # An axis of length 1 is left out, so that a volume of one slice is denoised as a picture.
    grid = "".join(letter for letter in AXES if letter in joined and (letter in "YX" or picture.size(letter) > 1))
    through = "".join(letter for letter in AXES if letter in axes and letter not in grid + "C")
    counts = tuple(picture.size(letter) for letter in through)
    return Layout(through, counts, grid, None if sizes is None else tuple(sizes[letter] for letter in grid))


def beside(path: Path, source: Path) -> Path:
    """Return the file that belongs to `source`: `path`, or the file of the same name in the folder `path`."""
    return path / source.name if os.path.isdir(path) else path


def inside_of(picture: Picture, source: Path, mask: Path | None) -> tuple[npt.NDArray[np.bool_] | None, int, int]:
    """Return the pixels that are not left out, None for all; how many are NaN, how many the mask excludes.

    Raises
    ------
    PictureError
        The mask has another shape, or all pixels are left out.
    """
    inside: npt.NDArray[np.bool_] | None = None
    nans = masked = 0
    if mask is not None:
        path = beside(mask, source)
        drawn = read_picture(path)
        inside = np.asarray(drawn.pixels != 0)
        if drawn.channel_axis is not None:
            inside = np.asarray(inside.any(axis=drawn.channel_axis))
        if inside.shape != picture.cells:
            raise PictureError(f"the mask {path} has the shape {inside.shape}, {source} has {picture.cells}")
        masked = inside.size - int(np.count_nonzero(inside))
    if picture.pixels.dtype.kind == "f":
        number = ~np.isnan(picture.pixels)
        if picture.channel_axis is not None:
            number = number.all(axis=picture.channel_axis)
        if not number.all():
            both = number if inside is None else number & inside
            nans = (number.size if inside is None else int(np.count_nonzero(inside))) - int(np.count_nonzero(both))
            inside = both
    if inside is not None and not inside.any():
        raise PictureError(f"{source}: no pixel is left, all are NaN or outside the mask")
    return inside, nans, masked
