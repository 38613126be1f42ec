"""Segment meshes hierarchically, by p -> 0, as the paper's outlook proposes: :func:`segment_mesh`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_values
from ..checks import number
from ..doors import door
from ..exchange import on_host
from ..graphs.csr import Graph
from ..graphs.of_shapes import face_graph
from ..model.result import Result
from ..regularization.options import RUN, Run
from ..regularization.pieces import Labels, coarser, whole
from ..shapes.surface import face_normals, face_vectors, surface_of
from ..solvers import Solver

# Default fidelities: the first leaves only flat parts whole, the last merges all faces.
_LAMS = tuple(3.0 * 2.0**-k for k in range(12))
# For unit normals: faces whose values differ by less than the first are merged; the second smooths the gradient norm.
_MET, _EPS = 0.05, 0.01


@dataclass(frozen=True, eq=False)
class MeshSegmentation:
    """Coarser and coarser segmentations of a mesh: see :func:`segment_mesh`.

    Attributes
    ----------
    levels : tuple of (F,) int32 arrays
        The segment of each face, one array per fidelity; each segment is a union of segments of the previous level.
    lam : tuple of float
        The fidelity of each level.
    results : tuple of Result
        The run of each level.
    """

    levels: tuple[Labels, ...]
    lam: tuple[float, ...]
    results: tuple[Result, ...]

    _exchanged: ClassVar[tuple[str, ...]] = ("levels", "results")

    @property
    def n_segments(self) -> tuple[int, ...]:
        """The number of segments of each level."""
        return tuple(int(on_host(labels, "labels").max()) + 1 for labels in self.levels)

    def at_most(self, n: int) -> Labels:
        """Return the finest level with at most `n` segments, (F,); raise ValueError if all have more."""
        for labels, count in zip(self.levels, self.n_segments, strict=True):
            if count <= n:
                return labels
        raise ValueError(f"no level has as few as {n} segments; they have {self.n_segments}: add a smaller lam")


@door(options=RUN)
def segment_mesh(
    mesh: Any,
    faces: npt.ArrayLike | None = None,
    *,
    lam: Sequence[float] | None = None,
    values: npt.ArrayLike | None = None,
    p: float = 0.1,
    weights: npt.ArrayLike | None = None,
    merge_tol: float | None = None,
    norm: Literal["vertex", "edge"] = "edge",
    eps: float | None = None,
    solver: str | Solver = "jacobi",
    max_iter: int = 200,
    tol: float | None = None,
    **options: Unpack[Run],
) -> MeshSegmentation:
    """Segment a mesh into parts on which a function is nearly constant, one segmentation for each lam.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        A mesh, or only its vertices, (n, 3), with `faces` as the second argument.
    faces : (F, 3) int array, optional
    lam : sequence of float, optional
        Decreasing fidelities > 0. None: twelve values, 3, 1.5, 0.75, ...
    values : (F,) or (F, m) array, optional
        A function on the faces. None: their unit normals, which gives flat parts.
    p : float, default 0.1
        Degree of regularity; with 1 and above no faces are merged.
    weights : (n_edges,) array, optional
        One number >= 0 per directed edge of :func:`gpureg.face_graph`. None: the length of the edge that two faces
        share, divided by the mean length.
    merge_tol : float, optional
        Neighbouring faces whose regularized values differ by at most this are merged. None: 0.05; with `values` 0.05 of
        their range.
    norm : {"edge", "vertex"}, default "edge"
        "edge" merges two parts at a time, in small steps; "vertex" merges all strips of a curved part at once.
    solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.
    eps : float, optional
        Smoothing of the gradient norm. None: a fifth of `merge_tol`.

    Returns
    -------
    MeshSegmentation

    Raises
    ------
    TypeError, ValueError
        Not a triangle mesh; fidelities that do not decrease; arguments out of range.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    The graph joins faces that share an edge, and the fidelity of a face is lam times its area over the mean area. For
    small p the energy of :func:`gpureg.regularize` then weighs the length of the borders between parts against the
    deviation of the function from the value of its part. Merged faces are a part; the parts, with their mean values,
    areas and borders, are the input for the next lam.

    Examples
    --------
    >>> import trimesh, gpureg as gr
    >>> box = trimesh.creation.box().subdivide().subdivide()
    >>> found = gr.segment_mesh(box, lam=[1.0, 0.001], backend="numpy")
    >>> found.n_segments
    (6, 1)
    """
    surface, _ = surface_of(mesh, faces).welded()
    if lam is not None and np.ndim(lam) != 1:
        raise ValueError(f"lam must be a list of fidelities, one a level, got {lam!r}")
    steps = _LAMS if lam is None else tuple(number("lam", one, finite=False) for one in lam)
    falls = all(a > b for a, b in itertools.pairwise(steps))
    if not steps or not falls or not (steps[-1] > 0 and np.isfinite(steps[0])):
        raise ValueError(f"lam must be finite, > 0 and fall, one after another, got {list(steps)}")
    if merge_tol is not None:
        number("merge_tol", merge_tol, above=0)
    v, corners = surface.vertices, surface.faces
    graph = face_graph(v, corners)
    areas = np.linalg.norm(face_vectors(v, corners), axis=1)
    if values is None:
        f, apart = face_normals(v, corners), _MET
    else:
        f = checked_values(values, len(corners)).astype(np.float64)
        apart = _MET * float(np.linalg.norm(np.ptp(f, axis=0)))
    apart = apart if merge_tol is None else float(merge_tol)
    # a face of area 0 has no normal and no mass
    mass = areas / areas.mean() if areas.any() else np.ones_like(areas)
    w = _borders(v, corners, graph) if weights is None else np.asarray(weights)
    smoothing = (apart * _EPS / _MET or 1.0) if eps is None else eps
    path = coarser(
        whole(f, graph, w, mass), steps, p=p, merge_tol=apart, norm=norm, eps=smoothing, solver=solver,
        max_iter=max_iter, tol=tol, **options,
    )  # fmt: skip
    found = list(path)
    return MeshSegmentation(tuple(level.labels for level in found), steps, found[-1].results)


def _borders(v: FloatArray, faces: IntArray, graph: Graph) -> FloatArray:
    """Compute the length of the edge that two faces share over the mean length, (n_edges,), on the graph of faces."""
    one, other = faces[graph.edge_rows()], faces[graph.indices]
    shared = (one[:, :, None] == other[:, None, :]).any(axis=2)
    # the two shared vertices come last
    order = np.argsort(shared, axis=1, kind="stable")[:, 1:]
    ends = v[np.take_along_axis(one, order, axis=1)]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    mean = lengths.mean() if len(lengths) else 1.0
    found: FloatArray = lengths / mean if mean > 0 else np.ones_like(lengths)
    return found
