"""The level of the noise around each point, where it may differ from place to place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..noise.graphs import MEDIAN, averaging
from .normals import nearest, residual_variances

# Neighbours whose median is the level at a point.
_AROUND = 24
# Rounds of the smallest, then of the largest level among neighbours: levels are high in a band around each corner and
# jump of a function, which is narrower than that; on curves and surfaces, and for values.
ROUNDS, _OF_VALUES = {2: 6, 3: 4}, 3
# Sweeps that average levels.
_AVERAGED = 40
# What the smallest levels among neighbours take off the variance of white noise: for points on curves and surfaces, and
# for values. Measured on circles, spheres and planes; the standard deviation is then right within 5 %, 15 % for values.
POINTS, _VALUES = {2: 1.18, 3: 1.34}, 1.45


def around_each(points: FloatArray) -> IntArray:
    """Find the points whose median is the level at each point, (n, 25)."""
    return nearest(points, _AROUND)


def row_medians(values: FloatArray, graph: Graph) -> FloatArray:
    """Compute the median of the values (n_edges,) of each vertex's edges, (n,); 0 without edges."""
    order = np.lexsort((values, graph.edge_rows()))
    sizes = np.diff(graph.indptr)
    some = sizes > 0
    low, high = graph.indptr[:-1][some] + (sizes[some] - 1) // 2, graph.indptr[:-1][some] + sizes[some] // 2
    found = np.zeros(len(sizes))
    found[some] = (values[order[low]] + values[order[high]]) / 2
    return found


def group_medians(values: FloatArray, group: IntArray, count: int) -> FloatArray:
    """Compute the median of the values of each group, (count,); 0 for a group without values."""
    order = np.lexsort((values, group)) if count > 1 else np.argsort(values)
    sizes = np.bincount(group, minlength=count)
    begin = np.cumsum(sizes) - sizes
    found = np.zeros(count)
    some = np.flatnonzero(sizes)
    low, high = begin[some] + (sizes[some] - 1) // 2, begin[some] + sizes[some] // 2
    found[some] = (values[order[low]] + values[order[high]]) / 2
    return found


class Bodies(NamedTuple):
    """The components of a graph of points.

    Attributes
    ----------
    part : (n,) int array
        The component of each point.
    bodies : int
        Their number.
    spacing : (n,) float array
        The median distance to the nearest point in the component of each point.
    """

    part: IntArray
    bodies: int
    spacing: FloatArray

    def mean_level(self, levels: FloatArray) -> FloatArray:
        """Return the root mean square of levels (n,) in the component of each point, (n,)."""
        squares = np.bincount(self.part, levels**2, self.bodies) / np.bincount(self.part, minlength=self.bodies)
        means: FloatArray = np.sqrt(squares)[self.part]
        return means


def bodies(points: FloatArray, graph: Graph) -> Bodies:
    """Find the components of a graph of points (n, d)."""
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    count, part = connected_components(graph.to_scipy(), directed=False)
    if len(points) < 2:
        return Bodies(part, count, np.zeros(len(points)))
    distance = np.asarray(cKDTree(points).query(points, 2, workers=-1)[0])[:, 1]
    return Bodies(part, count, group_medians(distance, part, count)[part])


def opened(level: FloatArray, graph: Graph, rounds: int = _OF_VALUES) -> FloatArray:
    """Remove from levels (n,) what is high in a narrow band, and average the rest over neighbours."""
    starts = graph.indptr[:-1]
    some = np.diff(graph.indptr) > 0
    for least in (np.minimum, np.maximum):
        for _ in range(rounds):
            found = level.copy()
            if some.any():
                # rows without neighbours take no space between those with some
                found[some] = least(level[some], least.reduceat(level[graph.indices], starts[some]))
            level = found
    mean = averaging(graph)
    for _ in range(_AVERAGED):
        level = np.where(some, (level + mean @ level) / 2, level)
    return level


def point_levels(points: FloatArray, graph: Graph) -> FloatArray:
    """Estimate the noise along the normals around each point of a curve or surface, (n,); NaN if there are too few.

    The median over 24 neighbours of the residual variance of the quadric through 17 points, see
    :func:`residual_variances`.
    """
    variances = residual_variances(points)
    if variances is None:
        return np.full(len(points), np.nan)
    median = np.median(variances[around_each(points)], axis=1)
    level: FloatArray = np.sqrt(opened(median, graph, ROUNDS[points.shape[1]]) * POINTS[points.shape[1]])
    return level


def value_levels(f: FloatArray, graph: Graph, near: IntArray) -> FloatArray:
    """Estimate the noise of values (n, m) around each vertex of a graph, (n,), from second differences along it.

    `near` (n, k) are the vertices around each one. The channels are taken together: the mean of their variances.
    """
    from scipy import sparse

    M = averaging(graph)
    T = sparse.csr_array(sparse.eye_array(graph.n_vertices, format="csr") - M)
    if len(f) < 3:
        return np.full(len(f), np.nan)
    growth = np.asarray((T @ T).power(2).sum(axis=1)).ravel()
    once = f - M @ f
    squares = (once - M @ once) ** 2 / np.where(growth > 0, growth, 1)[:, None]
    level = np.zeros(len(f))
    for column in squares.T:
        level += np.median(column[near], axis=1) / MEDIAN**2
    found: FloatArray = np.sqrt(opened(level / f.shape[1], graph) * _VALUES)
    return found
