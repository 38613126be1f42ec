"""The door for point clouds: :func:`denoise_points`."""

from __future__ import annotations

from typing import Any, Literal

import numpy.typing as npt

from .point_denoising import PointFilter, denoised
from .point_normals import noise_along_normals
from .shapes.cloud import cloud_of
from .solvers import Solver
from .solvers.loop import Callback
from .weights import Weights


def denoise_points(
    points: Any,
    values: npt.ArrayLike | None = None,
    *,
    filter: PointFilter | None = None,
    k: int | None = None,
    update_neighbours: int | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    sigma: float | None = None,
    max_iter: int | None = None,
    fixed: npt.ArrayLike | None = None,
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
    """Denoise the points of a cloud, or values at them; called with nothing else it estimates the noise.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        Points of a curve in the plane or a surface in space, for filter="normals"; of anything for "positions" and
        values. No two axes are told apart: scale those of different units first.
    values : (n,) or (n, m) array, optional
        A function on the points, such as colours: it is regularized in their place, and given back.
    filter : {"normals", "positions"}, optional
        "normals" regularizes the normals of the neighbourhoods and moves the points to fit them: it keeps creases, and
        points do not gather. "positions" regularizes the points themselves. None: "normals" for d of 2 and 3.
    k : int, optional
        Neighbours that each point chooses (:func:`gpureg.knn_graph`). None: 8.
    update_neighbours : int, optional
        Find the neighbours again, of the points where they are by then, every so many iterations of "positions" or of
        the 5 steps that fit points to normals. None: those of the points that came in.
    p : float, optional
        Degree of regularity > 0. None: 1 for normals and values, 2 for positions.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per point; larger stays closer, infinity pins. None: from the noise, see Notes.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of neighbours, or a number for each of its directed edges. None:
        1; for normals 1 in a first round, then exp(-|N(u) - N(v)|^2 / 0.35^2) of the N = n n^T of the round before, in
        two more.
    sigma : float, optional
        Deviation of the noise in the units of the coordinates, along the normals; of `values`, in theirs. None
        estimates it (:func:`estimate_point_noise`; of other than 2 or 3 coordinates as that of values on the graph).
    max_iter : int, optional
        Iterations at most. None: 30 in each round of normals, 100 otherwise.
    fixed : (n,) bool array, optional
        Points that keep their place (or value).
    max_displacement : float, optional
        No point moves further than this. None: 3 sigma for normals, no bound for positions.
    norm, eps, solver, tol, backend, dtype, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    points of the kind that came in, in their order; with `values` an array of their shape

    Raises
    ------
    TypeError, ValueError
        What is no cloud of points, arguments out of their ranges or that do not fit together.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize`; of normals that of N(u) = n(u) n(u)^T, which does not ask for a
    side, with n from the principal components of 9 to 25 points, the more the larger the noise. Where lam is None it
    is for normals 0.5 / a^2, a the median distance of neighbouring N over sqrt(2) or, if less, what sigma explains of
    it; for positions 2^(p - 2) 4 s^(p - 1) / sigma, s the median distance to the nearest point; for values
    1.1 sqrt(degree / m) / sigma at p = 1. Points are fitted to normals by five steps of Lu, Schaefer, Luo, Ma and He
    (IEEE TVCG 28(8), 2022).

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> t = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    >>> circle = np.stack([np.cos(t), np.sin(t)], axis=1)
    >>> noisy = circle + np.random.default_rng(0).normal(0, 0.01, circle.shape)
    >>> clean = gr.denoise_points(noisy, backend="numpy")
    >>> [bool(np.abs(np.hypot(*x.T) - 1).std() < most) for x, most in ((noisy, 0.01), (clean, 0.004))]
    [True, True]
    """
    cloud = cloud_of(points)
    found = denoised(
        cloud.points,
        filter=filter,
        values=values,
        k=k,
        update_neighbours=update_neighbours,
        p=p,
        lam=lam,
        weights=weights,
        sigma=sigma,
        max_iter=max_iter,
        fixed=fixed,
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
    return cloud.like(found.points) if found.values is None else found.values


def estimate_point_noise(points: Any) -> float:
    """Estimate the deviation of the noise of points of a curve or a surface, along the normals, in their units.

    Parameters
    ----------
    points : (n, 2) or (n, 3) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud

    Raises
    ------
    TypeError, ValueError
        What is no cloud of points of the plane or of space.

    Notes
    -----
    The median of what is left of each point's 17 nearest, itself among them, by the parabola or paraboloid that fits
    them best. Measured on four surfaces in space, in units of the distance to the nearest point: 0.11 to 0.13 for 0.1,
    0.26 to 0.29 for 0.25, 0.49 to 0.51 for 0.5, up to 0.05 without noise, where it is the shape that is left.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> plane = np.random.default_rng(0).random((2000, 3)) * [1, 1, 0]
    >>> round(gr.estimate_point_noise(plane + np.random.default_rng(1).normal(0, 0.01, (2000, 3))), 4)
    0.0092
    """
    found = cloud_of(points).points
    if found.shape[1] not in (2, 3):
        raise ValueError(f"normals are those of points of the plane or of space, got {found.shape[1]} coordinates")
    return noise_along_normals(found)
