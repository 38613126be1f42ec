"""The rounding of energies: :func:`rounding_of`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..graphs.grid import GridGraph
from .problem import Problem


def rounding_of(problem: Problem, energy: float, dtype: np.dtype[Any]) -> float:
    """Return a bound on the rounding errors of an energy near the minimum, in units of the frame.

    The terms of the energy are >= 0. Each has 5 roundings, those of a sum over the edges of a vertex, and those of a
    power, at most 16 (``kernels/README.md``); the sum over the vertices is in float64 or compensated. A rounding d of
    the data changes the minimum by at most sqrt(2 energy) |d| + |d|^2/2 with |d|^2 = sum_u lam(u) d(u)^2, as its
    derivative is lam (f0 - f).
    """
    graph, unit = problem.graph, float(np.finfo(dtype).eps) / 2
    edges = len(graph.offsets) if isinstance(graph, GridGraph) else int(np.diff(graph.indptr).max(initial=0))
    of_terms: float = (21 + problem.p / 2 * (edges * problem.f0.shape[1] + 5)) * unit * energy
    if problem.data is None:
        return of_terms
    lost = (problem.data - problem.frame.back(problem.f0, np.dtype(np.float64))) / problem.frame.scale
    if isinstance(graph, GridGraph) and graph.mask is not None:
        lost = lost[graph.mask.ravel()]
        lam = problem.lam if problem.lam.ndim == 0 else problem.lam[graph.mask.ravel()]
    else:
        lam = problem.lam
    moved = math.sqrt(float((np.where(np.isfinite(lam), lam, 0.0) * lost**2).sum()))
    return of_terms + math.sqrt(2 * energy) * moved + moved**2 / 2
