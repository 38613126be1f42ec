"""Denoise one picture file: the work of ``gpureg denoise``."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import plot
from ..files.pictures import Picture, PictureError, check_destination, read_picture, write_picture
from ..images.plan import DenoisePlan
from ..images.raster import Raster
from ..images.run import run_plan
from ..model.result import Result
from ..progress import progress_bar
from .denoise_report import DenoiseReport
from .denoise_settings import Settings, expect_fitting, plan_of
from .report import about
from .slices import beside, inside_of, layout_of


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
    picture = read_picture(source, settings.axes)
    check_destination(target, picture)
    layout = layout_of(picture, source, settings.each, settings.spacing)
    inside, nans, masked = inside_of(picture, source, settings.mask)
    slices = layout.turned(picture.pixels, picture.axes)
    valid = None if inside is None else layout.turned(inside, picture.axes.replace("C", ""))
    axis = None if picture.channel_axis is None else -1
    measure: Callable[[npt.NDArray[Any]], tuple[float, float]] | None = None
    quality: list[tuple[float, float]] = []
    if settings.reference is not None:
        clean, limits = _reference(picture, source, beside(settings.reference, source))
        clean = layout.turned(clean, picture.axes)
        measure = partial(_quality, clean=clean, valid=valid, limits=limits, axis=axis)
        quality.append(measure(slices))
    guides: npt.NDArray[Any] | None = None
    if settings.guide is not None:
        guides = layout.turned(*_guide(picture, source, beside(settings.guide, source)))
    values: list[npt.NDArray[Any]] = []
    runs: list[tuple[DenoisePlan, Result]] = []
    explained: list[str] = []
    # Printed plans would mix with the bar.
    with progress_bar(progress and len(slices) > 1 and not settings.explain, len(slices), "slices") as done:
        for i, part in enumerate(slices):
            done(i)
            mask = None if valid is None or valid[i].all() else valid[i]
            if mask is not None and not mask.any():
                values.append(part)
                continue
            raster = Raster.of(part, axis, mask, axes_known=True)
            plan = plan_of(raster, settings, layout.spacing)
            if settings.explain:
                heading = "" if len(slices) == 1 else f"slice {i + 1} of {len(slices)} along {layout.several}\n"
                explained.append(heading + plan.explain())
                tell(explained[-1])
            result = run_plan(
                plan,
                raster,
                guide=None if guides is None else guides[i],
                progress=progress and len(slices) == 1,
                **settings.run(),
            )
            values.append(result.value)
            runs.append((plan, replace(result, value=np.empty(0))))
        done(len(slices))
    if measure is not None:
        quality.append(measure(np.stack(values)))
    write_picture(target, replace(picture, pixels=layout.turned_back(values, picture.axes)))
    return DenoiseReport(
        files=about(source, target, picture),
        runs=tuple(runs),
        through=layout.several,
        lam_search=settings.lam if isinstance(settings.lam, str) else None,
        norm=settings.norm,
        spacing=None if layout.spacing is None else dict(zip(layout.grid, layout.spacing, strict=True)),
        mask=settings.mask,
        outside_mask=0 if settings.mask is None else masked,
        nan=nans,
        guide=settings.guide,
        reference=settings.reference,
        quality=(quality[0], quality[1]) if quality else None,
        explained="\n".join(explained) if settings.explain else None,
    )


def beside_of(source: Path, settings: Settings) -> list[Path]:
    """List the files that are read with `source`: the mask, the guide and the reference."""
    paths = (settings.mask, settings.guide, settings.reference)
    return [beside(path, source) for path in paths if path is not None]


def _guide(picture: Picture, source: Path, path: Path) -> tuple[npt.NDArray[Any], str]:
    """Read the guide, which may have other channels than the picture; return it and the letters of its axes."""
    guide = read_picture(path)
    if guide.cells != picture.cells:
        raise PictureError(f"the guide {path} has the shape {guide.cells}, {source} has {picture.cells}")
    letters = list(picture.axes.replace("C", ""))
    if guide.channel_axis is not None:
        letters.insert(guide.channel_axis, "C")
    return guide.pixels, "".join(letters)


def _reference(picture: Picture, source: Path, path: Path) -> tuple[npt.NDArray[Any], tuple[float, float]]:
    """Read the clean picture, and return it with the range of values for the PSNR."""
    clean = read_picture(path, picture.axes if picture.is_stack else None).pixels
    if clean.shape != picture.pixels.shape:
        raise PictureError(f"the reference {path} has the shape {clean.shape}, {source} has {picture.pixels.shape}")
    whole = [array.dtype for array in (picture.pixels, clean) if array.dtype.kind == "u"]
    if len(set(whole)) > 1:
        raise PictureError(f"the reference {path} holds {clean.dtype}, {source} {picture.pixels.dtype}; convert one")
    if whole:
        return clean, (0, np.iinfo(whole[0]).max)
    finite = clean[np.isfinite(clean)]
    if not (finite.size and finite.max() > finite.min()):
        raise PictureError(f"the reference {path} has no range for the PSNR: its values are constant or not finite")
    return clean, (float(finite.min()), float(finite.max()))


def _quality(
    slices: npt.NDArray[Any],
    clean: npt.NDArray[Any],
    valid: npt.NDArray[np.bool_] | None,
    limits: tuple[float, float],
    axis: int | None,
) -> tuple[float, float]:
    """Compute the PSNR of all slices (s, ...), and the mean SSIM over slices and time."""
    if valid is not None:
        slices = np.where(valid if axis is None else valid[..., None], slices, np.nan)
    cells = slices.ndim - (axis is not None)
    try:
        if len(slices) == 1 and cells <= 4:
            return plot.quality(slices[0], clean[0], limits, channel_axis=axis)
        flat = (-1, *slices.shape[cells - 1 :])
        psnr, _ = plot.quality(slices.reshape(flat), clean.reshape(flat), limits, channel_axis=axis)
        parts = (array.reshape(-1, *array.shape[2 if cells == 5 else 1 :]) for array in (slices, clean))
        found = [plot.quality(one, other, limits, channel_axis=axis)[1] for one, other in zip(*parts, strict=True)]
    except ImportError as error:
        raise PictureError(f"--reference: {error}") from None
    known = [ssim for ssim in found if not math.isnan(ssim)]
    return psnr, sum(known) / len(known) if known else math.nan
