"""Filters that denoise the positions of a point cloud, or values on them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.csr import Graph
from ..graphs.of_points import knn_graph
from ..model.result import Result
from ..noise.fidelity import fidelity_to_normals, fidelity_to_values
from ..noise.graphs import noise_on_graph
from ..regularization.denoised import Denoised
from ..regularization.options import Model
from ..regularization.regularize import regularize
from ..shapes.cloud import Cloud
from ..weights import Weights, bilateral, guided
from .normals import directions, fitted_points, nearest, noise_along_normals, planes, projectors, spacing_of, tilt

PointFilter = Literal["normals", "positions"]
POINT_FILTERS: tuple[PointFilter, ...] = get_args(PointFilter)

# Neighbours in the graph.
NEIGHBOURS = 8
# Rounds in which projectors are regularized, and iterations per round.
_ROUNDS, _ITERATIONS = 3, 30
# Scale of the weights between projectors, a distance of matrices: 14 degrees.
_REACH = 0.35
# Steps that fit the points to their normals: more steps make noisy planes flatter and curved surfaces worse.
_FIT = 5
# Default bound on the displacement, in standard deviations of the noise.
MOST_MOVED = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class PointDenoising(Denoised[float]):
    """The result of denoising a point cloud: see :class:`Denoised`.

    Attributes
    ----------
    filter : {"normals", "positions", "values"}
    cloud : Cloud
        The input points.
    k : int
        Neighbours that each point chose in the graph.
    spacing : float
        Median distance from a point to its nearest neighbour in the input.
    normals : (n, d) float array or None
        The regularized unit normals, of either orientation; None with another filter.
    """

    WHAT: ClassVar[Mapping[str, str]] = {
        "normals": "normals of the neighbourhoods, points moved to fit them",
        "positions": "positions of the points",
        "values": "values at the points",
    }

    cloud: Cloud
    k: int
    spacing: float
    normals: FloatArray | None = None

    @property
    def points(self) -> FloatArray:
        """Positions of the points after denoising, (n, d)."""
        return self.value if self.moves else self.cloud.points

    def _parameters(self) -> str:
        return f"{self.k} neighbours, {super()._parameters()}"


@dataclass(frozen=True, eq=False)
class Task:
    """Centred points, and the settings of the filter.

    Attributes
    ----------
    cloud : Cloud
        The input points.
    points : (n, d) float array
        The same points, centred.
    pinned : (n,) bool array
        Points whose position or value does not change.
    k : int
    update_neighbours : int or None
    lam : float, (n,) array or None
    sigma, p : float or None
    weights : Weights, array or None
    max_iter : int or None
    options : Model
        Other settings of :func:`gpureg.regularize`.
    """

    cloud: Cloud
    points: FloatArray
    pinned: npt.NDArray[np.bool_]
    k: int
    update_neighbours: int | None
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    weights: Weights | npt.ArrayLike | None
    max_iter: int | None
    options: Model

    def of_values(self, f0: FloatArray) -> PointDenoising:
        """Regularize values other than positions, (n, m), on the graph of neighbours."""
        graph = knn_graph(self.points, self.k)
        sigma = noise_on_graph(f0, graph) if self.sigma is None else self.sigma
        p = 1.0 if self.p is None else self.p
        lam = fidelity_to_values(graph, sigma, p, f0.shape[1]) if self.lam is None else self.lam
        f, results = f0, []
        if not _is_infinite(lam):
            most = 100 if self.max_iter is None else self.max_iter
            results = [self._run(f0, graph, p, lam, most, self.weights)]
            f = results[0].value.astype(np.float64)
        return self._found(f, "values", results, sigma=sigma, p=p, lam=lam)

    def moved(self, filter: PointFilter) -> PointDenoising:
        """Regularize the points, or the normals of their neighbourhoods and then fit the points to them."""
        x, sigma = self.points, self.sigma
        if sigma is None and len(x) > 2:
            sigma = noise_along_normals(x) if x.shape[1] in (2, 3) else noise_on_graph(x, knn_graph(x, self.k))
        if len(x) < 3 or not sigma:
            p = self.p or (1.0 if filter == "normals" else 2.0)
            return self._found(x, filter, [], sigma=sigma or 0.0, p=p, lam=math.inf)
        return self._by_normals(sigma) if filter == "normals" else self._by_positions(sigma)

    def _found(
        self,
        value: FloatArray,
        filter: str,
        results: Iterable[Result],
        *,
        sigma: float,
        p: float,
        lam: float | FloatArray,
        normals: FloatArray | None = None,
    ) -> PointDenoising:
        return PointDenoising(
            value=value, filter=filter, results=tuple(results), sigma=sigma, estimated=self.sigma is None, p=p, lam=lam,
            normals=normals, cloud=self.cloud, k=self.k, spacing=spacing_of(self.cloud.points),
        )  # fmt: skip

    def _by_positions(self, sigma: float) -> PointDenoising:
        p, spacing = 2.0 if self.p is None else self.p, spacing_of(self.points)
        lam = self.lam
        if lam is None:
            lam = 2 ** (p - 2) * 4 * spacing ** (p - 1) / sigma if spacing > 0 else math.inf
        x, results = self.points, []
        left = 0 if _is_infinite(lam) else 100 if self.max_iter is None else self.max_iter
        each = left if self.update_neighbours is None else self.update_neighbours
        while left > 0:
            result = self._run(self.points, knn_graph(x, self.k), p, lam, min(each, left), self.weights, initial=x)
            results.append(result)
            x = result.value.astype(np.float64)
            left -= each
        return self._found(x, "positions", results, sigma=sigma, p=p, lam=lam)

    def _by_normals(self, sigma: float) -> PointDenoising:
        p, x, d = 1.0 if self.p is None else self.p, self.points, self.points.shape[1]
        around = _around(sigma, spacing_of(x), self.k)
        found = planes(x, nearest(x, around))
        graph = knn_graph(x, self.k)
        f0 = projectors(found.normals)
        u, v = graph.edge_rows(), graph.indices
        lam = self.lam
        if lam is None:
            apart = float(np.median(np.linalg.norm(f0[u] - f0[v], axis=1))) / math.sqrt(2) if len(u) else 0.0
            # with little noise the normals differ because of the shape
            noise = min(apart, tilt(found.extent, sigma, around))
            lam = fidelity_to_normals(noise)
        if _is_infinite(lam):
            return self._found(x, "normals", [], sigma=sigma, p=p, lam=lam, normals=found.normals)
        rows, results = f0, []
        for k in range(1 if self.weights is not None else _ROUNDS):
            alike = guided(bilateral(np.inf, _REACH), rows) if self.weights is None and k > 0 else self.weights
            most = _ITERATIONS if self.max_iter is None else self.max_iter
            results.append(self._run(f0, graph, p, lam, most, alike))
            normals = directions(results[-1].value.astype(np.float64), d)
            rows = projectors(normals)
        moves = (~self.pinned).astype(np.float64)
        left = _FIT
        while left > 0:
            steps = left if self.update_neighbours is None else min(left, self.update_neighbours)
            x = fitted_points(x, graph, normals, _REACH, moves, steps)
            left -= steps
            graph = knn_graph(x, self.k) if left > 0 else graph
        return self._found(x, "normals", results, sigma=sigma, p=p, lam=lam, normals=normals)

    def _run(
        self,
        f0: FloatArray,
        graph: Graph,
        p: float,
        lam: float | FloatArray,
        most: int,
        weights: Any,
        initial: FloatArray | None = None,
    ) -> Result:
        held = np.where(self.pinned, math.inf, lam) if self.pinned.any() else lam
        return regularize(f0, graph, p=p, lam=held, weights=weights, max_iter=most, initial=initial, **self.options)


def _is_infinite(lam: float | FloatArray) -> bool:
    """Return whether the fidelity pins everything."""
    return isinstance(lam, float) and math.isinf(lam)


def _around(sigma: float, spacing: float, k: int) -> int:
    """Return the number of neighbours for the plane of a point: 8 to 24, more for larger noise.

    Measured on two surfaces (bunny, fandisk): with noise of 0.1, 0.25, 0.5 and 0.8 spacings the errors are least with
    8, 8, 16-24 and 24 neighbours.
    """
    share = sigma / spacing if spacing > 0 else 1.0
    return int(max(k, np.clip(round(8 + 30 * (share - 0.25)), 8, 24)))
