"""Weights with parameters for other noise: :func:`scaled_by`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from .base import Parameter, PatchWeights, PerVertex, Weights
from .guide import Compared
from .similarity import Bilateral, Held, Patch


def scaled_by(weights: Weights | npt.ArrayLike, factors: npt.NDArray[np.float64]) -> Weights | None:
    """Return the weights with h and sigma, or sigma_value, multiplied by a factor at each vertex (n,).

    None if the weights have no such parameters.
    """
    if isinstance(weights, Patch):
        return replace(weights, h=_times(weights.h, factors), sigma=_times(weights.sigma, factors))
    if isinstance(weights, Bilateral):
        return replace(weights, sigma_value=_times(weights.sigma_value, factors))
    if isinstance(weights, Held):
        held = scaled_by(weights.weights, factors)
        return replace(weights, weights=held) if isinstance(held, PatchWeights) else None
    if isinstance(weights, Compared):
        inner = scaled_by(weights.weights, factors)
        return None if inner is None else replace(weights, weights=inner)
    return None


def _times(value: Parameter, factors: npt.NDArray[np.float64]) -> Parameter:
    """Return a parameter multiplied at each vertex; its middle does not depend on the factors of other vertices."""
    if isinstance(value, PerVertex):
        return PerVertex(value.values * factors, value.middle)
    return value if value == 0 or np.isinf(value) else PerVertex(value * factors, value)
