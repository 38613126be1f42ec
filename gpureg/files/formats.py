"""The formats of pictures: their extensions, and what each of them stores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .picture import Picture, PictureError
from .tiff_writing import loses_words


@dataclass(frozen=True)
class Format:
    """What a format of pictures stores when gpureg writes it.

    Attributes
    ----------
    name : str
    extensions : tuple of str
    types : tuple of str
        Types of the pixels; an empty tuple means any integers and floats.
    alpha, profile, exif, xmp, dpi : bool
        Whether there is a place for each.
    stacks : bool
        Whether it stores more than one picture of grey or colour.
    side : int
        Largest number of pixels along X or Y.
    lossy : str
        What happens to pixels that it stores only nearly; an empty string means that all come back as they are.
    """

    name: str
    extensions: tuple[str, ...]
    types: tuple[str, ...] = ("uint8",)
    alpha: bool = False
    profile: bool = False
    exif: bool = False
    xmp: bool = False
    dpi: bool = False
    stacks: bool = False
    side: int = 2**31
    lossy: str = ""


TABLE = (
    Format("PNG", (".png",), ("uint8", "uint16"), alpha=True, profile=True, exif=True, dpi=True),
    Format("TIFF", (".tif", ".tiff"), (), alpha=True, profile=True, xmp=True, dpi=True, stacks=True),
    Format(
        "JPEG",
        (".jpg", ".jpeg"),
        profile=True,
        exif=True,
        xmp=True,
        dpi=True,
        side=65500,  # the limit of libjpeg
        lossy="JPEG stores pixels nearly (quality 95); PNG and TIFF store them exactly",
    ),
    Format("WebP", (".webp",), alpha=True, profile=True, exif=True, xmp=True, side=16383),
    Format("JPEG 2000", (".jp2", ".j2k"), ("uint8", "uint16"), alpha=True),
    Format("BMP", (".bmp",), dpi=True),
    Format("PNM", (".pgm", ".ppm", ".pnm", ".pbm"), ("uint8", "uint16")),
    Format("GIF", (".gif",), side=65535),
)

FORMATS = {extension: row.name for row in TABLE for extension in row.extensions}
READ = "PNG, TIFF, JPEG, WebP, JPEG 2000, BMP, PNM or GIF"

_ROWS = {row.name: row for row in TABLE}


def format_of(path: Path) -> Format:
    """Return the format of an extension.

    Raises
    ------
    PictureError
        The extension is not one of these formats.
    """
    name = FORMATS.get(path.suffix.lower())
    if name is None:
        raise PictureError(f"{path}: the extension must be one of {', '.join(FORMATS)}")
    return _ROWS[name]


def expect_fitting(path: Path, picture: Picture) -> None:
    """Check that the format of an extension stores a picture.

    Raises
    ------
    PictureError
    """
    row, dtype = format_of(path), picture.pixels.dtype
    if row.stacks:
        return
    name = row.name
    if picture.is_stack:
        raise PictureError(f"{path}: {name} stores one picture, this is a stack {picture.axes}; write TIFF")
    if picture.channels not in (1, 3):
        raise PictureError(f"{path}: {name} stores grey or RGB, this has {picture.channels} channels; write TIFF")
    if picture.alpha is not None and not row.alpha:
        raise PictureError(f"{path}: {name} stores no alpha channel here; write PNG or TIFF")
    if dtype.name not in row.types:
        if dtype == np.uint16:
            raise PictureError(f"{path}: {name} stores 8 bits, the picture is {dtype}; write PNG or TIFF")
        raise PictureError(f"{path}: {name} stores no {dtype} pixels; write TIFF")
    if max(picture.pixels.shape[:2]) > row.side:
        raise PictureError(f"{path}: {name} stores at most {row.side} pixels on a side; write PNG or TIFF")
    if path.suffix.lower() == ".pgm" and picture.channels == 3:
        raise PictureError(f"{path}: PGM stores grey, the picture is RGB; name the file .ppm")
    if path.suffix.lower() == ".ppm" and picture.channels == 1:
        raise PictureError(f"{path}: PPM stores RGB, the picture is grey; name the file .pgm")
    if path.suffix.lower() == ".pbm":
        raise PictureError(f"{path}: PBM stores black and white alone, without greys; name the file .pgm or .ppm")


def written_otherwise(path: Path, picture: Picture) -> list[str]:
    """List, as sentences, what changes or is lost when a picture is written to a file of this name."""
    row, held = format_of(path), picture.metadata
    notes = [row.lossy] if row.lossy else []
    if row.name == "WebP" and picture.channels == 1:
        notes.append("WebP stores no grey pictures: the grey is written as RGB with three equal channels")
    if row.name == "GIF" and picture.channels == 3:
        notes.append("GIF stores 256 colours: the colours are reduced to the 256 that fit best")
    if held.white is not None and row.name != "PNM":
        notes.append(f"white is {held.white} in IN; {row.name} does not say so, the values stay as they are")
    unset = {
        "its colour profile": picture.icc_profile is not None and not row.profile,
        "EXIF": held.exif is not None and not row.exif,
        "XMP": held.xmp is not None and not row.xmp,
        "the resolution (dots per inch)": held.dpi is not None and not row.dpi,
        "text and colour chunks of the PNG": any(name in _TOLD for name, _ in held.chunks) and row.name != "PNG",
        "tags of the TIFF": bool(held.tags) and row.name != "TIFF",
        f"metadata of {_WRITERS.get(picture.tags.kind, 'the file')}": (
            loses_words(picture) if row.name == "TIFF" else bool(picture.tags.words)
        ),
    }
    lost = [what for what, is_lost in unset.items() if is_lost]
    if lost:
        notes.append(f"not stored in {row.name}: {', '.join(lost)}")
    return notes


_WRITERS = {"imagej": "ImageJ", "ome": "OME", "shaped": "tifffile"}
# Chunks of a PNG whose loss is told; others repeat what the formats take for granted, such as sRGB.
_TOLD = (b"tEXt", b"zTXt", b"iTXt", b"cHRM")
