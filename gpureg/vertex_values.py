"""Functions that doors are given at vertices or points, checked, and how far values with noise are to be trusted."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .graph import Graph, all_finite, unmasked


def checked_values(values: npt.ArrayLike, n: int) -> npt.NDArray[Any]:
    """Values as (n, m), in their type where it is one of floating point.

    Raises
    ------
    TypeError, ValueError
        What is not real and finite, another shape.
    """
    f = unmasked(values, "values")
    if f.dtype.kind not in "biuf":
        raise TypeError(f"values must be real numbers, got {f.dtype}")
    if f.ndim not in (1, 2) or len(f) != n or f.size == 0:
        raise ValueError(f"values must have shape ({n},) or ({n}, m), a row per vertex, got {f.shape}")
    if not all_finite(f):
        raise ValueError("values must be finite: give lam=0 and any value where there is none")
    return f.astype(f.dtype if f.dtype.kind == "f" else np.float64).reshape(n, -1)


def checked_flags(name: str, given: npt.ArrayLike, n: int) -> npt.NDArray[np.bool_]:
    """One truth per vertex, (n,).

    Raises
    ------
    ValueError
        Other types and shapes.
    """
    flags = np.asarray(given)
    if flags.dtype != np.bool_ or flags.shape != (n,):
        raise ValueError(f"{name} must be boolean of shape ({n},), one per vertex, got {flags.dtype} of {flags.shape}")
    return flags


def check_size(name: str, value: Any) -> None:
    """Refuse what is neither None nor a finite number >= 0.

    Raises
    ------
    TypeError, ValueError
    """
    if value is None:
        return
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"{name} must be a number, got {value!r}")
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and >= 0, got {value}")


def fidelity_to_values(graph: Graph, sigma: float, p: float, m: int) -> float:
    """The fidelity of values of m channels with noise of deviation sigma: 1.1 sqrt(degree/m) / sigma at p = 1."""
    degree = graph.n_edges / graph.n_vertices
    # all channels have one gradient norm, of the noise of all
    together = sigma * math.sqrt(m)
    return float(1.1 * degree ** (p / 2) * together ** (p - 2)) if sigma > 0 else math.inf
