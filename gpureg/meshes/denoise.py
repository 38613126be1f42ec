"""The door for meshes: :func:`denoise_mesh` (section 5.3)."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_flags, checked_values
from ..checks import number
from ..graphs.of_shapes import mesh_graph
from ..model.result import Result
from ..shapes.surface import Surface, border_vertices, surface_of
from ..solvers import Solver
from ..solvers.loop import Callback
from ..weights import Weights, cotangent
from .filters import FILTERS, TAUBIN, Filter, Task


def denoise_mesh(
    mesh: Any,
    faces: npt.ArrayLike | None = None,
    *,
    filter: Filter = "normals",
    values: npt.ArrayLike | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    weights: Weights | npt.ArrayLike | Literal["cotangent"] | None = None,
    sigma: float | None = None,
    max_iter: int | None = None,
    taubin: bool = False,
    fixed: npt.ArrayLike | None = None,
    fix_border: bool = False,
    max_displacement: float | None = None,
    norm: Literal["vertex", "edge"] = "vertex",
    eps: float | None = None,
    solver: str | Solver = "jacobi",
    tol: float | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> Any:
    """Denoise a triangle mesh; called with nothing else it estimates the noise and keeps creases.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        Or the vertices, (n, 3), with `faces` besides. Vertices on exactly the same point count as one, so that meshes
        which repeat them (STL) do not tear; vertices in no face stay where they are.
    faces : (F, 3) int array, optional
    filter : {"normals", "vertices"}, default "normals"
        "normals" regularizes the unit normals of the faces and moves the vertices to fit them: it keeps creases and
        volume. "vertices" regularizes the positions themselves (figure 6), and rounds creases.
    values : (n,) or (n, m) array, optional
        A function on the vertices, such as colours: it is regularized in the place of the positions, and given back.
    p : float, optional
        Degree of regularity > 0. None: 1 for normals and values, 2 for positions.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per vertex (to a face's normal goes the mean of its corners); larger stays
        closer to the mesh, infinity pins. With "vertices" and 0 it is Laplacian smoothing, which shrinks. None: from
        the noise, see Notes.
    weights : Weights, array or "cotangent", optional
        An object of :mod:`gpureg.weights` on the graph that the filter uses: that of :func:`gpureg.mesh_graph` for
        positions and values, :func:`gpureg.face_graph` across vertices for normals; "cotangent" for
        :func:`gpureg.weights.cotangent` of the faces (not for normals). None: 1; for normals 1 in a first round, then
        exp(-|n(u) - n(v)|^2 / 0.35^2) of the normals of the round before, in two more.
    sigma : float, optional
        Deviation of the noise, along the normals, in the units of the coordinates; of `values`, in theirs. None
        estimates it (:func:`gpureg.estimate_mesh_noise`). Normals go by their own noise, but so that vertices move by
        1.6 times this at most, in the root mean square.
    max_iter : int, optional
        Iterations at most. None: 30 in each round of normals, 100 otherwise, 10 with `taubin`.
    taubin : bool, default False
        With filter="vertices": Taubin's pair instead of the model, steps of 0.5 towards the mean of the neighbours and
        0.53 away from it in turn (`weights` count; p, lam, sigma do not).
    fixed : (n,) bool array, optional
        Vertices that keep their place (or value).
    fix_border : bool, default False
        Whether those on an edge of one face only keep theirs too.
    max_displacement : float, optional
        No vertex moves further than this, in the units of the coordinates.
    norm, eps, solver, tol, backend, dtype, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    mesh of the kind that came in, with the same faces; with `values` an array of their shape

    Raises
    ------
    TypeError, ValueError
        What is no mesh of triangles, arguments out of their ranges or that do not fit together.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize`. Where lam is None it is, with s the noise over the mean length of
    the edges: for positions edge^(p - 2) 2^(p - 3) / s, that is 0.5/s at p = 2; for values 1.1 sqrt(degree / m) / sigma
    at p = 1, of the mean degree and m channels; for normals 0.5 / d^2, d the median distance of a normal from the mean
    of those across its edges. The vertices are fitted to normals by ten steps of Sun, Rosin, Martin and Langbein (IEEE
    TVCG 13(5), 2007). Where these then move by more than 1.6 times the noise in the root mean square, it was not
    what it seemed, as with few or long and thin triangles: lam is taken four times as large, until they do not.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> x, y = (axis.ravel() for axis in np.mgrid[:9, :9])
    >>> corner = np.arange(81).reshape(9, 9)[:-1, :-1].ravel()
    >>> faces = np.concatenate([np.stack([corner, corner + 9, corner + 1], 1),
    ...                         np.stack([corner + 1, corner + 9, corner + 10], 1)])
    >>> noisy = np.stack([x, y, np.random.default_rng(0).normal(0, 0.2, 81)], axis=1)
    >>> clean, _ = gr.denoise_mesh((noisy, faces), backend="numpy")
    >>> bool(clean[:, 2].std() < 0.4 * noisy[:, 2].std())
    True
    """
    surface = surface_of(mesh, faces)
    found = denoised(
        surface,
        filter=filter,
        values=values,
        p=p,
        lam=lam,
        weights=weights,
        sigma=sigma,
        max_iter=max_iter,
        taubin=taubin,
        fixed=fixed,
        fix_border=fix_border,
        max_displacement=max_displacement,
        norm=norm,
        eps=eps,
        solver=solver,
        tol=tol,
        backend=backend,
        dtype=dtype,
        callback=callback,
        progress=progress,
    )
    return surface.like(found.vertices) if found.values is None else found.values


@dataclass(frozen=True, eq=False)
class MeshDenoising:
    """What :func:`denoised` did.

    Attributes
    ----------
    vertices : (n, 3) float array
        Where the vertices are now.
    values : (n,) or (n, m) float array or None
        The regularized attributes, where there were such; the vertices are then as they were.
    filter : str
        "normals", "vertices", "Taubin" or "values".
    sigma : float
        Deviation of the noise, in the units of the coordinates (or of the values): given, or estimated.
    estimated : bool
    p : float
    lam : float or array
        The fidelity used; one per vertex if so asked for, and then for "normals" one per face.
    results : list of Result
        The runs of the model, in their order: rounds of normals, or one.
    displacement : (n,) float array
        How far each vertex has moved.
    edge : float
        Mean length of the edges before.
    seconds : float
    """

    vertices: FloatArray
    values: npt.NDArray[Any] | None
    filter: str
    sigma: float
    estimated: bool
    p: float
    lam: float | FloatArray
    results: list[Result]
    displacement: FloatArray
    edge: float
    seconds: float

    @property
    def iterations(self) -> int:
        """Iterations of all runs together."""
        return sum(result.iterations for result in self.results)

    def describe(self) -> str:
        """The filter and its parameters, in a line."""
        if self.filter == "Taubin":
            return f"Taubin's pair of steps, {TAUBIN[0]} and {TAUBIN[1]}, {self.iterations} steps"
        what = {
            "normals": "normals of the faces, vertices moved to fit them",
            "vertices": "positions of the vertices",
            "values": "values at the vertices",
        }[self.filter]
        lam = f"{self.lam:.4g}" if isinstance(self.lam, float) else "a map"
        runs = len(self.results)
        if not runs:
            return f"{what}: there is no noise to remove"
        each = f"{runs} rounds of {self.results[0].iterations}" if runs > 1 else str(self.results[0].iterations)
        return f"{what}; p = {self.p:g}, lam = {lam}, {each} iterations"


def denoised(
    surface: Surface,
    *,
    filter: Filter = "normals",
    values: Any = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    weights: Weights | npt.ArrayLike | Literal["cotangent"] | None = None,
    sigma: float | None = None,
    max_iter: int | None = None,
    taubin: bool = False,
    fixed: npt.ArrayLike | None = None,
    fix_border: bool = False,
    max_displacement: float | None = None,
    **model: Any,
) -> MeshDenoising:
    """:func:`gpureg.denoise_mesh` of a surface; `model` is what else :func:`gpureg.regularize` is told.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.denoise_mesh`.
    """
    begin = time.perf_counter()
    _check(filter, taubin, values, p, lam, sigma, max_displacement)
    if isinstance(weights, str) and (weights != "cotangent" or (values is None and filter == "normals")):
        allowed = 'an object of gpureg.weights, an array, or "cotangent" for positions and values'
        raise ValueError(f"weights must be {allowed}, got {weights!r}")
    n = len(surface.vertices)
    whole, which = surface.welded()
    k = len(whole.vertices)
    pinned = np.zeros(k, bool)
    if fixed is not None:
        pinned[which[checked_flags("fixed", fixed, n)]] = True
    if fix_border:
        pinned |= border_vertices(whole.faces, k)
    fidelity = None if lam is None else _fidelity(lam, which, k)
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    # far from the origin single precision has too few digits for details
    positions = whole.vertices - whole.vertices.mean(axis=0)
    given = None if values is None else checked_values(values, n)
    task = Task(
        whole.faces,
        mesh_graph(positions, whole.faces),
        positions if given is None else _means(given, which, k),
        pinned,
        fidelity,
        sigma,
        p,
        {"weights": cotangent(whole.faces) if isinstance(weights, str) else weights} | model,
        max_iter,
    )
    found = task.values() if values is not None else task.taubin() if taubin else task.filtered(filter)
    # what is alone comes back as it was, to the bit
    still = pinned | (np.diff(task.graph.indptr) == 0)
    moves = np.where(still[:, None], 0.0, found.f - task.f0)
    if given is not None:
        kept = (given + moves[which]).astype(given.dtype).reshape(np.shape(values))
        return MeshDenoising(surface.vertices, kept, *found[1:], np.zeros(n), task.edge, time.perf_counter() - begin)
    distance = np.linalg.norm(moves, axis=1)
    if max_displacement is not None:
        moves *= np.minimum(1, max_displacement / np.maximum(distance, np.finfo(float).tiny))[:, None]
        distance = np.minimum(distance, max_displacement)
    vertices = (whole.vertices + moves)[which]
    return MeshDenoising(vertices, None, *found[1:], distance[which], task.edge, time.perf_counter() - begin)


def _check(
    filter: str,
    taubin: bool,
    values: Any,
    p: Any,
    lam: Any,
    sigma: Any,
    max_displacement: Any,
) -> None:
    if filter not in FILTERS:
        raise ValueError(f'filter must be "normals" or "vertices", got {filter!r}')
    if taubin and (filter != "vertices" or values is not None):
        raise ValueError('taubin=True moves positions: it needs filter="vertices", and no values')
    if taubin and not (p is None and lam is None and sigma is None):
        raise ValueError("Taubin's pair knows no p, lam or sigma: leave them out, or taubin")
    if values is not None and max_displacement is not None:
        raise ValueError("max_displacement bounds how far vertices move; values stay where they are")
    if sigma is not None:
        number("sigma", sigma, low=0)
    if max_displacement is not None:
        number("max_displacement", max_displacement, low=0)


def _fidelity(lam: Any, which: IntArray, k: int) -> float | FloatArray:
    """A number, or one per vertex; copies of a vertex have one."""
    if np.ndim(lam) == 0:
        return float(lam)
    values = np.asarray(lam, dtype=np.float64)
    if values.shape != which.shape:
        raise ValueError(f"lam must be a number or one per vertex, {which.shape}, got {values.shape}")
    return values if k == len(which) else _means(values[:, None], which, k)[:, 0]


def _means(f: FloatArray, which: IntArray, k: int) -> FloatArray:
    """Means over the copies of each vertex, (k, m)."""
    sums = np.stack([np.bincount(which, weights=x, minlength=k) for x in f.T.astype(np.float64)], axis=1)
    means: FloatArray = sums / np.bincount(which, minlength=k)[:, None]
    return means
