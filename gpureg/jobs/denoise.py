"""Denoise one picture file: the work of ``gpureg denoise``."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..files.pictures import Picture, PictureError, check_destination, write_files, write_picture
from ..files.spill import Spill
from ..files.tiff_writing import write_pages
from ..images.plan import DenoisePlan
from ..model.memory import process_limit
from ..model.result import Result
from ..progress import progress_bar
from .denoise_quality import qualities, reference_of
from .denoise_report import DenoiseReport
from .denoise_settings import Settings, expect_fitting
from .denoise_work import FileMemory, Work
from .inputs import Inside, Source, opened
from .report import about
from .slices import beside, layout_of, mask_of


def denoise_file(
    source: Path,
    target: Path,
    settings: Settings,
    *,
    progress: bool = False,
    tell: Callable[[str], None] = lambda text: None,
) -> DenoiseReport:
    """Denoise the picture, volume or series `source` into the file `target`.

    Parameters
    ----------
    source, target : Path
    settings : Settings
    progress : bool, default False
        Whether to show a progress bar.
    tell : callable, optional
        Called with the plan of each run before it starts, if ``settings.explain``.

    Returns
    -------
    DenoiseReport
        What was done.

    Raises
    ------
    PictureError
        A file cannot be read or written, or files do not fit together.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_image`.
    """
    expect_fitting(settings)
    for path in beside_of(source, settings):
        if os.path.exists(path) and os.path.exists(target) and os.path.samefile(path, target):
            raise ValueError(f"{target} would overwrite {path}, which is read; give another OUT")
    limit = process_limit(settings.memory)
    allowed = FileMemory(limit, settings)
    # the source is closed before OUT, which may be the same file, takes its place
    with ExitStack() as written, ExitStack() as files:

        def open_beside(path: Path) -> Source:
            return files.enter_context(opened(beside(path, source), in_parts=lambda header: read.in_parts))

        read = files.enter_context(opened(source, settings.axes, in_parts=partial(allowed.too_large, target=target)))
        header = read.header
        check_destination(target, header)
        if not read.in_parts:
            allowed.expect_whole(header, source)
        layout = layout_of(header, source, settings.each, settings.spacing)
        drawn = None if settings.mask is None else mask_of(open_beside(settings.mask), header, source, settings.mask)
        nodata = header.nodata if settings.nodata is None else settings.nodata
        inside = Inside(read, source, drawn, nodata)
        guide = None if settings.guide is None else _guide(open_beside(settings.guide), header, source, settings.guide)
        if settings.reference is not None and read.in_parts:
            raise MemoryError(
                f"--reference compares whole pictures, {source} is read in parts: give more --memory, or leave it out"
            )
        clean = None if settings.reference is None else reference_of(header, source, beside(settings.reference, source))
        out: npt.NDArray[Any] | None = None
        if read.in_parts:
            spill = written.enter_context(Spill(header, Path(os.path.realpath(target)).parent))
            put = spill.put
        else:
            out = np.empty(header.pixels.shape, header.pixels.dtype)
            put = partial(_put, out, header.axes)
        work = Work(read, inside, guide, layout, settings, allowed)
        runs, explained = list[tuple[DenoisePlan, Result]](), list[str]()
        # Printed plans would mix with the bar.
        several = layout.slices > 1
        with progress_bar(progress and several and not settings.explain, layout.slices, "slices") as done:
            for i in range(layout.slices):
                done(i)
                if not work.begin(i):
                    work.copy(i, put)
                    continue
                plan = work.plan(i)
                if settings.explain:
                    heading = f"slice {i + 1} of {layout.slices} along {layout.several}\n" if several else ""
                    explained.append(heading + plan.explain())
                    tell(explained[-1])
                runs.append((plan, work.run(i, plan, put, progress=progress and not several)))
            done(layout.slices)
        if not runs:
            raise PictureError(f"{source}: no pixel is left, all are NaN or outside the mask")
        quality = None
        if clean is not None and out is not None:
            quality = qualities(header, layout, out, clean, inside)
        files.close()
        if out is None:
            write_files({target: lambda temporary: write_pages(temporary, header, spill.page)})
        else:
            write_picture(target, replace(header, pixels=out))
    return DenoiseReport(
        files=about(source, target, replace(header, notes=(*header.notes, *work.notes))),
        runs=tuple(runs),
        through=layout.several,
        lam_search=settings.lam if isinstance(settings.lam, str) else None,
        norm=settings.norm,
        spacing=None if layout.spacing is None else dict(zip(layout.grid, layout.spacing, strict=True)),
        mask=settings.mask,
        outside_mask=0 if settings.mask is None else inside.masked,
        nan=inside.nans,
        nodata=inside.nodata,
        parts=work.parts if read.in_parts else 0,
        guide=settings.guide,
        reference=settings.reference,
        quality=quality,
        explained="\n".join(explained) if settings.explain else None,
    )


def _put(out: npt.NDArray[Any], axes: str, box: Mapping[str, slice], values: npt.NDArray[Any]) -> None:
    out[tuple(box.get(letter, slice(None)) for letter in axes)] = values


def beside_of(source: Path, settings: Settings) -> list[Path]:
    """List the files that are read with `source`: the mask, the guide and the reference."""
    paths = (settings.mask, settings.guide, settings.reference)
    return [beside(path, source) for path in paths if path is not None]


def _guide(guide: Source, picture: Picture, source: Path, path: Path) -> Source:
    """Return the guide, which may have other channels than the picture, with the letters of the picture's axes."""
    if guide.header.cells != picture.cells:
        raise PictureError(
            f"the guide {beside(path, source)} has the shape {guide.header.cells}, {source} has {picture.cells}"
        )
    return guide.named(picture.axes.replace("C", ""))
