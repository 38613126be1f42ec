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
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n = len(points)
    if n < 2:
        return Merged(points, np.arange(n), 0.0)
    tree = cKDTree(points, balanced_tree=False)
    distance = _distances(tree, points)
    if distance[:, -1].min() == 0 and n > _NEIGHBOURS:
        # more copies than neighbours: equal bits first
        once, owner = np.unique(points, axis=0, return_inverse=True)
        first = np.full(len(once), n)
        np.minimum.at(first, owner.ravel(), np.arange(n))
        order = np.argsort(first)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        inner = merged(once[order])
        return Merged(inner.points, inner.owner[rank[owner.ravel()]], inner.spacing)
    far = distance > _NO_COPY * distance[:, -1:]
    own = np.where(far, distance, np.inf).min(axis=1)
    spacing = float(np.median(own[np.isfinite(own)])) if np.isfinite(own).any() else 0.0
    limit = MERGE_TOL * spacing
    if distance[:, 1].min() > limit:
        return Merged(points, np.arange(n), float(np.median(distance[:, 1])))
    # only points with a copy are searched for pairs
    doubtful = np.flatnonzero(distance[:, 1] <= limit)
    pairs = doubtful[cKDTree(points[doubtful]).query_pairs(limit, output_type="ndarray")]
    links = sparse.coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    owner = np.asarray(connected_components(links, directed=False)[1], np.int64)
    group = Merged(np.empty((int(owner.max()) + 1, 0)), owner, 0.0)
    means = points[np.unique(owner, return_index=True)[1]]
    # means of differences, which are exact where points are equal
    means = means + group.mean(points - means[owner])
    nearest = _distances(cKDTree(means, balanced_tree=False), means)[:, 1] if len(means) > 1 else np.zeros(1)
    return Merged(means, owner, float(np.median(nearest)))


def _distances(tree: object, points: FloatArray) -> FloatArray:
    """Return the distances to the nearest points, ascending, (n, 20) or fewer; the first is 0."""
    found: FloatArray = tree.query(points, min(_NEIGHBOURS, len(points)), workers=-1)[0]  # type: ignore[attr-defined]
    return found
