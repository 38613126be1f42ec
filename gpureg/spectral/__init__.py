"""Diffusion and spectrum (section 4.1 of the paper): the Markov matrix of the process, and its eigenvectors.

A sweep of the Gauss-Jacobi process is f+ = phi_uu f0 + sum_v phi_uv f(v) (eq. 26). Without data, with gamma = sqrt(w),
it is a step of a random walk, f+ = P f (eq. 27). For p = 2, P = D^-1 W does not depend on f (eq. 28). P is symmetric in
the inner product <f, h>_delta = sum_u delta(u) f(u) h(u) with the degree delta, but not in the Euclidean one. Its
eigenvalues are in [-1, 1].
"""

from __future__ import annotations

from typing import Any

from .markov import AveragingFilter, averaging_filter, diffuse
from .spectrum import Eigenpairs, eigenpairs, spectral_filter

__all__ = [
    "AveragingFilter",
    "Eigenpairs",
    "averaging_filter",
    "diffuse",
    "eigenpairs",
    "spectral_filter",
]


def __getattr__(name: str) -> Any:
    """Raise AttributeError; for `markov_matrix` it names the new module."""
    if name == "markov_matrix":
        raise AttributeError("the Markov matrix is gpureg.operators.markov_matrix, with the same parameters")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
