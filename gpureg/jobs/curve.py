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
from ..curves.curves import Curves
from ..curves.denoise import denoised
from ..curves.files import CurveError, CurveInFile, CurvesFile, curve_format, encode_curves, read_curves
from ..curves.process import CurveFilter
from ..curves.simplify import simplified
from ..curves.skeletons import Skeleton, skeleton
from ..model.result import Result
from ..shapes.ends import Ends, ends_of
from .curve_report import CurveReport, Measures, Worked
from .options import ShapeSettings
from .outputs import Outputs


@dataclass(frozen=True, kw_only=True)
class CurveSettings(ShapeSettings):
    """The options, without IN and OUT, of ``gpureg curve``."""

    simplify: bool = False
    n_vertices: int | None = None
    filter: CurveFilter | None = None
    keep_ends: bool | None = None
    closed: bool | None = None
    degrees: bool | None = None
    skeleton: Path | None = None

    @property
    def simplifies(self) -> bool:
        """Whether to simplify the curves instead of denoising them."""
        return self.simplify or self.n_vertices is not None

    def check(self) -> None:
        """Raise ValueError for combinations of options that have no effect."""
        if self.simplifies and self.sigma is not None:
            raise ValueError("--sigma is for denoising, --simplify and --n-vertices are not; run twice")
        if self.simplifies and self.keep_ends is False:
            raise ValueError("--no-keep-ends is for denoising: simplified curves keep their ends")
        if not self.simplifies and self.filter is not None:
            raise ValueError("--filter says what is simplified: give --simplify too")


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
    outputs = Outputs(source, settings.reference)
    for option, path in (("OUT", target), ("--skeleton", settings.skeleton)):
        if path is not None:
            curve_format(path)
            outputs.expect(option, path)
    outputs.expect_picture(settings.picture, CurveError)
    begin = time.perf_counter()
    given = read_curves(source, closed=settings.closed)
    truth = None if settings.reference is None else read_curves(settings.reference, closed=settings.closed)
    scale = _scale(given, settings)
    before: list[FloatArray] = [curve.points * scale for curve in given.curves]
    ends = [_scaled(curve, x) for curve, x in zip(given.curves, before, strict=True)]
    worked = _worked(before, ends, settings, progress)
    made = [
        replace(curve, points=points / scale, more=curve.more[kept])
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
    )
    outputs.put(target, encode_curves(target, made, like=given))
    if settings.skeleton is not None:
        lines = encode_curves(settings.skeleton, _branches(report.bones, scale), names=("radius",))
        outputs.put(settings.skeleton, lines)
    if settings.picture is not None:
        outputs.draw(settings.picture, _drawn(report))
    outputs.write()
    return replace(report, seconds=time.perf_counter() - begin)


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
    """Denoise or simplify all curves: the closed curves as one graph, the open ones as another."""
    n = len(points)
    made: list[FloatArray] = list(points)
    kept: list[IntArray] = [np.arange(len(x)) for x in points]
    sigma, lam = [0.0] * n, [0.0] * n
    results: list[Result] = []
    told = settings.model() | {"progress": progress}
    p = 0.0
    for shut in (True, False):
        chosen = [k for k in range(n) if ends[k].closed == shut]
        if not chosen:
            continue
        # float64, as the file has them; a repeated vertex is removed
        kinds = [np.dtype(np.float64)] * len(chosen)
        curves = Curves([points[k] for k in chosen], [ends[k] for k in chosen], kinds, True)
        if settings.simplifies:
            simple = simplified(curves, filter=_filter(settings), n_vertices=settings.n_vertices, **told)
            for k, part in zip(chosen, simple.parts, strict=True):
                made[k], kept[k], lam[k] = part.points, part.kept, part.lam
                results.append(part.result)
            p = simple.p
        else:
            done = denoised(curves, sigma=settings.sigma, keep_ends=settings.keep_ends is not False, **told)
            for k, x, s, fidelity in zip(chosen, done.points, done.sigma, done.lam, strict=True):
                made[k], sigma[k], lam[k] = x, s, float(fidelity)
            results += done.results
            p = done.p
    what = _filter(settings) if settings.simplifies else "positions"
    return Worked(made, kept, what, settings.simplifies, p, lam, sigma, settings.sigma is None, results)


def _filter(settings: CurveSettings) -> CurveFilter:
    """Return the filter of simplification."""
    return settings.filter or "directions"


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
