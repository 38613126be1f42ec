"""The pixels of a picture in a nameless file, for a result that does not fit the memory: :class:`Spill`."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Picture, PictureError


class Spill:
    """Pixels on disk, row after row; a context manager that removes the file.

    Parameters
    ----------
    header : Picture
        The axes, the shape and the type; the axes end with YX or YXC.
    folder : Path
        Where the file lies.
    """

    def __init__(self, header: Picture, folder: Path) -> None:
        self._axes, self._shape, self._dtype = header.axes, header.pixels.shape, header.pixels.dtype
        self._front = header.axes.index("Y")
        try:
            self._file = tempfile.TemporaryFile(dir=folder)
        except OSError as error:
            raise PictureError(f"{folder}: the result cannot be written there: {error.strerror}") from None

    def __enter__(self) -> Spill:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def put(self, box: Mapping[str, slice], values: npt.NDArray[Any]) -> None:
        """Write the part in a box, with the axes of the picture.

        Raises
        ------
        PictureError
            The disk is full.
        """
        bounds = [
            range(*box.get(letter, slice(None)).indices(n)) for letter, n in zip(self._axes, self._shape, strict=True)
        ]
        at, row = self._front, math.prod(self._shape[self._front + 1 :])
        rows, columns = bounds[at], bounds[at + 1]
        sample = math.prod(self._shape[at + 2 :])
        flat = values.reshape(-1, *values.shape[at:])
        try:
            for i, place in enumerate(np.ndindex(*(len(bound) for bound in bounds[:at]))):
                page = self._page(tuple(bound[step] for bound, step in zip(bounds[:at], place, strict=True)))
                if len(columns) == self._shape[at + 1]:
                    self._write(page + rows.start * row, flat[i])
                    continue
                for j, y in enumerate(rows):
                    self._write(page + y * row + columns.start * sample, flat[i, j])
        except OSError as error:
            raise PictureError(f"the result cannot be written: {error.strerror}") from None

    def page(self, place: tuple[int, ...], rows: slice) -> npt.NDArray[Any]:
        """Return rows of the page at a place along the axes in front of Y."""
        row = math.prod(self._shape[self._front + 1 :])
        self._file.seek((self._page(place) + rows.start * row) * self._dtype.itemsize)
        data = self._file.read((rows.stop - rows.start) * row * self._dtype.itemsize)
        return np.frombuffer(data, self._dtype).reshape(-1, *self._shape[self._front + 1 :])

    def _page(self, place: tuple[int, ...]) -> int:
        """Return the number of values in front of a page."""
        number = 0
        for index, length in zip(place, self._shape, strict=False):
            number = number * length + index
        return number * math.prod(self._shape[self._front :])

    def _write(self, start: int, values: npt.NDArray[Any]) -> None:
        self._file.seek(start * self._dtype.itemsize)
        self._file.write(np.ascontiguousarray(values, self._dtype).data)
