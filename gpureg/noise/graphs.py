"""Means over the neighbours of a vertex, and the median of noise: what estimates on graphs have in common."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..graphs.csr import Graph

# The median of |x| for a standard normal x.
MEDIAN = 0.6744897501960817


def averaging(graph: Graph) -> Any:
    """Return the CSR matrix M (n, n) that takes means over neighbours; rows are zero without neighbours."""
    from scipy import sparse

    degree = np.diff(graph.indptr)
    data = np.repeat(1 / np.maximum(degree, 1), degree)
    return sparse.csr_array((data, graph.indices, graph.indptr), shape=(graph.n_vertices,) * 2)
