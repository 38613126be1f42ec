"""The pictures that a job reads, as a whole or in parts: :class:`Source`; the pixels that count: :class:`Inside`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..files.pictures import Picture, PictureError, first_bytes, is_tiff, read_picture
from ..files.slabs import Slabs

Box = Mapping[str, slice]


@dataclass(frozen=True, eq=False)
class Source:
    """A picture of which parts can be read.

    Attributes
    ----------
    header : Picture
        The picture; if it is read part by part, without its values.
    read : callable
        Returns the values in a box, slices along the axes with these letters.
    in_parts : bool
        Whether the picture is not in memory.
    """

    header: Picture
    read: Callable[[Box], npt.NDArray[Any]]
    in_parts: bool

    @classmethod
    def of(cls, picture: Picture) -> Source:
        """Return the source of a picture in memory."""

        def read(box: Box) -> npt.NDArray[Any]:
            return picture.pixels[tuple(box.get(letter, slice(None)) for letter in picture.axes)]

        return cls(picture, read, False)

    def named(self, cells: str) -> Source:
        """Return the source with other letters for its axes, one for each but the channels."""
        letters = list(cells)
        if self.header.channel_axis is not None:
            letters.insert(self.header.channel_axis, "C")
        names = dict(zip(letters, self.header.axes, strict=True))

        def read(box: Box) -> npt.NDArray[Any]:
            return self.read({names[letter]: part for letter, part in box.items() if letter in names})

        return Source(replace(self.header, axes="".join(letters)), read, self.in_parts)


@contextmanager
def opened(path: Path, axes: str | None = None, *, in_parts: Callable[[Picture], bool]) -> Iterator[Source]:
    """Open a picture: a TIFF part by part if `in_parts` says so of its header, anything else as a whole.

    Raises
    ------
    PictureError, AxesError
        As :func:`gpureg.files.pictures.read_picture`.
    """
    slabs: AbstractContextManager[Slabs | None] = nullcontext(None)
    if is_tiff(first_bytes(path)):
        slabs = _slabs(path, axes) or slabs
    with slabs as found:
        if found is not None and in_parts(found.header):
            yield Source(found.header, found.read, True)
            return
    yield Source.of(read_picture(path, axes))


def _slabs(path: Path, axes: str | None) -> Slabs | None:
    """Open a TIFF in parts; None if it is to be read as a whole, which says what is wrong with it."""
    try:
        return Slabs.open(path, axes)
    except Exception:
        return None


class Inside:
    """Which pixels take part: those that are inside the mask, are numbers, and are not the value for no data.

    Parameters
    ----------
    source : Source
    path : Path
        Its file, for messages.
    mask : Source or None
        True is not 0, in any of the channels; with the letters of the picture.
    nodata : float or None
        The value of pixels without data, in any channel, or in all of them if they are unsigned integers; an infinite
        one means both infinities.

    Attributes
    ----------
    nans, nodata, masked : int
        Numbers of pixels left out, counted once by :meth:`count`.
    """

    def __init__(self, source: Source, path: Path, mask: Source | None, nodata: float | None) -> None:
        self._source, self._path, self._mask, self._nodata = source, path, mask, nodata
        self.nans = self.nodata = self.masked = self.taken = 0
        self.needed = mask is not None or nodata is not None or source.header.pixels.dtype.kind == "f"

    def of(self, values: npt.NDArray[Any], box: Box) -> npt.NDArray[np.bool_] | None:
        """Return where the pixels in a box take part, without the axis of channels; None if all of a picture do."""
        if not self.needed:
            return None
        numbers, data = self._parts(values)
        return numbers & data & self._drawn(box, numbers.shape)

    def count(self, box: Box) -> npt.NDArray[np.bool_]:
        """Count the pixels in a box, and return where they take part.

        Raises
        ------
        PictureError
            Infinite values among the pixels that take part.
        """
        values = self._source.read(box)
        numbers, data = self._parts(values)
        drawn = self._drawn(box, numbers.shape)
        inside: npt.NDArray[np.bool_] = numbers & data & drawn
        self.masked += drawn.size - int(np.count_nonzero(drawn))
        self.nans += int(np.count_nonzero(drawn & ~numbers))
        self.nodata += int(np.count_nonzero(drawn & numbers & ~data))
        self.taken += int(np.count_nonzero(inside))
        infinite = self._any(np.isinf(values)) & inside
        if infinite.any():
            raise PictureError(
                f"{self._path} holds infinite values, at {int(np.count_nonzero(infinite))} pixel(s) at least: "
                "--nodata inf leaves them out, as NaN are"
            )
        return inside

    def _parts(self, values: npt.NDArray[Any]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return where all channels are numbers, and where none has the value for no data."""
        numbers = ~self._any(np.isnan(values))
        if self._nodata is None:
            return numbers, np.ones_like(numbers)
        missing = _equal(values, self._nodata)
        axis = self._source.header.channel_axis
        if axis is not None and values.dtype.kind == "u":  # a colour may well have one channel of 0
            return numbers, ~np.asarray(missing.all(axis=axis))
        return numbers, ~self._any(missing)

    def _any(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        axis = self._source.header.channel_axis
        return flags if axis is None else np.asarray(flags.any(axis=axis))

    def _drawn(self, box: Box, shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        if self._mask is None:
            return np.ones(shape, bool)
        drawn = np.asarray(self._mask.read(box) != 0)
        axis = self._mask.header.channel_axis
        return drawn if axis is None else np.asarray(drawn.any(axis=axis))


def _equal(values: npt.NDArray[Any], nodata: float) -> npt.NDArray[np.bool_]:
    """Return where values are that for no data, in their own type."""
    if np.isinf(nodata):
        return np.asarray(np.isinf(values))
    if values.dtype.kind in "iu":
        limits = np.iinfo(values.dtype)
        if not (float(nodata).is_integer() and limits.min <= nodata <= limits.max):
            return np.zeros(values.shape, bool)
        return np.asarray(values == int(nodata))
    return np.asarray(values == values.dtype.type(nodata))
