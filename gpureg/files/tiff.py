"""Read TIFF with tifffile: pictures, volumes and series."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Metadata, Picture, PictureError, Tags, checked_axes, split
from .tiff_colours import from_cmyk, from_palette, from_ycbcr, spread, unassociated, upright
from .tiff_words import OF_AXIS, copied_tags, damaged, lettered, lost_tags, nodata_of, only_series, sizes_of, words_of

# Compressions whose decoder turns YCbCr into RGB.
_JPEGS = (6, 7, 34892, 33007)
# Units of the resolution, in inches.
_INCHES = {2: 1.0, 3: 2.54}


def read_tiff(path: Path, where: str, axes: str | None = None, labels: bool = False) -> Picture:
    """Read a TIFF file; `axes` replaces the letters of the axes in the file, `labels` keeps the numbers of a palette.

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
    with quiet(), tifffile.TiffFile(path) as file:
        series = only_series(file, where)
        expect_readable(series.keyframe, where)
        array = series.asarray()
        if array.shape != tuple(series.shape):
            raise damaged(where, f"it holds {array.shape} of {tuple(series.shape)} values")
        return picture_of(file, series, array, where, given, labels)


def expect_readable(page: Any, where: str) -> None:
    """Refuse colours and bits that are not understood.

    Raises
    ------
    PictureError
    """
    import tifffile

    known = tifffile.PHOTOMETRIC
    plain = (known.MINISBLACK, known.MINISWHITE, known.RGB, known.YCBCR, known.PALETTE, known.SEPARATED)
    if page.photometric not in plain:
        name = getattr(page.photometric, "name", str(page.photometric)).lower()
        raise PictureError(f"{where} has {name} colours; convert it to grey or RGB first")
    bits = page.bitspersample
    if bits not in (1, 2, 4, 8, 16, 32, 64) and not 8 < bits < 16 and not (bits == 24 and page.sampleformat == 3):
        raise PictureError(f"{where} has {bits} bits per sample; 1, 2, 4, 8 to 16, 32 and 64 are read")
    halved = known.YCBCR == page.photometric and tuple(page.tags.valueof(530, default=(2, 2))) != (1, 1)
    if halved and page.compression not in _JPEGS:
        raise PictureError(f"{where} has YCbCr colours at fewer places than its greys; convert it to RGB first")
    if page.photometric == known.SEPARATED and page.samplesperpixel != 4:
        raise PictureError(f"{where} has {page.samplesperpixel} inks; CMYK is read, convert it to RGB first")


def picture_of(
    file: Any, series: Any, array: npt.NDArray[Any], where: str, given: str | None, labels: bool = False
) -> Picture:
    """Return the picture of a series whose values are `array`, with the axes as they are stored."""
    import tifffile

    page, found, notes = series.keyframe, series.axes, list[str]()
    known, bits = tifffile.PHOTOMETRIC, int(page.bitspersample)
    kind, told = words_of(file, series)
    profile = page.tags.valueof(34675)
    if "S" in found:  # samples on the last axis, however they are stored
        array, found = np.moveaxis(array, found.index("S"), -1), found.replace("S", "") + "S"
    if page.photometric == known.PALETTE and not labels:
        if kind == "imagej":  # numbers that ImageJ shows in colours
            told = {**told, "LUTs": [(np.asarray(page.colormap) >> 8).astype(np.uint8)]}
        else:
            array, found = from_palette(array, page.colormap), f"{found}S"
            notes.append("its palette became colours: OUT has no palette")
    elif page.photometric == known.SEPARATED:
        array, lost = from_cmyk(array), "" if profile is None else " without its colour profile"
        notes.append(f"CMYK colours became RGB by the plain formula{lost}")
        profile = None
    elif page.photometric == known.YCBCR and page.compression not in _JPEGS:
        array = from_ycbcr(array)
        notes.append("YCbCr colours became RGB")
    elif bits < 8:
        array = spread(array, bits) if not labels or bits == 1 else array
        notes.append(f"its {bits} bit(s) per sample became 8")
    elif 8 < bits < 16 or bits == 24:
        notes.append(f"its {bits} bits per sample are written as {array.dtype}; the values stay as they are")
    if page.photometric == known.MINISWHITE and array.dtype.kind == "u":
        array = np.iinfo(array.dtype).max - array
        if not labels:
            notes.append("white is 0 in the file, and is the largest value in OUT")
    array = array.astype(array.dtype.newbyteorder("="), copy=False)
    resolution = tuple(page.tags[code].value for code in (282, 283) if code in page.tags)
    orientation = int(page.tags.valueof(274, default=1))
    if orientation != 1:
        array = upright(array, orientation, found.index("Y"), found.index("X"))
        resolution = resolution[::-1] if orientation > 4 else resolution
    array, letters, named = lettered(array, found, given, where)
    samples = "C" not in letters or (found.endswith("S") and letters.endswith("C"))
    alpha = None
    if samples and "C" in letters and (array.shape[-1] <= 4 or _has_alpha(page)):
        array, alpha = split(array, where)
        letters = letters[: array.ndim]
    if alpha is not None and tifffile.EXTRASAMPLE.ASSOCALPHA in page.extrasamples:
        array = unassociated(array, alpha)
        notes.append("its colours were multiplied by alpha; those of OUT are not")
    size = sizes_of(kind, told, resolution)
    unit = int(page.tags.valueof(296, default=1))
    tags = Tags(
        kind=kind,
        named=named,
        samples=samples,
        words={name: value for name, value in told.items() if OF_AXIS.get(name, "Y") in letters},
        resolution=(resolution[0], resolution[1], unit) if len(resolution) == 2 else None,
        sizes=size,
    )
    dropped = lost_tags(page)
    if dropped:
        notes.append(f"tags of the TIFF that are not copied: {', '.join(dropped)}")
    xmp = page.tags.valueof(700)
    return Picture(
        array,
        alpha,
        None if profile is None else bytes(profile),
        letters,
        tags,
        Metadata(
            xmp=bytes(xmp) if isinstance(xmp, bytes | bytearray) else None,
            dpi=_dpi(tags.resolution),
            tags=copied_tags(page, kind),
        ),
        nodata_of(page),
        tuple(notes),
    )


def _dpi(resolution: tuple[Any, Any, int] | None) -> tuple[float, float] | None:
    """Return the pixels per inch, if the resolution has a unit of length."""
    if resolution is None or resolution[2] not in _INCHES:
        return None
    x, y = (each[0] / each[1] if isinstance(each, tuple) and each[1] else 0.0 for each in resolution[:2])
    return (x * _INCHES[resolution[2]], y * _INCHES[resolution[2]]) if x > 0 and y > 0 else None


@contextmanager
def quiet() -> Iterator[None]:
    """Silence the log of tifffile: damaged files raise an error here."""
    silence, log = logging.NullHandler(), logging.getLogger("tifffile")
    log.addHandler(silence)
    try:
        yield
    finally:
        log.removeHandler(silence)


def _has_alpha(page: Any) -> bool:
    import tifffile

    alphas = {tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA}
    return not alphas.isdisjoint(page.extrasamples)
