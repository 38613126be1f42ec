"""Simplify meshes, by p < 1: :func:`simplify_mesh` (section 5.3, figure 8)."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import integer, number
from ..doors import door, part_of
from ..graphs.of_shapes import mesh_graph
from ..model.result import Result
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..shapes.surface import Surface, surface_of, vertex_normals
from ..solvers import Solver
from ..weights import Weights, bilateral, guided
from .collapse import Collapses

# Reach of the default weights between unit normals of vertices: 9 degrees.
_REACH = 0.15

# Where a number of vertices is asked for, of the edges that met this share, the cheapest, is collapsed in a round, so
# that what is cheap in a later round goes before what is dear in this: at 100 of 6475 vertices the fandisk is 0.4 to
# 1.9 edges off, as rounding has it, 3.6 where all are. A cost below the second, in mean edges to the fourth (squared
# distances, by areas), is none.
_CHEAP, _NOTHING = 0.5, 1e-9
# Where none is, nor weights, what an edge may cost at most, in the same unit: the bunny is 0.5 edges off at 6270
# vertices, 2.0 at 3968 with all that met, and a sphere of 162 vertices does not become a tetrahedron.
_DEAR = 0.3

# Vertices have met where the process leaves less than this between them, in mean edges.
_MET = 0.1


@dataclass(frozen=True, eq=False)
class MeshSimplification:
    """What simplifying a mesh of n vertices did.

    Attributes
    ----------
    surface : Surface
        The mesh that came in.
    vertices : (k, 3) float array
        Those of the simpler mesh; vertices in no face are gone.
    faces : (F, 3) int array
        Its triangles.
    kept : (k,) int array
        A vertex of the mesh that came for each, whose attributes it has.
    labels : (n,) int array
        Which vertex each that came is part of now; -1 for those in no face.
    met : int
        Edges whose ends met in the process, over all rounds.
    refused : int
        Of these, those that could not be collapsed, for the surface to stay one.
    results : list of Result
        The run of each round.
    seconds : float
        How long it took.
    """

    surface: Surface
    vertices: FloatArray
    faces: IntArray
    kept: IntArray
    labels: IntArray
    met: int
    refused: int
    results: list[Result]
    seconds: float


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
    """Simplify a mesh, and say all that there is to say about it: the work of :func:`simplify_mesh`.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`simplify_mesh`.
    """
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
    labels, kept = which, _first(which, len(whole.vertices))
    # squares of coordinates far from the origin would have no digits left for distances
    centre = whole.vertices.mean(axis=0)
    v, triangles = whole.vertices - centre, whole.faces
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
            # those given were for the first graph; the coarser a mesh, the further apart are neighbouring normals
            weights = guided(bilateral(np.inf, _REACH * 2 ** len(results)), vertex_normals(v, triangles))
        v, triangles, part, which_kept, counts, result, quadrics = _round(
            v, triangles, quadrics, least, share, dear, weights, process
        )
        labels = np.where(labels >= 0, part[np.maximum(labels, 0)], -1)
        kept = kept[which_kept]
        met, refused = met + counts[0], refused + counts[1]
        results.append(result)
        if n_vertices is None:
            break
        if len(v) >= before:
            # nothing cheap is left: half of the rest, and at last all
            if share == 1 or not counts[0]:
                break
            share = (1 + share) / 2 if share < 0.95 else 1.0
        else:
            share = _CHEAP
    spent = time.perf_counter() - begin
    return MeshSimplification(surface, v + centre, triangles, kept, labels, met, refused, results, spent)


@door(options=RUN)
@part_of(simplified)
def simplify_mesh(found: MeshSimplification) -> Any:
    """Simplify a triangle mesh: the vertices that meet when their positions are regularized with p < 1 become one.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        Or the vertices, (n, 3), and `faces` too. Vertices on exactly the same point count as one.
    faces : (F, 3) int array, optional
    n_vertices : int, optional
        How many vertices to leave, at least 4: as many rounds are done as that takes, each collapsing the cheaper half
        of what met, and the last stops there. More are left where the surface allows no fewer. None: what one round
        leaves of a mesh where an edge may cost 0.3 mean edges to the fourth (squared distance, by area), a tenth to a
        fifth of most; all that met where weights are given.
    p : float, default 0.1
        Degree of regularity, best below 1.
    lam : float, default 0.001
        Fidelity >= 0: larger leaves more vertices. Positions are taken in mean edges, so that it has no unit.
    weights : Weights or array, optional
        On :func:`gpureg.mesh_graph`, for the first round. None: exp(-|n(u) - n(v)|^2 / 0.15^2) of the vertices' unit
        normals (0.3 in a second round, 0.6 in a third), so that flat parts thin out and creases stay;
        ``weights=gpureg.weights.constant()`` is figure 8.
    eps : float, default 1e-3
        Smoothing of the gradient norm, in mean edges.
    norm, solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    mesh of the kind that came in
        Its vertices have the attributes (colours and the like) of one of those that they are made of. A closed surface
        stays closed, a manifold one; there are no faces without area or twice the same.

    Raises
    ------
    TypeError, ValueError
        What is no mesh of triangles, arguments out of their ranges.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for the positions, from where they are: p < 1 has many minima.
    Edges that are left shorter than a tenth of the mean edge are collapsed, always the flattest of those left, each to
    the point nearest to the planes of all faces merged so far, in earlier rounds too (quadrics, Garland and Heckbert
    1997), and only where the surface stays one: the link condition holds, no face turns over or loses its area. Faces
    at an edge of more than two are left alone.

    Examples
    --------
    A flat square of 81 vertices needs few:

    >>> import numpy as np, gpureg as gr
    >>> x, y = (axis.ravel() for axis in np.mgrid[:9, :9])
    >>> corner = np.arange(81).reshape(9, 9)[:-1, :-1].ravel()
    >>> faces = np.concatenate([np.stack([corner, corner + 9, corner + 1], 1),
    ...                         np.stack([corner + 1, corner + 9, corner + 10], 1)])
    >>> vertices, faces = gr.simplify_mesh(np.stack([x, y, 0 * x], axis=1), faces, n_vertices=9, backend="numpy")
    >>> len(vertices), round(gr.metrics.area((vertices, faces)))
    (9, 64)
    """
    return found.surface.like(found.vertices, found.faces, found.kept)


def _first(which: IntArray, k: int) -> IntArray:
    """Find for each vertex that is left of copies the first of them, (k,)."""
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
) -> tuple[FloatArray, IntArray, IntArray, IntArray, tuple[int, int], Result, FloatArray]:
    """Run the process once and collapse edges, the cheapest first, down to `least` vertices.

    Of the edges that met only a share, the cheapest, is collapsed. Vertices and faces left, which of them each
    vertex has become (-1: none), a vertex that each of them was, how many edges met and how many of these were refused,
    the run, and the planes that the vertices remember.
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
    left, triangles, kept = collapses.mesh()
    place = np.full(len(v), -1)
    place[kept] = np.arange(len(kept))
    counts = len(edges), refused
    return left, triangles, place[collapses.labels()], kept, counts, result, collapses.quadrics[kept]
