"""PNG beyond Pillow: colours of 16 bits, which Pillow narrows to 8, and the chunks beside the pixels."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .picture import Metadata, Picture, split

# Chunks that hold for other pixels too, and are copied from PNG to PNG; they stand in front of the pixels.
_COPIED = (b"cHRM", b"gAMA", b"sRGB", b"tEXt", b"zTXt", b"iTXt")
_PER_INCH = 0.0254


def read_deep_png(path: Path, where: str) -> Picture:
    """Read a PNG of 16 bits."""
    import imagecodecs

    data = path.read_bytes()
    pixels, alpha = split(imagecodecs.png_decode(data), where)
    found = chunks_of(data)
    profile = None
    for name, body in found:
        if name == b"iCCP":
            profile = zlib.decompress(body.partition(b"\0")[2][1:])
        if name == b"tRNS" and alpha is None:  # one grey, or one colour, is transparent
            clear = pixels == np.frombuffer(body, ">u2")
            shown = ~(clear if pixels.ndim == 2 else clear.all(axis=-1))
            alpha = shown * np.uint16(65535)
    return Picture(pixels, alpha, profile, metadata=metadata_of(found))


def chunks_of(data: bytes) -> list[tuple[bytes, bytes]]:
    """List the chunks in front of the pixels, and behind them."""
    at, found = 8, []
    while at + 8 <= len(data):
        length, name = struct.unpack(">I4s", data[at : at + 8])
        if name != b"IDAT":
            found.append((name, data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def metadata_of(chunks: list[tuple[bytes, bytes]]) -> Metadata:
    """Return what the chunks say beside the pixels."""
    exif = dpi = None
    for name, body in chunks:
        if name == b"eXIf":
            exif = body
        if name == b"pHYs" and len(body) == 9 and body[8] == 1:
            x, y = struct.unpack(">II", body[:8])
            dpi = x * _PER_INCH, y * _PER_INCH
    return Metadata(exif=exif, dpi=dpi, chunks=tuple(chunk for chunk in chunks if chunk[0] in _COPIED))


def write_deep_png(array: npt.NDArray[np.uint16]) -> bytes:
    """Encode a picture of 16 bits."""
    import imagecodecs

    return bytes(imagecodecs.png_encode(array))


def with_chunks(data: bytes, picture: Picture) -> bytes:
    """Insert the colour profile, the EXIF, the resolution and the copied chunks behind the header of a PNG."""
    held, added = picture.metadata, list(picture.metadata.chunks)
    if picture.icc_profile is not None:
        added = [chunk for chunk in added if chunk[0] != b"sRGB"]  # a file has one of both
        added.insert(0, (b"iCCP", b"ICC Profile\0\0" + zlib.compress(picture.icc_profile)))
    if held.dpi is not None:
        x, y = (round(dots / _PER_INCH) for dots in held.dpi)
        added.append((b"pHYs", struct.pack(">IIB", x, y, 1)))
    if held.exif is not None:
        added.append((b"eXIf", held.exif.removeprefix(b"Exif\0\0")))
    body = b"".join(_chunk(name, content) for name, content in added)
    end_of_header = 8 + 12 + 13
    return data[:end_of_header] + body + data[end_of_header:]


def _chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
