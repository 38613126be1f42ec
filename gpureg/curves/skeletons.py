"""Compute skeletons of polygons, graphs with radii, before and after smoothing (section 5.3, figure 9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import number
from ..doors import door
from ..graphs.csr import Graph
from ..regularization.options import MODEL, Model
from ..weights import Weights
from .curves import curves_of
from .denoise import denoised

# Vertices whose rays are cast together.
_BLOCK = 1 << 22


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The skeleton of a polygon.

    Attributes
    ----------
    points : (n, 2) float array
        The polygon's vertices.
    graph : Graph
        The skeleton's vertices, at their positions, joined by its edges.
    radii : (k,) float array
        The distance of each skeleton vertex from the polygon's vertices next to it: the radius of the largest disk
        around it that holds none.
    """

    points: FloatArray
    graph: Graph
    radii: FloatArray

    @property
    def positions(self) -> FloatArray:
        """Coordinates of the skeleton's vertices, (k, 2)."""
        assert self.graph.positions is not None
        return self.graph.positions

    @property
    def n_ends(self) -> int:
        """Vertices where a branch ends."""
        return int((self._degrees() == 1).sum())

    @property
    def n_junctions(self) -> int:
        """Vertices where three or more branches meet."""
        return int((self._degrees() > 2).sum())

    def _degrees(self) -> IntArray:
        return np.diff(self.graph.indptr)

    def branches(self) -> list[IntArray]:
        """List the chains from end or junction to end or junction, as vertices in order; a ring by itself is one."""
        degree, indptr, indices = self._degrees(), self.graph.indptr, self.graph.indices
        nodes = np.flatnonzero((degree != 2) & (degree > 0))
        done: set[tuple[int, int]] = set()
        found = []

        def walk(u: int, v: int) -> IntArray:
            chain = [u, v]
            done.add((u, v))
            while degree[v] == 2 and v != chain[0]:
                a, b = indices[indptr[v] : indptr[v + 1]]
                u, v = v, int(a if b == u else b)
                chain.append(v)
                done.add((u, v))
            done.add((v, u))
            return np.array(chain)

        for u in nodes.tolist():
            for v in indices[indptr[u] : indptr[u + 1]].tolist():
                if (u, v) not in done:
                    found.append(walk(u, v))
        on_chains = np.zeros(len(degree), bool)
        for chain in found:
            on_chains[chain] = True
        for u in np.flatnonzero((degree == 2) & ~on_chains).tolist():
            if not on_chains[u]:
                chain = walk(u, int(indices[indptr[u]]))
                on_chains[chain] = True
                found.append(chain)
        return found

    @property
    def n_branches(self) -> int:
        """Number of branches."""
        return len(self.branches())


@dataclass(frozen=True, eq=False)
class SkeletonSimplification:
    """A polygon's skeleton before and after its vertices were regularized: see :func:`simplify_skeleton`."""

    before: Skeleton
    after: Skeleton


@door
def skeleton(points: npt.ArrayLike, *, detail: float = 1.0) -> Skeleton:
    """Compute the skeleton of a simple polygon: the part inside it of the Voronoi diagram of its vertices.

    Parameters
    ----------
    points : (n, 2) array
        The vertices in order, either way round; those of a closed curve, the first not repeated or repeated. They
        should be dense: the diagram knows vertices, not sides. Vertices on the same point count once.
    detail : float, default 1
        An edge of the diagram counts if the way between its two vertices along the polygon is longer than the straight
        one by at least so many mean segments: what is less comes of the sampling. 0 keeps all.

    Returns
    -------
    Skeleton

    Raises
    ------
    TypeError, ValueError
        What is no polygon of the plane; vertices on one line; a detail below 0.

    Notes
    -----
    The edges of the diagram between two vertices that follow each other along the polygon are those that leave it
    through a side; of all others between places inside, the skeleton is made. Inside is by the even-odd rule, so that a
    polygon that crosses itself has one too. How much longer the way along the polygon is (the chord residual of
    Ogniewicz and Kuebler, Pattern Recognition 28(3), 1995) grows from the tips of branches inwards, so that what is
    left hangs together. Every convex corner has a branch: the noisier a polygon, the more.

    Examples
    --------
    A long rectangle has a spine, which forks towards its four corners:

    >>> import numpy as np, gpureg as gr
    >>> x, y = np.arange(0, 40.0), np.arange(0, 10.0)
    >>> sides = [(x, 0 * x), (0 * y + 40, y), (40 - x, 0 * x + 10), (0 * y, 10 - y)]
    >>> found = gr.skeleton(np.concatenate([np.stack(side, axis=1) for side in sides]))
    >>> found.n_ends, found.n_branches, round(float(found.radii.max()), 2)
    (4, 5, 5.02)
    """
    from scipy.spatial import QhullError, Voronoi

    [x] = curves_of(points, True).points
    number("detail", detail, low=0, finite=False)
    if x.shape[1] != 2:
        raise ValueError(f"a skeleton is that of a polygon of the plane, (n, 2); got {x.shape}")
    sites, order = np.unique(x, axis=0, return_index=True)
    # along the polygon, without copies
    first = np.sort(order)
    sites = x[first]
    n = len(sites)
    try:
        diagram = Voronoi(sites - sites.mean(axis=0))
    except QhullError:
        raise ValueError("the polygon has no inside: its vertices lie on one line, or are fewer than three") from None
    places = diagram.vertices + sites.mean(axis=0)
    ridges = np.array(diagram.ridge_vertices)
    between = np.array(diagram.ridge_points)
    apart = np.abs(between[:, 0] - between[:, 1])
    inside = _inside(places, x)
    kept = (ridges >= 0).all(axis=1) & (apart != 1) & (apart != n - 1)
    segments = np.linalg.norm(np.roll(sites, -1, axis=0) - sites, axis=1)
    place = np.concatenate([[0], np.cumsum(segments)])
    way = np.abs(place[between[:, 0]] - place[between[:, 1]])
    straight = np.linalg.norm(sites[between[:, 0]] - sites[between[:, 1]], axis=1)
    kept &= np.minimum(way, place[-1] - way) - straight >= detail * segments.mean()
    kept[kept] = inside[ridges[kept]].all(axis=1)
    edges, between = ridges[kept], between[kept]
    if not len(edges):
        return Skeleton(x, Graph.from_edges([], n_vertices=1, positions=sites.mean(axis=0)[None]), np.zeros(1))
    used, renamed = np.unique(edges, return_inverse=True)
    renamed = renamed.reshape(-1, 2)
    radii = np.zeros(len(used))
    radii[renamed.ravel()] = np.linalg.norm(places[edges.ravel()] - sites[np.repeat(between[:, 0], 2)], axis=1)
    # sites on one circle give edges of length 0, and the same edge more than once
    proper = renamed[renamed[:, 0] != renamed[:, 1]]
    graph = Graph.from_edges(np.unique(np.sort(proper, axis=1), axis=0), n_vertices=len(used), positions=places[used])
    return Skeleton(x, graph, radii)


@door(options=MODEL)
def simplify_skeleton(
    points: npt.ArrayLike,
    *,
    p: float = 2.0,
    lam: float | npt.ArrayLike = 0.1,
    max_iter: int = 10,
    detail: float = 1.0,
    weights: Weights | npt.ArrayLike | None = None,
    fixed: npt.ArrayLike | None = None,
    **options: Unpack[Model],
) -> SkeletonSimplification:
    """Compute the skeleton of a polygon before and after its vertices are regularized (figure 9).

    Parameters
    ----------
    points : (n, 2) array
        As for :func:`skeleton`.
    p, lam, max_iter
        The process on the polygon: p = 2, lam = 0.1 and 10 iterations, unless asked otherwise.
    detail : float, default 1
        As for :func:`skeleton`.
    weights, fixed
        As for :func:`gpureg.denoise_curve`.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    SkeletonSimplification
        ``before`` and ``after``, each a :class:`Skeleton` with its polygon; ``n_branches`` tells what went.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`skeleton` and :func:`gpureg.denoise_curve`.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    >>> ellipse = np.stack([3 * np.cos(angle), np.sin(angle)], axis=1)
    >>> noisy = ellipse + np.random.default_rng(0).normal(0, 0.01, ellipse.shape)
    >>> found = gr.simplify_skeleton(noisy, backend="numpy")
    >>> found.after.n_branches < found.before.n_branches / 2
    True
    """
    curves = curves_of(points, True)
    before = skeleton(points, detail=detail)
    told: Model = {"solver": "jacobi", **options}
    [smooth] = denoised(curves, p=p, lam=lam, max_iter=max_iter, weights=weights, fixed=fixed, **told).points
    return SkeletonSimplification(before, skeleton(smooth, detail=detail))


def _inside(places: FloatArray, polygon: FloatArray) -> npt.NDArray[np.bool_]:
    """Say whether a ray from each place crosses the polygon an odd number of times, (k,)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    odd = np.zeros(len(places), bool)
    step = max(1, _BLOCK // len(polygon))
    for begin in range(0, len(places), step):
        x, y = places[begin : begin + step].T[:, :, None]
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = b[:, 1] - a[:, 1]
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / np.where(rise == 0, 1, rise)
        odd[begin : begin + step] = (spans & (x < at)).sum(axis=1) % 2 == 1
    return odd
