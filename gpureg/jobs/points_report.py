"""What was done with points: as JSON can hold it, and in a few lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .. import metrics
from .._version import __version__
from ..arrays import FloatArray
from ..points.denoise import PointDenoising
from ..points.files import PointsFile
from .report import number


def denoising_report(found: PointDenoising) -> dict[str, Any]:
    """What :func:`gpureg.points.denoise.denoised` did."""
    runs = found.results
    report: dict[str, Any] = {
        "points": len(found.points),
        "coordinates": found.points.shape[1],
        "spacing": found.spacing,
        "method": found.filter,
        "filter": found.describe(),
        "p": found.p,
        "lam": number(found.lam) if isinstance(found.lam, float) else "map",
        "neighbours": found.k,
        "sigma": found.sigma,
        "sigma_estimated": found.estimated,
    }
    if found.values is None:
        report["displacement"] = {"largest": float(found.displacement.max()), "mean": float(found.displacement.mean())}
    return report | {
        "iterations": found.iterations,
        "stop": [run.stop.name.lower() for run in runs],
        "backend": runs[0].backend if runs else None,
        "seconds": round(found.seconds, 4),
        "version": __version__,
    }


def clustering_report(labels: npt.NDArray[np.int32], given: bool, seconds: float) -> dict[str, Any]:
    """What :func:`gpureg.cluster_points` found."""
    sizes = np.bincount(labels)
    return {
        "points": len(labels),
        "method": "cluster",
        "filter": "points that meet for p < 1, pieces joined by their mean weight",
        "clusters": len(sizes),
        "clusters_given": given,
        "sizes": sizes.tolist(),
        "seconds": round(seconds, 4),
        "version": __version__,
    }


def errors_of(before: PointsFile, after: FloatArray, truth: PointsFile) -> dict[str, Any]:
    """Root mean square distances from the truth: from its surface, if it is a mesh, else from its points."""
    x = before.points
    errors: dict[str, Any] = {}
    if truth.faces is not None and x.shape[1] == 3:
        surface = (truth.points, truth.faces)
        errors["surface"] = _pair(x, after, lambda points: metrics.distance_to_surface(points, surface))
    else:
        from scipy.spatial import cKDTree

        tree = cKDTree(truth.points)
        errors["nearest"] = _pair(x, after, lambda points: np.asarray(tree.query(points, workers=-1)[0]))
    if x.shape == truth.points.shape:
        errors["point"] = _pair(x, after, lambda points: np.linalg.norm(points - truth.points, axis=1))
    return errors


def _pair(before: FloatArray, after: FloatArray, distance: Any) -> dict[str, float]:
    return {
        which: float(np.sqrt(np.mean(distance(points) ** 2)))
        for which, points in (("before", before), ("after", after))
    }


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader."""
    lines = []
    if "sigma" in report:
        spacing = report["spacing"]
        moves = "displacement" in report and spacing
        share = f", {report['sigma'] / spacing:.2g} of the spacing" if moves else ""
        lines.append(
            f"noise    sigma = {report['sigma']:.4g}{share}, {'estimated' if report['sigma_estimated'] else 'as given'}"
        )
    lines.append(f"filter   {report['filter']}")
    if "clusters" in report:
        sizes = sorted(report["sizes"], reverse=True)
        shown = ", ".join(map(str, sizes[:8])) + (", ..." if len(sizes) > 8 else "")
        lines.append(f"clusters {report['clusters']}, {'as given' if report['clusters_given'] else 'found'}: {shown}")
    if "displacement" in report:
        moved = report["displacement"]
        lines.append(f"quality  displacement {moved['mean']:.3g} on average, {moved['largest']:.3g} at most")
    for name, what in (
        ("surface", "distance to the surface"),
        ("nearest", "distance to the nearest"),
        ("point", "points"),
    ):
        if name in report.get("reference", {}):
            error = report["reference"][name]
            lines.append(f"errors   {what} {error['before']:.4g} -> {error['after']:.4g}, root mean square")
    if "picture" in report:
        lines.append(f"picture  {report['picture']}")
    on = f" on {report['backend']}" if report.get("backend") else ""
    lines.append(f"done     {report['seconds']:.2f} s{on}; {report['points']} points -> {report['output']}")
    return "\n".join(lines)
