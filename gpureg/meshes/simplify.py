"""Simplify meshes, by p < 1: :func:`simplify_mesh` (section 5.3, figure 8)."""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import integer, number
from ..doors import door, outside, part_of
from ..graphs.of_shapes import mesh_graph
from ..model.result import Result
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..shapes.carried import Carried
from ..shapes.surface import Surface, proper_faces, surface_of, vertex_normals
from ..solvers import Solver
from ..weights import Weights, bilateral, guided
from .collapse import Collapses

# Scale of the default weights between unit normals of vertices: 9 degrees.
_REACH = 0.15

# With `n_vertices`: the share of the short edges, the cheapest ones, that is collapsed in a round, so that edges that
# become cheap in a later round go before expensive ones of this round. With 100 of 6475 vertices the error of the
# fandisk is 0.4 to 1.9 edges, depending on rounding, and 3.6 if all short edges are collapsed. A cost below the second
# number, in mean edges to the fourth power (squared distance times area), counts as 0.
_CHEAP, _NOTHING = 0.5, 1e-9
# Without `n_vertices` and weights: the maximal cost of an edge, in the same unit. The error of the bunny is 0.5 edges
# with 6270 vertices, and 2.0 with 3968 if all short edges are collapsed; a sphere of 162 vertices stays round.
_DEAR = 0.3

# Edges that the process leaves shorter than this, in mean edges, are collapsed.
_MET = 0.1


@dataclass(frozen=True, eq=False)
class MeshSimplification:
    """The result of simplifying a mesh of n vertices.

    Attributes
    ----------
    surface : Surface
        The input mesh.
    vertices : (k, 3) float array
        The vertices of the simplified mesh; vertices without a face are removed.
    faces : (F, 3) int array
        Its triangles.
    kept : (k,) int array
        One of the input vertices merged into each vertex.
    origin : (F,) int array
        The input triangle that each triangle is the rest of, with the corners in the same order.
    which : (n,) int array
        The same number for input vertices at the same point.
    labels : (n,) int array
        The new vertex that each input vertex was merged into; -1 for vertices without a face.
    met : int
        Number of edges that the process made short, over all rounds.
    refused : int
        How many of them were not collapsed because the result would not be a surface.
    results : list of Result
        The run of each round.
    seconds : float
        Wall-clock time.
    asked : int or None
        The number of vertices that was asked for.
    """

    surface: Surface
    vertices: FloatArray
    faces: IntArray
    kept: IntArray
    origin: IntArray
    which: IntArray
    labels: IntArray
    met: int
    refused: int
    results: list[Result]
    seconds: float
    asked: int | None = None

    @property
    def notes(self) -> list[str]:
        """What a user may not expect, in sentences."""
        if self.asked is None or len(self.vertices) <= self.asked:
            return []
        why = "the surface allows no more" if self.refused else "the process brought no more together: raise max_iter"
        return [f"{len(self.vertices)} vertices are left instead of {self.asked}: {why}"]

    @property
    def carried(self) -> Carried:
        """Where the data at the vertices and faces come from."""
        before, labels = self.surface, self.labels
        return Carried(before.vertices, before.faces, self.which, labels, self.origin, self.vertices, self.faces)


def simplified(
    mesh: Any,
    faces: npt.ArrayLike | None = None,
    *,
    n_vertices: int | None = None,
    p: float = 0.1,
    lam: float = 0.001,
    weights: Weights | npt.ArrayLike | None = None,
    norm: Literal["vertex", "edge"] = "vertex",
    eps: float = 1e-3,
    solver: str | Solver = "jacobi",
    max_iter: int = 500,
    tol: float | None = None,
    **options: Unpack[Run],
) -> MeshSimplification:
    """Simplify a mesh and return a full report; the parameters and errors are those of :func:`simplify_mesh`."""
    begin = time.perf_counter()
    surface = surface_of(mesh, faces)
    if n_vertices is not None and integer("n_vertices", n_vertices) < 4:
        raise ValueError(f"n_vertices must be at least 4, those of a tetrahedron; got {n_vertices}")
    least = 0 if n_vertices is None else int(n_vertices)
    number("lam", lam, low=0)

    process = functools.partial(
        regularize, p=p, lam=lam, norm=norm, eps=eps, solver=solver, max_iter=max_iter, tol=tol, **options
    )
    whole, which = surface.welded()
    if not proper_faces(whole.vertices, whole.faces).any():
        raise ValueError("the mesh has no shape to simplify: none of its faces has an area")
    labels, kept = which, _first(which, len(whole.vertices))
    # squares of coordinates far from the origin have too few digits for distances
    centre = whole.vertices.mean(axis=0)
    v, triangles, origin = whole.vertices - centre, whole.faces, np.arange(len(whole.faces))
    met = refused = 0
    results: list[Result] = []
    quadrics: FloatArray | None = None
    share = 1.0 if n_vertices is None else _CHEAP
    while True:
        before = len(np.unique(triangles))
        if n_vertices is not None and before <= least and results:
            break
        dear = _DEAR if n_vertices is None and weights is None else np.inf
        if weights is None or results:
            # given weights are for the first graph only; neighbouring normals differ more on a coarser mesh
            weights = guided(bilateral(np.inf, _REACH * 2 ** len(results)), vertex_normals(v, triangles))
        v, triangles, part, which_kept, of_faces, counts, result, quadrics = _round(
            v, triangles, quadrics, least, share, dear, weights, process
        )
        labels = np.where(labels >= 0, part[np.maximum(labels, 0)], -1)
        kept, origin = kept[which_kept], origin[of_faces]
        met, refused = met + counts[0], refused + counts[1]
        results.append(result)
        if n_vertices is None:
            break
        if len(v) >= before:
            # no cheap edge is left: take half of the rest, and finally all
            if share == 1 or not counts[0]:
                break
            share = (1 + share) / 2 if share < 0.95 else 1.0
        else:
            share = _CHEAP
    spent = time.perf_counter() - begin
    moved = v + centre
    return MeshSimplification(
        surface, moved, triangles, kept, origin, which, labels, met, refused, results, spent, n_vertices
    )


@door(options=RUN)
@part_of(simplified)
def simplify_mesh(found: MeshSimplification) -> Any:
    """Simplify a triangle mesh: merge vertices that come together when positions are regularized with p < 1.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        A mesh, or only its vertices, (n, 3), with `faces` as the second argument. Vertices at exactly the same point
        count as one.
    faces : (F, 3) int array, optional
    n_vertices : int, optional
        Number of vertices of the result, at least 4; those repeated at seams are not counted. Each round collapses the
        cheaper half of the short edges, until the number is reached, or until the surface allows no further collapse.
        None: one round. It collapses short edges that cost up to 0.3 mean edges to the fourth power (squared distance
        times area), which leaves a tenth to a fifth of the vertices of most meshes; with given weights it collapses all
        short edges.
    p : float, default 0.1
        Degree of regularity, best below 1.
    lam : float, default 0.001
        Fidelity >= 0: larger values leave more vertices. It has no unit: positions are measured in mean edges.
    weights : Weights or array, optional
        Weights on :func:`gpureg.mesh_graph` for the first round. None: exp(-|n(u) - n(v)|^2 / 0.15^2) of the vertices'
        unit normals (0.3 in the second round, 0.6 in the third), which thins out flat parts and preserves creases;
        ``weights=gpureg.weights.constant()`` is figure 8.
    eps : float, default 1e-3
        Smoothing of the gradient norm, in mean edges.
    norm, solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    mesh of the type of the input
        A closed surface stays closed, a manifold stays a manifold; no face has area 0 or occurs twice. Numbers and
        colours at a vertex, and its place in a texture, are interpolated in the nearest triangle around the vertices
        merged into it; whole numbers, which may be labels, are those of the nearest vertex. A face has the data of the
        face that it is the rest of. At the seam of a texture a vertex is repeated, once for each side. Normals are
        computed again.

    Warns
    -----
    UserWarning
        Names the data that the new mesh has not; more than `n_vertices` are left.

    Raises
    ------
    TypeError, ValueError
        Not a triangle mesh, or one of which no face has an area; arguments out of range.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for the positions, starting at the mesh: for p < 1 there are many
    minima. Edges that become shorter than a tenth of the mean edge are collapsed in order of cost, each to the point
    nearest to the planes of all faces merged so far (quadrics, Garland and Heckbert 1997), but only if the mesh stays a
    surface: the link condition is met, and no face turns over or loses its area. Edges with more than two faces are not
    collapsed.

    Examples
    --------
    A flat square of 81 vertices needs only a few:

    >>> import numpy as np, gpureg as gr
    >>> x, y = (axis.ravel() for axis in np.mgrid[:9, :9])
    >>> corner = np.arange(81).reshape(9, 9)[:-1, :-1].ravel()
    >>> faces = np.concatenate([np.stack([corner, corner + 9, corner + 1], 1),
    ...                         np.stack([corner + 1, corner + 9, corner + 10], 1)])
    >>> vertices, faces = gr.simplify_mesh(np.stack([x, y, 0 * x], axis=1), faces, n_vertices=9, backend="numpy")
    >>> len(vertices), round(gr.metrics.area((vertices, faces)))
    (9, 64)
    """
    for note in found.notes:
        warnings.warn(note, stacklevel=outside())
    return found.surface.like(found.vertices, found.carried)


def _first(which: IntArray, k: int) -> IntArray:
    """Return the first copy of each of the k vertices, (k,); `which`, (n,), numbers the vertices."""
    first: IntArray = np.unique(which, return_index=True)[1]
    assert len(first) == k
    return first


def _round(
    v: FloatArray,
    faces: IntArray,
    quadrics: FloatArray | None,
    least: int,
    share: float,
    dear: float,
    weights: Weights | npt.ArrayLike,
    process: Callable[..., Result],
) -> tuple[FloatArray, IntArray, IntArray, IntArray, IntArray, tuple[int, int], Result, FloatArray]:
    """Run the process once and collapse the cheapest share of the short edges, down to `least` vertices.

    Return the vertices, (k, 3), and faces that are left, the new index of each vertex, (n,) (-1: removed), the old
    index of each new vertex, (k,), and of each new face, the numbers of short and of refused edges, the result, and the
    quadrics, (k, 4, 4).
    """
    graph = mesh_graph(v, faces)
    u, w = graph.edge_rows(), graph.indices
    length = float(np.linalg.norm(v[u] - v[w], axis=1).mean()) if len(u) else 1.0
    result = process((v - v.mean(axis=0)) / length, graph, weights=weights)
    f = result.value
    edges = np.stack([u, w], axis=1)[u < w].astype(np.int64)
    edges = edges[np.linalg.norm(f[edges[:, 0]] - f[edges[:, 1]], axis=1) < _MET]
    collapses = Collapses(v, faces, quadrics)
    most = dear * length**4
    if share < 1 and len(edges):
        most = max(float(np.quantile(collapses.costs(edges), share)), _NOTHING * length**4)
    refused = collapses.collapse_cheapest(edges, least, most)
    left, triangles, kept, numbers = collapses.mesh()
    place = np.full(len(v), -1)
    place[kept] = np.arange(len(kept))
    counts = len(edges), refused
    return left, triangles, place[collapses.labels()], kept, numbers, counts, result, collapses.quadrics[kept]
