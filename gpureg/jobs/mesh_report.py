"""The report on a mesh, for JSON and as text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics
from ..meshes.report import MeshDenoising
from ..meshes.simplify import MeshSimplification
from ..shapes.surface import Surface
from .report import Change, Displacement, ShapeReport, noise_line, number


@dataclass(frozen=True)
class Measures:
    """Area and volume of a mesh, and whether it is closed, before and after; see :func:`gpureg.metrics.volume`."""

    area: Change
    volume: Change
    closed: Change

    @classmethod
    def of(cls, before: Surface, after: Surface) -> Measures:
        """Measure two surfaces."""
        one, two = (before.vertices, before.faces), (after.vertices, after.faces)
        measures = (metrics.area, metrics.volume, metrics.is_watertight)
        return cls(*(Change.of(measure, one, two) for measure in measures))

    def as_json(self) -> dict[str, Any]:
        """Return the measures as a dictionary for JSON."""
        return {name: getattr(self, name).as_json() for name in ("area", "volume", "closed")}

    def words(self) -> list[str]:
        """Describe how the measures changed."""
        volume, area = (f"{x.percent:.4g} %" if x.before else "none" for x in (self.volume, self.area))
        words = [f"volume {volume}" if self.closed.before else f"open; volume inside {volume}", f"area {area}"]
        return [*words, "no longer closed"] if self.closed.before and not self.closed.after else words


@dataclass(frozen=True)
class MeshErrors:
    """How far a mesh is from the truth, before and after.

    Attributes
    ----------
    file : Path
        File with the truth.
    hausdorff : float
        The distance of the mesh after.
    normal_angle, vertex : Change or None
        Errors of normals, in degrees, and of vertices, in mean edges; None if the faces are not the same.
    """

    file: Path
    hausdorff: float
    normal_angle: Change | None
    vertex: Change | None

    @classmethod
    def of(cls, file: Path, before: Surface, after: Surface, truth: Surface) -> MeshErrors:
        """Measure the errors of two surfaces."""
        pairs = [(surface.vertices, surface.faces) for surface in (before, after)]
        alike = all(
            surface.vertices.shape == truth.vertices.shape and np.array_equal(surface.faces, truth.faces)
            for surface in (before, after)
        )
        true = (truth.vertices, truth.faces)
        far = metrics.hausdorff(pairs[1], true)
        if not alike:
            return cls(file, far, None, None)
        angle = Change.of(lambda pair: metrics.normal_angle_error(pair, true), *pairs)
        return cls(file, far, angle, Change.of(lambda pair: metrics.vertex_error(pair, true), *pairs))

    def as_json(self) -> dict[str, Any]:
        """Return the errors as a dictionary for JSON."""
        errors: dict[str, Any] = {"file": str(self.file), "hausdorff": self.hausdorff}
        for name in ("normal_angle", "vertex"):
            change = getattr(self, name)
            errors |= {} if change is None else {name: change.as_json()}
        return errors

    def line(self) -> str:
        """Return the errors as a line of text."""
        assert math.isfinite(self.hausdorff)
        words = ["other faces than the reference"]
        if self.normal_angle is not None and self.vertex is not None:
            angle, vertex = self.normal_angle, self.vertex
            words = [f"normals {angle.before:.2f} -> {angle.after:.2f} degrees"]
            words.append(f"vertices {vertex.before:.3f} -> {vertex.after:.3f} edges")
        return f"errors   {', '.join(words)}, Hausdorff distance {self.hausdorff:.3g}"


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshReport(ShapeReport):
    """The common part of the reports on denoised and simplified meshes.

    Attributes
    ----------
    measures : Measures or None
        None if the vertices have not moved.
    errors : MeshErrors or None
        None without a reference.
    notes : tuple of str
        What was not read, not carried over or not written, in sentences.
    """

    measures: Measures | None
    errors: MeshErrors | None = None
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        report = super().as_json() | {"notes": list(self.notes)}
        if self.errors is None:
            return report
        picture = {"picture": report.pop("picture")} if "picture" in report else {}
        return report | {"reference": self.errors.as_json()} | picture

    def cautions(self) -> list[str]:
        """Return the notes as lines of text."""
        return [f"note     {note}" for note in self.notes]

    def _quality(self, last: str) -> list[str]:
        lines = []
        if self.measures is not None:
            lines.append(f"quality  {', '.join([*self.measures.words(), last])}")
        return lines if self.errors is None else [*lines, self.errors.line()]


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshDenoisingReport(MeshReport):
    """The report on a denoised mesh.

    Attributes
    ----------
    found : MeshDenoising
    """

    found: MeshDenoising

    def _told(self) -> dict[str, Any]:
        found = self.found
        report: dict[str, Any] = {
            "vertices": len(found.surface.vertices),
            "faces": len(found.surface.faces),
            "edge": found.edge,
            "method": found.filter,
            "filter": self.filter,
            "p": found.p,
            "lam": number(found.lam) if isinstance(found.lam, float) else "map",
        }
        if found.filter != "Taubin":
            report |= {"sigma": number(found.sigma), "sigma_estimated": found.estimated}
            low, high = found.noise_range
            if math.isfinite(low):
                report["noise_range"] = [low, high]
            report |= {"spikes": found.spikes, "components": found.components}
            report |= {"unknown_noise": found.unknown, "left": found.left}
        if self.measures is not None:
            report |= self.measures.as_json()
            report["displacement"] = Displacement.of(found.displacement).as_json()
        return report | self._runs()

    def _noise(self) -> list[str]:
        found = self.found
        if found.filter == "Taubin":
            return []
        if math.isnan(found.sigma):
            line = "noise    cannot be told" if found.unknown else "noise    not measured"
        else:
            share = f", {found.sigma / found.edge:.2g} of the mean edge" if found.moves and found.edge else ""
            line = noise_line(found.sigma, share, found.estimated)
        return [line, *([f"found    {found.found()}"] if found.found() else [])]

    def _found(self) -> list[str]:
        largest, edge = Displacement.of(self.found.displacement).largest, self.found.edge
        edges = f" ({largest / edge:.2f} edges)" if edge else ""
        return self._quality(f"largest displacement {largest:.3g}{edges}")

    def _size(self) -> str:
        return f"{len(self.found.surface.vertices)} vertices, {len(self.found.surface.faces)} faces"


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshSimplificationReport(MeshReport):
    """The report on a simplified mesh.

    Attributes
    ----------
    found : MeshSimplification
    hausdorff : float
        The distance between the mesh before and after.
    """

    found: MeshSimplification
    hausdorff: float

    def _counts(self) -> tuple[Change, Change]:
        """Count the vertices of faces, and the faces, before and after."""
        surface, found = self.found.surface, self.found
        used = len(np.unique(surface.welded()[0].faces))
        return Change(used, len(found.vertices)), Change(len(surface.faces), len(found.faces))

    def _told(self) -> dict[str, Any]:
        vertices, faces = self._counts()
        report = {
            "vertices": vertices.as_json(),
            "faces": faces.as_json(),
            "method": "simplify",
            "filter": self.filter,
            "met": self.found.met,
            "refused": self.found.refused,
        }
        measures = {} if self.measures is None else self.measures.as_json()
        return report | measures | {"hausdorff": self.hausdorff} | self._runs()

    def _found(self) -> list[str]:
        vertices, faces = self._counts()
        percent = 100 * vertices.after / max(vertices.before, 1)
        left = f"left     {vertices.after} of {vertices.before} vertices, {percent:.3g} %; "
        return [
            f"{left}{faces.after} of {faces.before} faces",
            *self._quality(f"Hausdorff distance {self.hausdorff:.3g}"),
        ]
