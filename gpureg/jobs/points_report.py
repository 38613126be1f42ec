"""The report on points, for JSON and as text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import metrics
from .._version import __version__
from ..arrays import FloatArray
from ..points.contents import PointsFile
from ..points.report import PointDenoising
from .report import Change, Displacement, ShapeReport, noise_line, number

_WORDS = {"surface": "distance to the surface", "nearest": "distance to the nearest", "point": "points"}


@dataclass(frozen=True)
class PointErrors:
    """Root mean square distances of points from the truth, before and after.

    Attributes
    ----------
    file : Path
        File with the truth.
    surface, nearest, point : Change or None
        Distance from its surface if it is a mesh, else from its nearest point; and from the point of the same index.
    """

    file: Path
    surface: Change | None
    nearest: Change | None
    point: Change | None

    @classmethod
    def of(cls, file: Path, before: FloatArray, after: FloatArray, truth: PointsFile) -> PointErrors:
        """Measure the errors of points (n, d) before and after."""
        surface = nearest = point = None
        if truth.faces is not None and before.shape[1] == 3:
            mesh = (truth.points, truth.faces)
            surface = _mean(lambda x: metrics.distance_to_surface(x, mesh), before, after)
        else:
            from scipy.spatial import cKDTree

            tree = cKDTree(truth.points)
            nearest = _mean(lambda x: np.asarray(tree.query(x, workers=-1)[0]), before, after)
        if before.shape == truth.points.shape:
            point = _mean(lambda x: np.linalg.norm(x - truth.points, axis=1), before, after)
        return cls(file, surface, nearest, point)

    def _changes(self) -> dict[str, Change]:
        return {name: change for name in _WORDS if (change := getattr(self, name)) is not None}

    def as_json(self) -> dict[str, Any]:
        """Return the errors as a dictionary for JSON."""
        return {"file": str(self.file)} | {name: change.as_json() for name, change in self._changes().items()}

    def lines(self) -> list[str]:
        """Return the errors as lines of text."""
        return [
            f"errors   {_WORDS[name]} {error.before:.4g} -> {error.after:.4g}, root mean square"
            for name, error in self._changes().items()
        ]


def _mean(distance: Callable[[FloatArray], FloatArray], before: FloatArray, after: FloatArray) -> Change:
    return Change.of(lambda x: float(np.sqrt(np.mean(distance(x) ** 2))), before, after)


@dataclass(frozen=True, eq=False, kw_only=True)
class _PointsReport(ShapeReport):
    """The report on a file of points.

    Attributes
    ----------
    notes : tuple of str
        What the file held that was changed or not kept, in sentences.
    """

    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON."""
        return super().as_json() | {"notes": list(self.notes)}

    def cautions(self) -> list[str]:
        """Return the notes on what was not kept."""
        return [f"note     {note}" for note in self.notes]


@dataclass(frozen=True, eq=False, kw_only=True)
class PointDenoisingReport(_PointsReport):
    """The report on denoised points.

    Attributes
    ----------
    found : PointDenoising
    errors : PointErrors or None
        None without a reference.
    """

    found: PointDenoising
    errors: PointErrors | None = None

    def _told(self) -> dict[str, Any]:
        found = self.found
        report: dict[str, Any] = {
            "points": len(found.points),
            "coordinates": found.points.shape[1],
            "spacing": found.spacing,
            "method": found.filter,
            "filter": self.filter,
            "p": found.p,
            "lam": number(found.lam) if isinstance(found.lam, float) else "map",
            "neighbours": found.k,
            "sigma": number(found.sigma),
            "sigma_estimated": found.estimated,
            "noise_unknown": found.unknown,
            "outliers": int(found.outliers.sum()),
            "repeated": found.repeated,
        }
        if found.moves:
            report["displacement"] = Displacement.of(found.displacement).as_json()
        report |= self._runs()
        return report if self.errors is None else report | {"reference": self.errors.as_json()}

    def _noise(self) -> list[str]:
        found = self.found
        if np.isnan(found.sigma):
            return ["noise    sigma cannot be told from so few points"]
        share = f", {found.sigma / found.spacing:.2g} of the spacing" if found.moves and found.spacing else ""
        return [noise_line(found.sigma, share, found.estimated)]

    def _found(self) -> list[str]:
        lines = [f"left out {sentence}" for sentence in self.found.warnings()]
        if self.found.repeated:
            lines.append(f"repeated {self.found.repeated} points repeat others; they were merged, and put back after")
        if self.found.moves:
            moved = Displacement.of(self.found.displacement)
            lines.append(f"quality  displacement {moved.mean:.3g} on average, {moved.largest:.3g} at most")
        return lines if self.errors is None else [*lines, *self.errors.lines()]

    def _size(self) -> str:
        return f"{len(self.found.points)} points"


@dataclass(frozen=True, eq=False, kw_only=True)
class ClusteringReport(_PointsReport):
    """The report on clustered points.

    Attributes
    ----------
    labels : (n,) int32 array
        The cluster of each point.
    given : bool
        Whether the number of clusters was given.
    """

    filter: str = "points that meet for p < 1, pieces joined by their mean weight"
    labels: npt.NDArray[np.int32]
    given: bool

    @property
    def sizes(self) -> list[int]:
        """Number of points of each cluster."""
        sizes: list[int] = np.bincount(self.labels).tolist()
        return sizes

    def _told(self) -> dict[str, Any]:
        return {
            "points": len(self.labels),
            "method": "cluster",
            "filter": self.filter,
            "clusters": len(self.sizes),
            "clusters_given": self.given,
            "sizes": self.sizes,
            "seconds": round(self.seconds, 4),
            "version": __version__,
        }

    def _found(self) -> list[str]:
        sizes = sorted(self.sizes, reverse=True)
        shown = ", ".join(map(str, sizes[:8])) + (", ..." if len(sizes) > 8 else "")
        return [f"clusters {len(sizes)}, {'as given' if self.given else 'found'}: {shown}"]

    def _size(self) -> str:
        return f"{len(self.labels)} points"
