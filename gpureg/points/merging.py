"""Merge points that are equal, as in overlapping scans: :func:`merged`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .normals import spacing_of

# Points at most this part of the spacing apart are equal.
MERGE_TOL = 1e-6
# The spacing of a point is the distance to its nearest neighbour that is no copy: farther than this part of the
# distance to the last of so many neighbours.
_NO_COPY, _NEIGHBOURS = 1e-4, 20
# Where even the last neighbours are closer than this part of the extent they are copies, of which cells of this part of
# the extent hold most.
_COPIES, _CELL = 1e-8, 1e-8


class Merged(NamedTuple):
    """Points without repetitions.

    Attributes
    ----------
    points : (m, d) float array
        The mean of each group of equal points, in the order of their first points.
    owner : (n,) int array
        The group of each point of the input.
    spacing : float
        Median distance from a group to the nearest other one; 0 for a single group.
    """

    points: FloatArray
    owner: IntArray
    spacing: float

    @property
    def repeated(self) -> int:
        """Number of points of the input that repeat another one."""
        return len(self.owner) - len(self.points)

    def mean(self, values: FloatArray) -> FloatArray:
        """Compute the mean over each group, (m, ...), of values (n, ...)."""
        if not self.repeated:
            return values
        count = np.bincount(self.owner, minlength=len(self.points))
        table = values.reshape(len(values), -1)
        sums = [np.bincount(self.owner, column, len(self.points)) for column in table.T]
        # a group of one keeps its bits
        means: FloatArray = (np.stack(sums, axis=1) / count[:, None]).reshape(-1, *values.shape[1:])
        return means

    def any(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return whether a point of each group has the flag, (m,)."""
        found = np.zeros(len(self.points), bool)
        found[self.owner[flags]] = True
        return found


def unmerged(points: FloatArray) -> Merged:
    """Return points (n, d) as they are, each of them a group."""
    return Merged(points, np.arange(len(points)), spacing_of(points))


def merged(points: FloatArray) -> Merged:
    """Merge points (n, d) that are at most 1e-6 of the median spacing apart; chains of such points are one group."""
    n = len(points)
    if n < 2:
        return unmerged(points)
    near, distance = _nearest(points)
    limit = MERGE_TOL * _spacing(points, distance)
    means, owner = points, np.arange(n, dtype=np.int64)
    # of many copies the nearest ones are joined first
    while (distance[:, 1:2] <= limit).any():
        part = _joined(near, distance <= limit)
        first = means[np.unique(part, return_index=True)[1]]
        # means of differences, which are exact where points are equal
        means = first + Merged(first, part, 0.0).mean(means - first[part])
        owner = part[owner]
        if len(means) < 2:
            return Merged(means, owner, 0.0)
        near, distance = _nearest(means)
    return Merged(means, owner, float(np.median(distance[:, 1])))


def _nearest(points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find the nearest points and their distances, ascending, (n, 20) or fewer; the first distance is 0."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points, balanced_tree=False)
    distance, near = tree.query(points, min(_NEIGHBOURS, len(points)), workers=-1)
    return np.asarray(near), np.asarray(distance)


def _joined(near: IntArray, same: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Number the groups of points (n,) that are joined with the same ones of the nearest, (n, k)."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    u, column = np.nonzero(same)
    links = sparse.coo_array((np.ones(len(u), bool), (u, near[u, column])), shape=(len(near), len(near)))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _spacing(points: FloatArray, distance: FloatArray) -> float:
    """Compute the median distance to the nearest point that is no copy; `distance` (n, k) is to the nearest ones."""
    low, high = np.quantile(points, [0.05, 0.95], axis=0)
    extent = float((high - low).max())
    if np.median(distance[:, -1]) < _COPIES * extent:
        # most points have more copies than neighbours: one of each cell of a fine grid is taken
        cells = np.floor((points - low) / (_CELL * extent))
        once = points[np.sort(np.unique(cells, axis=0, return_index=True)[1])]
        if len(once) < 2:
            return 0.0
        points, distance = once, _nearest(once)[1]
    far = distance > _NO_COPY * distance[:, -1:]
    own = np.where(far, distance, np.inf).min(axis=1)
    own = own[np.isfinite(own)]
    return float(np.median(own)) if len(own) else 0.0
