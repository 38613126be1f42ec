"""Graphs of meshes, faces and curves, and k-ring graphs (section 5.3)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, checked_faces, checked_points
from ..checks import choice, flag, integer
from ..doors import door
from .accepted import StoredLike, as_stored
from .csr import Graph
from .grid import GridGraph

Across = Literal["edge", "vertex"]


def face_edges(faces: IntArray) -> IntArray:
    """Return the edges of all faces in order, (F k, 2); an edge of two faces is listed twice."""
    edges: IntArray = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    return edges


def _joined(u: IntArray, v: IntArray, n: int, positions: FloatArray) -> Graph:
    """Make a graph from edges (u, v), repeated or not, in any direction; loops are left out."""
    from scipy import sparse

    both = sparse.csr_array(
        (np.ones(2 * len(u), np.int8), (np.concatenate([u, v]), np.concatenate([v, u]))), shape=(n, n)
    )
    # rows sorted, each neighbour once
    both.sum_duplicates()
    return _without_loops(both, positions)


def _without_loops(matrix: Any, positions: FloatArray) -> Graph:
    """Make a graph from the stored entries of a symmetric CSR matrix with sorted rows, except its diagonal."""
    n = matrix.shape[0]
    rows = np.repeat(np.arange(n), np.diff(matrix.indptr))
    other = matrix.indices != rows
    indptr = np.concatenate([[0], np.cumsum(np.bincount(rows[other], minlength=n))])
    return Graph(indptr, matrix.indices[other], None, positions)


def with_three_corners(faces: IntArray) -> npt.NDArray[np.bool_]:
    """Find the faces (F, k) with at least three different corners, (F,) bool: others have no area, and join nothing."""
    if faces.shape[1] == 3:
        one, two, three = faces.T
        found: npt.NDArray[np.bool_] = (one != two) & (two != three) & (three != one)
        return found
    ordered = np.sort(faces, axis=1)
    several: npt.NDArray[np.bool_] = (ordered[:, 1:] != ordered[:, :-1]).sum(axis=1) >= min(2, faces.shape[1] - 1)
    return several


@door
def mesh_graph(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> Graph:
    """Make the graph of a mesh: its vertices are joined along the edges of its faces (section 5.3).

    Parameters
    ----------
    vertices : (n, d) float array
        Coordinates, which become the graph's positions.
    faces : (F, 3) int array
        Triangles; (F, k) for faces of k corners.

    Returns
    -------
    Graph
        A graph without weights: give :mod:`gpureg.weights` such as ``inverse_distance(2)`` to
        :func:`gpureg.regularize`. A vertex without a face has no edges, and a face with fewer than three different
        corners makes none.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not finite, faces with numbers that are not vertices.

    Examples
    --------
    Two triangles that share an edge, and a vertex in no face:

    >>> import gpureg as gr
    >>> graph = gr.mesh_graph([[0, 0], [1, 0], [0, 1], [1, 1], [5, 5]], [[0, 1, 2], [2, 1, 3]])
    >>> graph.n_edges // 2, graph.degree()
    (5, array([2., 3., 3., 2., 0.]))
    """
    positions = checked_points(vertices, "vertices")
    corners = checked_faces(faces, len(positions))
    edges = face_edges(corners[with_three_corners(corners)])
    return _joined(edges[:, 0], edges[:, 1], len(positions), positions)


@door
def face_graph(vertices: npt.ArrayLike, faces: npt.ArrayLike, *, across: Across = "edge") -> Graph:
    """Make the graph of a mesh's faces, for functions such as their normals.

    Parameters
    ----------
    vertices : (n, d) float array
    faces : (F, 3) int array
        Triangles; (F, k) for faces of k corners.
    across : {"edge", "vertex"}, default "edge"
        Faces are neighbours if they share an edge (three neighbours on a manifold surface), or a vertex (about twelve).

    Returns
    -------
    Graph
        One vertex per face, at the mean of its corners. All pairs of faces along a non-manifold edge are neighbours. A
        face with fewer than three different corners has no neighbours.

    Raises
    ------
    TypeError, ValueError
        As :func:`mesh_graph`; also no faces, an unknown `across`.

    Examples
    --------
    >>> import gpureg as gr
    >>> square = [[0, 0], [1, 0], [0, 1], [1, 1]], [[0, 1, 2], [2, 1, 3]]
    >>> gr.face_graph(*square)
    Graph(2 vertices, 1 undirected edges, unweighted)
    """
    from scipy import sparse

    positions = checked_points(vertices, "vertices")
    corners = checked_faces(faces, len(positions))
    choice("across", across, ("edge", "vertex"))
    n_faces, k = corners.shape
    if n_faces == 0:
        raise ValueError("faces is empty: there is no face to make a graph from")
    middles = positions[corners].mean(axis=1)
    proper = np.flatnonzero(with_three_corners(corners))
    if across == "vertex":
        at = (np.repeat(proper, k), corners[proper].ravel())
        parts = sparse.csr_array((np.ones(len(at[0]), np.int32), at), shape=(n_faces, len(positions)))
        shared = sparse.csr_array(parts @ parts.T)
        shared.sort_indices()
        return _without_loops(shared, middles)
    return _joined(*adjacent_faces(corners), n_faces, middles)


def adjacent_faces(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the pairs of faces that share an edge, once per edge, as two arrays of face numbers, (E,) each.

    Faces with fewer than three different corners are left out.
    """
    edges = np.sort(face_edges(faces), axis=1)
    proper = (edges[:, 0] != edges[:, 1]) & np.repeat(with_three_corners(faces), faces.shape[1])
    keys = edges[proper] @ np.array([int(faces.max(initial=0)) + 1, 1])
    order = np.argsort(keys)
    keys, owners = keys[order], np.flatnonzero(proper)[order] // faces.shape[1]
    # faces with a common edge are next to each other; for edges with three or more faces, also those with larger steps
    pairs, step = [], 1
    while step < len(keys) and (same := keys[step:] == keys[:-step]).any():
        pairs.append(np.stack([owners[:-step][same], owners[step:][same]]))
        step += 1
    u, v = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), np.int64)
    return u, v


@door
def curve_graph(points: npt.ArrayLike, closed: bool = True) -> Graph:
    """Make the graph of a polygonal curve: each point is joined to the next (figures 5, 7 and 9).

    Parameters
    ----------
    points : (n, d) float array
        The vertices in order; do not repeat the first vertex of a closed curve at the end.
    closed : bool, default True
        Whether the last point is joined to the first.

    Returns
    -------
    Graph
        A graph without weights, with the points as positions.

    Raises
    ------
    TypeError, ValueError
        Coordinates that are not finite, fewer than two points (three for a closed curve).

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.curve_graph([[0, 0], [1, 0], [1, 1], [0, 1]]).degree()
    array([2., 2., 2., 2.])
    """
    positions, closed = checked_points(points), flag("closed", closed)
    n, least = len(positions), 3 if closed else 2
    if n < least:
        raise ValueError(f"{'a closed' if closed else 'an open'} curve needs at least {least} points, got {n}")
    start = np.arange(n if closed else n - 1)
    return Graph.from_edges(np.stack([start, (start + 1) % n], axis=1), n_vertices=n, positions=positions)


@door
def ring_graph(graph: StoredLike, rings: int) -> Graph:
    """Join all vertices of a graph that are at most `rings` edges apart (k-ring neighbourhoods).

    Parameters
    ----------
    graph : Graph
        A graph, a symmetric sparse matrix of scipy, or a graph of networkx. Its weights are not used.
    rings : int
        At least 1; 1 gives the same edges.

    Returns
    -------
    Graph
        A graph without weights, with the positions of `graph`.

    Raises
    ------
    TypeError, ValueError
        Another kind of graph, rings that are not an integer >= 1.

    Examples
    --------
    >>> import gpureg as gr
    >>> path = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3]])
    >>> gr.ring_graph(path, 2).to_scipy().toarray().astype(int)
    array([[0, 1, 1, 0],
           [1, 0, 1, 1],
           [1, 1, 0, 1],
           [0, 1, 1, 0]])
    """
    from scipy import sparse

    if isinstance(graph, GridGraph):
        raise TypeError("graph must be a Graph, got a GridGraph: give the grid a larger radius")
    graph, rings = as_stored(graph), integer("rings", rings, low=1)
    n = graph.n_vertices
    A = sparse.csr_array((np.ones(graph.n_edges, bool), graph.indices, graph.indptr), shape=(n, n))
    near, ring = A, A
    for _ in range(rings - 1):
        ring = ring @ A
        near = near + ring
    pairs = near.tocoo()
    other = pairs.row != pairs.col
    joined = sparse.csr_array((np.ones(other.sum(), bool), (pairs.row[other], pairs.col[other])), shape=(n, n))
    joined.sort_indices()
    return Graph(joined.indptr, joined.indices, None, graph.positions)
