"""JPEG 2000 by imagecodecs, 8 and 16 bits; written without loss."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .picture import Picture, PictureError, split


def read_jpeg2000(data: bytes, where: str) -> Picture:
    """Read a JP2 file, or a bare codestream.

    Raises
    ------
    PictureError
        Its components have different sizes, or more than four of them.
    """
    import imagecodecs

    pixels, alpha = split(imagecodecs.jpeg2k_decode(data), where)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise PictureError(f"{where} has {pixels.dtype} pixels; JPEG 2000 of 8 and 16 bits is read")
    head = data[:4096]
    lost = [what for mark, what in ((b"colr\x02", "its colour profile"), (b"res ", "the resolution")) if mark in head]
    lost += ["XML data"] if b"xml " in head else []
    return Picture(pixels, alpha, notes=(f"not read from JPEG 2000: {', '.join(lost)}",) if lost else ())


def write_jpeg2000(array: npt.NDArray[np.unsignedinteger], *, boxed: bool) -> bytes:
    """Encode a picture; `boxed`: as a JP2 file, otherwise as a bare codestream."""
    import imagecodecs

    kind = "jp2" if boxed else "j2k"
    return bytes(imagecodecs.jpeg2k_encode(array, level=0, codecformat=kind, reversible=True))
