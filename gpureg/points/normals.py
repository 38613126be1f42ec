"""Normals of point clouds: estimates, noise, and points fitted to normals.

The orientation of a normal n is not known: the function that is regularized is the projector n n^T, the same for n and
-n.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from .quadrics import frames, in_pieces, solved, terms

# Points per block; the neighbourhoods of a block take about 100 MB.
_PIECE = 1 << 16
# Neighbours for the paraboloids that estimate the noise.
_PARABOLOID = 16


class Planes(NamedTuple):
    """The planes that fit the neighbourhoods of points best.

    Attributes
    ----------
    normals : (n, d) float array
        Unit vectors.
    extent : (n,) float array
        Standard deviation of the neighbourhood along the narrowest direction within the plane.
    """

    normals: FloatArray
    extent: FloatArray


def nearest(points: FloatArray, k: int) -> IntArray:
    """Find each point and its `k` nearest neighbours, (n, k + 1); fewer columns if there are fewer points."""
    from scipy.spatial import cKDTree

    near = cKDTree(points).query(points, min(k, len(points) - 1) + 1, workers=-1)[1]
    found: IntArray = near.reshape(len(points), -1)
    return found


def spacing_of(points: FloatArray) -> float:
    """Compute the median distance from a point (n, d) to its nearest neighbour; 0 if most points coincide."""
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return 0.0
    distance = np.asarray(cKDTree(points).query(points, 2, workers=-1)[0])
    return float(np.median(distance[:, 1]))


def planes(points: FloatArray, near: IntArray) -> Planes:
    """Fit planes to neighbourhoods by their principal components; `near` is (n, k)."""
    normals, extent = np.empty((len(near), points.shape[1])), np.empty(len(near))
    for begin in range(0, len(near), _PIECE):
        part = slice(begin, begin + _PIECE)
        values, vectors = _components(points[near[part]])
        normals[part] = vectors[:, :, 0]
        extent[part] = np.sqrt(np.maximum(values[:, 1], 0))
    return Planes(normals, extent)


def planes_of(points: FloatArray, around: IntArray) -> Planes:
    """Fit planes to points (n, d) and their nearest, as many of them as `around` (n,) says."""
    normals, extent = np.empty_like(points), np.empty(len(points))
    for k in np.unique(around).tolist():
        rows = around == k
        normals[rows], extent[rows] = planes(points, nearest(points, k)[rows])
    return Planes(normals, extent)


def _components(around: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the variances (q, d), ascending, along the principal directions (q, d, d) of point sets (q, k, d)."""
    centred = around - around.mean(axis=1, keepdims=True)
    found = np.linalg.eigh(np.einsum("qki,qkj->qij", centred, centred) / around.shape[1])
    return found.eigenvalues, found.eigenvectors


def residual_variances(points: FloatArray) -> FloatArray | None:
    """Compute the residual variance (n,) of the quadric through each point and its 16 nearest neighbours.

    It is corrected for the degrees of freedom of the fit. None if there are too few points for a quadric.
    """
    n, d = points.shape
    count = 1 + (d - 1) + d * (d - 1) // 2
    near = nearest(points, _PARABOLOID)
    k = near.shape[1]
    if k <= count:
        return None

    def work(part: slice) -> FloatArray:
        around = points[near[part]]
        local = around - around[:, :1]
        w = np.ones(local.shape[:2])
        local = local @ frames(local, w)[1]
        heights, plane = local[:, :, 0], local[:, :, 1:]
        scale = np.sqrt((plane**2).mean(axis=(1, 2), keepdims=True))
        plane = np.divide(plane, scale, out=np.zeros_like(plane), where=scale > 0)
        A = terms(plane, heights)
        # for points that coincide or lie on a line: the smallest of the best solutions
        fit = solved(A, w, np.full(count, 1e-9 / k))
        left = heights - (fit[:, None] @ A[:, :-1])[:, 0]
        variances: FloatArray = (left**2).sum(axis=1) / (k - count)
        return variances

    return in_pieces(work, n, k * (d + 8))


def projectors(normals: FloatArray) -> FloatArray:
    """Return the projectors n n^T of unit vectors as rows (n, d (d + 1)/2) with the same distances as the matrices."""
    i, j = np.triu_indices(normals.shape[1])
    rows: FloatArray = normals[:, i] * normals[:, j] * np.where(i == j, 1.0, np.sqrt(2))
    return rows


def directions(rows: FloatArray, d: int) -> FloatArray:
    """Find the unit vector whose projector is nearest to each row of (n, d (d + 1)/2), (n, d)."""
    i, j = np.triu_indices(d)
    matrices = np.zeros((len(rows), d, d))
    matrices[:, i, j] = matrices[:, j, i] = rows / np.where(i == j, 1.0, np.sqrt(2))
    vectors: FloatArray = np.linalg.eigh(matrices).eigenvectors[:, :, -1]
    return vectors


def fitted_points(
    points: FloatArray, graph: Graph, normals: FloatArray, reach: float, moves: FloatArray, steps: int
) -> FloatArray:
    """Move points (n, d) towards the planes of their neighbours; `normals` is (n, d), `moves` (n,).

    Each step moves a point x_u by moves(u)/3 of the mean over its neighbours of (n_u n_u^T + n_v n_v^T)(x_v - x_u),
    weighted by w = exp(-|n_u n_u^T - n_v n_v^T|^2 / reach^2). It decreases the sum over the edges of
    w ((n_u . (x_v - x_u))^2 + (n_v . (x_v - x_u))^2): Lu, Schaefer, Luo, Ma and He (IEEE TVCG 28(8), 2022).
    """
    from scipy import sparse

    n, d = points.shape
    u, v = graph.edge_rows(), graph.indices
    rows = projectors(normals)
    alike = np.exp(-((rows[u] - rows[v]) ** 2).sum(axis=1) / reach**2)
    W = sparse.csr_array((alike, v, graph.indptr), shape=(n, n))
    total = W.sum(axis=1)
    step = np.where(total > 0, moves / (3 * np.where(total > 0, total, 1)), 0)[:, None]
    outer = (normals[:, :, None] * normals[:, None, :]).reshape(n, -1)
    around = np.asarray(W @ outer).reshape(n, d, d)
    x = points.copy()
    for _ in range(steps):
        own = (normals * (W @ x - total[:, None] * x)).sum(axis=1, keepdims=True) * normals
        theirs = W @ (normals * (normals * x).sum(axis=1, keepdims=True)) - np.einsum("nij,nj->ni", around, x)
        x += step * (own + theirs)
    return x


def tilt(extent: FloatArray, sigma: float | FloatArray, k: IntArray) -> FloatArray:
    """Compute the expected distance sqrt(2) sin(angle), (n,), by which noise turns projectors of `k` + 1 points.

    `extent` is (n,); it is 1 where the extent is 0.
    """
    wide = np.where(extent > 0, extent, 1)
    turned = np.where(extent > 0, np.sqrt(2) * sigma / (np.sqrt(k + 1) * wide), 1)
    found: FloatArray = np.minimum(turned, 1)
    return found
