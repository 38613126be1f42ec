"""Estimate the noise of points of a curve or a surface: :func:`estimate_point_noise`."""

from __future__ import annotations

import warnings
from typing import Any, Literal, get_args, overload

import numpy as np

from ..arrays import FloatArray, IntArray
from ..checks import choice
from ..doors import door, outside
from ..graphs.components import Components
from ..graphs.csr import Graph
from ..graphs.of_points import knn_graph
from ..model.result import Result
from ..regularization.regularize import regularize
from ..shapes.cloud import cloud_of
from .filters import NEIGHBOURS, mean_level
from .levels import point_levels
from .merging import merged
from .outliers import outliers
from .surface import LEAST, SCALES, fitted_surface

Of = Literal["cloud", "component", "point"]


@overload
def estimate_point_noise(points: Any, *, of: Literal["cloud"] = "cloud") -> float: ...


@overload
def estimate_point_noise(points: Any, *, of: Literal["component", "point"]) -> FloatArray: ...


@door
def estimate_point_noise(points: Any, *, of: Of = "cloud") -> float | FloatArray:
    """Estimate the standard deviation of the noise of points of a curve or a surface, along the normals.

    Parameters
    ----------
    points : (n, 2) or (n, 3) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
    of : {"cloud", "component", "point"}, default "cloud"
        What the estimate is for: the whole cloud; each component of the graph of 8 neighbours, such as a body by
        itself; or the surroundings of each point.

    Returns
    -------
    float, or (n,) float array with one value per point
        In the units of the coordinates. For a cloud or a component it is the root mean square over its points. 0: no
        noise was found; NaN: it cannot be told, as for outliers and for fewer than 19 points on a surface.

    Raises
    ------
    TypeError, ValueError
        Not a point cloud in the plane or in space.

    Warns
    -----
    UserWarning
        The noise of the whole cloud cannot be told.

    Notes
    -----
    Repeated points are merged first, and outliers left out, as in :func:`denoise_points`. On a surface it is the
    root mean square around a point of the heights over the quadrics through 8 or 18 neighbours, divided by what white
    noise of deviation 1 would give; 8 where the heights over the quadrics through 18 are not white. On a curve it is
    the median around a point of the residuals of the parabola through 17 points.

    Measured on five surfaces in space, in units of the distance to the nearest point: 0.10 to 0.12 for 0.1, 0.25 to
    0.26 for 0.25, 0.50 to 0.51 for 0.5.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> plane = np.random.default_rng(0).random((2000, 3)) * [1, 1, 0]
    >>> noisy = plane + np.random.default_rng(1).normal(0, 0.01, (2000, 3)) * (plane[:, :1] < 0.5)
    >>> levels = gr.estimate_point_noise(noisy, of="point")
    >>> [round(float(np.nanmedian(levels[part])), 3) for part in (plane[:, 0] < 0.4, plane[:, 0] > 0.6)]
    [0.01, 0.0]
    """
    choice("of", of, get_args(Of))
    found = cloud_of(points).points
    if found.shape[1] not in (2, 3):
        raise ValueError(f"normals need points in the plane or in space, got {found.shape[1]} coordinates")
    copies = merged(found)
    apart = outliers(copies.points)
    known, component = _levels(copies.points[~apart])
    if of == "component":
        for i in range(int(component.max(initial=-1)) + 1):
            known[component == i] = mean_level(known[component == i])
    levels = np.full(len(apart), np.nan)
    levels[~apart] = known
    levels = levels[copies.owner]
    if of != "cloud":
        return levels
    if np.isnan(known).all():
        warnings.warn(
            f"the noise of {len(levels)} points cannot be told: too few of them lie together",
            UserWarning,
            stacklevel=outside(),
        )
    return mean_level(known)


def _levels(x: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the noise around each point (n,) and its component (n,)."""
    if x.shape[1] == 3 and len(x) >= LEAST:

        def run(f0: FloatArray, graph: Graph, lam: float, weights: Any) -> Result:
            return regularize(f0, graph, lam=lam, weights=weights, max_iter=1)

        fit = fitted_surface(x, run, SCALES[:2])
        return fit.sigma, fit.component
    if x.shape[1] == 3 or len(x) < 3:
        return np.full(len(x), np.nan), np.zeros(len(x), int)
    graph = knn_graph(x, NEIGHBOURS)
    return point_levels(x, graph), Components.of(graph).labels
