"""Find vertices of a mesh that are the same point: :func:`same_points`."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.components import sorted_medians

# Distance of vertices that count as one, in mean edges around them: ten times the rounding and jitter of 1e-6 edges of
# triangle soups, because two copies are further apart than each is from its place.
WELD = 1e-5

# Copies of a vertex that are searched for at a time; more are found in further passes.
_COPIES = 8

# A direction along which different points seldom have nearly the same coordinate.
_DIRECTION = np.array([1.0, 2.0**0.5, 3.0**0.5]) / 6.0**0.5


def same_points(vertices: FloatArray, faces: IntArray) -> IntArray | None:
    """Number the points of a mesh, (n,), in the order of their first vertices; None if no two vertices are the same.

    Vertices are the same point if they are equal, or closer than 1e-5 times the mean or median length of the edges
    around them, whichever is less, around that of the shorter edges: a vertex very far away joins no others. This is
    local, so that a small body in a large scene does not become one point.
    """
    along = vertices @ _DIRECTION
    edges = _mean_edges(vertices, faces)
    sums = np.sort(along)
    # nearly the same points are nearly the same along the direction; rounding is below 4 units in the last place
    near = WELD * edges.max(initial=0.0) + 4 * np.spacing(np.abs(sums).max(initial=0.0))
    if len(sums) < 2 or np.diff(sums).min() > near:
        return None
    points, first, which = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    # of the copies at a point, those without a face have no edges
    reach = np.zeros(len(points))
    np.maximum.at(reach, which, WELD * np.minimum(edges, _usual_edges(vertices, faces)))
    numbers = _closer(points, reach)[which]
    if numbers.max(initial=-1) + 1 == len(vertices):
        return None
    first = np.full(int(numbers.max()) + 1, len(vertices))
    np.minimum.at(first, numbers, np.arange(len(vertices)))
    # in the order of their first copies, so that meshes with equal faces still have equal faces
    place = np.empty(len(first), np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    ordered: IntArray = place[numbers]
    return ordered


def _mean_edges(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the mean length of the edges of the faces around each vertex, (n,); 0 without a face."""
    total, count = np.zeros((2, len(vertices)))
    for k in range(3):
        one, two = faces[:, k], faces[:, (k + 1) % 3]
        lengths = np.linalg.norm(vertices[one] - vertices[two], axis=1)
        for end in (one, two):
            total += np.bincount(end, weights=lengths, minlength=len(vertices))
            count += np.bincount(end, minlength=len(vertices))
    return np.divide(total, count, out=total, where=count > 0)


def _usual_edges(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the median length of the edges of the faces around each vertex, (n,); 0 without a face."""
    ends = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    lengths = np.repeat(np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1), 2)
    order = np.lexsort((lengths, ends.ravel()))
    indptr = np.searchsorted(ends.ravel()[order], np.arange(len(vertices) + 1))
    medians: FloatArray = np.nan_to_num(sorted_medians(lengths[order], indptr))
    return medians


def _closer(points: FloatArray, reach: FloatArray) -> IntArray:
    """Number the groups of points (k, 3) closer than the smaller `reach`, (k,), of both; return the numbers (k,)."""
    from scipy import sparse
    from scipy.spatial import cKDTree

    numbers = np.arange(len(points))
    left = numbers
    while len(left) > 1 and reach.max() > 0:
        k = min(_COPIES, len(left))
        tree = cKDTree(points[left])
        far, near = (np.ravel(x) for x in tree.query(points[left], k, distance_upper_bound=reach.max() * (1 + 1e-9)))
        rows, columns = np.repeat(np.arange(len(left)), k), near
        there = (columns < len(left)) & (columns != rows)
        rows, columns, far = rows[there], columns[there], far[there]
        close = far <= np.minimum(reach[left[rows]], reach[left[columns]])
        if not close.any():
            break
        pairs = sparse.csr_array((np.ones(close.sum(), np.int8), (rows[close], columns[close])), shape=(len(left),) * 2)
        count, group = sparse.csgraph.connected_components(pairs, directed=False)
        first = np.full(count, len(left))
        np.minimum.at(first, group, np.arange(len(left)))
        renumbered = np.arange(len(points))
        renumbered[left] = left[first[group]]
        numbers = renumbered[numbers]
        left = left[first]
    return np.unique(numbers, return_inverse=True)[1].ravel()
