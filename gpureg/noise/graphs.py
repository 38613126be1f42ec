"""Estimate the noise of a function on the vertices of a graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..graphs.csr import Graph

# The median of |x| for a standard normal x.
MEDIAN = 0.6744897501960817
# Maximum number of vertices to measure, evenly spread.
_MOST = 100_000


def averaging(graph: Graph) -> Any:
    """Return the CSR matrix M (n, n) that takes means over neighbours; rows are zero without neighbours."""
    from scipy import sparse

    degree = np.diff(graph.indptr)
    data = np.repeat(1 / np.maximum(degree, 1), degree)
    return sparse.csr_array((data, graph.indices, graph.indptr), shape=(graph.n_vertices,) * 2)


def second_differences(f: FloatArray, graph: Graph, first: FloatArray | None = None) -> FloatArray:
    """Compute (I - M)^2 f, (k, m), at vertices with neighbours, relative to its deviation for white noise of sigma 1.

    `first` is (I - M) f, (n,) or (n, m), if it is known. At most 100 000 vertices are used, evenly spread.
    """
    from scipy import sparse

    M = averaging(graph)
    n = graph.n_vertices
    rows = np.flatnonzero(np.diff(graph.indptr) > 0)
    rows = rows[:: -(-len(rows) // _MOST) or 1]
    once = f - M @ f if first is None else first
    once = once[:, None] if once.ndim == 1 else once
    T = sparse.csr_array(sparse.eye_array(n, format="csr") - M)
    part = T[rows]
    growth = np.sqrt(np.asarray((part @ T).power(2).sum(axis=1)).ravel())
    twice: FloatArray = (part @ once) / growth[:, None]
    return twice


def noise_on_graph(f: FloatArray, graph: Graph) -> float:
    """Estimate the standard deviation of white noise in a function (n,) or (n, m) that is smooth on the graph."""
    differences = np.abs(second_differences(f.reshape(len(f), -1), graph))
    return float(np.median(differences) / MEDIAN) if differences.size else 0.0
