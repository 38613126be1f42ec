"""Denoise point clouds: :func:`denoise_points`."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_flags, checked_values
from ..checks import choice, integer
from ..doors import door, part_of
from ..regularization.denoised import check_numbers, checked_fidelity, limited
from ..regularization.options import MODEL, Model
from ..shapes.cloud import cloud_of
from ..weights import Weights
from .filters import MOST_MOVED, NEIGHBOURS, POINT_FILTERS, PointDenoising, PointFilter, Task
from .normals import noise_along_normals


def denoised(
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
    **options: Unpack[Model],
) -> PointDenoising:
    """Denoise points and return a full report; the parameters and errors are those of :func:`denoise_points`."""
    begin = time.perf_counter()
    cloud = cloud_of(points)
    x = cloud.points
    n, d = x.shape
    chosen = _chosen(filter, d, values is not None)
    check_numbers(options, p=p, sigma=sigma, max_iter=max_iter, max_displacement=max_displacement)
    if k is not None:
        integer("k", k, low=1)
    if values is not None and (max_displacement is not None or update_neighbours is not None):
        raise ValueError("max_displacement and update_neighbours are for points that move; values stay where they are")
    if update_neighbours is not None:
        integer("update_neighbours", update_neighbours, low=1)
        if isinstance(weights, np.ndarray | list):
            raise ValueError("weights as an array are for one graph: leave out update_neighbours, or give a function")
    pinned = np.zeros(n, bool) if fixed is None else checked_flags("fixed", fixed, n).copy()
    fidelity = None if lam is None else checked_fidelity(lam, n, "point")
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    # float32 has too few digits for details far from the origin
    task = Task(
        cloud,
        x - x.mean(axis=0),
        pinned,
        NEIGHBOURS if k is None else k,
        update_neighbours,
        fidelity,
        sigma,
        p,
        weights,
        max_iter,
        options,
    )
    given = None if values is None else checked_values(values, n)
    found = task.of_values(given) if given is not None else task.moved(chosen)
    f0 = task.points if given is None else given
    moves = np.where(pinned[:, None], 0.0, found.value - f0)
    value: npt.NDArray[Any]
    if given is not None and values is not None:
        value = (given + moves).astype(given.dtype).reshape(np.shape(values))
        distance: FloatArray = np.zeros(n)
    else:
        most = max_displacement
        if most is None and found.filter == "normals":
            most = MOST_MOVED * found.sigma
        moves, distance = limited(moves, most)
        value = x + moves
    return replace(found, value=value, displacement=distance, seconds=time.perf_counter() - begin)


@door(options=MODEL)
@part_of(denoised)
def denoise_points(found: PointDenoising) -> Any:
    """Denoise the points of a cloud, or values at them; without parameters it estimates the noise.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        Points of a curve in the plane or a surface in space for filter="normals"; any points for "positions" and
        values. All axes count alike: scale axes with different units first.
    values : (n,) or (n, m) array, optional
        A function on the points, such as colours, to regularize and return instead of the points.
    filter : {"normals", "positions"}, optional
        "normals" regularizes the normals of the neighbourhoods and moves the points to fit them: it preserves creases,
        and points do not gather. "positions" regularizes the points. None: "normals" if d is 2 or 3, else "positions".
    k : int, optional
        Neighbours that each point chooses (:func:`gpureg.knn_graph`). None: 8.
    update_neighbours : int, optional
        Search the neighbours of the moved points again each time after this number of iterations of "positions", or of
        the 5 steps that fit points to normals. None: the neighbours of the input.
    p : float, optional
        Degree of regularity > 0. None: 1 for normals and values, 2 for positions.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per point. Larger values stay closer to the data; infinity pins. None: computed
        from the noise, see Notes.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of neighbours, or one value per directed edge. None: 1; for
        normals 1 in the first round, then exp(-|N(u) - N(v)|^2 / 0.35^2) with N = n n^T of the previous round in two
        more rounds.
    sigma : float, optional
        Standard deviation of the noise: along the normals, in the units of the coordinates; with `values`, in their
        units. None: estimated (:func:`estimate_point_noise`; if d is not 2 or 3, like that of values on the graph).
    max_iter : int, optional
        Maximal number of iterations. None: 30 in each round of normals, 100 otherwise.
    fixed : (n,) bool array, optional
        Points whose position (or value) does not change.
    max_displacement : float, optional
        Maximal displacement of a point. None: 3 sigma for normals, no bound for positions.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    points of the type of the input, in their order; with `values` an array of their shape

    Raises
    ------
    TypeError, ValueError
        Not a point cloud; arguments out of range or in conflict.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize`. For normals the function is N(u) = n(u) n(u)^T, which needs no
    orientation; n comes from the principal components of 9 to 25 points, more for larger noise. The default lam is
    0.5 / a^2 for normals, with a the median distance of neighbouring N over sqrt(2), or the part of it that sigma
    explains, if that is less; 2^(p - 2) 4 s^(p - 1) / sigma for positions, with s the median distance to the nearest
    point; 1.1 sqrt(degree / m) / sigma for values at p = 1. Points are fitted to normals by five steps of Lu, Schaefer,
    Luo, Ma and He (IEEE TVCG 28(8), 2022).

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
    return found.cloud.like(found.value) if found.moves else found.value


@door
def estimate_point_noise(points: Any) -> float:
    """Estimate the standard deviation of the noise of points of a curve or a surface, along the normals.

    Parameters
    ----------
    points : (n, 2) or (n, 3) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud

    Raises
    ------
    TypeError, ValueError
        Not a point cloud in the plane or in space.

    Notes
    -----
    The median residual of the parabola or paraboloid that fits each point and its 16 nearest neighbours best. Measured
    on four surfaces in space, in units of the distance to the nearest point: 0.11 to 0.13 for 0.1, 0.26 to 0.29 for
    0.25, 0.49 to 0.51 for 0.5, and up to 0.05 without noise, where the residual comes from the shape.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> plane = np.random.default_rng(0).random((2000, 3)) * [1, 1, 0]
    >>> round(gr.estimate_point_noise(plane + np.random.default_rng(1).normal(0, 0.01, (2000, 3))), 4)
    0.0092
    """
    found = cloud_of(points).points
    if found.shape[1] not in (2, 3):
        raise ValueError(f"normals need points in the plane or in space, got {found.shape[1]} coordinates")
    return noise_along_normals(found)


def _chosen(filter: Any, d: int, values: bool) -> PointFilter:
    if filter is None:
        return "normals" if d in (2, 3) else "positions"
    word = choice("filter", filter, POINT_FILTERS)
    if values:
        raise ValueError("filter is for points that move; values stay where they are: leave it out")
    if word == "normals" and d not in (2, 3):
        raise ValueError(f'filter="normals" is for 2 or 3 coordinates, got {d} coordinates: use "positions"')
    return word
