"""Describe points by patches: their neighbourhoods, sampled on a grid in the tangent plane."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_points, checked_values
from ..checks import integer
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.of_points import knn_graph
from ..shapes.cloud import cloud_of
from .normals import nearest

# Points per block.
_PIECE = 1 << 14


@door
def point_patches(
    points: Any, values: npt.ArrayLike | None = None, *, k: int = 16, patch_radius: int = 1
) -> FloatArray:
    """Describe the neighbourhood of each point of a surface: heights above its tangent plane, or values, on a grid.

    Parameters
    ----------
    points : (n, 3) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
    values : (n,) or (n, m) array, optional
        Colours or other values to compare. None: the heights of the neighbours above the plane.
    k : int, default 16
        Number of neighbours in a patch; their distances give its size.
    patch_radius : int, default 1
        Cells on each side of the middle one: a patch has 2 patch_radius + 1 cells along each axis.

    Returns
    -------
    (n, (2 patch_radius + 1)^2 m) float64 array
        Features for :func:`gpureg.weights.gaussian` or :func:`patch_knn_graph`, without NaN.

    Raises
    ------
    TypeError, ValueError
        Not points in space; values of another shape; numbers out of range.

    Notes
    -----
    As in Lozes, Elmoataz and Lezoray (IEEE TIP 23(9), 2014): the plane is that of the principal components of the
    neighbourhood. The value of a cell is a mean of the neighbours' values with Gaussian weights of the distance from
    its centre, as wide as a cell. The grid is rotated so that patches do not depend on the coordinates: the first axis
    is the direction in which the values rise most, or in which the heights vary most, with the normal on the side of
    most neighbours. If no direction is special, the patch is the same for all rotations, up to noise.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> x, y = (a.ravel() for a in np.mgrid[:9.0, :9.0])
    >>> roof = np.stack([x, y, np.abs(x - 4)], axis=1)
    >>> patches = gr.point_patches(roof)
    >>> ridge, slope = patches[4 * 9 + 4], patches[2 * 9 + 4]
    >>> bool(np.abs(ridge).max() > 5 * np.abs(slope).max())
    True
    """
    x = cloud_of(points).points
    if x.shape[1] != 3:
        raise ValueError(f"patches need points in space, (n, 3), got {x.shape}")
    integer("k", k, low=3)
    side = 2 * integer("patch_radius", patch_radius, low=0) + 1
    f = None if values is None else checked_values(values, len(x)).astype(np.float64)
    near = nearest(x, k)
    m = 1 if f is None else f.shape[1]
    patches = np.zeros((len(x), side * side * m))
    if near.shape[1] < 2:
        return patches if f is None else np.repeat(f, side * side, axis=1)
    for begin in range(0, len(x), _PIECE):
        part = slice(begin, begin + _PIECE)
        around = x[near[part]] - x[part, None]
        patches[part] = _laid_out(around, None if f is None else f[near[part]], side)
    return patches


def _laid_out(around: FloatArray, values: FloatArray | None, side: int) -> FloatArray:
    """Sample patches of neighbourhoods (q, k, 3), relative to their points, on grids, (q, side^2 m)."""
    q = len(around)
    centred = around - around.mean(axis=1, keepdims=True)
    frame = np.linalg.eigh(np.einsum("qki,qkj->qij", centred, centred)).eigenvectors
    local = np.einsum("qki,qij->qkj", around, frame)
    heights, plane = local[:, :, 0], local[:, :, 1:]
    if values is None:
        # most neighbours are on the side of the normal
        heights = heights * np.where(heights.sum(axis=1, keepdims=True) < 0, -1, 1)
        strength = np.einsum("qk,qki,qkj->qij", np.abs(heights), plane, plane)
        first = np.linalg.eigh(strength).eigenvectors[:, :, -1]
        lean = np.einsum("qk,qk->q", np.abs(heights), np.einsum("qki,qi->qk", plane, first) ** 3)
        first = first * np.where(lean < 0, -1, 1)[:, None]
        values = heights[:, :, None]
    else:
        brightness = values.mean(axis=2)
        first = np.einsum("qk,qki->qi", brightness - brightness.mean(axis=1, keepdims=True), plane)
        length = np.linalg.norm(first, axis=1, keepdims=True)
        first = np.where(length > 0, first / np.where(length > 0, length, 1), [1.0, 0.0])
    u = np.einsum("qki,qi->qk", plane, first)
    # of the two perpendicular directions, the one with the larger values
    w = plane[:, :, 1] * first[:, :1] - plane[:, :, 0] * first[:, 1:]
    lean = np.einsum("qkm,qk->q", np.abs(values), w**3)
    w = w * np.where(lean < 0, -1, 1)[:, None]
    size = np.sqrt((plane**2).sum(axis=2).max(axis=1))
    cell = np.where(size > 0, 2 * size / side, 1.0)
    centres = (np.arange(side) - (side - 1) / 2)[None, :] * cell[:, None]
    # subtract the least exponent of each cell, so that one weight is exp(0) and the sum is not 0
    along = ((u[:, None, :] - centres[:, :, None]) / cell[:, None, None]) ** 2
    across = ((w[:, None, :] - centres[:, :, None]) / cell[:, None, None]) ** 2
    exponent = along[:, :, None, :] + across[:, None, :, :]
    weights = np.exp(exponent.min(axis=3, keepdims=True) - exponent)
    cells = np.einsum("qabk,qkm->qabm", weights, values) / weights.sum(axis=3)[..., None]
    laid: FloatArray = cells.reshape(q, -1)
    return laid


@door
def patch_knn_graph(
    points: Any,
    values: npt.ArrayLike | None = None,
    k: int = 8,
    *,
    among: int = 64,
    reach: float = np.inf,
    features: npt.ArrayLike | None = None,
    symmetrize: Literal["max", "mutual"] = "max",
) -> Graph:
    """Join each point to those of the nearest points with the most similar patches: a nonlocal graph.

    Parameters
    ----------
    points : (n, 3) array, trimesh.PointCloud, pyvista.PolyData or open3d.geometry.PointCloud
        With `features`, points in any dimension, (n, d).
    values : (n,) or (n, m) array, optional
        As in :func:`point_patches`.
    k : int, default 8
        Neighbours that each point chooses.
    among : int, default 64
        How many of the nearest points it chooses from.
    reach : float, default infinity
        Maximal distance to a chosen point.
    features : (n, q) array, optional
        Features to compare instead of patches.
    symmetrize : {"max", "mutual"}, default "max"
        "max" makes an edge if either point chose the other, "mutual" if both did.

    Returns
    -------
    Graph
        Without weights, with the points as positions; `gr.weights.gaussian(features, h)` gives weights.

    Raises
    ------
    TypeError, ValueError
        As :func:`point_patches` and :func:`gpureg.knn_graph`; among below k; features of another shape.

    Examples
    --------
    >>> import gpureg as gr
    >>> line = [[0.0], [1.0], [2.0], [3.0]]
    >>> gr.patch_knn_graph(line, k=1, features=[[5], [7], [5], [7]]).indices.tolist()
    [2, 3, 0, 1]
    """
    cloud = cloud_of(points)
    x = cloud.points
    integer("k", k, low=1)
    if integer("among", among) < k:
        raise ValueError(f"among must be an integer >= k = {k}, got {among!r}")
    local = knn_graph(x, 1 if len(x) < 2 else min(k, len(x) - 1), symmetrize=symmetrize, reach=reach)
    if features is not None and values is not None:
        raise ValueError("features are compared instead of values: leave values out")
    rows = point_patches(cloud.points, values) if features is None else checked_points(features, "features")
    if len(rows) != len(x):
        raise ValueError(f"features must have {len(x)} rows, one per point, got {len(rows)}")
    if len(x) < 2:
        return local
    near = nearest(x, among)
    chosen = _most_alike(x, rows, near, k, float(reach))
    u = np.repeat(np.arange(len(x)), chosen.shape[1])
    there = chosen.ravel() >= 0
    edges = np.stack([u[there], chosen.ravel()[there]], axis=1)
    if not len(edges):
        return Graph.from_edges([], n_vertices=len(x), positions=x)
    return Graph.from_edges(edges, n_vertices=len(x), positions=x, symmetrize=symmetrize)


def _most_alike(x: FloatArray, rows: FloatArray, near: IntArray, k: int, reach: float) -> IntArray:
    """Choose among `near`, (n, k'), the k points with the most similar features, (n, q); (n, k), -1 for no point."""
    k = min(k, near.shape[1] - 1)
    chosen = np.full((len(x), k), -1, np.int64)
    for begin in range(0, len(x), _PIECE):
        part = slice(begin, begin + _PIECE)
        others = near[part]
        apart = np.linalg.norm(rows[others] - rows[part, None], axis=2)
        far = np.linalg.norm(x[others] - x[part, None], axis=2) > reach
        apart[far | (others == np.arange(begin, begin + len(others))[:, None])] = np.inf
        # with equal features the nearer point comes first, as in `near`
        order = np.argsort(apart, axis=1, kind="stable")[:, :k]
        alike = np.take_along_axis(others, order, axis=1)
        chosen[part] = np.where(np.isfinite(np.take_along_axis(apart, order, axis=1)), alike, -1)
    return chosen
