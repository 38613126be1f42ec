"""Denoise point clouds: :func:`denoise_points`."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_flags, checked_values
from ..checks import choice, integer
from ..doors import door, outside, part_of
from ..regularization.denoised import check_numbers, checked_fidelity, limited
from ..regularization.options import MODEL, Model
from ..shapes.cloud import cloud_of
from ..weights import Weights
from .filters import MOST_MOVED, NEIGHBOURS, POINT_FILTERS, PointFilter, Task
from .merging import merged, unmerged
from .outliers import outliers
from .renewed import renewed_normals
from .report import PointDenoising


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
    named: dict[str, Any] = {"k": k, "update_neighbours": update_neighbours, "p": p, "lam": lam, "weights": weights}
    named |= {"sigma": sigma, "max_iter": max_iter}
    named |= {name: options.get(name) for name in ("norm", "eps", "solver", "tol")}
    chosen = _chosen(filter, d, values is not None, named)
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
    # an array of weights belongs to the graph of all points
    copies = unmerged(x) if isinstance(weights, np.ndarray | list) else merged(x)
    apart = np.zeros(len(copies.points), bool)
    if values is None and d in (2, 3) and not isinstance(weights, np.ndarray | list):
        apart = outliers(copies.points, surface=chosen != "positions")
    part = copies.points[~apart]
    # float32 has too few digits for details far from the origin
    task = Task(
        cloud,
        part - part.mean(axis=0),
        copies.spacing,
        copies.any(pinned)[~apart],
        NEIGHBOURS if k is None else k,
        update_neighbours,
        copies.mean(fidelity)[~apart] if isinstance(fidelity, np.ndarray) else fidelity,
        sigma,
        p,
        weights,
        max_iter,
        options,
    )
    given = None if values is None else checked_values(values, n)
    if given is not None and values is not None:
        found = task.of_values(copies.mean(given))
        # copies differ in their noise
        after = np.where(pinned[:, None] | (not found.results), given, found.value[copies.owner])
        value: npt.NDArray[Any] = after.astype(given.dtype).reshape(np.shape(values))
        distance: FloatArray = np.zeros(n)
    else:
        found = task.moved(chosen)
        most: float | FloatArray | None = max_displacement
        if most is None and found.filter == "normals":
            most = MOST_MOVED * (found.sigma if found.levels is None else np.nan_to_num(found.levels))
        moves, distance = limited(np.where(task.pinned[:, None], 0.0, found.value - task.points), most)
        moves, distance = (_spread(array, apart)[copies.owner] for array in (moves, distance))
        moves[pinned] = 0
        value = x + moves
    bad = apart[copies.owner]
    levels, normals = (
        None if array is None else _spread(array, apart, fill)[copies.owner]
        for array, fill in ((found.levels, np.nan), (found.normals, 0.0))
    )
    return replace(
        found, value=value, displacement=distance, outliers=bad, repeated=copies.repeated,
        levels=levels, normals=normals,
        seconds=time.perf_counter() - begin,
    )  # fmt: skip


def _spread(array: FloatArray, apart: npt.NDArray[np.bool_], fill: float = 0.0) -> FloatArray:
    """Return an array with a row for each point, from one with the rows of those that are not apart."""
    found = np.full((len(apart), *array.shape[1:]), fill)
    found[~apart] = array
    return found


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
    filter : {"surface", "normals", "positions"}, optional
        "surface", for points in space, moves them along averaged normals to quadrics; it has no parameters. "normals"
        regularizes the normals of the neighbourhoods and moves the points to fit them. Both preserve creases, and
        points do not gather. "positions" regularizes the points. None: "surface" if d is 3 and none of k, p, lam,
        weights, sigma, max_iter, update_neighbours, norm, eps, solver and tol is given, "normals" if d is 2 or 3, else
        "positions".
    k : int, optional
        Neighbours that each point chooses (:func:`gpureg.knn_graph`). None: 8.
    update_neighbours : int, optional
        Search the neighbours of the moved points again each time after this number of iterations of "positions", or of
        the 5 steps that fit points to normals. None: the neighbours of the input.
    p : float, optional
        Degree of regularity > 0. None: 1 for normals and values, 2 for positions.
    lam : float or (n,) array, optional
        Fidelity >= 0, a number or one per point. Larger values stay closer to the data; infinity pins. None: computed
        from the noise around each point, see Notes.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights` on the graph of neighbours, or one value per directed edge of the graph of
        all points, which are then not merged. None: 1; for normals 1 in the first round, then
        exp(-|N(u) - N(v)|^2 / 0.35^2) with N = n n^T of the previous round in two more rounds.
    sigma : float, optional
        Standard deviation of the noise: along the normals, in the units of the coordinates; with `values`, in their
        units. None: estimated around each point (:func:`estimate_point_noise`; if d is not 2 or 3, like that of values
        on the graph).
    max_iter : int, optional
        Maximal number of iterations. None: 30 in each round of normals, 100 otherwise.
    fixed : (n,) bool array, optional
        Points whose position (or value) does not change.
    max_displacement : float, optional
        Maximal displacement of a point. None: for normals 3 times the noise around the point, otherwise no bound.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    points of the type of the input, in their order; with `values` an array of their shape
        Normals of a cloud are computed again for the moved points, on the side of the old ones; colours and other data
        stay as they are.

    Raises
    ------
    TypeError, ValueError
        Not a point cloud; arguments out of range or in conflict.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        Points are outliers, or their noise cannot be told (on a surface: they lie in groups of fewer than 19 points).
        They stay where they are. Or the normals or covariances of a cloud are left out.

    Notes
    -----
    Points that are equal up to 1e-6 of the spacing are merged first, and move as one. If d is 2 or 3, outliers take no
    part and stay where they are. Such are points whose mean distance to 8 neighbours is more than 3 times (in the
    plane 5 times) the median around them, and, but for "positions", points whose height over a robust quadric through
    their 18 nearest others is more than 6 times the deviation of such heights there, and more than half of that
    distance (in the plane all of it).

    "surface": the projectors n n^T of normals of planes through 19 points are averaged twice over 8 neighbours, by the
    energy of :func:`gpureg.regularize` with p = 2 and bilateral weights on a guide. Each point moves along its normal
    to the quadric through its 8, 18, 40, 80 or 160 nearest neighbours, whose weights fall with the difference of
    normals; the neighbours come from a first round of such fits. A point takes the largest scale up to which the
    heights that would be removed around it are white: where they are not, they are shape. Where even the finest are
    not, it moves less. No estimate of the noise is needed, and bodies and parts with other noise do not matter. It
    takes fixed, max_displacement and the options of a run.

    The other filters minimise the energy of :func:`gpureg.regularize`. For normals the function is N(u) = n(u) n(u)^T,
    which needs no orientation; n comes from the principal components of 9 to 25 points, more for larger noise. The
    default lam is 0.5 / a^2 for normals, with a the median distance of neighbouring N around a point over sqrt(2), or
    the part of it that the noise explains, if that is less; 2^(p - 2) 4 s^(p - 1) / sigma for positions, with s the
    median distance to the nearest point; 1.1 sqrt(degree / m) / sigma for values at p = 1. Here sigma is the noise
    around the point, if it was not given as a number. Values far beyond those of all neighbours but one begin at the
    median of these and have lam = 0, and channels whose noise differs by more than a factor of two are regularized
    apart. Points are fitted to normals by five steps of Lu, Schaefer, Luo, Ma and He (IEEE TVCG 28(8), 2022).

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
    for sentence in found.warnings():
        warnings.warn(sentence, UserWarning, stacklevel=outside())
    if not found.moves:
        return found.value
    cloud = found.cloud
    normals = None if cloud.normals is None else renewed_normals(found, cloud.normals)
    lost = [*cloud.lost, *(["the normals"] if normals is None and cloud.normals is not None else [])]
    if lost:
        warnings.warn(f"{' and '.join(lost)} are left out: the points moved", UserWarning, stacklevel=outside())
    return cloud.like(found.value, normals)


def _chosen(filter: Any, d: int, values: bool, options: Mapping[str, Any]) -> PointFilter:
    """Return the filter; `options` are those that the filter "surface" does not have."""
    told = [name for name, value in options.items() if value is not None and f"{name}={value}" not in _DEFAULTS]
    if filter is None:
        return ("normals" if told else "surface") if d == 3 else "normals" if d == 2 else "positions"
    word = choice("filter", filter, POINT_FILTERS)
    if values:
        raise ValueError("filter is for points that move; values stay where they are: leave it out")
    if word == "normals" and d not in (2, 3):
        raise ValueError(f'filter="normals" is for 2 or 3 coordinates, got {d} coordinates: use "positions"')
    if word == "surface" and d != 3:
        raise ValueError(f'filter="surface" is for 3 coordinates, got {d}: use "normals" or "positions"')
    if word == "surface" and told:
        raise ValueError(f'filter="surface" has no {told[0]}: leave it out, or use filter="normals"')
    return word


# What an option is on the command line if it was not given.
_DEFAULTS = ("norm=vertex", "solver=jacobi")
