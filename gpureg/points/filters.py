"""What denoising a point cloud does to its positions, or to values on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.csr import Graph
from ..graphs.of_points import knn_graph
from ..model.result import Result
from ..noise.fidelity import fidelity_to_normals, fidelity_to_values
from ..noise.graphs import noise_on_graph
from ..regularization.regularize import regularize
from ..weights import Weights, bilateral, guided
from .normals import directions, fitted_points, nearest, noise_along_normals, planes, projectors, spacing_of, tilt

PointFilter = Literal["normals", "positions"]
POINT_FILTERS: tuple[PointFilter, ...] = get_args(PointFilter)

# Neighbours in the graph.
NEIGHBOURS = 8
# Rounds in which projectors are regularized, and their iterations.
_ROUNDS, _ITERATIONS = 3, 30
# Reach of the weights between projectors, a distance of matrices: 14 degrees.
_REACH = 0.35
# Steps that fit the points to their normals: more make noisy planes flatter, and curved surfaces worse.
_FIT = 5
# Noise of Gauss moves no point further than so many deviations.
MOST_MOVED = 3.0


class _Found(NamedTuple):
    """A function on the points, and what :class:`PointDenoising` says of how it was found."""

    f: FloatArray
    filter: str
    sigma: float
    estimated: bool
    p: float
    lam: float | FloatArray
    results: list[Result]
    normals: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Task:
    """Points around their mean, and what was asked for."""

    points: FloatArray
    pinned: npt.NDArray[np.bool_]
    k: int
    update_neighbours: int | None
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    weights: Weights | npt.ArrayLike | None
    model: dict[str, Any]
    max_iter: int | None

    def of_values(self, f0: FloatArray) -> _Found:
        """Values other than positions, on the graph of neighbours."""
        graph = knn_graph(self.points, self.k)
        sigma = noise_on_graph(f0, graph) if self.sigma is None else self.sigma
        p = 1.0 if self.p is None else self.p
        lam = fidelity_to_values(graph, sigma, p, f0.shape[1]) if self.lam is None else self.lam
        if isinstance(lam, float) and math.isinf(lam):
            return _Found(f0, "values", sigma, self.sigma is None, p, lam, [])
        most = 100 if self.max_iter is None else self.max_iter
        result = self._run(f0, graph, p, lam, most, self.weights)
        return _Found(result.value.astype(np.float64), "values", sigma, self.sigma is None, p, lam, [result])

    def moved(self, filter: PointFilter) -> _Found:
        """The points, by themselves or by the normals of their neighbourhoods."""
        x, sigma = self.points, self.sigma
        if sigma is None and len(x) > 2:
            sigma = noise_along_normals(x) if x.shape[1] in (2, 3) else noise_on_graph(x, knn_graph(x, self.k))
        if len(x) < 3 or not sigma:
            p = self.p or (1.0 if filter == "normals" else 2.0)
            return _Found(x, filter, sigma or 0.0, self.sigma is None, p, math.inf, [])
        return self._by_normals(sigma) if filter == "normals" else self._by_positions(sigma)

    def _by_positions(self, sigma: float) -> _Found:
        p, spacing = 2.0 if self.p is None else self.p, spacing_of(self.points)
        lam = self.lam
        if lam is None:
            lam = 2 ** (p - 2) * 4 * spacing ** (p - 1) / sigma if spacing > 0 else math.inf
        if isinstance(lam, float) and math.isinf(lam):
            return _Found(self.points, "positions", sigma, self.sigma is None, p, lam, [])
        left = 100 if self.max_iter is None else self.max_iter
        each = left if self.update_neighbours is None else self.update_neighbours
        x, results = self.points, []
        while left > 0:
            result = self._run(self.points, knn_graph(x, self.k), p, lam, min(each, left), self.weights, initial=x)
            results.append(result)
            x = result.value.astype(np.float64)
            left -= each
        return _Found(x, "positions", sigma, self.sigma is None, p, lam, results)

    def _by_normals(self, sigma: float) -> _Found:
        p, x, d = 1.0 if self.p is None else self.p, self.points, self.points.shape[1]
        around = _around(sigma, spacing_of(x), self.k)
        found = planes(x, nearest(x, around))
        graph = knn_graph(x, self.k)
        f0 = projectors(found.normals)
        u, v = graph.edge_rows(), graph.indices
        lam = self.lam
        if lam is None:
            apart = float(np.median(np.linalg.norm(f0[u] - f0[v], axis=1))) / math.sqrt(2) if len(u) else 0.0
            # where there is hardly any noise it is the shape that makes normals differ
            noise = min(apart, tilt(found.extent, sigma, around))
            lam = fidelity_to_normals(noise)
        if isinstance(lam, float) and math.isinf(lam):
            return _Found(x, "normals", sigma, self.sigma is None, p, lam, [], found.normals)
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
        return _Found(x, "normals", sigma, self.sigma is None, p, lam, results, normals)

    def _run(
        self, f0: FloatArray, graph: Graph, p: float, lam: float | FloatArray, most: int, weights: Any, **more: Any
    ) -> Result:
        held = np.where(self.pinned, math.inf, lam) if self.pinned.any() else lam
        return regularize(f0, graph, p=p, lam=held, weights=weights, max_iter=most, **self.model, **more)


def _around(sigma: float, spacing: float, k: int) -> int:
    """Neighbours through whom a point's plane is fitted: 8 to 24, more where noise is larger.

    Measured on two surfaces (bunny, fandisk) with noise of 0.1 to 0.8 spacings: the least errors are at 8, 8, 16-24 and
    24 neighbours for 0.1, 0.25, 0.5 and 0.8.
    """
    share = sigma / spacing if spacing > 0 else 1.0
    return int(max(k, np.clip(round(8 + 30 * (share - 0.25)), 8, 24)))
