"""Operators of sections 2 and 3 of the paper, on any graph and device: :mod:`gpureg.operators.vertices`.

Each takes a function on the vertices, (n,), (n, m), or on a grid its shape with or without a last axis of channels, and
the settings ``weights``, ``gamma``, ``backend`` and ``dtype`` of :func:`gpureg.regularize`; channels share a gradient
norm unless ``coupled`` is False (section 5.1). ``eps`` smooths the gradient norm (eq. 15) and is 0 unless given.
``norm`` is that of :func:`gpureg.regularize`. A function on the edges has one value per stored directed edge,
(n_edges,) or (n_edges, m), in the order of the graph's rows; for a grid, of ``grid.to_graph()``.
"""

from __future__ import annotations

from ..spectral.markov import markov_matrix
from .edges import adjoint, difference, divergence, edge_derivative
from .energies import dirichlet_energy, energy
from .vertices import curvature, gradient_norm, laplacian, p_laplacian

__all__ = [
    "adjoint",
    "curvature",
    "difference",
    "dirichlet_energy",
    "divergence",
    "edge_derivative",
    "energy",
    "gradient_norm",
    "laplacian",
    "markov_matrix",
    "p_laplacian",
]
