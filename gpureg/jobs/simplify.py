"""Simplify a picture file, and write its partition: the work of ``gpureg simplify``."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..checks import number
from ..files.picture import Tags
from ..files.pictures import FORMATS, Picture, PictureError, check_destination, read_picture, write_pictures
from ..images.raster import Raster
from ..progress import progress_bar
from ..regions.regions import Regions
from ..regions.simplify import simplify_image
from .report import about
from .simplify_report import Errors, RegionRun, SimplifyReport
from .simplify_settings import Simplification
from .slices import Layout, beside, inside_of, layout_of

# Outputs on the picture's pixels, without its channels.
_ON_CELLS = ("--labels", "--random-colours")

# Metadata of a file that are valid for labels and colours.
_SIZES = ("spacing", "unit", "finterval", "fps", "PhysicalSize", "TimeIncrement")


def simplify_file(source: Path, target: Path, settings: Simplification, *, progress: bool = False) -> SimplifyReport:
    """Simplify the picture, volume or series `source` into the file `target`, and write the other outputs.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : Simplification
    progress : bool, default False
        Whether to show a progress bar.

    Returns
    -------
    SimplifyReport
        What was done.

    Raises
    ------
    PictureError
        A file cannot be read or written, or files do not fit together.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.simplify_image`.
    """
    if settings.merge_tol is not None:
        number("--merge-tol", settings.merge_tol, low=0, finite=False)
    model = settings.model_of_regions()
    outputs = settings.outputs(target)
    _expect_apart(source, outputs, settings)
    picture = read_picture(source, settings.axes)
    cells = picture.axes.replace("C", "")
    _check_destinations(outputs, picture)
    layout = layout_of(picture, source, settings.each, settings.spacing)
    inside, left = inside_of(picture, source, settings.mask)
    slices = layout.turned(picture.pixels, picture.axes)
    valid = None if inside is None else layout.turned(inside, cells)
    markers = None if settings.markers is None else _markers(picture, source, settings.markers, layout)
    arrays: dict[str, list[npt.NDArray[Any]]] = {option: [] for option in outputs}
    errors, runs, count = Errors(), list[RegionRun](), 0
    with progress_bar(progress and len(slices) > 1, len(slices), "slices") as done:
        for i, part in enumerate(slices):
            done(i)
            mask = None if valid is None or valid[i].all() else valid[i]
            if mask is not None and not mask.any():
                parts = _untouched(part, mask.shape)
            else:
                raster = Raster.of(part, None if picture.channel_axis is None else -1, mask, axes_known=True)
                regions = simplify_image(
                    raster,
                    sources=settings.sources if markers is None else markers[i],
                    spacing=layout.spacing,
                    progress=progress and len(slices) == 1,
                    **model,
                )
                found = regions if settings.merge_tol is None else regions.merged(settings.merge_tol)
                value = found.value
                errors = errors.and_those_of(part, regions.fine, value, mask)
                runs.append(RegionRun.of(regions, found))
                parts = _parts(regions, found, value, count)
                count += found.n_regions
            for option, made in arrays.items():
                made.append(parts[option]())
        done(len(slices))
    write_pictures({path: _picture(option, arrays[option], picture, layout) for option, path in outputs.items()})
    return SimplifyReport(
        files=about(source, target, picture),
        asked=settings,
        runs=tuple(runs),
        errors=errors,
        through=layout.several,
        spacing=None if layout.spacing is None else dict(zip(layout.grid, layout.spacing, strict=True)),
        outside_mask=0 if settings.mask is None else left.masked,
        nan=left.nans,
        nodata=left.nodata,
        outputs={option.lstrip("-").replace("-", "_"): path for option, path in outputs.items() if option != "OUT"},
    )


def _expect_apart(source: Path, outputs: dict[str, Path], settings: Simplification) -> None:
    """Refuse two outputs in one file, and an output that overwrites an input; only OUT may be IN."""
    known: dict[Path, str] = {}
    for option, path in outputs.items():
        place = Path(os.path.realpath(path))
        if place in known:
            raise ValueError(f"{known[place]} and {option} would both be written to {path}; give each its own file")
        known[place] = option
    read = [beside(path, source) for path in (settings.mask, settings.markers) if path is not None]
    for option, path in outputs.items():
        for other in read if option == "OUT" else [source, *read]:
            if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
                raise ValueError(f"{option} {path} would overwrite {other}, which is read; give another file")


def _check_destinations(outputs: dict[str, Path], picture: Picture) -> None:
    for option, path in outputs.items():
        like = picture
        if option in _ON_CELLS:
            shape = (*picture.cells, 3) if option == "--random-colours" else picture.cells
            like = _on_cells(np.broadcast_to(np.uint8(0), shape), picture)
        check_destination(path, like)
        if option == "--labels" and FORMATS[path.suffix.lower()] != "TIFF":
            raise PictureError(f"{path}: labels are written as TIFF; name the file .tif")


def _markers(picture: Picture, source: Path, path: Path, layout: Layout) -> npt.NDArray[np.int32]:
    """Read the markers as slices (s, ...): numbered from 0 in each slice, -1 where there is no marker."""
    path = beside(path, source)
    drawn = read_picture(path, labels=True)
    if drawn.channel_axis is not None:
        raise PictureError(f"the markers {path} have {drawn.channels} channels; give a grey picture, a number each")
    if drawn.pixels.shape != picture.cells:
        raise PictureError(f"the markers {path} have the shape {drawn.pixels.shape}, {source} has {picture.cells}")
    wrong = ~(drawn.pixels >= 0)
    if drawn.pixels.dtype.kind == "f":
        wrong |= ~np.isfinite(drawn.pixels) | (drawn.pixels != np.floor(drawn.pixels))
    if wrong.any():
        raise PictureError(
            f"the markers {path} must be whole numbers, 0 where there is none; got {drawn.pixels[wrong][0]:g}"
        )
    slices = layout.turned(drawn.pixels, picture.axes.replace("C", ""))
    numbered = np.full(slices.shape, -1, np.int32)
    for i, part in enumerate(slices):
        marked = part > 0
        if not marked.any():
            where = f" in slice {i + 1} of {len(slices)} along {layout.several}" if layout.several else ""
            raise PictureError(f"the markers {path} are all 0{where}: give a pixel of each source a number above 0")
        numbered[i][marked] = np.unique(part[marked], return_inverse=True)[1]
    return numbered


def _parts(
    regions: Regions, found: Regions, value: npt.NDArray[Any], first: int
) -> dict[str, Callable[[], npt.NDArray[Any]]]:
    """Return functions that make the outputs of a slice; `first` is the label of its first region."""
    return {
        "OUT": lambda: value,
        "--labels": lambda: np.where(found.labels >= 0, found.labels.astype(np.int64) + first, -1),
        "--random-colours": found.random_colours,
        "--fine": lambda: regions.fine,
    }


def _untouched(part: npt.NDArray[Any], shape: tuple[int, ...]) -> dict[str, Callable[[], npt.NDArray[Any]]]:
    """Return functions that make the outputs of a slice in which all pixels are left out."""
    return {
        "OUT": lambda: part,
        "--labels": lambda: np.full(shape, -1),
        "--random-colours": lambda: np.zeros((*shape, 3), np.uint8),
        "--fine": lambda: part,
    }


def _picture(option: str, slices: list[npt.NDArray[Any]], picture: Picture, layout: Layout) -> Picture:
    """Return the picture to write for `option`."""
    if option not in _ON_CELLS:
        return replace(picture, pixels=layout.turned_back(slices, picture.axes))
    cells = picture.axes.replace("C", "")
    if option == "--random-colours":
        return _on_cells(layout.turned_back(slices, f"{cells}C"), picture)
    return _on_cells(_label_type(layout.turned_back(slices, cells)), picture)


def _on_cells(array: npt.NDArray[Any], picture: Picture) -> Picture:
    """Return labels or colours on the pixels of a picture, with its axes and sizes, without its display settings."""
    cells, tags = picture.axes.replace("C", ""), picture.tags
    words = {name: word for name, word in tags.words.items() if name.startswith(_SIZES)}
    plain = Tags(tags.kind, tags.named, True, words, tags.resolution, tags.sizes)
    return Picture(array, axes=cells if array.ndim == len(cells) else f"{cells}C", tags=plain)


def _label_type(labels: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Convert labels to uint16, which ImageJ reads, if they fit, otherwise to int32."""
    fits = labels.min() >= 0 and labels.max() <= np.iinfo(np.uint16).max
    return labels.astype(np.uint16 if fits else np.int32)
