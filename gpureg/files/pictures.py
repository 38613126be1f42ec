"""Read and write pictures: 8- and 16-bit PNG, TIFF and JPEG; grey and RGB, with or without alpha; TIFF stacks.

Pillow reads and writes JPEG and 8-bit PNG, imagecodecs 16-bit PNG (Pillow narrows 16-bit colour to 8), tifffile TIFF.
"""

from __future__ import annotations

import contextlib
import io
import os
import secrets
import shutil
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .picture import AxesError, Picture, PictureError, checked_axes, split
from .tiff import read_tiff, write_tiff

__all__ = [
    "FORMATS",
    "Picture",
    "PictureError",
    "check_destination",
    "check_place",
    "read_picture",
    "write_atomically",
    "write_files",
    "write_picture",
    "write_pictures",
]

FORMATS = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF", ".jpg": "JPEG", ".jpeg": "JPEG"}

_JPEG_SIDE = 65500  # libjpeg's limit


def read_picture(path: str | os.PathLike[str], axes: str | None = None, *, labels: bool = False) -> Picture:
    """Read a PNG, TIFF or JPEG file; the format is found from the content, not from the name.

    The picture is turned upright by its EXIF or TIFF tag, and its colours are not multiplied by alpha.

    Parameters
    ----------
    path : path
    axes : str, optional
        One letter for each axis of the values: T, Z, Y, X or C. The default is the axes in the file, or ZYX, a volume,
        if the file does not name them.
    labels : bool, default False
        Accept integers of any size and sign, for labels.

    Raises
    ------
    PictureError
        The file does not exist, cannot be read, is truncated, or is not a picture of these formats.
    AxesError
        `axes` are wrong, or do not fit the file.
    """
    try:
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise PictureError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise PictureError(f"{path} is a folder, not a picture") from None
    except OSError as error:
        raise PictureError(f"{path} cannot be read: {error.strerror}") from None
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        read = _read_deep_png if data[24:25] == b"\x10" else _read_with_pillow
    elif data.startswith(b"\xff\xd8"):
        read = _read_with_pillow
    elif data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        read = partial(read_tiff, axes=axes)
    else:
        raise PictureError(f"{path} is not a PNG, TIFF or JPEG picture" + (" (it is empty)" if not data else ""))
    try:
        picture = read(data, str(path))
    except (PictureError, AxesError, MemoryError):
        raise
    except Exception as error:  # decoders raise various exceptions for damaged data
        raise PictureError(f"{path} is truncated or damaged: {error}") from None
    if picture.pixels.dtype not in (np.uint8, np.uint16, np.float32, np.float64) and not (
        labels and picture.pixels.dtype.kind in "iu"
    ):
        raise PictureError(f"{path} has {picture.pixels.dtype} pixels; uint8, uint16 and float are supported")
    if picture.pixels.size == 0:
        raise PictureError(f"{path} has no pixels")
    if axes is not None and checked_axes(axes) != picture.axes:
        raise AxesError(
            f"axes {axes} are not those of {path}, {picture.axes}; only those of a TIFF file can be renamed"
        )
    return picture


def _read_with_pillow(data: bytes, where: str) -> Picture:
    from PIL import Image, ImageOps

    with _any_size(), Image.open(io.BytesIO(data)) as opened:
        frames: int = getattr(opened, "n_frames", 1)
        if frames != 1:
            raise PictureError(f"{where} is an animation of {frames} frames; give a single picture")
        opened.load()  # raises for a truncated file
        profile = opened.info.get("icc_profile")
        image = ImageOps.exif_transpose(opened)
    if image.mode == "P" or "transparency" in image.info:
        grey = image.mode == "L"
        image = image.convert(("LA" if grey else "RGBA") if "transparency" in image.info else "RGB")
    elif image.mode not in ("L", "LA", "RGB", "RGBA"):
        # Bilevel becomes grey, CMYK and YCbCr become RGB, which a CMYK profile does not fit.
        profile = profile if image.mode == "1" else None
        image = image.convert("L" if image.mode == "1" else "RGB")
    pixels, alpha = split(np.asarray(image), where)
    return Picture(pixels, alpha, profile)


@contextlib.contextmanager
def _any_size() -> Iterator[None]:
    """Switch off Pillow's limit on the size of pictures, which refuses a scan of 180 megapixels."""
    from PIL import Image

    guard, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = guard


def _read_deep_png(data: bytes, where: str) -> Picture:
    import imagecodecs

    return Picture(*split(imagecodecs.png_decode(data), where), _png_profile(data))


def _png_profile(data: bytes) -> bytes | None:
    """Read the colour profile in a PNG's iCCP chunk, which imagecodecs ignores."""
    at = 8
    while at + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        if kind == b"iCCP":
            _, _, packed = data[at + 8 : at + 8 + length].partition(b"\0")
            return zlib.decompress(packed[1:])
        if kind == b"IDAT":
            return None
        at += 12 + length
    return None


def _with_png_profile(data: bytes, profile: bytes) -> bytes:
    """Insert an iCCP chunk after the header of a PNG."""
    body = b"iCCP" + b"ICC Profile\0\0" + zlib.compress(profile)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    end_of_header = 8 + 12 + 13
    return data[:end_of_header] + chunk + data[end_of_header:]


def check_place(path: str | os.PathLike[str]) -> None:
    """Check, before the work begins, that a file can be written there.

    Raises
    ------
    PictureError
        The folder does not exist or cannot be written, the file cannot be written, or it is a folder.
    """
    target = Path(os.path.realpath(path))
    try:
        if not target.parent.is_dir():
            raise PictureError(f"{path}: the folder {Path(path).parent} does not exist")
        if target.is_dir():
            raise PictureError(f"{path} is a folder")
        if not os.access(target.parent, os.W_OK) or (target.exists() and not os.access(target, os.W_OK)):
            raise PictureError(f"{path}: no permission to write there")
    except PictureError:
        raise
    except OSError as error:  # for example a name that is too long
        raise PictureError(f"{path} cannot be written: {error.strerror}") from None


def check_destination(path: str | os.PathLike[str], picture: Picture | None = None) -> None:
    """Check, before the work begins, that a picture can be written there.

    Raises
    ------
    PictureError
        An unknown extension, a format that cannot store the picture, or as :func:`check_place`.
    """
    kind = FORMATS.get(Path(path).suffix.lower())
    if kind is None:
        raise PictureError(f"{path}: the extension must be one of {', '.join(FORMATS)}")
    check_place(path)
    if picture is None:
        return
    if kind != "TIFF" and picture.is_stack:
        raise PictureError(f"{path}: {kind} stores one picture, this is a stack {picture.axes}; write TIFF")
    if kind != "TIFF" and picture.channels not in (1, 3):
        raise PictureError(f"{path}: {kind} stores grey or RGB, this has {picture.channels} channels; write TIFF")
    if kind == "JPEG" and picture.alpha is not None:
        raise PictureError(f"{path}: JPEG stores no alpha channel; write PNG or TIFF")
    if kind == "JPEG" and picture.pixels.dtype != np.uint8:
        raise PictureError(f"{path}: JPEG stores 8 bits, the picture is {picture.pixels.dtype}; write PNG or TIFF")
    if kind == "JPEG" and max(picture.pixels.shape[:2]) > _JPEG_SIDE:
        raise PictureError(f"{path}: JPEG stores at most {_JPEG_SIDE} pixels on a side; write PNG or TIFF")
    if kind == "PNG" and picture.pixels.dtype.kind == "f":
        raise PictureError(f"{path}: PNG stores no {picture.pixels.dtype} pixels; write TIFF")


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
    write_files({path: partial(_write, FORMATS[path.suffix.lower()], picture) for path, picture in pictures.items()})


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], Any]) -> None:
    """Call `write` with a temporary name in the folder of `path`, then rename; after an error no file is left."""
    write_files({Path(path): write})


def write_files(writes: Mapping[Path, Callable[[Path], Any]]) -> None:
    """Write files as :func:`write_atomically`, all or none: all are written before the first is renamed."""
    with contextlib.ExitStack() as temporaries:
        written: list[tuple[Path, Path, Path]] = []
        for path, write in writes.items():
            # Replace the target of a link, not the link.
            target = Path(os.path.realpath(path))
            temporary = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
            temporaries.callback(_remove, temporary)
            with _told(path):
                write(temporary)
                if target.exists():
                    shutil.copymode(target, temporary)
            written.append((path, temporary, target))
        for path, temporary, target in written:
            with _told(path):
                os.replace(temporary, target)


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn errors of the system into PictureError."""
    try:
        yield
    except OSError as error:
        raise PictureError(f"{path} cannot be written: {error.strerror or error}") from None


def _remove(temporary: Path) -> None:
    with contextlib.suppress(OSError):
        temporary.unlink(missing_ok=True)


def _write(kind: str, picture: Picture, temporary: Path) -> None:
    if kind == "TIFF":
        write_tiff(temporary, picture)
    else:
        temporary.write_bytes(_encode(kind, picture))


def _encode(kind: str, picture: Picture) -> bytes:
    """Encode a picture as PNG or JPEG."""
    pixels = picture.pixels if picture.pixels.ndim == 3 else picture.pixels[..., None]
    planes = pixels if picture.alpha is None else np.concatenate([pixels, picture.alpha[..., None]], axis=-1)
    array = np.ascontiguousarray(planes[..., 0] if planes.shape[2] == 1 else planes)
    if array.dtype == np.uint16:
        import imagecodecs

        encoded = bytes(imagecodecs.png_encode(array))
        return encoded if picture.icc_profile is None else _with_png_profile(encoded, picture.icc_profile)
    from PIL import Image

    buffer = io.BytesIO()
    extra: dict[str, Any] = {} if picture.icc_profile is None else {"icc_profile": picture.icc_profile}
    if kind == "JPEG":
        extra |= {"quality": 95, "subsampling": 0}
    Image.fromarray(array).save(buffer, kind, **extra)
    return buffer.getvalue()
