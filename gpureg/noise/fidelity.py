"""Functions that doors are given at vertices or points, checked, and how far values with noise are to be trusted."""

from __future__ import annotations

import math

from .graph import Graph


def fidelity_to_values(graph: Graph, sigma: float, p: float, m: int) -> float:
    """The fidelity of values of m channels with noise of deviation sigma: 1.1 sqrt(degree/m) / sigma at p = 1."""
    degree = graph.n_edges / graph.n_vertices
    # all channels have one gradient norm, of the noise of all
    together = sigma * math.sqrt(m)
    return float(1.1 * degree ** (p / 2) * together ** (p - 2)) if sigma > 0 else math.inf
