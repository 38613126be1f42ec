"""Denoise or simplify the curves of a file, and compute their skeletons: the work of ``gpureg curve``."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, IntArray
from ..curves.contents import CURVE_FORMATS, CurveError, CurveInFile, CurvesFile, curve_format
from ..curves.curves import Curves
from ..curves.denoise import denoised
from ..curves.files import encode_curves, read, same_format
from ..curves.process import CurveFilter
from ..curves.simplify import CurveMethod, simplified
from ..curves.skeletons import Skeleton, skeleton
from ..shapes.ends import Ends, ends_of
from .curve_report import CurveReport, Measures, Worked
from .many import Many, treat_files
from .options import ShapeSettings
from .outputs import Outputs
from .slices import beside


@dataclass(frozen=True, kw_only=True)
class CurveSettings(ShapeSettings):
    """The options, without IN and OUT, of ``gpureg curve``."""

    simplify: bool = False
    n_vertices: int | None = None
    tolerance: float | None = None
    method: CurveMethod | None = None
    valid: bool = False
    filter: CurveFilter | None = None
    keep_ends: bool | None = None
    closed: bool | None = None
    degrees: bool | None = None
    skeleton: Path | None = None

    @property
    def simplifies(self) -> bool:
        """Whether to simplify the curves instead of denoising them."""
        return self.simplify or self.n_vertices is not None or self.tolerance is not None

    def check(self) -> None:
        """Raise ValueError for combinations of options that have no effect."""
        if self.simplifies and self.sigma is not None:
            raise ValueError("--sigma is for denoising, --simplify and --n-vertices are not; run twice")
        if self.simplifies and self.keep_ends is False:
            raise ValueError("--no-keep-ends is for denoising: simplified curves keep their ends")
        for option, value in (("--filter", self.filter), ("--method", self.method)):
            if not self.simplifies and value is not None:
                raise ValueError(f"{option} says how curves are simplified: give --simplify too")


def curve_file(source: Path, target: Path, settings: CurveSettings, *, progress: bool = False) -> CurveReport:
    """Denoise or simplify the curves of `source` into the file `target`.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : CurveSettings
    progress : bool, default False
        Whether to show a progress bar.

    Returns
    -------
    CurveReport

    Raises
    ------
    CurveError, PictureError
        A file cannot be read or written, or matplotlib is missing for the picture.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_curve`, :func:`gpureg.simplify_curve` and :func:`gpureg.skeleton`.
    """
    settings.check()
    outputs = Outputs(source, None if settings.reference is None else beside(settings.reference, source))
    for option, path in (("OUT", target), ("--skeleton", settings.skeleton)):
        if path is not None:
            curve_format(path)
            outputs.expect(option, path)
    outputs.expect_picture(settings.picture, CurveError)
    begin = time.perf_counter()
    given = read(source, closed=settings.closed)
    truth = None if settings.reference is None else read(beside(settings.reference, source), closed=settings.closed)
    scale = _scale(given, settings)
    before: list[FloatArray] = [curve.points * scale for curve in given.curves]
    ends = [_scaled(curve, x) for curve, x in zip(given.curves, before, strict=True)]
    worked = _worked(before, ends, settings, progress)
    made = [
        replace(
            curve, points=points / scale, more=curve.more[kept], rows=None if curve.rows is None else curve.rows[kept]
        )
        for curve, points, kept in zip(given.curves, worked.points, worked.kept, strict=True)
    ]
    true: list[FloatArray] | None = None if truth is None else [x.points * scale for x in truth.curves]
    report = CurveReport(
        input=source,
        output=target,
        filter=worked.describe(),
        results=worked.results,
        seconds=0.0,
        picture=settings.picture,
        before=before,
        worked=worked,
        ends=ends,
        measures=Measures.of(before, worked.points, [one.closed for one in ends], true),
        unit="degrees of latitude" if scale[0] != 1 else None,
        skeleton=settings.skeleton,
        bones=[] if settings.skeleton is None else _skeletons(worked.points, made),
        left=given.left,
        left_out=not same_format(source, target),
    )
    outputs.put(target, encode_curves(target, made, like=given))
    if settings.skeleton is not None:
        lines = encode_curves(settings.skeleton, _branches(report.bones, scale), names=("radius",))
        outputs.put(settings.skeleton, lines)
    if settings.picture is not None:
        outputs.draw(settings.picture, _drawn(report))
    outputs.write()
    return replace(report, seconds=time.perf_counter() - begin)


def curve_files(sources: Sequence[Path], folder: Path, settings: CurveSettings, *, progress: bool = False) -> Many:
    """Denoise or simplify the curves of many files into a folder; the parameters are as in :func:`curve_file`.

    ``settings.reference`` is one file for all, or a folder with files named as the inputs.

    Raises
    ------
    PictureError, ValueError
        The options or the folder are wrong for all files; raised before any work.
    """
    settings.check()
    for option, path in (("--skeleton", settings.skeleton), ("--picture", settings.picture)):
        if path is not None:
            raise ValueError(f"{option} is one file: it needs a single IN")
    read_too = [] if settings.reference is None else [beside(settings.reference, source) for source in sources]
    return treat_files(
        sources,
        folder,
        lambda source, target: curve_file(source, target, settings),
        others=read_too,
        formats=CURVE_FORMATS,
        progress=progress,
    )


def _scale(given: CurvesFile, settings: CurveSettings) -> FloatArray:
    """Compute the factors (2,) that make degrees of longitude as long as those of latitude; 1 without degrees."""
    degrees = given.degrees if settings.degrees is None else settings.degrees
    if not degrees:
        return np.ones(2)
    latitudes = np.concatenate([curve.points[:, 1] for curve in given.curves])
    if np.abs(latitudes).max() > 90:
        raise ValueError(
            f"latitudes must lie in -90..90, got {np.abs(latitudes).max():g}: these are not degrees, give --no-degrees"
        )
    return np.array([max(math.cos(math.radians(float(latitudes.mean()))), 1e-3), 1.0])


def _scaled(curve: CurveInFile, points: FloatArray) -> Ends:
    """Return whether a curve of a file is closed, and the distance of its ends in the units of `points`, (n, 2)."""
    ends = ends_of(points, curve.closed) if curve.ends is None else curve.ends
    return ends if ends.repeated else replace(ends, gap=float(np.linalg.norm(points[-1] - points[0])))


def _worked(points: list[FloatArray], ends: list[Ends], settings: CurveSettings, progress: bool) -> Worked:
    """Denoise or simplify all curves."""
    # float64, as the file has them; a repeated vertex is removed
    curves = Curves(points, ends, [np.dtype(np.float64)] * len(points), True)
    told = settings.model() | {"progress": progress}
    whole: list[IntArray] = [np.arange(len(x)) for x in points]
    if not settings.simplifies:
        keep_ends = settings.keep_ends is not False
        done = denoised(curves, sigma=settings.sigma, keep_ends=keep_ends, valid=settings.valid, **told)
        lam = np.atleast_1d(done.lam).tolist()
        return Worked(
            done.points, whole, "positions", False, done.p, lam, list(done.sigma), done.estimated, list(done.results),
            found=done.found, crossings=done.crossings, refused=done.shortened,
        )  # fmt: skip
    names = ("method", "tolerance", "n_vertices", "filter")
    told |= {name: getattr(settings, name) for name in names if getattr(settings, name) is not None}
    simple = simplified(curves, valid=settings.valid, **told)
    kept = [part.kept for part in simple.parts]
    results = [part.result for part in simple.parts if part.result is not None]
    lam = [part.lam for part in simple.parts if part.lam is not None]
    return Worked(
        [part.points for part in simple.parts], kept, simple.filter or "heights", True, simple.p, lam,
        [0.0] * len(points), True, results, simple.tolerance, crossings=simple.crossings, refused=simple.refused,
    )  # fmt: skip


def _skeletons(points: list[FloatArray], made: list[CurveInFile]) -> list[Skeleton]:
    polygons = [x for x, curve in zip(points, made, strict=True) if curve.closed]
    if not polygons:
        raise ValueError("--skeleton needs a closed curve, and there is none")
    return [skeleton(x) for x in polygons]


def _branches(bones: Sequence[Skeleton], scale: FloatArray) -> list[CurveInFile]:
    """Convert the branches to open curves with the radius at each vertex."""
    found = [
        CurveInFile(bone.positions[chain] / scale, False, bone.radii[chain][:, None])
        for bone in bones
        for chain in bone.branches()
    ]
    if not found:
        raise ValueError("the curves have no skeleton: they have too few vertices, or no interior")
    return found


def _drawn(report: CurveReport) -> Any:
    from ..plot import curves
    from ..plot import skeleton as drawn

    if report.bones:
        return drawn(list(report.bones), caption=f"{report.branches} branches")
    closed = [one.closed for one in report.ends]
    return curves({"before": report.before, "after": report.worked.points}, closed=closed, caption=report.filter)
