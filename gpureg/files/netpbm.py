"""PNM: PBM, PGM, PPM (P1 to P6) and PAM (P7) are read; PGM and PPM are written, 8 and 16 bits."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Metadata, Picture, PictureError, split

_GAP = rb"(?:\s|#[^\n]*\n)"
_HEADERS = {False: re.compile(rb"P[14]" + _GAP + rb"+(\d+)" + _GAP + rb"+(\d+)" + _GAP)}
_HEADERS[True] = re.compile(_HEADERS[False].pattern.replace(b"[14]", b"[2356]") + _GAP + rb"*(\d+)\s")


def is_netpbm(data: bytes) -> bool:
    """Return whether a file begins as PBM, PGM, PPM or PAM."""
    return len(data) > 2 and data[:1] == b"P" and data[1:2] in b"1234567" and data[2:3].isspace()


def read_netpbm(data: bytes, where: str) -> Picture:
    """Read a file of the kinds P1 to P7; values stay as they are, black and white are 0 and 255.

    Raises
    ------
    PictureError
        The header is not one of these kinds, or values are missing.
    """
    kind = int(data[1:2])
    if kind == 7:
        width, height, depth, white, at = _pam(data, where)
    else:
        found = _HEADERS[kind not in (1, 4)].match(data)
        if found is None:
            raise PictureError(f"{where} is truncated or damaged: its header is not that of a PNM file")
        width, height = int(found[1]), int(found[2])
        white, depth, at = (1 if kind in (1, 4) else int(found[3])), (3 if kind in (3, 6) else 1), found.end()
    if not 0 < white < 65536 or not width * height:
        raise PictureError(f"{where} is truncated or damaged: {width} x {height} pixels, white {white}")
    dtype = np.dtype(np.uint8) if white < 256 else np.dtype(">u2")
    count = width * height * depth
    if kind == 4:
        row = -(-width // 8)
        packed = _values(data, at, row * height, np.dtype(np.uint8), where).reshape(height, row)
        flat = 1 - np.unpackbits(packed, axis=1)[:, :width].reshape(-1)
    elif kind == 1:
        flat = 1 - (np.frombuffer(re.sub(rb"\s|#[^\n]*\n", b"", data[at:])[:count], np.uint8) - ord("0"))
    elif kind in (2, 3):
        text = re.sub(rb"#[^\n]*\n", b" ", data[at:]).split(maxsplit=count)[:count]
        flat = np.array(text, np.int64).astype(dtype)
    else:
        flat = _values(data, at, count, dtype, where)
    if len(flat) < count:
        raise PictureError(f"{where} is truncated or damaged: it holds {len(flat)} of {count} values")
    if kind in (1, 4):
        flat, white = flat.astype(np.uint8) * np.uint8(255), 255
    array = flat.reshape((height, width) if depth == 1 else (height, width, depth))
    pixels, alpha = split(array.astype(array.dtype.newbyteorder("=")), where)
    usual = white in (255, 65535)
    note: tuple[str, ...] = () if usual else (f"white is {white}: the values stay as they are, 0 to {white}",)
    note += ("its 1 bit(s) per sample became 8",) if kind in (1, 4) else ()
    return Picture(pixels, alpha, metadata=Metadata(white=None if usual else white), notes=note)


def _pam(data: bytes, where: str) -> tuple[int, int, int, int, int]:
    """Return width, height, depth, white and the place of the values of a PAM file."""
    head, mark, _ = data.partition(b"ENDHDR\n")
    words = dict(line.split(None, 1) for line in head.splitlines()[1:] if line.strip() and not line.startswith(b"#"))
    try:
        width, height, depth, white = (int(words[name]) for name in (b"WIDTH", b"HEIGHT", b"DEPTH", b"MAXVAL"))
    except (KeyError, ValueError):
        raise PictureError(f"{where} is truncated or damaged: its header is not that of a PAM file") from None
    return width, height, depth, white, len(head) + len(mark)


def _values(data: bytes, at: int, count: int, dtype: np.dtype[Any], where: str) -> npt.NDArray[Any]:
    held = (len(data) - at) // dtype.itemsize
    if held < count:
        raise PictureError(f"{where} is truncated or damaged: it holds {held} of {count} values")
    return np.frombuffer(data, dtype, count, at)


def write_netpbm(array: npt.NDArray[Any], white: int | None) -> bytes:
    """Encode (H, W) as PGM or (H, W, 3) as PPM; `white` is that of the source, which limits the values."""
    deepest = int(np.iinfo(array.dtype).max)
    top = deepest if white is None or (white > 255) != (deepest > 255) else white
    kind = 6 if array.ndim == 3 else 5
    header = f"P{kind}\n{array.shape[1]} {array.shape[0]}\n{top}\n".encode()
    values: bytes = np.minimum(array, top).astype(">u2" if deepest > 255 else np.uint8).tobytes()
    return header + values
