"""Find the parts of a graph where a plain Gauss-Jacobi sweep can oscillate: bipartite parts without data.

With lam = 0 a sweep replaces each vertex by a mean of its neighbours. On a bipartite part (the 4-adjacency graph, a
tree, an even cycle) the values of the two classes can be exchanged forever: the operator has the eigenvalue -1. Data
(lam > 0), a pinned vertex or an odd cycle prevent that.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph

Ends = tuple[IntArray, IntArray]


def has_swinging_part(graph: AnyGraph, weights: FloatArray | None, lam: FloatArray) -> bool:
    """Return whether a connected part with an edge is bipartite and has lam = 0 everywhere.

    Parameters
    ----------
    graph : Graph or GridGraph
    weights : array or None
        In the form of ``Backend.prepare``, or gamma in that of ``Backend.put_edges``: weight 0 means no edge.
    lam : () or (n, 1) array
    """
    n = graph.n_vertices
    data = np.broadcast_to(lam > 0, (n, 1))[:, 0]
    if data.all():
        return False
    # The double cover has two copies of each vertex; an edge (u, v) joins each copy of u to the other copy of v. A part
    # is bipartite if the two copies of its vertices are not connected. Data connects the copies of its vertex.
    labels: IntArray = np.arange(2 * n)
    own = np.flatnonzero(data)
    labels = _joined(labels, own, own + n)
    touched = np.zeros(n, bool)
    for u, v in _edges(graph, weights):
        touched[u] = touched[v] = True
        labels = _joined(labels, np.concatenate([u, u + n]), np.concatenate([v + n, v]))
        apart = labels[:n] != labels[n:]
        if isinstance(graph, GridGraph) and graph.mask is not None:
            apart &= graph.mask.ravel()
        if not apart.any():
            return False
    return bool((touched & (labels[:n] != labels[n:])).any())


def _joined(labels: IntArray, a: IntArray, b: IntArray) -> IntArray:
    """Update the labels of connected parts, (2 n,), after joining node a[i] to node b[i] for all i."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    if not len(a):
        return labels
    m = int(labels.max()) + 1
    links = sparse.coo_array((np.ones(len(a), np.int8), (labels[a], labels[b])), shape=(m, m))
    part: npt.NDArray[np.int32] = connected_components(links, directed=False)[1]
    joined: IntArray = part[labels]
    return joined


def _edges(graph: AnyGraph, weights: FloatArray | None) -> Iterator[Ends]:
    """Yield the edges of weight > 0, each at least once: all of a stored graph, or one offset of a grid at a time."""
    if isinstance(graph, Graph):
        there = slice(None) if weights is None else np.flatnonzero(weights.reshape(-1) > 0)
        yield graph.edge_rows()[there], graph.indices[there].astype(np.int64)
        return
    vertices = np.arange(graph.n_vertices).reshape(graph.shape)
    H = graph.half_window
    directed = weights is not None and len(weights) == 2 * H and weights.ndim == graph.ndim + 2
    for h, step in enumerate(graph.forward_offsets):
        start, end = graph.ends(step)
        u, v = vertices[start].ravel(), vertices[end].ravel()
        if weights is None:
            yield u, v
        elif directed:
            there = (weights[H + h][start].ravel() > 0) | (weights[H - 1 - h][end].ravel() > 0)
            yield u[there], v[there]
        else:
            there = weights[h][start].ravel() > 0
            yield u[there], v[there]
