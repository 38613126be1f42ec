"""Cluster points by p -> 0: :func:`cluster_points`."""

from __future__ import annotations

import heapq
import itertools
from typing import Any, Literal, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, IntArray
from ..checks import integer, number
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.edges import check_weights
from ..graphs.of_points import knn_graph
from ..regularization.options import RUN, Run
from ..regularization.pieces import Labels, Pieces, coarser, whole
from ..shapes.cloud import cloud_of
from ..solvers import Solver
from ..weights import Weights
from .normals import nearest

# Points whose regularized places differ by less than this share of the median edge have met.
_MET = 0.05
# The smoothing of the gradient, as a share of the median edge: small against what has met.
_EPS = 0.01
# Reach of the weights, in median distances to the seventh nearest point.
_REACH, _NEIGHBOUR = 2.0, 7
# Clusters are split where the mean weight falls by such a factor from one join to the next; more than the second
# factor counts as much as it.
_GAP, _WIDEST = 3.0, 100.0


@door(options=RUN)
def cluster_points(
    points: Any,
    n_clusters: int | None = None,
    *,
    k: int = 10,
    p: float = 0.1,
    lam: float = 0.1,
    weights: Weights | npt.ArrayLike | None = None,
    min_size: int | None = None,
    norm: Literal["vertex", "edge"] = "vertex",
    eps: float | None = None,
    solver: str | Solver = "jacobi",
    max_iter: int = 200,
    tol: float | None = None,
    **options: Unpack[Run],
) -> Labels:
    """Cluster points: those that meet for p < 1 are one piece, and pieces are joined where they hang together most.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        Of any number of coordinates, which should be of one unit; two on the same place are in one cluster.
    n_clusters : int, optional
        How many clusters of at least min_size. None: where the joins show the widest gap, and 1 if there is none, see
        Notes.
    k : int, default 10
        Neighbours that each point chooses.
    p : float, default 0.1
        Degree of regularity; 1 and above make no points meet.
    lam : float, default 0.1
        Fidelity > 0, where the median edge is the unit of length: larger leaves more and smaller pieces.
    weights : Weights or array, optional
        None: exp(-d^2 / s^2) of the length d of an edge, s twice the median distance to the seventh nearest point.
    min_size : int, optional
        Smaller clusters, outliers most often, are joined to others and do not count. None: 1 percent of the points, at
        least k; where n_clusters of this size cannot be had, it is halved until they can.
    norm, eps, solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`; eps in units of the median edge, None: 0.01.

    Returns
    -------
    (n,) int32 array
        The cluster of each point, from 0, in the order of their first points.

    Raises
    ------
    TypeError, ValueError
        What is no cloud of points, arguments out of their ranges, more clusters than there are pieces, or than there
        are of a min_size that is given.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    The coordinates, over the median edge, are regularized on the graph of neighbours; points that are then less than
    0.05 apart along an edge have met. Of two pieces A and B the mean weight is w(A, B)/(|A| |B|), the sum of the
    weights between them over the pairs of points: the two for which it is largest are joined, again and again. It is
    the resolution at which the constant Potts model (Traag, Van Dooren and Nesterov, Phys. Rev. E 84, 2011), the limit
    p = 0 of eq. (30) with a price on each pair within a cluster, joins two clusters. Pieces between which there is no
    edge are joined last, the nearest first. With n_clusters=None the joins of clusters of at least min_size count: the
    widest relative gap between their mean weights, if it is 3 or more, says where to stop. With a number it is the last
    place at which as many are of that size. What is then smaller goes to the nearest cluster that is not.

    Measured with n_clusters given (adjusted Rand index; spectral clustering, HDBSCAN of 15): labirynth 0.72 (0.72,
    0.51), circles 1 (0.74, 1), mk4 1 (0.61, 0.49), two moons in 100 dimensions 0.88 (0.51, 0).

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> t = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    >>> ring = np.stack([np.cos(t), np.sin(t)], axis=1)
    >>> labels = gr.cluster_points(np.concatenate([ring, 3 * ring]), backend="numpy")
    >>> np.bincount(labels), bool((labels[:100] == 0).all())
    (array([100, 100]), True)
    """
    x = cloud_of(points).points
    n = len(x)
    _check(n, n_clusters, lam, min_size)
    graph = knn_graph(x, k)
    u, v = graph.edge_rows(), graph.indices
    lengths = np.linalg.norm(x[u] - x[v], axis=1)
    unit = float(np.median(lengths)) if len(lengths) else 0.0
    unit = unit or float(lengths.max(initial=0.0)) or 1.0
    w = near_weights(x, lengths, u, v) if weights is None else edge_weights(weights, graph, x)
    start = whole((x - x.mean(axis=0)) / unit, graph, w)
    [pieces] = coarser(
        start, [lam], p=p, merge_tol=_MET, norm=norm, eps=_EPS if eps is None else eps, solver=solver,
        max_iter=max_iter, tol=tol, **options,
    )  # fmt: skip
    if n_clusters is not None and n_clusters > pieces.n_pieces:
        raise ValueError(
            f"n_clusters must be at most {pieces.n_pieces}, the number of pieces that the points met in, got "
            f"{n_clusters}: a larger lam leaves more"
        )
    joins = _joins(pieces)
    least = max(k, n // 100) if min_size is None else min_size
    if n_clusters is None:
        stop = _widest_gap(joins, least)
    else:
        # with 1 every piece counts, so that there is an end
        while (cut := _with_count(joins, pieces.sizes, n_clusters, least)) is None and min_size is None:
            least //= 2
        # where edges join no such clusters, what is nearest may
        stop = len(joins) if cut is None else cut
    part = _joined(pieces, x, joins[:stop], n_clusters, least)
    if n_clusters is not None and part.max() + 1 < n_clusters:
        raise ValueError(
            f"there are no {n_clusters} clusters of {min_size} points and more: a smaller min_size counts more of "
            f"them, None takes what can be had"
        )
    return pieces.joined(part).labels


def edge_weights(weights: Weights | npt.ArrayLike, graph: Graph, f0: FloatArray) -> FloatArray:
    """Compute weights of any kind as one number per directed edge, (n_edges,).

    Raises
    ------
    TypeError, ValueError
        What is no weight function nor one number >= 0 for each edge.
    """
    if isinstance(weights, Weights):
        oracle = backends.get("numpy", np.float64)
        found = oracle.get_weights(weights.prepare(oracle, graph, f0))
        return np.ones(graph.n_edges) if found is None else np.asarray(found, np.float64)
    if np.asarray(weights).dtype.kind not in "biuf":
        raise TypeError(f"weights must be an object of gpureg.weights or an array of numbers, got {weights!r}")
    checked: FloatArray = check_weights(weights, (graph.n_edges,), "one per stored directed edge")
    return checked


def near_weights(x: FloatArray, lengths: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
    """exp(-d^2 / s^2), s twice the median distance to the seventh nearest point."""
    far = nearest(x, _NEIGHBOUR)[:, -1]
    s = _REACH * float(np.median(np.linalg.norm(x - x[far], axis=1)))
    near: FloatArray = np.exp(-((lengths / s) ** 2)) if s > 0 else (lengths == 0).astype(np.float64)
    # 0 would be no edge
    return np.maximum(near, np.finfo(np.float32).tiny)


def _joined(pieces: Pieces, x: FloatArray, joins: list[_Join], n_clusters: int | None, least: int) -> IntArray:
    """The cluster of each piece after these joins: what is too small, or beyond the number, is with what is nearest."""
    part = _with_large(_after(pieces.n_pieces, joins), pieces, x, least)
    sizes = np.bincount(part, pieces.sizes)
    while len(sizes) > 1 and (sizes.min() < least or (n_clusters is not None and len(sizes) > n_clusters)):
        part = _with_nearest(part, int(np.argmin(sizes)), part[pieces.labels], x)
        sizes = np.bincount(part, pieces.sizes)
    return part


class _Join(NamedTuple):
    """Two clusters that become one; each is named by the number of a piece in it."""

    mean: float
    a: int
    b: int
    smaller: float
    larger: float


def _joins(pieces: Pieces) -> list[_Join]:
    """The pairs of clusters with the largest mean weight between them, until there is no edge between any."""
    graph = pieces.graph
    sizes = pieces.sizes.tolist()
    # dictionaries of neighbours, because two rows of a sparse matrix would have to be added at every join
    rows: list[dict[int, float]] = [
        dict(zip(graph.indices[a:b].tolist(), graph.weights[a:b].tolist(), strict=True))  # type: ignore[index]
        for a, b in itertools.pairwise(graph.indptr.tolist())
    ]
    heap = [(-w / (sizes[u] * sizes[v]), u, v) for u, row in enumerate(rows) for v, w in row.items() if u < v]
    heapq.heapify(heap)
    alive = [True] * len(rows)
    done: list[_Join] = []
    # a cluster's number is never used again: each join makes a new one, so that what the heap holds of old ones is void
    first = list(range(len(rows)))
    while heap:
        mean, u, v = heapq.heappop(heap)
        if not (alive[u] and alive[v]):
            continue
        done.append(_Join(-mean, first[u], first[v], min(sizes[u], sizes[v]), max(sizes[u], sizes[v])))
        new, row = len(rows), dict(rows[u])
        for neighbour, w in rows[v].items():
            row[neighbour] = row.get(neighbour, 0.0) + w
        del row[u], row[v]
        alive[u] = alive[v] = False
        alive.append(True)
        rows.append(row)
        sizes.append(sizes[u] + sizes[v])
        first.append(min(first[u], first[v]))
        for neighbour, w in row.items():
            other = rows[neighbour]
            other.pop(u, None)
            other.pop(v, None)
            other[new] = w
            heapq.heappush(heap, (-w / (sizes[neighbour] * sizes[new]), neighbour, new))
        rows[u], rows[v] = {}, {}
    return done


def _widest_gap(joins: list[_Join], least: float) -> int:
    """How many of the joins are within clusters: those before the widest gap, all if there is none."""
    large = [i for i, join in enumerate(joins) if join.smaller >= least]
    # a join may be of a larger mean than one before it: what counts is the least so far
    means = np.minimum.accumulate([joins[i].mean for i in large]) if large else np.zeros(0)
    if len(means) < 2:
        return len(joins)
    gaps = np.minimum(means[:-1] / np.maximum(means[1:], np.finfo(float).tiny), _WIDEST)
    widest = int(np.argmax(gaps))
    return large[widest + 1] if gaps[widest] >= _GAP else len(joins)


def _with_count(joins: list[_Join], sizes: FloatArray, count: int, least: float) -> int | None:
    """After how many joins, the most there can be, `count` clusters are of at least a size; None if never.

    All of the joins where even then there are more: what no edge joins is left for :func:`_joined`.
    """
    small, large = (np.array([getattr(join, name) for join in joins]) for name in ("smaller", "larger"))
    change = (small + large >= least).astype(int) - (small >= least) - (large >= least)
    counts = int((sizes >= least).sum()) + np.concatenate([[0], np.cumsum(change)])
    if counts[-1] >= count:
        return len(joins)
    # a join changes the count by one at most: where it has passed `count`, it has met it
    met = np.flatnonzero(counts == count)
    return int(met[-1]) if len(met) else None


def _after(m: int, joins: list[_Join]) -> IntArray:
    """The cluster of each of m pieces after some joins."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    a, b = [join.a for join in joins], [join.b for join in joins]
    links = sparse.csr_array((np.ones(len(joins), bool), (a, b)), shape=(m, m))
    found: IntArray = connected_components(links, directed=False)[1]
    return found


def _with_large(part: IntArray, pieces: Pieces, x: FloatArray, least: int) -> IntArray:
    """Each cluster of fewer points than `least` joined to the one of more that is nearest, if there is any."""
    from scipy.spatial import cKDTree

    large = np.bincount(part, pieces.sizes) >= least
    if large.all() or not large.any():
        return part
    of_points = part[pieces.labels]
    inside = large[of_points]
    owner = of_points[inside]
    distance, found = cKDTree(x[inside]).query(x[~inside], workers=-1)
    # of a cluster's points the nearest decides, the first of those as near
    order = np.lexsort((np.asarray(distance), of_points[~inside]))
    which, first = np.unique(of_points[~inside][order], return_index=True)
    new = np.arange(len(large))
    new[which] = owner[np.asarray(found)[order[first]]]
    return np.unique(new[part], return_inverse=True)[1].ravel()


def _with_nearest(part: IntArray, one: int, of_points: IntArray, x: FloatArray) -> IntArray:
    """A cluster joined to the one that a point nearest to one of its own is in."""
    from scipy.spatial import cKDTree

    inside = of_points == one
    distance, found = cKDTree(x[~inside]).query(x[inside], workers=-1)
    other = of_points[~inside][np.asarray(found)[np.argmin(distance)]]
    new = np.where(part == one, other, part)
    return np.unique(new, return_inverse=True)[1].ravel()


def _check(n: int, n_clusters: Any, lam: Any, min_size: Any) -> None:
    for name, value in (("n_clusters", n_clusters), ("min_size", min_size)):
        if value is not None and not 1 <= integer(name, value) <= n:
            raise ValueError(f"{name} must lie in 1..{n}, the number of points, got {value}")
    if not (number("lam", lam, finite=False) > 0 and np.isfinite(lam)):
        raise ValueError(f"lam must be finite and > 0: with 0 all points of a component meet; got {lam}")
