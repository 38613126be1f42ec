"""Denoise meshes: :func:`denoise_mesh` (section 5.3)."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_flags, checked_values
from ..checks import choice, flag
from ..doors import door, part_of
from ..graphs.of_shapes import mesh_graph
from ..regularization.denoised import check_numbers, checked_fidelity, limited
from ..regularization.options import MODEL, Model
from ..shapes.surface import border_vertices, surface_of
from ..weights import Weights, cotangent
from .filters import FILTERS, Filter, MeshDenoising, Task


def denoised(
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
    **options: Unpack[Model],
) -> MeshDenoising:
    """Denoise a mesh, and say all that there is to say about it: the work of :func:`denoise_mesh`.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`denoise_mesh`.
    """
    begin = time.perf_counter()
    surface = surface_of(mesh, faces)
    check_filter(filter)
    if flag("taubin", taubin):
        _check_taubin(filter, values, p, lam, sigma)
    if values is not None and max_displacement is not None:
        raise ValueError("max_displacement bounds how far vertices move; values stay where they are")
    check_numbers(options, p=p, sigma=sigma, max_iter=max_iter, max_displacement=max_displacement)
    if isinstance(weights, str) and (weights != "cotangent" or (values is None and filter == "normals")):
        allowed = 'an object of gpureg.weights, an array, or "cotangent" for positions and values'
        raise ValueError(f"weights must be {allowed}, got {weights!r}")
    n = len(surface.vertices)
    whole, which = surface.welded()
    k = len(whole.vertices)
    pinned = np.zeros(k, bool)
    if fixed is not None:
        pinned[which[checked_flags("fixed", fixed, n)]] = True
    if flag("fix_border", fix_border):
        pinned |= border_vertices(whole.faces, k)
    fidelity = None if lam is None else checked_fidelity(lam, n)
    if isinstance(fidelity, np.ndarray) and k < n:
        fidelity = _means(fidelity[:, None], which, k)[:, 0]
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    # far from the origin single precision has too few digits for details
    positions = whole.vertices - whole.vertices.mean(axis=0)
    given = None if values is None else checked_values(values, n)
    task = Task(
        surface,
        whole.faces,
        mesh_graph(positions, whole.faces),
        positions if given is None else _means(given, which, k),
        pinned,
        fidelity,
        sigma,
        p,
        cotangent(whole.faces) if isinstance(weights, str) else weights,
        max_iter,
        options,
    )
    found = task.values() if values is not None else task.taubin() if taubin else task.filtered(filter)
    # what is alone comes back as it was, to the bit
    still = pinned | (np.diff(task.graph.indptr) == 0)
    moves = np.where(still[:, None], 0.0, found.value - task.f0)
    value: npt.NDArray[Any]
    if given is not None and values is not None:
        value = (given + moves[which]).astype(given.dtype).reshape(np.shape(values))
        distance: FloatArray = np.zeros(n)
    else:
        moves, far = limited(moves, max_displacement)
        value, distance = (whole.vertices + moves)[which], far[which]
    return replace(found, value=value, displacement=distance, seconds=time.perf_counter() - begin)


@door(options=MODEL)
@part_of(denoised)
def denoise_mesh(found: MeshDenoising) -> Any:
    """Denoise a triangle mesh; called with nothing else it estimates the noise and keeps creases.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        Or the vertices, (n, 3), and `faces` too. Vertices on exactly the same point count as one, so that meshes
        which repeat them (STL) do not tear; vertices in no face stay where they are.
    faces : (F, 3) int array, optional
    filter : {"normals", "positions"}, default "normals"
        "normals" regularizes the unit normals of the faces and moves the vertices to fit them: it keeps creases and
        volume. "positions" regularizes the vertices themselves (figure 6), and rounds creases.
    values : (n,) or (n, m) array, optional
        A function on the vertices, such as colours: it is regularized instead of the positions, and returned.
    p : float, optional
        Degree of regularity > 0. None: 1 for normals and values, 2 for positions.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per vertex (to a face's normal goes the mean of its corners); larger stays
        closer to the mesh, infinity pins. With "positions" and 0 it is Laplacian smoothing, which shrinks. None: from
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
        With filter="positions": Taubin's pair instead of the model, steps of 0.5 towards the mean of the neighbours and
        0.53 away from it in turn (`weights` count; p, lam, sigma do not).
    fixed : (n,) bool array, optional
        Vertices that keep their place (or value).
    fix_border : bool, default False
        Whether those on an edge of one face only keep theirs too.
    max_displacement : float, optional
        No vertex moves further than this, in the units of the coordinates.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
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
    return found.surface.like(found.value) if found.moves else found.value


def check_filter(filter: str) -> None:
    """Raise ValueError unless this is a filter of meshes; for the word of earlier versions, name the new one."""
    if filter == "vertices":
        raise ValueError('filter="vertices" is called filter="positions" now')
    choice("filter", filter, FILTERS)


def _check_taubin(filter: str, values: Any, p: Any, lam: Any, sigma: Any) -> None:
    if filter != "positions" or values is not None:
        raise ValueError('taubin=True moves positions: it needs filter="positions", and no values')
    if not (p is None and lam is None and sigma is None):
        raise ValueError("Taubin's pair knows no p, lam or sigma: leave them out, or taubin")


def _means(f: FloatArray, which: IntArray, k: int) -> FloatArray:
    """Average a function (n, m) over the copies of each vertex, (k, m)."""
    sums = np.stack([np.bincount(which, weights=x, minlength=k) for x in f.T.astype(np.float64)], axis=1)
    means: FloatArray = sums / np.bincount(which, minlength=k)[:, None]
    return means
