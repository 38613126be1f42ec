"""Read and write TIFF with tifffile: pictures, volumes and series, the letters of their axes, the size of a voxel."""

from __future__ import annotations

import io
import logging
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from .picture import AXES, AxesError, Picture, PictureError, Tags, checked_axes, split

Kind = Literal["plain", "shaped", "imagej", "ome"]

# ImageJ's order of axes, and the metadata that the writer computes.
_IMAGEJ_AXES = "TZCYXS"
_IMAGEJ_COUNTS = {"images", "channels", "slices", "frames", "hyperstack", "order", "axes", "SCIFIO"}
# Metadata that need the axis with this letter.
_OF_AXIS = {
    **{"spacing": "Z", "finterval": "T", "fps": "T", "PhysicalSizeZ": "Z", "PhysicalSizeZUnit": "Z"},
    **{"TimeIncrement": "T", "TimeIncrementUnit": "T"},
}
# The tags that are read: description, resolution, colour profile, ImageJ's metadata.
_TAGS = (270, 282, 283, 34675, 50838, 50839)
_OF_OME_CHANNEL = ("Name", "Color", "Fluor", "EmissionWavelength", "ExcitationWavelength")
_MICROMETRES = {"Å": 1e-4, "nm": 1e-3, "µm": 1.0, "um": 1.0, "mm": 1e3, "cm": 1e4, "m": 1e6}


def read_tiff(data: bytes, where: str, axes: str | None = None) -> Picture:
    """Read the bytes of a TIFF file; `axes` replaces the letters of the axes in the file.

    The finest level of a pyramid is read.

    Raises
    ------
    PictureError
        Several series, unsupported colours or bits, unknown axes, or missing pages.
    AxesError
        `axes` are wrong, or do not fit the file.
    """
    import tifffile

    given = None if axes is None else checked_axes(axes)
    with _quiet(), tifffile.TiffFile(io.BytesIO(data)) as file:
        series = _only_series(file, where)
        page: Any = series.keyframe
        known = tifffile.PHOTOMETRIC
        if page.photometric not in (known.MINISBLACK, known.MINISWHITE, known.RGB, known.YCBCR):
            name = getattr(page.photometric, "name", str(page.photometric)).lower()
            raise PictureError(f"{where} has {name} colours; convert it to grey or RGB first")
        if page.bitspersample not in (1, 8, 16, 32, 64):
            raise PictureError(f"{where} has {page.bitspersample} bits per sample; 1, 8, 16 and float are supported")
        array, found = series.asarray(), series.axes
        if array.shape != tuple(series.shape):
            raise _damaged(where, f"it holds {array.shape} of {tuple(series.shape)} values")
        if "S" in found:  # samples on the last axis, however they are stored
            array, found = np.moveaxis(array, found.index("S"), -1), found.replace("S", "") + "S"
        if page.bitspersample == 1:
            array = array.astype(np.uint8) * np.uint8(255)
        if page.photometric == known.MINISWHITE and array.dtype.kind == "u":
            array = np.iinfo(array.dtype).max - array
        array = array.astype(array.dtype.newbyteorder("="), copy=False)
        resolution = tuple(page.tags[code].value for code in (282, 283) if code in page.tags)
        orientation = int(page.tags.valueof(274, default=1))
        if orientation != 1:
            array = _upright(array, orientation, found.index("Y"), found.index("X"))
            resolution = resolution[::-1] if orientation > 4 else resolution
        array, letters, named = _lettered(array, found, given, where)
        samples = "C" not in letters or (found.endswith("S") and letters.endswith("C"))
        alpha = None
        if samples and "C" in letters and (array.shape[-1] <= 4 or _has_alpha(page)):
            array, alpha = split(array, where)
            letters = letters[: array.ndim]
        if alpha is not None and tifffile.EXTRASAMPLE.ASSOCALPHA in page.extrasamples:
            array = _unassociated(array, alpha)
        kind, words = _words(file, series)
        sizes = _sizes(kind, words, resolution)
        words = {name: value for name, value in words.items() if _OF_AXIS.get(name, "Y") in letters}
        unit = int(page.tags.valueof(296, default=1))
        profile = page.tags.valueof(34675)
        tags = Tags(
            kind=kind,
            named=named,
            samples=samples,
            words=words,
            resolution=(resolution[0], resolution[1], unit) if len(resolution) == 2 else None,
            sizes=sizes,
        )
        return Picture(array, alpha, None if profile is None else bytes(profile), letters, tags)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the log of tifffile: damaged files raise an error here."""
    silence, log = logging.NullHandler(), logging.getLogger("tifffile")
    log.addHandler(silence)
    try:
        yield
    finally:
        log.removeHandler(silence)


def _damaged(where: str, why: str) -> PictureError:
    return PictureError(f"{where} is truncated or damaged: {why}")


def _only_series(file: Any, where: str) -> Any:
    """Return the only series of pages in a file, and check for missing parts, which tifffile ignores."""
    tiff, handle, first = file.tiff, file.filehandle, file.pages.first
    # The offset after the last page is 0; any other offset is that of a missing page.
    handle.seek(file.pages.next_page_offset)
    (following,) = struct.unpack(tiff.offsetformat, handle.read(tiff.offsetsize))
    if following:
        raise _damaged(where, f"the page after the first {len(file.pages)} is missing")
    handle.seek(first.offset)
    (count,) = struct.unpack(tiff.tagnoformat, handle.read(tiff.tagnosize))
    entries = handle.read(count * tiff.tagsize)
    codes = {struct.unpack_from(f"{tiff.byteorder}H", entries, i * tiff.tagsize)[0] for i in range(count)}
    if any(code in codes and code not in first.tags for code in _TAGS):
        raise _damaged(where, "its description is missing")
    series = file.series
    if len(series) != 1:
        shapes = ", ".join(str(tuple(one.shape)) for one in series[:4]) + (", ..." if len(series) > 4 else "")
        raise PictureError(f"{where} holds {len(series)} series of pictures, of shapes {shapes}; give a file of one")
    (only,) = series
    for kind, kinds in (("ome", ("ome", "imagej", "mmstack")), ("imagej", ("imagej", "ome")), ("shaped", ("shaped",))):
        if getattr(file, f"is_{kind}") and only.kind not in kinds:
            raise _damaged(where, "its description does not match its pages")
    if only.kind == "ome" and any(page is None for page in only.pages):
        raise PictureError(f"{where} holds a part of a set of pictures, the others are in other files; join them")
    return only


def _lettered(array: npt.NDArray[Any], found: str, given: str | None, where: str) -> tuple[npt.NDArray[Any], str, bool]:
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


def _has_alpha(page: Any) -> bool:
    import tifffile

    alphas = {tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA}
    return not alphas.isdisjoint(page.extrasamples)


def _upright(array: npt.NDArray[Any], orientation: int, y: int, x: int) -> npt.NDArray[Any]:
    """Turn a picture by the orientation tag of TIFF and EXIF, 1 to 8; `y` and `x` are its axes."""
    if orientation in (5, 6, 7, 8):  # rows and columns are exchanged
        array = np.swapaxes(array, y, x)
    if orientation in (3, 4, 7, 8):
        array = np.flip(array, y)
    if orientation in (2, 3, 6, 7):
        array = np.flip(array, x)
    return array


def _unassociated(pixels: npt.NDArray[Any], alpha: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Divide colours (..., 3) or grey by alpha, which they were multiplied by; black where alpha is 0."""
    white = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    opacity = (alpha if pixels.ndim == alpha.ndim else alpha[..., None]).astype(np.float64)
    colours = np.divide(pixels * float(white), opacity, out=np.zeros(pixels.shape), where=opacity > 0)
    if pixels.dtype.kind == "u":
        colours = np.clip(np.rint(colours), 0, white)
    return colours.astype(pixels.dtype)


def _words(file: Any, series: Any) -> tuple[Kind, dict[str, Any]]:
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


def _sizes(kind: Kind, words: dict[str, Any], resolution: tuple[Any, ...]) -> dict[str, float]:
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


def write_tiff(path: Path, picture: Picture) -> None:
    """Write a picture or a stack, with the metadata of its source file if their format can store it."""
    import tifffile

    array, letters, tags = picture.pixels, picture.axes, picture.tags
    if tags.samples and "C" in letters:
        array, letters = np.moveaxis(array, letters.index("C"), -1), letters.replace("C", "") + "S"
    if picture.alpha is not None:
        planes = array if letters.endswith("S") else array[..., None]
        array = np.concatenate([planes, picture.alpha[..., None]], axis=-1)
        letters = letters.rstrip("S") + "S"
    kind = tags.kind
    if kind == "imagej":
        order = [letters.index(letter) for letter in _IMAGEJ_AXES if letter in letters]
        # ImageJ reads 8, 16 and 32 bits, and colours of 8 bits
        if array.dtype.char in ("BHf" if "S" not in letters else "B") and picture.alpha is None:
            array, letters = array.transpose(order), "".join(letters[i] for i in order)
        else:
            kind = "shaped"
    if kind == "ome" and not letters.rstrip("S").endswith("YX"):
        kind = "shaped"
    if kind in ("plain", "shaped"):
        # Name the axes if they are known; a single page needs no names.
        kind = "shaped" if picture.is_stack and (tags.named or kind == "shaped") else "plain"
    words = tags.words if kind == tags.kind else {}
    if kind != "plain" and tags.named:
        words = {**words, "axes": letters}
    settings: dict[str, Any] = {"imagej": kind == "imagej", "ome": kind == "ome"}
    if kind != "imagej":  # ImageJ stacks are not compressed
        settings |= {"compression": "zlib", "predictor": array.dtype.kind == "u"}
    if tags.resolution is not None:
        settings |= {"resolution": tags.resolution[:2], "resolutionunit": tags.resolution[2]}
    tifffile.imwrite(
        path,
        np.ascontiguousarray(array),
        photometric="rgb" if tags.samples and picture.channels == 3 else "minisblack",
        planarconfig="contig" if letters.endswith("S") else None,
        extrasamples=None if picture.alpha is None else ["unassalpha"],
        iccprofile=picture.icc_profile,
        metadata=None if kind == "plain" else words,
        **settings,
    )
