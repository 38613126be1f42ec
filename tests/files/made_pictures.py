"""Pictures and PNG files for the tests of picture files."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
import pytest
from PIL import ImageCms

from gpureg.files.pictures import (
    Picture,
    PictureError,
    read_picture,
)

SIZE = (23, 17)  # odd, and not square: a transposed picture is found out
# name: extra channels of colour, alpha
LAYOUTS = {"grey": (1, False), "rgb": (3, False), "grey-alpha": (1, True), "rgba": (3, True)}


def picture(layout: str, dtype: str, size: tuple[int, int] = SIZE) -> Picture:
    """A picture whose channels all differ and use all bits of their type."""
    channels, has_alpha = LAYOUTS[layout]
    rng = np.random.default_rng(5)

    def plane(*shape: int) -> np.ndarray:
        if np.dtype(dtype).kind == "f":
            return rng.normal(0, 300, shape).astype(dtype)
        return rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)

    return Picture(plane(*size, 3) if channels == 3 else plane(*size), plane(*size) if has_alpha else None)


def joined(what: Picture) -> np.ndarray:
    """All planes as one array, as a library hands it out."""
    if what.alpha is None:
        return what.pixels
    return np.dstack([what.pixels, what.alpha])


def smooth(channels: int = 3, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Ramps, which JPEG keeps closely."""
    y, x = np.mgrid[: size[0], : size[1]]
    planes = np.dstack([5 * y + 40, 6 * x + 60, 3 * y + 3 * x + 30]).astype(np.uint8)
    return planes if channels == 3 else planes[..., 0]


def assert_same(got: Picture, want: Picture) -> None:
    assert got.pixels.dtype == want.pixels.dtype
    np.testing.assert_array_equal(got.pixels, want.pixels)
    assert (got.alpha is None) == (want.alpha is None)
    if want.alpha is not None:
        assert got.alpha.dtype == want.alpha.dtype
        np.testing.assert_array_equal(got.alpha, want.alpha)


def profile() -> bytes:
    return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return chunks


def png_file(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG put together by hand, for kinds that no library here writes."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, body in chunks:
        parts += [struct.pack(">I", len(body)), name, body, struct.pack(">I", zlib.crc32(name + body))]
    return b"".join(parts)


def refuses(path, *words: str) -> str:
    """The sentence of a refusal: it names the file and the matter, in one line."""
    with pytest.raises(PictureError) as caught:
        read_picture(path)
    message = str(caught.value)
    assert os.path.basename(path) in message
    for word in words:
        assert word in message, f"{word!r} is not in {message!r}"
    assert "\n" not in message
    return message
