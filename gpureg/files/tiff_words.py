"""What a TIFF says of its pixels: its series of pages, the letters of their axes, its metadata, the size of a voxel."""

from __future__ import annotations

import math
import struct
from typing import Any, Literal
from xml.etree import ElementTree

import numpy.typing as npt

from .picture import AXES, AxesError, PictureError

Kind = Literal["plain", "shaped", "imagej", "ome"]

# Metadata of ImageJ that the writer computes.
_IMAGEJ_COUNTS = {"images", "channels", "slices", "frames", "hyperstack", "order", "axes", "SCIFIO"}
# Metadata that need the axis with this letter.
OF_AXIS = {
    **{"spacing": "Z", "finterval": "T", "fps": "T", "PhysicalSizeZ": "Z", "PhysicalSizeZUnit": "Z"},
    **{"TimeIncrement": "T", "TimeIncrementUnit": "T"},
}
# The tags that are read: description, resolution, colour profile, ImageJ's metadata.
_TAGS = (270, 282, 283, 34675, 50838, 50839)
_OF_OME_CHANNEL = ("Name", "Color", "Fluor", "EmissionWavelength", "ExcitationWavelength")
_MICROMETRES = {"Å": 1e-4, "nm": 1e-3, "µm": 1.0, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}

# Tags that hold for other pixels too, and are copied: names, dates, camera, the place on the ground (GeoTIFF), GDAL,
# XMP, IPTC.
_COPIED = (
    *(269, 271, 272, 285, 305, 306, 315, 316, 33432),
    *(33550, 33922, 34264, 34735, 34736, 34737, 42112, 42113, 700, 33723),
)
_DESCRIPTION, _NODATA = 270, 42113
# Tags of the storage, and of what is read in other ways; any other tag is named as lost.
_STORAGE = {
    *(254, 255, 256, 257, 258, 259, 262, 263, 264, 265, 266, 270, 273, 274, 277, 278, 279, 280, 281, 282, 283, 284),
    *(292, 293, 296, 297, 317, 318, 319, 320, 321, 322, 323, 324, 325, 332, 334, 336, 338, 339, 340, 341, 347, 512),
    *(513, 514, 529, 530, 531, 532, 34675, 50838, 50839, 65000, 65420, 65426),
}


def damaged(where: str, why: str) -> PictureError:
    """Return the error for a file that is not whole."""
    return PictureError(f"{where} is truncated or damaged: {why}")


def only_series(file: Any, where: str) -> Any:
    """Return the only series of pages in a file, and check for missing parts, which tifffile ignores."""
    tiff, handle, first = file.tiff, file.filehandle, file.pages.first
    # The offset after the last page is 0; any other offset is that of a missing page.
    handle.seek(file.pages.next_page_offset)
    (following,) = struct.unpack(tiff.offsetformat, handle.read(tiff.offsetsize))
    if following:
        raise damaged(where, f"the page after the first {len(file.pages)} is missing")
    handle.seek(first.offset)
    (count,) = struct.unpack(tiff.tagnoformat, handle.read(tiff.tagnosize))
    entries = handle.read(count * tiff.tagsize)
    codes = {struct.unpack_from(f"{tiff.byteorder}H", entries, i * tiff.tagsize)[0] for i in range(count)}
    if any(code in codes and code not in first.tags for code in _TAGS):
        raise damaged(where, "its description is missing")
    series = file.series
    if len(series) != 1:
        shapes = ", ".join(str(tuple(one.shape)) for one in series[:4]) + (", ..." if len(series) > 4 else "")
        raise PictureError(f"{where} holds {len(series)} series of pictures, of shapes {shapes}; give a file of one")
    (only,) = series
    for kind, kinds in (("ome", ("ome", "imagej", "mmstack")), ("imagej", ("imagej", "ome")), ("shaped", ("shaped",))):
        if getattr(file, f"is_{kind}") and only.kind not in kinds:
            raise damaged(where, "its description does not match its pages")
    if only.kind == "ome" and any(page is None for page in only.pages):
        raise PictureError(f"{where} holds a part of a set of pictures, the others are in other files; join them")
    return only


def lettered(array: npt.NDArray[Any], found: str, given: str | None, where: str) -> tuple[npt.NDArray[Any], str, bool]:
    """Return an array, the letters of its axes, and whether `given` or the file (`found`) names them."""
    # Remove unknown axes of length 1.
    kept = [i for i, letter in enumerate(found) if array.shape[i] > 1 or letter in AXES + "S"]
    found = "".join(found[i] for i in kept).replace("S", "C")
    array = array.reshape([array.shape[i] for i in kept])
    if given is not None:
        if len(given) != array.ndim:
            raise AxesError(
                f"axes {given} name {len(given)} axes, the values of {where} have {array.ndim}, of shape {array.shape}"
            )
        return array, given, True
    unknown = [letter for letter in found if letter not in AXES]
    named = not unknown
    if len(unknown) == 1 and unknown[0] in "IQ" and "Z" not in found:
        found = found.replace(unknown[0], "Z")
    elif unknown or not {"Y", "X"} <= set(found):
        raise PictureError(
            f"{where} has the shape {array.shape}, and does not say which axis is which ({found}); "
            f"name them with --axes, for instance --axes {'TZCYX'[-array.ndim :]}"
        )
    if found.count("C") > 1:
        raise PictureError(f"{where} has two axes of channels, of lengths {array.shape} ({found}); split it first")
    return array, found, named


def copied_tags(page: Any, kind: Kind) -> tuple[tuple[Any, ...], ...]:
    """Return the tags that are written again, as tifffile takes them; a plain file's description is one of them."""
    codes = (*_COPIED, _DESCRIPTION) if kind == "plain" else _COPIED
    tags = [page.tags[code] for code in codes if code in page.tags]
    own = [tag for tag in tags if not (tag.code == 305 and str(tag.value).startswith("tifffile"))]
    return tuple((tag.code, int(tag.dtype), tag.count, _value(tag), True) for tag in own)


def _value(tag: Any) -> Any:
    """Return the value of a tag as it is written: text in UTF-8, as it is in many files, not only in ASCII."""
    return tag.value.encode() if isinstance(tag.value, str) else tag.value


def lost_tags(page: Any) -> list[str]:
    """List the names of tags that are not written again."""
    known = {*_COPIED, *_STORAGE}
    return sorted({str(tag.name) for tag in page.tags if tag.code not in known})


def nodata_of(page: Any) -> float | None:
    """Return the value of pixels without data that the tag of GDAL names."""
    if _NODATA not in page.tags:
        return None
    try:
        return float(str(page.tags[_NODATA].value).strip("\0 "))
    except ValueError:
        return None


def words_of(file: Any, series: Any) -> tuple[Kind, dict[str, Any]]:
    """Return the format of a file's metadata, and the metadata that are valid for other pixel values."""
    if series.kind == "ome":
        return "ome", _ome_words(file.ome_metadata)
    if series.kind == "imagej":
        return "imagej", {name: v for name, v in file.imagej_metadata.items() if name not in _IMAGEJ_COUNTS}
    if series.kind == "shaped":
        (words,) = file.shaped_metadata
        return "shaped", {name: v for name, v in words.items() if name not in ("shape", "axes", "truncated")}
    return "plain", {}


def _ome_words(xml: str) -> dict[str, Any]:
    """Return name, sizes, time step and channels of an OME image, as tifffile writes them."""
    image = next(element for element in ElementTree.fromstring(xml) if element.tag.endswith("Image"))
    pixels = next(element for element in image if element.tag.endswith("Pixels"))
    words: dict[str, Any] = {"Name": image.get("Name")}
    for name in ("PhysicalSizeX", "PhysicalSizeY", "PhysicalSizeZ", "TimeIncrement"):
        words |= {name: pixels.get(name), f"{name}Unit": pixels.get(f"{name}Unit")}
    channels = [element for element in pixels if element.tag.endswith("Channel")]
    for name in _OF_OME_CHANNEL:
        values = [channel.get(name) for channel in channels]
        if all(value is not None for value in values):
            words.setdefault("Channel", {})[name] = values
    return {name: value for name, value in words.items() if value is not None}


def sizes_of(kind: Kind, words: dict[str, Any], resolution: tuple[Any, ...]) -> dict[str, float]:
    """Return the sizes of a voxel along X, Y and Z in the metadata of ImageJ or OME, in one unit."""
    found: dict[str, float] = {}
    if kind == "imagej":
        for letter, pixels in zip("XY", resolution, strict=False):
            count, unit = pixels if isinstance(pixels, tuple) else (pixels, 1)
            found[letter] = float(unit) / float(count) if count else 0.0
        found["Z"] = words.get("spacing", 0.0)
    if kind == "ome":
        units = {letter: words.get(f"PhysicalSize{letter}Unit", "µm") for letter in "XYZ"}
        same = len({units[letter] for letter in "XYZ" if f"PhysicalSize{letter}" in words}) <= 1
        for letter, unit in units.items():
            factor = 1.0 if same else _MICROMETRES.get(unit, 0.0)
            found[letter] = factor * float(words.get(f"PhysicalSize{letter}", 0.0))
    return {letter: size for letter, size in found.items() if math.isfinite(size) and size > 0}
