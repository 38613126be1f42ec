"""Fit a surface to noisy points: quadrics of crease-aware neighbourhoods, a scale for each point by whiteness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..model.result import Result
from ..weights import bilateral, guided
from .normals import directions, planes, projectors
from .quadrics import in_pieces, terms

# Numbers of neighbours of the quadrics, of which each point takes one; the finest and the second one tell the noise.
SCALES = (8, 18, 40, 80, 160)
# Neighbours in the graph, and for planes and the quadrics of the first iteration.
GRAPH, AROUND = 8, 18
# The normals of a component with no more points cannot be told from noise.
LEAST = AROUND + 1
# The scale s of the weights of normals: s^2 = 0.15^2 + min(0.5, 1.5 m)^2, with m the median difference along an edge.
_BASE, _FACTOR, _MOST = 0.15, 1.5, 0.5
# Two sweeps; a point itself counts 0.3, and 0.6 / 2 of the fidelity is 0.3.
_SWEEPS, OWN = 2, 0.6
# The scale of the weights between projectors in the quadrics: 20 degrees.
_REACH = 0.5
# Width of the Gaussian weights of places: the distance to the last neighbour over this.
_WIDTH = 1.5
# Regularization of the terms 1, s, t, s^2, st, t^2, relative to the sum of the weights; the same for all directions of
# s, as (a, b, c) -> a^2 + b^2/2 + c^2 is for a quadratic form.
_RIDGE = np.array([0, 1e-6, 1e-6, 1e-4, 0.5e-4, 1e-4])
# Correlation of heights along an edge below which they are white, and from which on, added, they are shape alone.
_WHITE, _SHAPE = 0.02, 0.3
# Sweeps that average correlations, choices and shares. Normals further apart than cos = 0.8 have no common height.
_AVERAGED, _BLENDED, _SHARED, _SAME = 20, 3, 2, 0.8

Run = Callable[[FloatArray, Graph, float, Any], Result]


class SurfaceFit(NamedTuple):
    """Points fitted to their surface.

    Attributes
    ----------
    heights : (n,) float array
        The height of each point over the surface, along its normal: what is noise.
    normals : (n, 3) float array
        Unit vectors, of either orientation.
    sigma : (n,) float array
        The standard deviation of the noise along the normal around each point; NaN where it cannot be told, which is in
        components of fewer than 19 points.
    component : (n,) int array
        The component of each point in the graph of neighbours.
    results : tuple of Result
        The runs of the model.
    """

    heights: FloatArray
    normals: FloatArray
    sigma: FloatArray
    component: IntArray
    results: tuple[Result, ...]


def fitted_surface(points: FloatArray, run: Run, scales: Sequence[int] = SCALES) -> SurfaceFit:
    """Fit a surface to points (n, 3) without repetitions.

    Parameters
    ----------
    points : (n, 3) float array
        At least 19 points.
    run : callable
        ``run(f0, graph, lam, weights)`` sweeps once over a function on the graph with p = 2.
    scales : sequence of int
        Numbers of neighbours, ascending.

    Notes
    -----
    Twice: the normals N of planes through 19 points are averaged with weights exp(-|g(u) - g(v)|^2 / s^2) of a guide g,
    the mean projector of the neighbours. Then the height of each point over the quadric through its neighbours, in the
    frame of its normal, with weights exp(-(d / r)^2 - |N(u) N(u)^T - N(v) N(v)^T|^2 / 0.5^2). The neighbours and their
    places come from the points as the first iteration moves them, the heights from the data. The first iteration uses
    18 neighbours. In the second, each point takes the largest scale up to which its heights and those around it are
    white: the mean of h(u) h(v) over the edges is at most 0.02 of that of h^2.
    """
    # neighbours beside each other in memory: searches and sums take little more than half of the time
    order = _tree(points).indices
    points = points[order]
    y, results = points, []
    tree, around = _tree(y), slice(0, len(y))
    normals, more, graph, part = _normals(y, _neighbours(tree, y, around, AROUND)[0], run)
    results += more
    heights = _heights(points, y, normals, tree, (AROUND,), part)[:, :1]
    y = points - heights * normals
    scales, tree = [k for k in scales if k < len(points)], _tree(y)
    normals, more, graph, part = _normals(y, _neighbours(tree, y, around, AROUND)[0], run)
    results += more
    table = _heights(points, y, normals, tree, scales, part)
    heights, sigma = _chosen(graph, normals, *np.split(table, 3, axis=1))
    alone = np.bincount(part)[part] < LEAST
    heights[alone], sigma[alone] = 0, np.nan
    back = np.argsort(order)
    return SurfaceFit(heights[back], normals[back], sigma[back], part[back], tuple(results))


def _tree(y: FloatArray) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(y, balanced_tree=False)


def _neighbours(tree: Any, y: FloatArray, part: slice, k: int, workers: int = -1) -> tuple[IntArray, FloatArray]:
    """Find each point of the part itself, first, and its k nearest others, with their distances; both (q, k + 1)."""
    rows = np.arange(len(y))[part]
    distance, near = tree.query(y[part], k + 1, workers=workers)
    other = np.flatnonzero(near[:, 0] != rows)
    if len(other):
        # points that came to the same place: the point itself changes places with the first, or takes the last one
        own = near[other] == rows[other][:, None]
        near[other, np.where(own.any(axis=1), own.argmax(axis=1), k)] = near[other, 0]
        near[other, 0] = rows[other]
    return near, distance


def _graph(near: IntArray) -> Graph:
    """Join each point with its neighbours `near` (n, k + 1), of which the first is the point itself."""
    from scipy import sparse

    n, k = len(near), near.shape[1] - 1
    chosen = sparse.csr_array((np.ones(n * k, bool), near[:, 1:].ravel(), np.arange(n + 1) * k), shape=(n, n))
    both = sparse.csr_array(chosen + chosen.T)
    both.sort_indices()
    return Graph(both.indptr, both.indices)


def _normals(y: FloatArray, near: IntArray, run: Run) -> tuple[FloatArray, list[Result], Graph, IntArray]:
    """Compute guided normals (n, 3) of planes through `near`; also the runs, the graph and its components (n,)."""
    from scipy import sparse

    n, d = y.shape
    graph = _graph(near[:, : GRAPH + 1])
    u, v = graph.edge_rows(), graph.indices
    joined = sparse.csr_array((np.ones(len(v)), v, graph.indptr), shape=(n, n))
    parts = Components.of(graph)
    part = parts.labels
    rows, results = projectors(planes(y, near).normals), []
    normals: FloatArray = np.empty((n, d))
    for _ in range(_SWEEPS):
        mean = directions(joined @ rows + rows, d)
        apart = np.sqrt(_between(mean, u, v))
        usual = np.nan_to_num(parts.medians(apart, part[u]))
        scale = np.sqrt(_BASE**2 + np.minimum(_MOST, _FACTOR * usual) ** 2)
        # one scale for each component: no edge joins two
        guide = projectors(mean) / scale[part][:, None]
        results.append(run(rows, graph, OWN, guided(bilateral(np.inf, 1.0), guide)))
        normals = directions(results[-1].value.astype(np.float64), d)
        rows = projectors(normals)
    return normals, results, graph, part


def _between(normals: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
    """Compute the squared distances 2 - 2 (n(u) . n(v))^2 of projectors."""
    return np.maximum(2 - 2 * _products(normals, u, v) ** 2, 0)


def _products(normals: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
    found = np.zeros(len(u))
    for column in normals.T:
        found += column[u] * column[v]
    return found


def _heights(
    x: FloatArray, y: FloatArray, normals: FloatArray, tree: Any, scales: Sequence[int], component: IntArray
) -> FloatArray:
    """Compute the heights over quadrics, the variances of white noise in them, and whether a scale is allowed.

    Places are those of `y`, of which `tree` is the tree, heights those of `x`, (n, 3). The result is (n, 3 scales):
    heights; their variances for white noise of variance 1; 1 where all neighbours are of the point's component.
    """
    n, last = len(x), max(scales)

    def work(part: slice) -> FloatArray:
        some, distance = _neighbours(tree, y, part, last, workers=1)
        own = normals[part]
        q = len(own)
        first = np.where(np.abs(own[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
        first = np.cross(own, first)
        first /= np.linalg.norm(first, axis=1)[:, None]
        plane = np.stack([first, np.cross(own, first)], axis=2)
        unit = distance[:, last]
        unit = np.where(unit > 0, unit, 1)[:, None]
        heights = ((x[some] - x[part][:, None]) @ own[:, :, None])[..., 0] / unit
        places = ((y[some] - y[part][:, None]) @ plane) / unit[..., None]
        A = terms(places, heights)
        squared = (distance / unit) ** 2
        alike = (normals[some] @ own[:, :, None])[..., 0]
        crease = np.exp(np.minimum(alike**2 - 1, 0) * (2 / _REACH**2))
        mine = component[some] == component[part][:, None]
        found = np.empty((q, 3, len(scales)))
        for i, k in enumerate(scales):
            scale = distance[:, k][:, None] / _WIDTH / unit
            scale = np.where(scale > 0, scale, 1)
            w = np.exp(-squared[:, : k + 1] / scale**2) * crease[:, : k + 1] + 1e-12
            B = A[:, :, : k + 1]
            G = (B * w[:, None]) @ B.transpose(0, 2, 1)
            # the terms in units of the scale
            one = np.ones_like(scale)
            by = np.concatenate([one, 1 / scale, 1 / scale, *[1 / scale**2] * 3], axis=1)
            M = G[:, :-1, :-1] * by[:, :, None] * by[:, None, :]
            M += w.sum(axis=1)[:, None, None] * np.diag(_RIDGE) + 1e-12 * np.eye(6)
            right = np.zeros((q, 6, 2))
            right[:, :, 0] = G[:, :-1, -1] * by
            right[:, 0, 1] = 1
            fit = np.linalg.solve(M, right)
            # the fit in the point's own place is the sum of share times height
            share = w * ((fit[:, :, 1] * by)[:, None] @ B[:, :-1])[:, 0]
            found[:, 0, i] = -fit[:, 0, 0] * unit[:, 0]
            found[:, 1, i] = (share**2).sum(axis=1) + 1 - 2 * share[:, 0]
            found[:, 2, i] = mine[:, : k + 1].all(axis=1)
        return found.reshape(q, -1)

    return in_pieces(work, n, (last + 1) * 20)


def _chosen(
    graph: Graph, normals: FloatArray, heights: FloatArray, growth: FloatArray, inside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Choose the scale of each point; return its height (n,) and the standard deviation of the noise around it (n,)."""
    from scipy import sparse

    n, count = heights.shape
    u, v = graph.edge_rows(), graph.indices
    degree = np.diff(graph.indptr).astype(np.float64)[:, None]
    joined = sparse.csr_array((np.ones(len(v)), v, graph.indptr), shape=(n, n))

    def averaged(q: FloatArray, times: int) -> FloatArray:
        for _ in range(times):
            q = (q + joined @ (q / degree)) / 2
        return q

    cosine = _products(normals, u, v)
    sign = np.where(np.abs(cosine) > _SAME, np.sign(cosine), 0)
    rho, variance = np.empty((n, count)), np.empty((n, count))
    for i, h in enumerate(heights.T):
        own, other = h[u], h[v]
        told = np.stack(
            [
                np.bincount(u, sign * own * other, n),
                np.bincount(u, np.abs(sign) * (own**2 + other**2) / 2, n),
                h**2 * degree[:, 0],
                growth[:, i] * degree[:, 0],
            ],
            axis=1,
        )
        products, squares, level, white_level = averaged(told, _AVERAGED).T
        # heights that are all 0 are white
        rho[:, i] = np.divide(products, squares, out=np.zeros(n), where=squares > 0)
        variance[:, i] = level / np.maximum(white_level, np.finfo(float).tiny)
    white = (rho <= _WHITE) & (inside > 0)
    white[:, 0] = True
    best = np.logical_and.accumulate(white, axis=1).sum(axis=1) - 1
    share = averaged(np.eye(count)[best], _BLENDED)
    share /= share.sum(axis=1, keepdims=True)
    noise = averaged(np.clip(1 - (rho[:, :1] - _WHITE) / _SHAPE, 0, 1) * degree, _SHARED)[:, 0]
    noise /= averaged(degree, _SHARED)[:, 0]
    # the finest scales tell the noise, whichever others there are
    fine = np.where(best > 0, variance[:, min(1, count - 1)], variance[:, 0])
    return (share * heights).sum(axis=1) * noise, np.sqrt(fine) * noise
