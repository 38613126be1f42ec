"""What was done with curves: as JSON can hold it, and in a few lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import metrics
from .._version import __version__
from ..arrays import FloatArray, IntArray
from ..model.result import Result
from .report import number


@dataclass(frozen=True, eq=False)
class Worked:
    """Curves after they were denoised or simplified, and how.

    Attributes
    ----------
    points : list of (k, 2) float arrays
    kept : list of (k,) int arrays
        Which vertices these were.
    what : str
        "directions" or "positions": what was regularized.
    p : float or None
    lam, sigma : list of float or None
        Per curve.
    estimated : bool
        Whether the noise was.
    results : list of Result
    """

    points: list[FloatArray]
    kept: list[IntArray]
    what: str
    p: float | None
    lam: list[float | None]
    sigma: list[float | None]
    estimated: bool
    results: list[Result]


def as_report(
    before: list[FloatArray], worked: Worked, closed: list[bool], truth: list[FloatArray] | None
) -> dict[str, Any]:
    """What there is to say of curves before and after."""
    after = worked.points
    simplified = any(len(a) != len(b) for a, b in zip(before, after, strict=True)) or worked.sigma[0] is None
    lams = [lam for lam in worked.lam if lam is not None]
    lam = f"{np.median(lams):.4g}" if lams else "none"
    many = " in the middle" if len(set(lams)) > 1 else ""
    what = "vertices kept where the " if simplified else ""
    verb = f"{what}{worked.what} {'jump' if simplified else 'of the vertices'}"
    if not worked.results:
        rule = f"{verb}: there is no noise to remove"
    else:
        rule = f"{verb}; p = {worked.p:g}, lam = {lam}{many}, {worked.results[0].iterations} iterations"
    report: dict[str, Any] = {
        "curves": len(before),
        "closed": sum(closed),
        "vertices": {"before": sum(map(len, before)), "after": sum(map(len, after))},
        "method": "simplify" if simplified else "denoise",
        "filter": rule,
        "p": worked.p,
        "lam": [None if lam is None else number(lam) for lam in worked.lam],
    }
    if not simplified:
        report |= {"sigma": worked.sigma, "sigma_estimated": worked.estimated}
        moved = np.concatenate([np.linalg.norm(a - b, axis=1) for a, b in zip(before, after, strict=True)])
        report["displacement"] = {"largest": float(moved.max()), "mean": float(moved.mean())}
    report["length"] = _both(before, after, closed, metrics.curve_length)
    shut = [k for k, is_closed in enumerate(closed) if is_closed]
    if shut:
        report["area"] = {
            which: float(sum(abs(metrics.curve_area(points[k])) for k in shut))
            for which, points in (("before", before), ("after", after))
        }
    report["hausdorff"] = max(
        metrics.curve_hausdorff(a, b, closed=c) for a, b, c in zip(before, after, closed, strict=True)
    )
    if truth is not None:
        if len(truth) != len(before):
            raise ValueError(f"--reference has {len(truth)} curves, IN has {len(before)}")
        report["reference"] = {
            which: max(metrics.curve_hausdorff(a, b, closed=c) for a, b, c in zip(points, truth, closed, strict=True))
            for which, points in (("before", before), ("after", after))
        }
    return report | {
        "backend": worked.results[0].backend if worked.results else None,
        "version": __version__,
    }


def _both(before: list[FloatArray], after: list[FloatArray], closed: list[bool], measure: Any) -> dict[str, float]:
    return {
        which: float(sum(measure(x, c) for x, c in zip(points, closed, strict=True)))
        for which, points in (("before", before), ("after", after))
    }


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader."""
    lines = []
    if "sigma" in report:
        middle = float(np.median(report["sigma"]))
        how = "estimated" if report["sigma_estimated"] else "as given"
        lines.append(f"noise    sigma = {middle:.4g}{' in the middle' if report['curves'] > 1 else ''}, {how}")
    lines.append(f"filter   {report['filter']}")
    counts = report["vertices"]
    if report["method"] == "simplify":
        percent = 100 * counts["after"] / counts["before"]
        lines.append(f"left     {counts['after']} of {counts['before']} vertices, {percent:.3g} %")
    words = []
    for name in ("area", "length"):
        if name in report and report[name]["before"]:
            words.append(f"{name} {100 * report[name]['after'] / report[name]['before']:.5g} %")
    unit = f" {report['unit']}" if "unit" in report else ""
    words.append(f"Hausdorff distance {report['hausdorff']:.3g}{unit}")
    lines.append(f"quality  {', '.join(words)}")
    if "reference" in report:
        error = report["reference"]
        lines.append(f"errors   Hausdorff distance {error['before']:.3g} -> {error['after']:.3g}")
    if "skeleton" in report:
        bones = report["skeleton"]
        lines.append(f"skeleton {bones['branches']} branches, {bones['ends']} ends -> {bones['file']}")
    if "picture" in report:
        lines.append(f"picture  {report['picture']}")
    on = f" on {report['backend']}" if report["backend"] else ""
    size = f"{report['curves']} curve{'s' if report['curves'] > 1 else ''}, {counts['before']} vertices"
    lines.append(f"done     {report['seconds']:.2f} s{on}; {size} -> {report['output']}")
    return "\n".join(lines)
