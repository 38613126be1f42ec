"""Noise of a function on the vertices of any graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..graphs.csr import Graph

# The median of |x| of a normal deviate of deviation 1.
MEDIAN = 0.6744897501960817
# Vertices that are looked at, evenly spread, where there are more: their median is as good.
_MOST = 100_000


def averaging(graph: Graph) -> Any:
    """The matrix M that replaces each value by the mean of its neighbours, CSR; rows of zeros without neighbours."""
    from scipy import sparse

    degree = np.diff(graph.indptr)
    data = np.repeat(1 / np.maximum(degree, 1), degree)
    return sparse.csr_array((data, graph.indices, graph.indptr), shape=(graph.n_vertices,) * 2)


def second_differences(f: FloatArray, graph: Graph, first: FloatArray | None = None) -> FloatArray:
    """(I - M)^2 f at vertices that have neighbours, in units of what it makes of white noise of deviation 1.

    `first` takes the place of (I - M) f, where that is known. Of more than 100 000 vertices some, evenly spread.
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
    """Deviation of white noise in a function (n,) or (n, m) that is smooth on the graph."""
    differences = np.abs(second_differences(f.reshape(len(f), -1), graph))
    return float(np.median(differences) / MEDIAN) if differences.size else 0.0
