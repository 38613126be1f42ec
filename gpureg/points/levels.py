"""The level of the noise around each point, where it may differ from place to place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..noise.graphs import averaging
from .normals import nearest, residual_variances

# Neighbours whose median is the level at a point.
_AROUND = 24
# Rounds of the smallest, then of the largest level among neighbours, on curves and surfaces: levels are high in a band
# around each corner, which is narrower than that.
ROUNDS = {2: 6, 3: 4}
# Sweeps that average levels.
_AVERAGED = 40
# What the smallest levels among neighbours take off the variance of white noise, for points on curves and surfaces.
# Measured on circles, spheres and planes; the standard deviation is then right within 5 %.
POINTS = {2: 1.18, 3: 1.34}


def around_each(points: FloatArray) -> IntArray:
    """Find the points whose median is the level at each point, (n, 25)."""
    return nearest(points, _AROUND)


class Bodies(NamedTuple):
    """The components of a graph of points.

    Attributes
    ----------
    parts : Components
    spacing : (n,) float array
        The median distance to the nearest point in the component of each point.
    """

    parts: Components
    spacing: FloatArray

    def mean_level(self, levels: FloatArray) -> FloatArray:
        """Return the root mean square of levels (n,) in the component of each point, (n,)."""
        means: FloatArray = np.sqrt(self.parts.means(levels**2))[self.parts.labels]
        return means


def bodies(points: FloatArray, graph: Graph) -> Bodies:
    """Find the components of a graph of points (n, d)."""
    from scipy.spatial import cKDTree

    parts = Components.of(graph)
    if len(points) < 2:
        return Bodies(parts, np.zeros(len(points)))
    distance = np.asarray(cKDTree(points).query(points, 2, workers=-1)[0])[:, 1]
    return Bodies(parts, parts.medians(distance)[parts.labels])


def opened(level: FloatArray, graph: Graph, rounds: int) -> FloatArray:
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
