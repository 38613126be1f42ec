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
from ..graphs.components import Components
from ..graphs.of_shapes import mesh_graph
from ..regularization.denoised import check_numbers, checked_fidelity, limited
from ..regularization.options import MODEL, Model
from ..shapes.orientation import used_faces
from ..shapes.surface import border_vertices, surface_of
from ..weights import Weights, cotangent
from .filters import FILTERS, Filter, Task
from .report import MeshDenoising


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
    """Denoise a mesh and return a full report; the parameters and errors are those of :func:`denoise_mesh`."""
    begin = time.perf_counter()
    surface = surface_of(mesh, faces)
    check_filter(filter)
    if flag("taubin", taubin):
        _check_taubin(filter, values, p, lam, sigma)
    if values is not None and max_displacement is not None:
        raise ValueError("max_displacement is for vertices that move; values stay where they are")
    check_numbers(options, p=p, sigma=sigma, max_iter=max_iter, max_displacement=max_displacement)
    if isinstance(weights, str) and (weights != "cotangent" or (values is None and filter == "normals")):
        allowed = 'an object of gpureg.weights, an array, or "cotangent" for positions and values'
        raise ValueError(f"weights must be {allowed}, got {weights!r}")
    n = len(surface.vertices)
    whole, which = surface.welded()
    k = len(whole.vertices)
    # triangles without an area join nothing and have no normal
    faces_used = used_faces(whole.vertices, whole.faces, ": they count turned round, and stay as they are")
    pinned = np.zeros(k, bool)
    if fixed is not None:
        pinned[which[checked_flags("fixed", fixed, n)]] = True
    if flag("fix_border", fix_border):
        pinned |= border_vertices(faces_used, k)
    fidelity = None if lam is None else checked_fidelity(lam, n)
    if isinstance(fidelity, np.ndarray) and k < n:
        fidelity = _means(fidelity[:, None], which, k)[:, 0]
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    graph = mesh_graph(whole.vertices, faces_used)
    parts = Components.of(graph)
    # float32 has too few digits for details far from the origin
    positions = parts.centred(whole.vertices)
    given = None if values is None else checked_values(values, n)
    task = Task(
        surface,
        faces_used,
        replace(graph, positions=positions),
        parts,
        positions if given is None else _means(given, which, k),
        pinned,
        fidelity,
        sigma,
        p,
        cotangent(faces_used) if isinstance(weights, str) else weights,
        max_iter,
        options,
    )
    found = task.values() if values is not None else task.taubin() if taubin else task.filtered(filter)
    # vertices that are pinned or without neighbours are returned unchanged, bit for bit
    alone = np.diff(task.graph.indptr) == 0
    moves = np.where((pinned | alone)[:, None], 0.0, found.value - task.f0)
    left = int((~(pinned | alone) & ~moves.any(axis=1))[which].sum())
    value: npt.NDArray[Any]
    if given is not None and values is not None:
        value = (given + moves[which]).astype(given.dtype).reshape(np.shape(values))
        distance: FloatArray = np.zeros(n)
    else:
        moves, far = limited(moves, max_displacement)
        value, distance = surface.vertices + moves[which], far[which]
    noise = found.noise[which] if found.noise.size else found.noise
    return replace(
        found, value=value, displacement=distance, noise=noise, left=left, seconds=time.perf_counter() - begin
    )


@door(options=MODEL)
@part_of(denoised)
def denoise_mesh(found: MeshDenoising) -> Any:
    """Denoise a triangle mesh; without parameters it estimates the noise and preserves creases.

    Parameters
    ----------
    mesh : (vertices, faces), trimesh.Trimesh, pyvista.PolyData or open3d.geometry.TriangleMesh
        A mesh, or only its vertices, (n, 3), with `faces` as the second argument. Vertices at the same point, up to
        1e-5 of the edges around, count as one, so that meshes that repeat them (STL) do not tear; vertices without a
        face do not move. Faces without an area and repeated faces count for nothing.
    faces : (F, 3) int array, optional
    filter : {"normals", "positions"}, default "normals"
        "normals" regularizes the unit normals of the faces and moves the vertices to fit them: it preserves creases
        and volume. "positions" regularizes the positions of the vertices (figure 6) and rounds creases.
    values : (n,) or (n, m) array, optional
        A function on the vertices, such as colours, to regularize and return instead of the positions.
    p : float, optional
        Degree of regularity > 0. None: 1 for values, 2 for positions; for normals the rounds of the notes, if none of
        `p`, `lam`, `weights`, `max_iter`, `norm`, `eps`, `solver` and `tol` is given, otherwise 1.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per vertex (a face's normal gets the mean of its vertices). Larger values stay
        closer to the data; infinity pins. With "positions", 0 is Laplacian smoothing, which shrinks the mesh. None:
        computed from the noise, see Notes.
    weights : Weights, array or "cotangent", optional
        An object of :mod:`gpureg.weights`, or one value per directed edge, on :func:`gpureg.mesh_graph` for positions
        and values, or on :func:`gpureg.face_graph` across vertices for normals; "cotangent" for
        :func:`gpureg.weights.cotangent` of the faces (not for normals). None: 1; for normals with a given model 1 in
        the first round, then exp(-|n(u) - n(v)|^2 / 0.35^2) with the normals of the previous round in two more rounds.
    sigma : float, optional
        Standard deviation of the noise: along the normals, in the units of the coordinates; with `values`, in their
        units. None: estimated around each vertex (:func:`gpureg.estimate_mesh_noise`). With normals it limits the root
        mean square displacement of the vertices of a component to 1.6 sigma; without it the rounds need no noise,
        except where their first one already removes shape.
    max_iter : int, optional
        Maximal number of iterations. None: 30 in each round of normals with a given model, 100 for positions and
        values, 10 with `taubin`.
    taubin : bool, default False
        With filter="positions": use Taubin smoothing instead of the model, alternating steps of 0.5 towards the mean of
        the neighbours and 0.53 away from it (with `weights`, but without p, lam and sigma).
    fixed : (n,) bool array, optional
        Vertices whose position (or value) does not change.
    fix_border : bool, default False
        Whether to fix the vertices on the border too, the edges with only one face.
    max_displacement : float, optional
        Maximal displacement of a vertex, in the units of the coordinates.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    mesh of the type of the input, with the same faces; with `values` an array of their shape

    Raises
    ------
    TypeError, ValueError
        Not a triangle mesh; arguments out of range or in conflict.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        The noise of a component cannot be told: nothing moves there. Faces are turned against their neighbours: they
        count as if they were turned round.

    Notes
    -----
    Each connected component is treated as if it were alone, and noise is measured around each vertex.

    Positions and values minimise the energy of :func:`gpureg.regularize`. With s the noise around a vertex divided by
    the mean edge length of its component, the default lam there is edge^(p - 2) 2^(p - 3) / s for positions, that is
    0.5/s at p = 2, and 1.1 sqrt(degree / m) / sigma for values at p = 1, with the mean degree and m channels. Single
    vertices or values far from all of their neighbours begin at the mean or median of these, and have lam = 0.
    Channels of values whose noise differs by more than a factor of two are regularized apart.

    Normals are regularized in up to 20 rounds, each from the current mesh: two sweeps of the model on the graph of
    faces across vertices, at p = 2 and lam = 0, with weights (a(u) a(v))^(1/3) exp(-|g(u) - g(v)|^2 / s^2) of the
    areas a and the guide g, the mean normal of the faces that share a vertex; one more sweep with the result as the
    guide; then ten
    steps that fit the vertices to the normals (Sun, Rosin, Martin and Langbein, IEEE TVCG 13(5), 2007). The scale is
    s^2 = 0.15^2 + min(0.4, 1.5 m)^2, with the median m of |g(u) - g(v)| in the component. The rounds end when what they
    have removed is no longer white: when the correlation of the heights of neighbouring vertices is above -0.03 in the
    component (without its last round), or above 0.1 around a vertex. Where this happens in the first round, vertices
    move by a part of it, 0.85 sigma and at most a tenth of their shortest edge.

    With a given p, lam, weights or max_iter, normals minimise the energy on that graph; the default lam is 0.5 / d^2,
    with d the median distance of a normal from the mean of its neighbours across edges in the component, and is
    multiplied by four until the vertices move by at most 1.6 times the noise.

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
    """Raise ValueError unless this is a filter of meshes; for the name of earlier versions, give the new one."""
    if filter == "vertices":
        raise ValueError('filter="vertices" is called filter="positions" now')
    choice("filter", filter, FILTERS)


def _check_taubin(filter: str, values: Any, p: Any, lam: Any, sigma: Any) -> None:
    if filter != "positions" or values is not None:
        raise ValueError('taubin=True moves positions: it needs filter="positions", and no values')
    if not (p is None and lam is None and sigma is None):
        raise ValueError("Taubin smoothing has no p, lam or sigma: leave them out, or leave taubin out")


def _means(f: FloatArray, which: IntArray, k: int) -> FloatArray:
    """Average a function (n, m) over the copies of each vertex, (k, m); `which`, (n,), numbers the vertices."""
    sums = np.stack([np.bincount(which, weights=x, minlength=k) for x in f.T.astype(np.float64)], axis=1)
    means: FloatArray = sums / np.bincount(which, minlength=k)[:, None]
    return means
