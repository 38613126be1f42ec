"""Graphs of points: nearest neighbours, and all neighbours within a radius."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, checked_points
from ..checks import choice, integer, number
from ..doors import door
from .csr import Graph


@door
def knn_graph(
    points: npt.ArrayLike, k: int, *, symmetrize: Literal["max", "mutual"] = "max", reach: float = np.inf
) -> Graph:
    """Join every point to its k nearest neighbours, found by a kd-tree.

    Parameters
    ----------
    points : (n, d) float array
        Points, or features of any number of dimensions.
    k : int
        Number of neighbours that each point chooses, at least 1; at most all other points.
    symmetrize : {"max", "mutual"}, default "max"
        "max" joins two points if one chose the other, "mutual" only if both did.
    reach : float, default infinity
        Maximum length of an edge.

    Returns
    -------
    Graph
        A graph without weights, with the points as positions. Points at the same place are neighbours too.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not finite, a `k` or `reach` out of its range.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.knn_graph([[0.0], [1.0], [3.0], [7.0]], 1).to_scipy().toarray().astype(int)
    array([[0, 1, 0, 0],
           [1, 0, 1, 0],
           [0, 1, 0, 1],
           [0, 0, 1, 0]])
    """
    positions = checked_points(points)
    k, reach = integer("k", k, low=1), number("reach", reach, above=0, finite=False)
    choice("symmetrize", symmetrize, ("max", "mutual"))
    n = len(positions)
    most = min(k, n - 1)
    if most == 0:
        return Graph.from_edges([], n_vertices=n, positions=positions)
    # The point itself is among its nearest, but not always the first if other points have the same position.
    distance, near = _tree(positions).query(positions, k=most + 1, distance_upper_bound=reach)
    rows = np.repeat(np.arange(n), most + 1)
    chosen = np.isfinite(distance).ravel() & (near.ravel() != rows)
    # If more than k points have the same position, the point may be missing: then the furthest neighbour is left out.
    chosen &= (np.cumsum(chosen.reshape(n, most + 1), axis=1) <= most).ravel()
    edges = np.stack([rows[chosen], near.ravel()[chosen]], axis=1)
    if not len(edges):
        return Graph.from_edges([], n_vertices=n, positions=positions)
    return Graph.from_edges(edges, n_vertices=n, positions=positions, symmetrize=symmetrize)


@door
def radius_graph(points: npt.ArrayLike, radius: float) -> Graph:
    """Join all points with a distance of at most `radius`.

    Parameters
    ----------
    points : (n, d) float array
    radius : float
        Distance > 0, in the units of the points.

    Returns
    -------
    Graph
        A graph without weights, with the points as positions.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not finite, a radius that is not > 0.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.radius_graph([[0.0], [1.0], [3.0]], 1.5)
    Graph(3 vertices, 1 undirected edges, unweighted)
    """
    positions, radius = checked_points(points), number("radius", radius, above=0, finite=False)
    pairs = _tree(positions).query_pairs(radius, output_type="ndarray")
    return Graph.from_edges(pairs, n_vertices=len(positions), positions=positions)


def _tree(positions: FloatArray) -> Any:
    from scipy.spatial import cKDTree

    # Unbalanced trees are built several times faster, and queries are as fast.
    return cKDTree(positions, balanced_tree=False)
