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
    """Denoise points, and say all that there is to say about it: the work of :func:`denoise_points`.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`denoise_points`.
    """
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
            raise ValueError("weights as an array are those of one graph: leave update_neighbours, or give a function")
    pinned = np.zeros(n, bool) if fixed is None else checked_flags("fixed", fixed, n).copy()
    fidelity = None if lam is None else checked_fidelity(lam, n, "point")
    pinned |= np.isinf(0.0 if fidelity is None else fidelity)
    # far from the origin single precision has too few digits for details
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
    """Denoise the points of a cloud, or values at them; called with nothing else it estimates the noise.

    Parameters
    ----------
    points : (n, d) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        Points of a curve in the plane or a surface in space, for filter="normals"; of anything for "positions" and
        values. No two axes are told apart: scale those of different units first.
    values : (n,) or (n, m) array, optional
        A function on the points, such as colours: it is regularized instead of them, and returned.
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
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
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
    return found.cloud.like(found.value) if found.moves else found.value


@door
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


def _chosen(filter: Any, d: int, values: bool) -> PointFilter:
    if filter is None:
        return "normals" if d in (2, 3) else "positions"
    word = choice("filter", filter, POINT_FILTERS)
    if values:
        raise ValueError("filter says how points move; values stay where they are: leave it out")
    if word == "normals" and d not in (2, 3):
        raise ValueError(f'filter="normals" is for points of the plane or of space, got {d} coordinates: "positions"')
    return word
