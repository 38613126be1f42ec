"""Read a part of a TIFF that does not fit the memory: :class:`Slabs`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Picture, PictureError, checked_axes
from .tiff import expect_readable, picture_of, quiet
from .tiff_words import damaged, only_series


class Slabs:
    """A TIFF of which parts are read; a context manager that closes the file.

    Attributes
    ----------
    header : Picture
        All of the picture but its values: its pixels are a view of one number.
    """

    header: Picture

    def __init__(self, file: Any, series: Any, header: Picture, where: str) -> None:
        self._file, self._series, self.header, self._where = file, series, header, where
        axes = header.axes
        self._front = axes[: axes.index("Y")]
        self._plane = header.pixels.shape[len(self._front) :]

    @classmethod
    def open(cls, path: Path, axes: str | None = None) -> Slabs | None:
        """Open a TIFF whose values are read as they are stored, page after page; None for any other file.

        Raises
        ------
        PictureError, AxesError
            As :func:`gpureg.files.tiff.read_tiff`.
        """
        import tifffile

        where = str(path)
        given = None if axes is None else checked_axes(axes)
        with quiet():
            file = tifffile.TiffFile(path)
            try:
                series = only_series(file, where)
                expect_readable(series.keyframe, where)
                dummy = np.broadcast_to(series.dtype.newbyteorder("=").type(0), series.shape)
                header = picture_of(file, series, dummy, where, given) if _is_plain(series) else None
                if header is not None and header.alpha is None and header.axes.endswith(("YX", "YXC")):
                    samples = header.axes.endswith("C")
                    if header.tags.samples == samples or not samples:
                        return cls(file, series, header, where)
            except BaseException:
                file.close()
                raise
            file.close()
            return None

    def __enter__(self) -> Slabs:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def read(self, box: Mapping[str, slice]) -> npt.NDArray[Any]:
        """Return the part in a box: slices along the axes that it names, all of the others.

        Raises
        ------
        PictureError
            The file is truncated or damaged.
        """
        shape, axes = self.header.pixels.shape, self.header.axes
        bounds = [range(*box.get(letter, slice(None)).indices(n)) for letter, n in zip(axes, shape, strict=True)]
        at = len(self._front)
        rows, columns = bounds[at], bounds[at + 1]
        found = np.empty([len(bound) for bound in bounds], self.header.pixels.dtype)
        flat = found.reshape(-1, *found.shape[at:])
        for i, place in enumerate(np.ndindex(*(len(bound) for bound in bounds[:at]))):
            number = 0
            for bound, step, length in zip(bounds[:at], place, shape[:at], strict=True):
                number = number * length + bound[step]
            flat[i] = self._rows(number, rows.start, rows.stop)[:, columns.start : columns.stop]
        return found

    def _rows(self, number: int, start: int, stop: int) -> npt.NDArray[Any]:
        """Read rows of a page."""
        try:
            if self._series.dataoffset is not None:
                page_bytes = math.prod(self._plane) * self._series.dtype.itemsize
                return self._stored(self._series.dataoffset + number * page_bytes, start, stop)
            return self._decoded(self._series.pages[number], start, stop)
        except (PictureError, MemoryError):
            raise
        except Exception as error:  # decoders raise various exceptions for damaged data
            raise damaged(self._where, " ".join(str(error).split())) from None

    def _stored(self, offset: int, start: int, stop: int) -> npt.NDArray[Any]:
        """Read rows that are stored one after the other from `offset` on."""
        dtype = self._series.dtype.newbyteorder(self._file.byteorder)
        row = math.prod(self._plane[1:]) * dtype.itemsize
        handle = self._file.filehandle
        handle.seek(offset + start * row)
        data = handle.read((stop - start) * row)
        if len(data) < (stop - start) * row:
            raise damaged(self._where, "values are missing at its end")
        return np.frombuffer(data, dtype).reshape(stop - start, *self._plane[1:])

    def _decoded(self, page: Any, start: int, stop: int) -> npt.NDArray[Any]:
        """Read the strips or tiles of a page that hold rows, and decode them."""
        first = self._series.keyframe
        if page is None:
            raise damaged(self._where, "a page is missing")
        high = first.tilelength if first.is_tiled else first.rowsperstrip
        across = -(-first.imagewidth // first.tilewidth) if first.is_tiled else 1
        found = np.zeros((stop - start, *self._plane[1:]), self.header.pixels.dtype)
        handle = self._file.filehandle
        for segment in range(start // high * across, min(len(page.dataoffsets), -(-stop // high) * across)):
            offset, count = page.dataoffsets[segment], page.databytecounts[segment]
            if not count:
                continue
            handle.seek(offset)
            data = handle.read(count)
            if len(data) < count:
                raise damaged(self._where, "values are missing at its end")
            values, place, shape = first.decode(data, segment, jpegtables=page.jpegtables)
            if values is None:
                continue
            _, _, y, x, _ = place
            values = values[0, : shape[1], : shape[2]].reshape(shape[1], shape[2], *self._plane[2:])
            low, top, right = max(start, y), min(stop, y + shape[1]), min(x + shape[2], self._plane[1])
            found[low - start : top - start, x:right] = values[low - y : top - y, : right - x]
        return found


def _is_plain(series: Any) -> bool:
    """Return whether the values of a series are read as they are stored."""
    import tifffile

    page = series.keyframe
    plain = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB)
    return (
        page.photometric in plain
        and page.bitspersample in (8, 16, 32, 64)
        and series.dtype.kind in "iuf"
        and not (series.dtype.kind in "iu" and series.dtype.itemsize == 8)
        and page.planarconfig == tifffile.PLANARCONFIG.CONTIG
        and page.imagedepth == 1
        and int(page.tags.valueof(274, default=1)) == 1
    )
