"""Reordering of vertices, so that neighbours are near each other in memory: :func:`reordered`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import IntArray
from ..doors import door
from .accepted import StoredLike, as_stored
from .csr import Graph

__all__ = ["reordered"]


@door
def reordered(graph: StoredLike, order: npt.ArrayLike | None = None) -> tuple[Graph, IntArray]:
    """Reorder the vertices of a graph, so that neighbours have near numbers.

    Parameters
    ----------
    graph : Graph
        A graph of n vertices, a symmetric sparse matrix of scipy without a diagonal, or a graph of networkx without
        self-loops.
    order : (n,) int array, optional
        The vertices in their new order, each once. None means the reverse Cuthill-McKee order.

    Returns
    -------
    Graph
        The reordered graph, with weights and positions: its vertex i is vertex ``order[i]`` of `graph`.
    (n,) int array
        `order`: ``f[order]`` is a function on the new graph, and ``f[order] = g`` converts one back.

    Raises
    ------
    TypeError, ValueError
        Not a graph, or an order that does not contain each vertex once.

    Notes
    -----
    A sweep reads the neighbours of each vertex, and is slow if these are far apart in memory. A grid of 1024 x 1024
    takes 16 ms per iteration in random order on a CPU with two cores, 7 ms in row order, and 8 ms after reordering.
    Reordering takes as long as some hundred iterations, so it is never done automatically. The result differs by
    rounding errors, as sums are computed in the new order of the neighbours.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> path = gr.Graph.from_edges([[0, 3], [3, 1], [1, 4], [4, 2]])
    >>> graph, order = gr.reordered(path)
    >>> order.tolist(), graph.indices.tolist()
    ([2, 4, 1, 3, 0], [1, 0, 2, 1, 3, 2, 4, 3])
    >>> f0 = np.arange(5.0)
    >>> f = np.empty(5)
    >>> f[order] = gr.regularize(f0[order], graph, backend="numpy").value
    >>> bool(np.allclose(f, gr.regularize(f0, path, backend="numpy").value))
    True
    """
    graph = as_stored(graph, degrees=True)
    n = graph.n_vertices
    if order is None:
        from scipy.sparse import csgraph

        # without weights: scipy needs a value per edge, but does not use it
        pattern = Graph(graph.indptr, graph.indices).to_scipy()
        found: IntArray = csgraph.reverse_cuthill_mckee(pattern, symmetric_mode=True).astype(np.int64)
    else:
        given = np.asarray(order)
        if given.dtype.kind not in "iu" or given.shape != (n,) or not np.array_equal(np.sort(given), np.arange(n)):
            raise ValueError(f"order must hold each of the {n} vertices once, got {given.dtype} of shape {given.shape}")
        found = given.astype(np.int64)
    place = np.empty(n, np.int64)
    place[found] = np.arange(n)
    degrees = np.diff(graph.indptr)[found]
    indptr = np.concatenate([[0], np.cumsum(degrees)])
    # the old edges of each new row, then sorted by the new numbers of their ends
    edges = np.repeat(graph.indptr[found] - indptr[:-1], degrees) + np.arange(graph.n_edges)
    ends = place[graph.indices[edges]]
    by_end = np.lexsort((ends, np.repeat(np.arange(n), degrees)))
    weights = None if graph.weights is None else graph.weights[edges][by_end]
    positions = None if graph.positions is None else graph.positions[found]
    return Graph(indptr, ends[by_end], weights, positions), found
