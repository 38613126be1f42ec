"""Operators of sections 2 and 3 of the paper, on any graph and device.

A function on the vertices has the shape (n,), (n, m), or on a grid its shape with or without a last axis of channels. A
function on the edges has one value per stored directed edge, (n_edges,) or (n_edges, m), in the order of the graph's
rows; for a grid, of ``grid.to_graph()``. The settings ``weights``, ``gamma``, ``norm``, ``coupled``, ``backend`` and
``dtype`` are those of :func:`gpureg.regularize`. ``eps`` smooths the gradient norm (eq. 15); the default is 0.
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
