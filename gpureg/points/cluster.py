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

# Neighbours whose regularized positions differ by at most this, in median edges, are merged.
_MET = 0.05
# Smoothing of the gradient norm, in median edges: small compared to _MET.
_EPS = 0.01
# Scale of the weights, in median distances to the seventh nearest point.
_REACH, _NEIGHBOUR = 2.0, 7
# Joining stops where the mean weight falls by at least the first factor from one join to the next; factors above the
# second count as the second.
_GAP, _WIDEST = 3.0, 100.0
# Clusters without an edge between them count as one more join, whose mean weight is smaller by this factor. Values from
# 5.8 to 8.7 give the right number on rings, moons, bars and spirals; larger ones join parts of a component too early.
_NO_EDGE = 7.0


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
    """Cluster points: merge them into pieces with p < 1, then join the pieces with the largest mean weight.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        Points in any dimension, with the same unit for all coordinates; equal points are in one cluster.
    n_clusters : int, optional
        Number of clusters of at least min_size points. None: determined by the widest gap between the mean weights of
        the joins; 1 if there is no gap. See Notes.
    k : int, default 10
        Neighbours that each point chooses.
    p : float, default 0.1
        Degree of regularity; with 1 and above no points are merged.
    lam : float, default 0.1
        Fidelity > 0, with the median edge as the unit of length: larger values leave more and smaller pieces.
    weights : Weights or array, optional
        None: exp(-d^2 / s^2) for an edge of length d, s twice the median distance to the seventh nearest point.
    min_size : int, optional
        Smaller clusters, usually outliers, are joined to others. None: 1 percent of the points, at least k; if there
        are not n_clusters of this size, it is halved until there are.
    norm, eps, solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`; eps in units of the median edge, None: 0.01.

    Returns
    -------
    (n,) int32 array
        The cluster of each point, numbered from 0 in the order of their first points.

    Raises
    ------
    TypeError, ValueError
        Not a point cloud; arguments out of range; more clusters than pieces, or than clusters of the given min_size.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    The coordinates, divided by the median edge, are regularized on the graph of neighbours; points at most 0.05 apart
    along an edge are merged. The mean weight of two pieces A and B is w(A, B)/(|A| |B|), the sum of the weights between
    them divided by the number of pairs of points; the two pieces with the largest mean weight are joined, repeatedly.
    The mean weight is the resolution at which the constant Potts model (Traag, Van Dooren and Nesterov, Phys. Rev. E
    84, 2011), the limit p = 0 of eq. (30) with a cost for each pair within a cluster, joins two clusters. Pieces
    without an edge between them are joined last, the nearest first. With n_clusters=None the joins stop at the widest
    relative gap between the mean weights of joins of clusters of at least min_size, if it is 3 or more; clusters of
    this size without an edge between them count as a gap of 7 after the last join. With a number, the joins stop at the
    last state with this number of such clusters. Smaller clusters are then joined to the nearest one.

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
        stop = _widest_gap(joins, pieces.sizes, least)
    else:
        # this ends: with least = 1 every piece counts
        while (cut := _with_count(joins, pieces.sizes, n_clusters, least)) is None and min_size is None:
            least //= 2
        # where edges cannot give this number of clusters, the nearest ones are joined below
        stop = len(joins) if cut is None else cut
    part = _joined(pieces, x, joins[:stop], n_clusters, least)
    if n_clusters is not None and part.max() + 1 < n_clusters:
        raise ValueError(
            f"there are no {n_clusters} clusters of {min_size} points and more: use a smaller min_size, or None, which "
            f"finds a size that works"
        )
    return pieces.joined(part).labels


def edge_weights(weights: Weights | npt.ArrayLike, graph: Graph, f0: FloatArray) -> FloatArray:
    """Compute weights of any kind as one number >= 0 per directed edge, (n_edges,); `f0` is (n, d)."""
    if isinstance(weights, Weights):
        oracle = backends.get("numpy", np.float64)
        found = oracle.get_weights(weights.prepare(oracle, graph, f0))
        return np.ones(graph.n_edges) if found is None else np.asarray(found, np.float64)
    if np.asarray(weights).dtype.kind not in "biuf":
        raise TypeError(f"weights must be an object of gpureg.weights or an array of numbers, got {weights!r}")
    checked: FloatArray = check_weights(weights, (graph.n_edges,), "one per stored directed edge")
    return checked


def near_weights(x: FloatArray, lengths: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
    """Compute exp(-d^2 / s^2) for the lengths d, (n_edges,); s is twice the median distance to the 7th nearest point.

    The edges join the points x[u] and x[v]; `x` is (n, d).
    """
    far = nearest(x, _NEIGHBOUR)[:, -1]
    s = _REACH * float(np.median(np.linalg.norm(x - x[far], axis=1)))
    near: FloatArray = np.exp(-((lengths / s) ** 2)) if s > 0 else (lengths == 0).astype(np.float64)
    # a weight of 0 would remove the edge
    return np.maximum(near, np.finfo(np.float32).tiny)


def _joined(pieces: Pieces, x: FloatArray, joins: list[_Join], n_clusters: int | None, least: int) -> IntArray:
    """Return the cluster of each piece after these joins, (k,); join small or extra clusters to the nearest one."""
    part = _with_large(_after(pieces.n_pieces, joins), pieces, x, least)
    sizes = np.bincount(part, pieces.sizes)
    while len(sizes) > 1 and (sizes.min() < least or (n_clusters is not None and len(sizes) > n_clusters)):
        part = _with_nearest(part, int(np.argmin(sizes)), part[pieces.labels], x)
        sizes = np.bincount(part, pieces.sizes)
    return part


class _Join(NamedTuple):
    """A join of two clusters, each given by one of its pieces: its mean weight, and the sizes of the clusters."""

    mean: float
    a: int
    b: int
    smaller: float
    larger: float


def _joins(pieces: Pieces) -> list[_Join]:
    """List the joins, always of the two clusters with the largest mean weight, until no edge joins two clusters."""
    graph = pieces.graph
    sizes = pieces.sizes.tolist()
    # dictionaries of neighbours: a sparse matrix would need a sum of two rows at every join
    rows: list[dict[int, float]] = [
        dict(zip(graph.indices[a:b].tolist(), graph.weights[a:b].tolist(), strict=True))  # type: ignore[index]
        for a, b in itertools.pairwise(graph.indptr.tolist())
    ]
    heap = [(-w / (sizes[u] * sizes[v]), u, v) for u, row in enumerate(rows) for v, w in row.items() if u < v]
    heapq.heapify(heap)
    alive = [True] * len(rows)
    done: list[_Join] = []
    # each join makes a cluster with a new number, so that heap entries of the old ones can be skipped
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


def _widest_gap(joins: list[_Join], sizes: FloatArray, least: float) -> int:
    """Return the number of joins before the widest gap between joins of clusters of at least `least`; all if none.

    If the joins leave several clusters of at least `least`, the missing edge between them counts as a gap of
    ``_NO_EDGE`` after the last join. Of equally wide gaps the last one counts. `sizes` is (k,).
    """
    large = [i for i, join in enumerate(joins) if join.smaller >= least]
    if not large:
        return len(joins)
    # a join can have a larger mean than an earlier one: use the least so far
    means = np.minimum.accumulate([joins[i].mean for i in large])
    left = np.bincount(_after(len(sizes), joins), sizes)
    if (left >= least).sum() > 1:
        means = np.append(means, means[-1] / _NO_EDGE)
    if len(means) < 2:
        return len(joins)
    gaps = np.minimum(means[:-1] / np.maximum(means[1:], np.finfo(float).tiny), _WIDEST)
    widest = len(gaps) - 1 - int(np.argmax(gaps[::-1]))
    if gaps[widest] < _GAP or widest + 1 == len(large):
        return len(joins)
    return large[widest + 1]


def _with_count(joins: list[_Join], sizes: FloatArray, count: int, least: float) -> int | None:
    """Return the largest number of joins after which `count` clusters have at least `least` points; None if never.

    If all joins leave more than `count`, return their number: :func:`_joined` joins the rest. `sizes` is (k,).
    """
    small, large = (np.array([getattr(join, name) for join in joins]) for name in ("smaller", "larger"))
    change = (small + large >= least).astype(int) - (small >= least) - (large >= least)
    counts = int((sizes >= least).sum()) + np.concatenate([[0], np.cumsum(change)])
    if counts[-1] >= count:
        return len(joins)
    # a join changes the count by at most one, so that it cannot skip a number
    met = np.flatnonzero(counts == count)
    return int(met[-1]) if len(met) else None


def _after(m: int, joins: list[_Join]) -> IntArray:
    """Return the cluster of each of m pieces after some joins, (m,)."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    a, b = [join.a for join in joins], [join.b for join in joins]
    links = sparse.csr_array((np.ones(len(joins), bool), (a, b)), shape=(m, m))
    found: IntArray = connected_components(links, directed=False)[1]
    return found


def _with_large(part: IntArray, pieces: Pieces, x: FloatArray, least: int) -> IntArray:
    """Join each cluster of fewer than `least` points to the nearest larger one, if there is one; `part` is (k,)."""
    from scipy.spatial import cKDTree

    large = np.bincount(part, pieces.sizes) >= least
    if large.all() or not large.any():
        return part
    of_points = part[pieces.labels]
    inside = large[of_points]
    owner = of_points[inside]
    distance, found = cKDTree(x[inside]).query(x[~inside], workers=-1)
    # the nearest point of a cluster decides; the first one if several are equally near
    order = np.lexsort((np.asarray(distance), of_points[~inside]))
    which, first = np.unique(of_points[~inside][order], return_index=True)
    new = np.arange(len(large))
    new[which] = owner[np.asarray(found)[order[first]]]
    return np.unique(new[part], return_inverse=True)[1].ravel()


def _with_nearest(part: IntArray, one: int, of_points: IntArray, x: FloatArray) -> IntArray:
    """Join cluster `one` to the cluster of the point nearest to it; `part` is (k,), `of_points` (n,)."""
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
