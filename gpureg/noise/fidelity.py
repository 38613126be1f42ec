"""Compute the fidelity lam from the standard deviation of the noise."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray
from ..graphs.csr import Graph


def fidelity_to_values(graph: Graph, sigma: float, p: float, m: int) -> float:
    """Compute the fidelity for values of m channels with noise sigma: 1.1 sqrt(degree/m) / sigma at p = 1."""
    degree = graph.n_edges / graph.n_vertices
    # the gradient norm contains the noise of all channels
    together = sigma * math.sqrt(m)
    return float(1.1 * degree ** (p / 2) * together ** (p - 2)) if sigma > 0 else math.inf


def fidelities_to_values(degree: FloatArray, sigma: FloatArray, p: float, m: int) -> FloatArray:
    """Compute the fidelity of :func:`fidelity_to_values` from one mean degree and one sigma per vertex, (n,) each."""
    together = sigma * math.sqrt(m)
    some = together > 0
    found: FloatArray = np.where(some, 1.1 * degree ** (p / 2) * np.where(some, together, 1.0) ** (p - 2), np.inf)
    return found


def fidelity_to_normals(noise: float) -> float:
    """Compute the default fidelity of :func:`regularized_normals`; infinite without noise.

    It is c / noise^2, with the c from 0.2 to 1.2 that gave the smallest error of normals on five pairs of meshes with
    noise of 0.2 to 0.5 edges.
    """
    return 0.5 / noise**2 if noise > 0 else np.inf
