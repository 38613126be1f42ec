"""Divide a picture into slices, and find the pixels that are left out."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..files.picture import AXES
from ..files.pictures import Picture, PictureError, read_picture
from .inputs import Inside, Source


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

    @property
    def slices(self) -> int:
        """The number of slices."""
        return math.prod(self.counts)

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

    def box(self, i: int, part: Sequence[slice] = ()) -> dict[str, slice]:
        """Return slices along the axes, by their letters, of a part of the grid in slice number i."""
        places = np.unravel_index(i, self.counts) if self.counts else ()
        at = {letter: slice(int(n), int(n) + 1) for letter, n in zip(self.through, places, strict=True)}
        return at | dict(zip(self.grid, part, strict=False))

    def part(self, array: npt.NDArray[Any], letters: str) -> npt.NDArray[Any]:
        """Return the values in a box of one slice with the axes of the grid, and the channels last, a view."""
        part: npt.NDArray[Any] = self.turned(array, letters)[0]
        return part

    def part_back(self, part: npt.NDArray[Any], axes: str) -> npt.NDArray[Any]:
        """Return a part of one slice, (grid..., channels), as an array whose axes have these letters, a view."""
        letters = [letter for letter in self.through + self.grid + "C" if letter in axes]
        part = part if "C" in axes else part[..., 0]
        whole = part.reshape(*[1] * len(self.through), *part.shape)
        return whole.transpose([letters.index(letter) for letter in axes])


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
    if "C" in each and "C" not in axes:
        raise ValueError(f"--each C: {source} has no channels, its axes are {axes}")
    each = tuple(letter for letter in each if letter != "C")
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


def inside_of(picture: Picture, source: Path, mask: Path | None) -> tuple[npt.NDArray[np.bool_] | None, Inside]:
    """Return the pixels that are not left out, None for all, and the numbers of those that are.

    Raises
    ------
    PictureError
        The mask has another shape, all pixels are left out, or values are infinite.
    """
    drawn = None if mask is None else mask_of(Source.of(read_picture(beside(mask, source))), picture, source, mask)
    inside = Inside(Source.of(picture), source, drawn, picture.nodata)
    if not inside.needed:
        return None, inside
    found = inside.count({})
    if not inside.taken:
        raise PictureError(f"{source}: no pixel is left, all are NaN or outside the mask")
    return (None if found.all() and mask is None else found), inside


def mask_of(drawn: Source, picture: Picture, source: Path, mask: Path) -> Source:
    """Return a mask with the letters of the picture's axes.

    Raises
    ------
    PictureError
        It has another shape.
    """
    if drawn.header.cells != picture.cells:
        raise PictureError(
            f"the mask {beside(mask, source)} has the shape {drawn.header.cells}, {source} has {picture.cells}"
        )
    return drawn.named(picture.axes.replace("C", ""))
