"""The door for meshes: :func:`denoise_mesh` (section 5.3)."""

from __future__ import annotations

from typing import Any, Literal

import numpy.typing as npt

from .mesh_denoising import Filter, denoised
from .shapes.surface import surface_of
from .solvers import Solver
from .solvers.loop import Callback
from .weights import Weights


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
