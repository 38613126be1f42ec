"""Energies of a function on the vertices (eq. 19, 20 and 30)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy.typing as npt

from ..graphs.grid import AnyGraph
from ..model.problem import Norm
from ..weights.base import AnyWeights
from .on_device import put_function


def dirichlet_energy(f: npt.ArrayLike, graph: AnyGraph, p: float, **settings: Any) -> float:
    """p-Dirichlet energy 1/p sum_u |grad_w f(u)|^p (eq. 20, with eps eq. 15); the settings are those of p_laplacian.

    With ``norm="edge"``, 1/(2 p) sum_u sum_v |d_w(f)(u, v)|^p (eq. 30), over the edges whose gamma is not 0.

    Examples
    --------
    >>> dirichlet_energy([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), 2, backend="numpy")
    9.0
    """
    return energy(f, f, graph, p, 0.0, **settings)


def energy(
    f: npt.ArrayLike,
    f0: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    lam: float | npt.ArrayLike,
    *,
    eps: float = 0.0,
    norm: Norm = "vertex",
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str | npt.ArrayLike = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> float:
    """Energy of f that :func:`gpureg.regularize` lowers (eq. 19): Dirichlet energy plus fidelity to f0.

    A weight function is computed from `f0`. Where lam is infinite, f = f0 is taken for granted.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> graph = Graph.from_edges([[0, 1], [1, 2]])
    >>> energy([0.0, 3.0, 3.0], [1.0, 3.0, 3.0], graph, 2, 4.0, backend="numpy")
    11.0
    """
    settings = {"weights": weights, "gamma": gamma, "norm": norm, "backend": backend, "dtype": dtype}
    # The sum, unlike the derivative, needs no eps > 0: any stands in while the arguments are checked.
    on, function = put_function(f, graph, p, eps or 1.0, coupled, settings, lam=lam, f0=f0)
    put = on.put_function(function)
    return on.backend.energy(on.weighted, put, on.f0, on.lam, replace(on.model, eps=float(eps)))
