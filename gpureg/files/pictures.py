"""Read and write picture files: PNG, TIFF, JPEG, WebP, JPEG 2000, BMP, PNM and GIF; TIFF stacks.

Pillow reads and writes PNG of 8 bits, JPEG, WebP, BMP and GIF; imagecodecs PNG of 16 bits (Pillow narrows 16-bit colour
to 8) and JPEG 2000; tifffile TIFF.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .formats import FORMATS, READ, expect_fitting, format_of
from .jpeg2000 import read_jpeg2000, write_jpeg2000
from .netpbm import is_netpbm, read_netpbm, write_netpbm
from .picture import AxesError, Picture, PictureError, checked_axes
from .png import read_deep_png, with_chunks, write_deep_png
from .tiff import read_tiff
from .tiff_writing import write_tiff
from .with_pillow import read_with_pillow, write_with_pillow
from .writing import check_place, write_atomically, write_files

__all__ = [
    "FORMATS",
    "Picture",
    "PictureError",
    "check_destination",
    "check_place",
    "is_tiff",
    "read_picture",
    "write_atomically",
    "write_files",
    "write_picture",
    "write_pictures",
]

_JPEG2000 = (b"\x00\x00\x00\x0cjP  \r\n\x87\n", b"\xffO\xffQ")

# Integers above this are not exact in float64, in which they are computed.
_EXACT = 2**53


def is_tiff(data: bytes) -> bool:
    """Return whether a file with these first bytes is a TIFF."""
    return data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def first_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the first bytes of a file.

    Raises
    ------
    PictureError
        The file does not exist or cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return file.read(32)
    except FileNotFoundError:
        raise PictureError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise PictureError(f"{path} is a folder, not a picture") from None
    except OSError as error:
        raise PictureError(f"{path} cannot be read: {error.strerror}") from None


def read_picture(path: str | os.PathLike[str], axes: str | None = None, *, labels: bool = False) -> Picture:
    """Read a picture file; the format is found from the content, not from the name.

    The picture is turned upright by its EXIF or TIFF tag, and its colours are not multiplied by alpha. What is
    converted or left out is named in its notes.

    Parameters
    ----------
    path : path
    axes : str, optional
        One letter for each axis of the values: T, Z, Y, X or C. The default is the axes in the file, or ZYX, a volume,
        if the file does not name them.
    labels : bool, default False
        The values are labels: those of a palette are its numbers, not its colours.

    Raises
    ------
    PictureError
        The file does not exist, cannot be read, is truncated, or is not a picture of these formats.
    AxesError
        `axes` are wrong, or do not fit the file.
    """
    read = _reader(path, axes, labels)
    try:
        picture = read(Path(path), str(path))
    except (PictureError, AxesError, MemoryError):
        raise
    except Exception as error:  # decoders raise various exceptions for damaged data
        raise PictureError(f"{path} is truncated or damaged: {_one_line(error)}") from None
    expect_usable(picture, path, axes, labels=labels)
    return picture


def expect_usable(
    picture: Picture, path: str | os.PathLike[str], axes: str | None, *, labels: bool = False, whole: bool = True
) -> None:
    """Refuse pixels that cannot be computed with, and axes that are not those of the file; `whole`: look at values.

    Raises
    ------
    PictureError, AxesError
    """
    kind = picture.pixels.dtype
    if kind.kind not in "iuf" or kind.itemsize > 8:
        how = "; give its real and its imaginary part as two channels" if kind.kind == "c" else ""
        raise PictureError(f"{path} has {kind} pixels; integers and floats of 8 to 64 bits are read{how}")
    if picture.pixels.size == 0:
        raise PictureError(f"{path} has no pixels")
    if whole and kind.kind in "iu" and kind.itemsize == 8 and not labels:
        extremes = int(picture.pixels.min()), int(picture.pixels.max())
        if max(-extremes[0], extremes[1]) > _EXACT:
            raise PictureError(
                f"{path} has {kind} pixels above 2^53, up to {extremes[1]}, which float64 does not hold; scale them"
            )
    if axes is not None and checked_axes(axes) != picture.axes:
        raise AxesError(
            f"axes {axes} are not those of {path}, {picture.axes}; only those of a TIFF file can be renamed"
        )


def _reader(path: str | os.PathLike[str], axes: str | None, labels: bool) -> Callable[[Path, str], Picture]:
    """Return the function that reads a file of this content."""
    start = first_bytes(path)
    if start.startswith(b"\x89PNG\r\n\x1a\n"):
        return read_deep_png if start[24:25] == b"\x10" else read_with_pillow
    if start.startswith((b"\xff\xd8", b"GIF8", b"BM")) or (start[:4] == b"RIFF" and start[8:12] == b"WEBP"):
        return read_with_pillow
    if is_tiff(start):
        return partial(read_tiff, axes=axes, labels=labels)
    if start.startswith(_JPEG2000):
        return lambda file, where: read_jpeg2000(file.read_bytes(), where)
    if is_netpbm(start):
        return lambda file, where: read_netpbm(file.read_bytes(), where)
    raise PictureError(f"{path} is not a {READ} picture" + (" (it is empty)" if not start else ""))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def check_destination(path: str | os.PathLike[str], picture: Picture | None = None) -> None:
    """Check, before the work begins, that a picture can be written there.

    Raises
    ------
    PictureError
        An unknown extension, a format that cannot store the picture, or as :func:`check_place`.
    """
    format_of(Path(path))
    check_place(path)
    if picture is not None:
        expect_fitting(Path(path), picture)


def write_picture(path: str | os.PathLike[str], picture: Picture) -> None:
    """Write a picture in the format of the extension, as a whole or not at all.

    The file is written with a temporary name in the same folder and then renamed, so that an error or an interruption
    does not change an existing file.

    Raises
    ------
    PictureError
        As :func:`check_destination`, or the file cannot be written.
    """
    write_pictures({Path(path): picture})


def write_pictures(pictures: Mapping[Path, Picture]) -> None:
    """Write pictures as :func:`write_picture`, all or none: all are written before the first is renamed.

    Raises
    ------
    PictureError
        As :func:`write_picture`.
    """
    for path, picture in pictures.items():
        check_destination(path, picture)
    write_files({path: partial(_write, format_of(path).name, picture) for path, picture in pictures.items()})


def _write(kind: str, picture: Picture, temporary: Path) -> None:
    if kind == "TIFF":
        write_tiff(temporary, picture)
    else:
        temporary.write_bytes(_encode(kind, picture, temporary.suffix.lower()))


def _encode(kind: str, picture: Picture, suffix: str) -> bytes:
    """Encode a picture in a format other than TIFF."""
    pixels = picture.pixels if picture.pixels.ndim == 3 else picture.pixels[..., None]
    planes = pixels if picture.alpha is None else np.concatenate([pixels, picture.alpha[..., None]], axis=-1)
    array: Any = np.ascontiguousarray(planes[..., 0] if planes.shape[2] == 1 else planes)
    if kind == "JPEG 2000":
        return write_jpeg2000(array, boxed=suffix == ".jp2")
    if kind == "PNM":
        return write_netpbm(array, picture.metadata.white)
    encoded = write_deep_png(array) if array.dtype == np.uint16 else write_with_pillow(array, kind, picture)
    return with_chunks(encoded, picture) if kind == "PNG" else encoded
