"""Graphs made from other graphs: :func:`ring_graph`."""

from __future__ import annotations

import numpy as np

from .graph import Graph


def ring_graph(graph: Graph, rings: int) -> Graph:
    """The graph in which vertices at most `rings` edges apart are neighbours (k-ring neighbourhoods).

    Parameters
    ----------
    graph : Graph
        Its weights play no part, its positions are kept.
    rings : int
        At least 1, which gives the same edges.

    Returns
    -------
    Graph
        Without weights: 1 on every edge.

    Raises
    ------
    TypeError, ValueError
        Another kind of graph, rings that are no integer or below 1.

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

    if not isinstance(graph, Graph):
        raise TypeError(f"graph must be a Graph, got {type(graph).__name__}: a GridGraph takes a radius")
    if isinstance(rings, bool) or not isinstance(rings, int | np.integer):
        raise TypeError(f"rings must be an integer, got {rings!r}")
    if rings < 1:
        raise ValueError(f"rings must be at least 1, got {rings}")
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
