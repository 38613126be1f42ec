"""Write TIFF with tifffile: a picture or a stack as a whole, or page by page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .picture import Picture
from .tiff_words import Kind

# ImageJ's order of axes.
_IMAGEJ_AXES = "TZCYXS"
# Pages of more bytes are written in tiles of this side, so that no page has to be in memory.
_LARGEST_PAGE, _TILE = 1 << 24, 256


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
    kind = written_kind(picture, letters)
    if kind == "imagej":
        order = [letters.index(letter) for letter in _IMAGEJ_AXES if letter in letters]
        array, letters = array.transpose(order), "".join(letters[i] for i in order)
    tifffile.imwrite(path, np.ascontiguousarray(array), **_settings(picture, kind, letters))


def write_pages(path: Path, header: Picture, page: Callable[[tuple[int, ...], slice], npt.NDArray[Any]]) -> None:
    """Write a stack without alpha whose axes end with YX or samples YXC, one page after the other.

    Parameters
    ----------
    path : Path
    header : Picture
        All but the values of the pixels.
    page : callable
        Returns the rows of a page, from its place along the axes in front of Y, in the order of the header.
    """
    import tifffile

    letters = f"{header.axes[:-1]}S" if header.axes.endswith("C") else header.axes
    front, plane = letters[: letters.index("Y")], header.pixels.shape[letters.index("Y") :]
    kind = written_kind(header, letters)
    order = [front.index(letter) for letter in (_IMAGEJ_AXES if kind == "imagej" else front) if letter in front]
    lengths = tuple(header.pixels.shape[i] for i in order)
    letters = "".join(front[i] for i in order) + letters[len(front) :]
    settings = _settings(header, kind, letters)
    tiled = kind != "imagej" and math.prod(plane) * header.pixels.dtype.itemsize > _LARGEST_PAGE
    if tiled:
        settings["tile"] = (_TILE, _TILE)

    def pages() -> Iterator[npt.NDArray[Any]]:
        for place in np.ndindex(*lengths):
            found = tuple(place[order.index(i)] for i in range(len(front)))
            if not tiled:
                yield page(found, slice(0, plane[0]))
                continue
            for y in range(0, plane[0], _TILE):
                band = page(found, slice(y, min(y + _TILE, plane[0])))
                for x in range(0, plane[1], _TILE):
                    yield np.ascontiguousarray(band[:, x : x + _TILE])

    shape = (*lengths, *plane)
    tifffile.imwrite(path, pages(), shape=shape, dtype=header.pixels.dtype, **settings)


def written_kind(picture: Picture, letters: str) -> Kind:
    """Return the format of the metadata in which a picture with these axes (S: samples) can be written."""
    kind, dtype = picture.tags.kind, picture.pixels.dtype
    # ImageJ reads 8, 16 and 32 bits, and colours of 8 bits
    if kind == "imagej" and (dtype.char not in ("BHf" if "S" not in letters else "B") or picture.alpha is not None):
        kind = "shaped"
    if kind == "ome" and not letters.rstrip("S").endswith("YX"):
        kind = "shaped"
    if kind in ("plain", "shaped"):
        # Name the axes if they are known; a single page needs no names.
        kind = "shaped" if picture.is_stack and (picture.tags.named or kind == "shaped") else "plain"
    return kind


def loses_words(picture: Picture) -> bool:
    """Return whether the metadata of ImageJ or OME cannot be written with these axes and this type."""
    letters = picture.axes
    if picture.alpha is not None or (picture.tags.samples and "C" in letters):
        letters = letters.replace("C", "") + "S"
    return bool(picture.tags.words) and written_kind(picture, letters) != picture.tags.kind


def _settings(picture: Picture, kind: Kind, letters: str) -> dict[str, Any]:
    """Return what tifffile is told beside the values."""
    tags, held = picture.tags, picture.metadata
    words = tags.words if kind == tags.kind else {}
    if kind != "plain" and tags.named:
        words = {**words, "axes": letters}
    settings: dict[str, Any] = {"imagej": kind == "imagej", "ome": kind == "ome"}
    if kind != "imagej":  # ImageJ stacks are not compressed
        kind_of = picture.pixels.dtype
        settings |= {"compression": "zlib", "predictor": kind_of.kind == "u" and kind_of.itemsize < 8}
    if tags.resolution is not None:
        settings |= {"resolution": tags.resolution[:2], "resolutionunit": tags.resolution[2]}
    elif held.dpi is not None:
        settings |= {"resolution": held.dpi, "resolutionunit": 2}
    copied = [tag for tag in held.tags if tag[0] != 270 or kind == "plain"]
    if held.xmp is not None and not any(tag[0] == 700 for tag in copied):
        copied.append((700, 1, len(held.xmp), held.xmp, True))
    software = [tag for tag in copied if tag[0] == 305]
    if software:  # tifffile writes its own name otherwise
        settings["software"] = False
    if any(tag[0] == 306 for tag in copied):
        settings["datetime"] = None
    return settings | {
        "photometric": "rgb" if tags.samples and picture.channels == 3 else "minisblack",
        "planarconfig": "contig" if letters.endswith("S") else None,
        "extrasamples": None if picture.alpha is None else ["unassalpha"],
        "iccprofile": picture.icc_profile,
        "metadata": None if kind == "plain" else words,
        "extratags": copied,
    }
