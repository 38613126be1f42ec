"""Weights from distances in space or between features: :func:`constant`, :func:`inverse_distance`, :func:`gaussian`."""

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
    """Compute |points(u) - points(v)|^2 / unit^2, (k,)."""
    total, steps, ends = np.zeros((3, len(u)))
    u, v = u.astype(np.intp, copy=False), v.astype(np.intp, copy=False)
    # One coordinate at a time, into the same arrays: gathering rows of a few numbers takes numpy four times as long.
    for x in np.ascontiguousarray(points.T, np.float64):
        # the indices are in range; "clip" avoids a copy of the output in numpy
        np.take(x, v, out=steps, mode="clip")
        np.take(x, u, out=ends, mode="clip")
        steps -= ends
        steps /= unit  # before squaring: the square of a tiny unit is 0
        steps *= steps
        total += steps
    return total


def _positions(graph: Graph) -> FloatArray:
    """Return the coordinates of the vertices, (n, d)."""
    if graph.positions is None:
        raise ValueError("these weights need the vertices' coordinates: give the graph positions=(n, d)")
    return graph.positions


def _squared_lengths(graph: AnyGraph, u: IntArray, v: IntArray) -> FloatArray:
    """Compute |u - v|^2 in the units of the grid's spacing or the graph's positions, (k,)."""
    if isinstance(graph, Graph):
        return _squared_distances(_positions(graph), u, v)
    cells = np.stack(np.unravel_index(u, graph.shape)) - np.stack(np.unravel_index(v, graph.shape))
    lengths: FloatArray = ((cells.T * graph.cell) ** 2).sum(axis=-1)
    return lengths


def nearness(graph: AnyGraph, sigma: float) -> FloatArray | None:
    """Compute exp(-|u - v|^2 / sigma^2) per forward offset of a grid or per directed edge; None for infinite sigma."""
    if math.isinf(sigma):
        return None
    if isinstance(graph, GridGraph):
        steps = graph.forward_offsets * graph.cell
        # divided before squaring: the square of a tiny sigma is 0
        squares: FloatArray = ((steps / sigma) ** 2).sum(axis=1)
    else:
        squares = _squared_distances(_positions(graph), graph.edge_rows(), graph.indices, sigma)
    near: FloatArray = np.exp(-squares)
    return near


@dataclass(frozen=True)
class Constant(Weights):
    """See :func:`constant`."""

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """Return the graph with weight 1 on every edge, on the backend's device."""
        if isinstance(graph, Graph) and graph.weights is not None:
            return backend.prepare(graph, np.ones(graph.n_edges, backend.dtype))
        return backend.prepare(graph, None)

    def scaled(self, scale: float) -> Weights | None:
        """Return itself."""
        return self

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return itself."""
        return self


@dataclass(frozen=True)
class InverseDistance(EdgeWeights):
    """See :func:`inverse_distance`."""

    reads_data = False
    power: float

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Compute the weights |u - v|^-power, (k,)."""
        distance = np.sqrt(_squared_lengths(graph, u, v))
        if distance.size and not distance.min() > 0:
            k = int(np.argmin(distance))
            raise ValueError(f"vertices {u[k]} and {v[k]} lie at the same point: 1/distance is infinite")
        weights: FloatArray = distance**-self.power
        return weights

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return itself if coordinates are integers; with a spacing, rounding errors depend on the position."""
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
        """Return the weight function with the features of the part."""
        return Gaussian(rows_of(self._of(grid), grid, box), self.sigma)

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Compute the weights exp(-|features(u) - features(v)|^2 / sigma^2), (k,)."""
        weights: FloatArray = np.exp(-_squared_distances(self._of(graph), u, v, self.sigma))
        return weights


@door
def constant() -> Weights:
    """Return the weight function with weight 1 on every edge: the unweighted graph."""
    return Constant()


@door
def inverse_distance(power: float = 2) -> Weights:
    """Return weights 1/|u - v|^power, with the distance between the vertices' positions (figure 6: power 2).

    Raises
    ------
    TypeError, ValueError
        A power that is not a number > 0; at use, vertices without positions, or neighbours at the same point.
    """
    return InverseDistance(number("power", power, above=0))


@door
def gaussian(features: npt.ArrayLike, sigma: float) -> Weights:
    """Return weights exp(-|F(u) - F(v)|^2 / sigma^2) for feature vectors F of the vertices.

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
