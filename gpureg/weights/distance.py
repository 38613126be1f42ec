"""Weights by distances, in space or between features: :func:`constant`, :func:`inverse_distance`, :func:`gaussian`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..backends import Backend, Weighted
from ..checks import number
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph
from .base import EdgeWeights, Weights, rows_of


def _squared_distances(points: FloatArray, u: IntArray, v: IntArray, unit: float = 1.0) -> FloatArray:
    """|points(u) - points(v)|^2 in units of `unit`, (k,)."""
    total, steps, ends = np.zeros((3, len(u)))
    u, v = u.astype(np.intp, copy=False), v.astype(np.intp, copy=False)
    # A coordinate at a time, into the same arrays: to gather rows of a few numbers takes numpy four times as long.
    for x in np.ascontiguousarray(points.T, np.float64):
        # in range: these are vertices; "clip" spares numpy a copy of its output
        np.take(x, v, out=steps, mode="clip")
        np.take(x, u, out=ends, mode="clip")
        steps -= ends
        steps /= unit  # before the square, which would be 0 of a tiny unit
        steps *= steps
        total += steps
    return total


def _positions(graph: Graph) -> FloatArray:
    """Coordinates of the vertices, (n, d)."""
    if graph.positions is None:
        raise ValueError("these weights need the vertices' coordinates: give the graph positions=(n, d)")
    return graph.positions


def _squared_lengths(graph: AnyGraph, u: IntArray, v: IntArray) -> FloatArray:
    """|u - v|^2 in the units of the grid's spacing or the graph's positions, (k,)."""
    if isinstance(graph, Graph):
        return _squared_distances(_positions(graph), u, v)
    cells = np.stack(np.unravel_index(u, graph.shape)) - np.stack(np.unravel_index(v, graph.shape))
    lengths: FloatArray = ((cells.T * graph.cell) ** 2).sum(axis=-1)
    return lengths


def nearness(graph: AnyGraph, sigma: float) -> FloatArray | None:
    """exp(-|u - v|^2 / sigma^2), per forward offset of a grid or per directed edge; None for an infinite sigma."""
    if math.isinf(sigma):
        return None
    if isinstance(graph, GridGraph):
        steps = graph.forward_offsets * graph.cell
        # divided first: the square of a tiny sigma would be 0
        squares: FloatArray = ((steps / sigma) ** 2).sum(axis=1)
    else:
        squares = _squared_distances(_positions(graph), graph.edge_rows(), graph.indices, sigma)
    near: FloatArray = np.exp(-squares)
    return near


@dataclass(frozen=True)
class Constant(Weights):
    """See :func:`constant`."""

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with weight 1 on every edge."""
        if isinstance(graph, Graph) and graph.weights is not None:
            return backend.prepare(graph, np.ones(graph.n_edges, backend.dtype))
        return backend.prepare(graph, None)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself."""
        return self


@dataclass(frozen=True)
class InverseDistance(EdgeWeights):
    """See :func:`inverse_distance`."""

    reads_data = False
    power: float

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights |u - v|^-power."""
        distance = np.sqrt(_squared_lengths(graph, u, v))
        if distance.size and not distance.min() > 0:
            k = int(np.argmin(distance))
            raise ValueError(f"vertices {u[k]} and {v[k]} lie on the same point: 1/distance has no value there")
        weights: FloatArray = distance**-self.power
        return weights

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, where coordinates are whole numbers; the roundings of others would depend on the place."""
        return self if grid.spacing is None else None


@dataclass(frozen=True, eq=False)
class Gaussian(EdgeWeights):
    """See :func:`gaussian`."""

    reads_data = False
    features: FloatArray
    sigma: float

    def _of(self, graph: AnyGraph) -> FloatArray:
        if len(self.features) != graph.n_vertices:
            raise ValueError(f"features must have {graph.n_vertices} rows, one per vertex, got {len(self.features)}")
        return self.features

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The features of the part."""
        return Gaussian(rows_of(self._of(grid), grid, box), self.sigma)

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights exp(-|features(u) - features(v)|^2 / sigma^2)."""
        weights: FloatArray = np.exp(-_squared_distances(self._of(graph), u, v) / self.sigma**2)
        return weights


@door
def constant() -> Weights:
    """Weight 1 on every edge: the unweighted graph."""
    return Constant()


@door
def inverse_distance(power: float = 2) -> Weights:
    """Weights 1/|u - v|^power between the positions of the vertices (figure 6 of the paper, with power 2).

    Raises
    ------
    TypeError, ValueError
        A power that is not a number > 0; at use, vertices without positions, or two that lie on the same point.
    """
    return InverseDistance(number("power", power, above=0))


@door
def gaussian(features: npt.ArrayLike, sigma: float) -> Weights:
    """Weights exp(-|F(u) - F(v)|^2 / sigma^2) between feature vectors of the vertices.

    Parameters
    ----------
    features : (n,) or (n, q) float array
        One feature vector per vertex.
    sigma : float
        Standard deviation (without a factor 1/2) > 0, in the features' units.

    Raises
    ------
    TypeError, ValueError
        Features that are not finite numbers, or a sigma that is not > 0; at use, another number of vertices.
    """
    given = np.asarray(features)
    if given.dtype.kind not in "biuf":
        raise TypeError(f"features must be real numbers, one row per vertex, got {given.dtype}")
    table: Any = given.astype(np.float64)
    table = table.reshape(len(table), -1) if table.ndim else table
    if table.ndim != 2 or not np.isfinite(table).all():
        raise ValueError(f"features must be finite, one row per vertex, got shape {table.shape}")
    return Gaussian(table, number("sigma", sigma, above=0))
