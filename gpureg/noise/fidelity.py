"""From the standard deviation of the noise to the fidelity lam."""

from __future__ import annotations

import math

import numpy as np

from ..graphs.csr import Graph


def fidelity_to_values(graph: Graph, sigma: float, p: float, m: int) -> float:
    """The fidelity of values of m channels with noise of deviation sigma: 1.1 sqrt(degree/m) / sigma at p = 1."""
    degree = graph.n_edges / graph.n_vertices
    # all channels have one gradient norm, of the noise of all
    together = sigma * math.sqrt(m)
    return float(1.1 * degree ** (p / 2) * together ** (p - 2)) if sigma > 0 else math.inf


def fidelity_to_normals(noise: float) -> float:
    """The fidelity that :func:`regularized_normals` takes where none is given; infinite where there is no noise.

    It is c / noise^2 with the c among 0.2 to 1.2 that left the least error of normals on five pairs of meshes, with
    noise of 0.2 to 0.5 edges.
    """
    return 0.5 / noise**2 if noise > 0 else np.inf
