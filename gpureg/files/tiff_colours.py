"""Colours of TIFF files that are no plain grey or RGB: palettes, CMYK, white as zero, few bits, multiplied by alpha."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def from_palette(index: npt.NDArray[Any], colormap: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the colours (..., 3) of the numbers of a palette (3, n) of 16 bits; 8 bits if they need no more."""
    colours = np.ascontiguousarray(np.asarray(colormap, np.uint16).T)
    high, low = colours >> 8, colours & 0xFF
    if not low.any() or (high == low).all():
        colours = high.astype(np.uint8)
    found: npt.NDArray[Any] = colours[index]
    return found


def from_cmyk(inks: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return RGB (..., 3) for cyan, magenta, yellow and black (..., 4): (1 - C)(1 - K) and so on, without a profile."""
    white = float(np.iinfo(inks.dtype).max) if inks.dtype.kind == "u" else 1.0
    colours = (white - inks[..., :3].astype(np.float64)) * (1 - inks[..., 3:].astype(np.float64) / white)
    return (np.rint(colours) if inks.dtype.kind == "u" else colours).astype(inks.dtype)


def from_ycbcr(colours: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return RGB (..., 3) for luma and two differences of colour of 8 bits (ITU-R BT.601, as in JPEG)."""
    luma, blue, red = (colours[..., i].astype(np.float64) for i in range(3))
    blue, red = blue - 128, red - 128
    rgb = np.stack([luma + 1.402 * red, luma - 0.344136 * blue - 0.714136 * red, luma + 1.772 * blue], axis=-1)
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def spread(values: npt.NDArray[Any], bits: int) -> npt.NDArray[Any]:
    """Spread 1, 2 or 4 bits over 0..255, so that black stays black and white white."""
    return values.astype(np.uint8) * np.uint8(255 // (2**bits - 1))


def upright(array: npt.NDArray[Any], orientation: int, y: int, x: int) -> npt.NDArray[Any]:
    """Turn a picture by the orientation tag of TIFF and EXIF, 1 to 8; `y` and `x` are its axes."""
    if orientation in (5, 6, 7, 8):  # rows and columns are exchanged
        array = np.swapaxes(array, y, x)
    if orientation in (3, 4, 7, 8):
        array = np.flip(array, y)
    if orientation in (2, 3, 6, 7):
        array = np.flip(array, x)
    return array


def unassociated(pixels: npt.NDArray[Any], alpha: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Divide colours (..., 3) or grey by alpha, which they were multiplied by; black where alpha is 0."""
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    opacity = (alpha if pixels.ndim == alpha.ndim else alpha[..., None]).astype(np.float64)
    colours = np.divide(pixels * float(white), opacity, out=np.zeros(pixels.shape), where=opacity > 0)
    if pixels.dtype.kind == "u":
        colours = np.clip(np.rint(colours), 0, white)
    return colours.astype(pixels.dtype)
