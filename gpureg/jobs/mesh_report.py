"""What was done with a mesh: as JSON can hold it, and in a few lines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .. import metrics
from .._version import __version__
from ..meshes.denoise import MeshDenoising
from ..meshes.simplify import MeshSimplification
from ..shapes.surface import Surface
from .report import number


def denoising_report(before: Surface, after: Surface, found: MeshDenoising) -> dict[str, Any]:
    """What :func:`gpureg.meshes.denoise.denoised` did."""
    report = {
        "vertices": len(before.vertices),
        "faces": len(before.faces),
        "edge": found.edge,
        "method": found.filter,
        "filter": found.describe(),
        "p": found.p,
        "lam": number(found.lam) if isinstance(found.lam, float) else "map",
    }
    if found.filter != "Taubin":
        report |= {"sigma": found.sigma, "sigma_estimated": found.estimated}
    if found.values is None:
        report |= _kept(before, after)
        report["displacement"] = {"largest": float(found.displacement.max()), "mean": float(found.displacement.mean())}
    return report | _runs(found)


def simplification_report(before: Surface, after: Surface, found: MeshSimplification) -> dict[str, Any]:
    """What :func:`gpureg.meshes.simplify.simplified` did."""
    used = len(np.unique(before.welded()[0].faces))
    rounds = len(found.results)
    result = found.results[0]
    each = f"{rounds} rounds of " if rounds > 1 else ""
    report = {
        "vertices": {"before": used, "after": len(after.vertices)},
        "faces": {"before": len(before.faces), "after": len(after.faces)},
        "method": "simplify",
        "filter": f"vertices that meet become one; {each}{result.iterations} iterations",
        "met": found.met,
        "refused": found.refused,
    }
    report |= _kept(before, after)
    report["hausdorff"] = _hausdorff(after, before)
    return report | _runs(found)


def _runs(found: MeshDenoising | MeshSimplification) -> dict[str, Any]:
    runs = found.results
    return {
        "iterations": sum(run.iterations for run in runs),
        "stop": [run.stop.name.lower() for run in runs],
        "backend": runs[0].backend if runs else None,
        "seconds": round(found.seconds, 4),
        "version": __version__,
    }


def _kept(before: Surface, after: Surface) -> dict[str, Any]:
    """Area and volume of both; of an open mesh the volume is that under cones over its borders."""
    pairs = [(surface.vertices, surface.faces) for surface in (before, after)]
    return {
        name: dict(zip(("before", "after"), (measure(pair) for pair in pairs), strict=True))
        for name, measure in (("area", metrics.area), ("volume", metrics.volume), ("closed", metrics.is_watertight))
    }


def errors_of(before: Surface, after: Surface, truth: Surface) -> dict[str, Any]:
    """How far both are from the truth: by face and vertex where these correspond, and between surfaces."""
    errors: dict[str, Any] = {"hausdorff": _hausdorff(after, truth)}
    for name, measure in (("normal_angle", metrics.normal_angle_error), ("vertex", metrics.vertex_error)):
        if all(
            surface.vertices.shape == truth.vertices.shape and np.array_equal(surface.faces, truth.faces)
            for surface in (before, after)
        ):
            errors[name] = {
                which: measure((surface.vertices, surface.faces), (truth.vertices, truth.faces))
                for which, surface in (("before", before), ("after", after))
            }
    return errors


def _hausdorff(one: Surface, other: Surface) -> float:
    return metrics.hausdorff((one.vertices, one.faces), (other.vertices, other.faces))


def as_lines(report: dict[str, Any]) -> str:
    """A report for a reader."""
    lines = []
    if "sigma" in report:
        share = (
            f", {report['sigma'] / report['edge']:.2g} of the mean edge" if _moves(report) and report["edge"] else ""
        )
        lines.append(
            f"noise    sigma = {report['sigma']:.4g}{share}, {'estimated' if report['sigma_estimated'] else 'as given'}"
        )
    lines.append(f"filter   {report['filter']}")
    if "met" in report:
        counts = report["vertices"]
        percent = 100 * counts["after"] / max(counts["before"], 1)
        lines.append(
            f"left     {counts['after']} of {counts['before']} vertices, {percent:.3g} %; "
            f"{report['faces']['after']} of {report['faces']['before']} faces"
        )
    if "area" in report:
        lines.append(f"quality  {_quality(report)}")
    if "reference" in report:
        lines.append(f"errors   {_errors(report)}")
    if "picture" in report:
        lines.append(f"picture  {report['picture']}")
    on = f" on {report['backend']}" if report["backend"] else ""
    size = ""
    if "met" not in report:
        size = f"; {report['vertices']} vertices, {report['faces']} faces"
    lines.append(f"done     {report['seconds']:.2f} s{on}{size} -> {report['output']}")
    return "\n".join(lines)


def _moves(report: dict[str, Any]) -> bool:
    return "displacement" in report


def _quality(report: dict[str, Any]) -> str:
    volume, area = (
        f"{100 * report[name]['after'] / report[name]['before']:.4g} %" if report[name]["before"] else "none"
        for name in ("volume", "area")
    )
    closed = report["closed"]["before"]
    words = [f"volume {volume}" if closed else f"open; volume inside {volume}", f"area {area}"]
    if closed and not report["closed"]["after"]:
        words.append("no longer closed")
    if _moves(report):
        largest, edge = report["displacement"]["largest"], report["edge"]
        edges = f" ({largest / edge:.2f} edges)" if edge else ""
        words.append(f"largest displacement {largest:.3g}{edges}")
    else:
        words.append(f"Hausdorff distance {report['hausdorff']:.3g}")
    return ", ".join(words)


def _errors(report: dict[str, Any]) -> str:
    errors = report["reference"]
    words = []
    if "normal_angle" in errors:
        angle, vertex = errors["normal_angle"], errors["vertex"]
        words.append(f"normals {angle['before']:.2f} -> {angle['after']:.2f} degrees")
        words.append(f"vertices {vertex['before']:.3f} -> {vertex['after']:.3f} edges")
    else:
        words.append("other faces than the reference")
    assert math.isfinite(errors["hausdorff"])
    words.append(f"Hausdorff distance {errors['hausdorff']:.3g}")
    return ", ".join(words)
