"""Compute skeletons of polygons, as graphs with radii, before and after smoothing (section 5.3, figure 9)."""

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
from .crossings import is_inside
from .curves import Curves, curves_of
from .denoise import denoised


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
        The distance of each skeleton vertex from the nearest vertices of the polygon: the radius of the largest disk
        around it without such a vertex.
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
        """Number of vertices where a branch ends."""
        return int((self._degrees() == 1).sum())

    @property
    def n_junctions(self) -> int:
        """Number of vertices where three or more branches meet."""
        return int((self._degrees() > 2).sum())

    def _degrees(self) -> IntArray:
        return np.diff(self.graph.indptr)

    def branches(self) -> list[IntArray]:
        """List the chains between ends and junctions, as vertices in order; a ring without junctions is one chain."""
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
    """Compute the skeleton of a simple polygon: the part of the Voronoi diagram of its vertices inside the polygon.

    Parameters
    ----------
    points : (n, 2) array
        The vertices of a closed curve in order, in either direction, with or without the first repeated at the end.
        They should be dense: the diagram uses the vertices and not the sides. Equal vertices count once.
    detail : float, default 1
        An edge of the diagram separates two vertices of the polygon. It is used if the path along the polygon between
        them is longer than the straight line by at least this number of mean segments: smaller values come from the
        sampling. 0 uses all edges.

    Returns
    -------
    Skeleton

    Raises
    ------
    TypeError, ValueError
        Not a polygon in the plane; vertices on one line; a detail below 0.

    Notes
    -----
    An edge of the diagram that separates two consecutive vertices crosses a side of the polygon; the other edges whose
    ends are inside make the skeleton. Inside is defined by the even-odd rule, also for polygons that intersect
    themselves. The excess length along the polygon (the chord residual of Ogniewicz and Kuebler, Pattern Recognition
    28(3), 1995) increases from the tips of branches inwards, so that the skeleton stays connected. Every convex corner
    has a branch: a noisy polygon has many.

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

    x = _polygon(points).points[0]
    number("detail", detail, low=0, finite=False)
    if x.shape[1] != 2:
        raise ValueError(f"a skeleton needs a polygon in the plane, (n, 2), got {x.shape}")
    sites, order = np.unique(x, axis=0, return_index=True)
    # in the order of the polygon, without copies
    first = np.sort(order)
    sites = x[first]
    n = len(sites)
    try:
        diagram = Voronoi(sites - sites.mean(axis=0))
    except QhullError:
        raise ValueError("the polygon has no inside: its vertices are on one line, or fewer than three") from None
    places = diagram.vertices + sites.mean(axis=0)
    ridges = np.array(diagram.ridge_vertices)
    between = np.array(diagram.ridge_points)
    apart = np.abs(between[:, 0] - between[:, 1])
    inside = is_inside(places, x)
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
    # sites on one circle give edges of length 0 and repeated edges
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
        The process on the polygon, as in :func:`gpureg.denoise_curve`; the defaults are 2, 0.1 and 10.
    detail : float, default 1
        As for :func:`skeleton`.
    weights, fixed
        As for :func:`gpureg.denoise_curve`.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    SkeletonSimplification
        ``before`` and ``after``, each a :class:`Skeleton` with its polygon.

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
    curves = _polygon(points)
    before = skeleton(points, detail=detail)
    told: Model = {"solver": "jacobi", **options}
    [smooth] = denoised(curves, p=p, lam=lam, max_iter=max_iter, weights=weights, fixed=fixed, **told).points
    return SkeletonSimplification(before, skeleton(smooth, detail=detail))


def _polygon(points: npt.ArrayLike) -> Curves:
    curves = curves_of(points, True)
    if len(curves.points) != 1:
        raise ValueError(f"a skeleton needs one polygon without holes, got {len(curves.points)} curves")
    return curves
