"""Filters that denoise the positions of a point cloud, or values on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..graphs.of_points import knn_graph
from ..model.result import Result
from ..noise.fidelity import fidelities_to_values
from ..noise.local import row_medians
from ..noise.values import ValueNoise, alike_channels, mean_squares, value_noise
from ..regularization.options import Model
from ..regularization.regularize import regularize
from ..shapes.cloud import Cloud
from ..weights import Weights, bilateral, guided
from .levels import POINTS, ROUNDS, Bodies, around_each, bodies, opened, point_levels
from .normals import directions, fitted_points, planes_of, projectors, tilt
from .report import PointDenoising
from .surface import LEAST, OWN, fitted_surface

PointFilter = Literal["surface", "normals", "positions"]
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
# With fewer points in a component values do not tell their noise.
_TELLING = 3
# The default fidelity to normals is this over the square of their noise.
_TO_NORMALS = 0.5


@dataclass(frozen=True, eq=False)
class Task:
    """Points that take part, and the settings of the filter.

    Attributes
    ----------
    cloud : Cloud
        The input points.
    points : (n, d) float array
        The points without repetitions and outliers, centred.
    spacing : float
        The median distance to the nearest of them.
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
    spacing: float
    pinned: npt.NDArray[np.bool_]
    k: int
    update_neighbours: int | None
    lam: float | FloatArray | None
    sigma: float | None
    p: float | None
    weights: Weights | npt.ArrayLike | None
    max_iter: int | None
    options: Model

    @cached_property
    def graph(self) -> Graph:
        """The graph of neighbours."""
        return knn_graph(self.points, self.k)

    @cached_property
    def bodies(self) -> Bodies:
        """The components of the graph."""
        return bodies(self.points, self.graph)

    def of_values(self, f0: FloatArray) -> PointDenoising:
        """Regularize values other than positions, (n, m), on the graph of neighbours, and alike channels together."""
        graph, p, lam = self.graph, 1.0 if self.p is None else self.p, self.lam
        if self.sigma is None and lam is None and self.weights is None:
            groups = alike_channels(f0, graph)
            if len(groups) > 1:
                return self._in_groups(f0, groups)
        f, far, results = f0, np.zeros(len(f0), bool), []
        sigma, levels = self.sigma, None
        if sigma is None:
            levels, smooth, far = self._value_noise(f0)
            sigma = mean_level(levels)
        if lam is None:
            noise = np.full(len(f0), sigma) if levels is None else levels
            lam = fidelities_to_values(np.full(len(f0), graph.n_edges / graph.n_vertices), noise, p, f0.shape[1])
            lam[far] = 0.0
            lam = float(lam[0]) if (lam == lam[0]).all() else lam
            if far.any():
                f = np.where((far & ~self.pinned)[:, None], smooth, f0)
        if not _is_infinite(lam):
            most = 100 if self.max_iter is None else self.max_iter
            results = [self._run(f, graph, p, lam, most, self.weights)]
            f = results[0].value.astype(np.float64)
        return self._found(f, "values", results, sigma=sigma, p=p, lam=lam, levels=levels)

    def _value_noise(self, f0: FloatArray) -> ValueNoise:
        parts = Components.of(self.graph)
        return value_noise(f0, self.graph, parts, parts.sizes()[parts.labels] >= _TELLING)

    def _in_groups(self, f0: FloatArray, groups: list[IntArray]) -> PointDenoising:
        """Regularize groups of channels one after another."""
        sizes, value = [len(group) for group in groups], f0.copy()
        each = [self.of_values(f0[:, group]) for group in groups]
        for group, part in zip(groups, each, strict=True):
            value[:, group] = part.value
        return replace(
            each[0],
            value=value,
            results=tuple(result for part in each for result in part.results),
            sigma=float(mean_squares([np.array(part.sigma) for part in each], sizes)),
            levels=mean_squares([np.asarray(part.levels) for part in each], sizes),
        )

    def moved(self, filter: PointFilter) -> PointDenoising:
        """Fit a surface, or regularize the points, or regularize the normals and fit the points to them."""
        x = self.points
        if filter == "surface" and len(x) >= LEAST:
            return self._by_surface()
        few = filter == "surface" or len(x) < 3
        sigma, levels = self._noise(lambda: np.full(len(x), np.nan) if few else self._levels())
        if few or not sigma > 0:
            p = self.p or (1.0 if filter == "normals" else 2.0)
            return self._found(x, filter, [], sigma=sigma, p=p, lam=math.inf, levels=levels)
        return self._by_normals(sigma, levels) if filter == "normals" else self._by_positions(sigma, levels)

    def _noise(self, estimate: Callable[[], FloatArray]) -> tuple[float, FloatArray | None]:
        """Return the given noise, or its root mean square and the level around each point, (n,)."""
        if self.sigma is not None:
            return self.sigma, None
        levels = estimate()
        return mean_level(levels), levels

    def _levels(self) -> FloatArray:
        x, graph = self.points, self.graph
        return point_levels(x, graph) if x.shape[1] in (2, 3) else self._value_noise(x).local

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
        levels: FloatArray | None = None,
    ) -> PointDenoising:
        return PointDenoising(
            value=value, filter=filter, results=tuple(results), sigma=sigma, estimated=self.sigma is None, p=p, lam=lam,
            normals=normals, levels=levels, cloud=self.cloud, k=self.k, spacing=self.spacing,
        )  # fmt: skip

    def _by_surface(self) -> PointDenoising:
        def run(f0: FloatArray, graph: Graph, lam: float, weights: Any) -> Result:
            return regularize(f0, graph, p=2.0, lam=lam, weights=weights, max_iter=1, **self.options)

        fit = fitted_surface(self.points, run)
        return self._found(
            self.points - fit.heights[:, None] * fit.normals, "surface", fit.results,
            sigma=mean_level(fit.sigma), p=2.0, lam=OWN, normals=fit.normals, levels=fit.sigma,
        )  # fmt: skip

    def _by_positions(self, sigma: float, levels: FloatArray | None) -> PointDenoising:
        p, lam = 2.0 if self.p is None else self.p, self.lam
        if lam is None:
            noise = np.asarray(sigma if levels is None else levels)
            spacing = self.bodies.spacing if self.bodies.parts.count > 1 else self.bodies.spacing[0]
            lam = _where((noise > 0) & (spacing > 0), lambda: 2 ** (p - 2) * 4 * spacing ** (p - 1) / noise)
        x, results = self.points, []
        left = 0 if _is_infinite(lam) else 100 if self.max_iter is None else self.max_iter
        each = left if self.update_neighbours is None else self.update_neighbours
        while left > 0:
            result = self._run(self.points, knn_graph(x, self.k), p, lam, min(each, left), self.weights, initial=x)
            results.append(result)
            x = result.value.astype(np.float64)
            left -= each
        return self._found(x, "positions", results, sigma=sigma, p=p, lam=lam, levels=levels)

    def _by_normals(self, sigma: float, levels: FloatArray | None) -> PointDenoising:
        p, x, d = 1.0 if self.p is None else self.p, self.points, self.points.shape[1]
        graph = self.graph
        around = _around(sigma if levels is None else self.bodies.mean_level(levels), self.bodies.spacing, self.k)
        found = planes_of(x, around)
        f0 = projectors(found.normals)
        lam = self.lam
        if lam is None:
            u, v = graph.edge_rows(), graph.indices
            apart = np.linalg.norm(f0[u] - f0[v], axis=1) / math.sqrt(2)
            turned = tilt(found.extent, sigma if levels is None else levels, around)
            # with little noise the normals differ because of the shape
            if levels is None:
                wide = turned[found.extent > 0]
                noise = np.minimum(_median(apart), _median(wide))
            else:
                near = around_each(x)
                differ = np.median(np.nan_to_num(row_medians(graph.indptr, apart))[near], axis=1)
                noise = np.minimum(differ, np.median(turned[near], axis=1))
                # near creases normals differ because of the shape too
                noise = np.sqrt(opened(noise**2, graph, ROUNDS[d]) * POINTS[d])
            lam = _where(noise > 0, lambda: _TO_NORMALS / noise**2)
        if _is_infinite(lam):
            return self._found(x, "normals", [], sigma=sigma, p=p, lam=lam, normals=found.normals, levels=levels)
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
        return self._found(x, "normals", results, sigma=sigma, p=p, lam=lam, normals=normals, levels=levels)

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


def mean_level(levels: FloatArray) -> float:
    """Return the root mean square of noise levels (n,), those that are known; NaN without any."""
    known = levels[~np.isnan(levels)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def _where(some: Any, value: Callable[[], Any]) -> float | FloatArray:
    """Return a value where there is noise, infinity elsewhere: a number for a number."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = np.where(some, value(), math.inf)
    return float(found) if found.ndim == 0 else found


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _is_infinite(lam: float | FloatArray) -> bool:
    """Return whether the fidelity pins everything."""
    return bool(np.isinf(lam).all())


def _around(sigma: float | FloatArray, spacing: FloatArray, k: int) -> IntArray:
    """Return the number of neighbours for the plane of each point, (n,): 8 to 24, more for larger noise.

    Measured on two surfaces (bunny, fandisk): with noise of 0.1, 0.25, 0.5 and 0.8 spacings the errors are least with
    8, 8, 16-24 and 24 neighbours.
    """
    share = np.where(spacing > 0, sigma / np.where(spacing > 0, spacing, 1), 1.0)
    around: IntArray = np.maximum(k, np.clip(np.rint(8 + 30 * (share - 0.25)), 8, 24).astype(int))
    return around
