"""From a file of curves to denoised or simpler ones, and their skeletons: what ``gpureg curve`` does."""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .. import weights
from ..arrays import FloatArray, IntArray
from ..curves.denoise import Curves, curves_of, denoised_curves
from ..curves.files import CurveError, CurveInFile, CurvesFile, curve_format, encode_curves, read_curves
from ..curves.simplify import Function, simplified_curves
from ..curves.skeletons import Skeleton, skeleton
from ..files.pictures import check_place, write_files
from .curve_report import Worked, as_report

CURVE_WEIGHTS = ("constant", "inverse-distance", "inverse-square")

_SIMPLIFYING = ("function", "n_vertices")
_MODEL = ("p", "lam", "norm", "solver", "max_iter", "tol", "eps", "backend", "dtype")


@dataclass(frozen=True)
class CurveSettings:
    """What is asked for besides IN and OUT: the options of ``gpureg curve``; None leaves it to the door."""

    simplify: bool = False
    n_vertices: int | None = None
    function: Function | None = None
    p: float | None = None
    lam: float | None = None
    sigma: float | None = None
    weights: str | None = None
    norm: Literal["vertex", "edge"] | None = None
    free_ends: bool = False
    closed: bool | None = None
    degrees: bool | None = None
    skeleton: Path | None = None
    solver: Literal["jacobi", "certified"] | None = None
    max_iter: int | None = None
    tol: float | None = None
    eps: float | None = None
    backend: str = "auto"
    dtype: str | None = None
    reference: Path | None = None
    picture: Path | None = None

    @property
    def simplifies(self) -> bool:
        """Whether curves are to have fewer vertices, instead of less noise."""
        return self.simplify or self.n_vertices is not None

    def model(self) -> dict[str, Any]:
        """What the doors are told of the model, where it is not their default."""
        found = {name: getattr(self, name) for name in _MODEL if getattr(self, name) is not None}
        chosen: Any = {
            None: None,
            "constant": weights.constant(),
            "inverse-distance": weights.inverse_distance(1),
            "inverse-square": weights.inverse_distance(2),
        }[self.weights]
        return found if chosen is None else found | {"weights": chosen}

    def check(self) -> None:
        """Refuse options that do nothing together.

        Raises
        ------
        ValueError
        """
        if self.simplifies and self.sigma is not None:
            raise ValueError("--sigma is for denoising, --simplify and --n-vertices are not; run twice")
        if self.simplifies and self.free_ends:
            raise ValueError("--free-ends is for denoising: simplified curves keep their ends")
        if not self.simplifies and self.function is not None:
            raise ValueError("--function says what is simplified: give --simplify too")


def curve_file(source: Path, target: Path, settings: CurveSettings, *, progress: bool = False) -> dict[str, Any]:
    """Denoise or simplify the curves of `source` into the file `target`.

    All files are written, or none.

    Parameters
    ----------
    source, target : Path
    settings : CurveSettings
    progress : bool, default False
        Whether to draw a bar.

    Returns
    -------
    dict
        What was done, as JSON can hold it.

    Raises
    ------
    CurveError, PictureError
        A file that cannot be read or written, a picture where matplotlib is not installed.
    ValueError, TypeError, BackendUnavailable, FloatingPointError, MemoryError, Interrupted
        As :func:`gpureg.denoise_curve`, :func:`gpureg.simplify_curve` and :func:`gpureg.curves.skeletons`.
    """
    settings.check()
    _check_files(source, target, settings)
    begin = time.perf_counter()
    given = read_curves(source, closed=settings.closed)
    truth = None if settings.reference is None else read_curves(settings.reference, closed=settings.closed)
    scale = _scale(given, settings)
    before: list[FloatArray] = [curve.points * scale for curve in given.curves]
    worked = _worked(before, [curve.closed for curve in given.curves], settings, progress)
    made = [
        replace(curve, points=points / scale, more=curve.more[kept])
        for curve, points, kept in zip(given.curves, worked.points, worked.kept, strict=True)
    ]
    truth_points: list[FloatArray] | None = None if truth is None else [x.points * scale for x in truth.curves]
    report = {"input": str(source), "output": str(target)} | as_report(
        before,
        worked,
        [curve.closed for curve in given.curves],
        truth_points,
    )
    if scale[0] != 1:
        report["unit"] = "degrees of latitude"
    content = encode_curves(target, made, like=given)
    writes = {target: lambda path: path.write_bytes(content)}
    bones: list[Skeleton] = []
    if settings.skeleton is not None:
        bones = _skeletons(worked.points, made)
        lines = encode_curves(settings.skeleton, _branches(bones, scale), names=("radius",))
        writes[settings.skeleton] = lambda path: path.write_bytes(lines)
        report["skeleton"] = {
            "file": str(settings.skeleton),
            "branches": sum(bone.n_branches for bone in bones),
            "ends": sum(bone.n_ends for bone in bones),
        }
    if settings.picture is not None:
        figure = _drawn(before, worked.points, made, bones, settings, report)
        writes[settings.picture] = lambda path: figure.savefig(path)
        report["picture"] = str(settings.picture)
    write_files(writes)
    return report | {"seconds": round(time.perf_counter() - begin, 4)}


def _check_files(source: Path, target: Path, settings: CurveSettings) -> None:
    """Refuse, before work is spent on them, files that cannot be written, and such as overwrite what is read."""
    curve_format(target)
    check_place(target)
    read = [path for path in (settings.reference,) if path is not None]
    outputs: list[tuple[str, Path, list[Path]]] = [("OUT", target, read)]
    if settings.skeleton is not None:
        curve_format(settings.skeleton)
        check_place(settings.skeleton)
        outputs.append(("--skeleton", settings.skeleton, [source, *read]))
    if settings.picture is not None:
        from ..plot.canvas import check_path

        try:
            check_path(settings.picture)
        except ImportError as error:
            raise CurveError(f"--picture: {error}") from None
        check_place(settings.picture)
        outputs.append(("--picture", settings.picture, [source, *read]))
    for k, (option, path, others) in enumerate(outputs):
        for other in others:
            if os.path.exists(path) and os.path.exists(other) and os.path.samefile(path, other):
                raise ValueError(f"{option} {path} would overwrite {other}, which is read; give another file")
        for name, earlier, _ in outputs[:k]:
            if os.path.realpath(path) == os.path.realpath(earlier):
                raise ValueError(f"{name} and {option} would both be written to {path}; give each its own file")


def _scale(given: CurvesFile, settings: CurveSettings) -> FloatArray:
    """What makes a degree of longitude as long as one of latitude, in the middle; 1 where these are no degrees."""
    degrees = given.degrees if settings.degrees is None else settings.degrees
    if not degrees:
        return np.ones(2)
    latitudes = np.concatenate([curve.points[:, 1] for curve in given.curves])
    if np.abs(latitudes).max() > 90:
        raise ValueError(
            f"latitudes must lie in -90..90, got {np.abs(latitudes).max():g}: these are no degrees, give --no-degrees"
        )
    return np.array([max(math.cos(math.radians(float(latitudes.mean()))), 1e-3), 1.0])


def _worked(points: list[FloatArray], closed: list[bool], settings: CurveSettings, progress: bool) -> Worked:
    """All curves, those that are closed and those that are open each as one graph."""
    made: list[FloatArray] = list(points)
    kept: list[IntArray] = [np.arange(len(x)) for x in points]
    sigma: list[float | None] = [None] * len(points)
    lam: list[float | None] = [None] * len(points)
    results, p = [], None
    model = settings.model() | {"progress": progress}
    for shut in (True, False):
        chosen = [k for k, is_closed in enumerate(closed) if is_closed == shut]
        if not chosen:
            continue
        curves: Curves = curves_of([points[k] for k in chosen], shut)
        if settings.simplifies:
            options: dict[str, Any] = {"norm": "edge", "p": 0.5, "eps": 1e-3, "max_iter": 2000, "tol": 1e-6}
            options |= {"dtype": np.float64, "solver": "jacobi"} | model
            wanted: dict[str, Any] = {"function": settings.function or "directions", "n_vertices": settings.n_vertices}
            for k, found in zip(chosen, simplified_curves(curves, **wanted, **options), strict=True):
                made[k], kept[k], lam[k] = found.points, found.kept, found.lam
                results.append(found.result)
            p = options["p"]
        else:
            done = denoised_curves(curves, sigma=settings.sigma, keep_ends=not settings.free_ends, **model)
            for k, x, s, fidelity in zip(chosen, done.points, done.sigma, done.lam, strict=True):
                made[k], sigma[k], lam[k] = x, s, float(fidelity)
            results += [] if done.result is None else [done.result]
            p = done.p
    what = (settings.function or "directions") if settings.simplifies else "positions"
    return Worked(made, kept, what, p, lam, sigma, settings.sigma is None, results)


def _skeletons(points: list[FloatArray], made: list[CurveInFile]) -> list[Skeleton]:
    polygons = [x for x, curve in zip(points, made, strict=True) if curve.closed]
    if not polygons:
        raise ValueError("--skeleton is that of closed curves, and there is none")
    return [skeleton(x) for x in polygons]


def _branches(bones: list[Skeleton], scale: FloatArray) -> list[CurveInFile]:
    """The branches as open curves, with the radius at each vertex."""
    found = [
        CurveInFile(bone.positions[chain] / scale, False, bone.radii[chain][:, None])
        for bone in bones
        for chain in bone.branches()
    ]
    if not found:
        raise ValueError("the curves have no skeleton: they have too few vertices, or no inside")
    return found


def _drawn(
    before: list[FloatArray],
    after: list[FloatArray],
    made: list[CurveInFile],
    bones: list[Skeleton],
    settings: CurveSettings,
    report: dict[str, Any],
) -> Any:
    from ..plot import curves
    from ..plot import skeleton as drawn

    if bones:
        return drawn(bones, caption=f"{report['skeleton']['branches']} branches")
    closed = [curve.closed for curve in made]
    return curves({"before": before, "after": after}, closed=closed, caption=report["filter"])
