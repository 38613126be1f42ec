"""Operators of sections 2 and 3 of the paper, on any graph and device: :mod:`gpureg.operators`.

Each takes a function on the vertices, (n,), (n, m), or on a grid its shape with or without a last axis of channels, and
the settings ``weights``, ``gamma``, ``backend`` and ``dtype`` of :func:`gpureg.regularize`; channels share a gradient
norm unless ``coupled`` is False (section 5.1). ``eps`` smooths the gradient norm (eq. 15) and is 0 unless given.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import backends
from .graph import FloatArray, Graph, GridGraph
from .problem import DeviceProblem, Problem, as_function
from .weights import Weights

__all__ = ["curvature", "dirichlet_energy", "energy", "gradient_norm", "laplacian", "p_laplacian"]

AnyGraph = Graph | GridGraph
AnyWeights = Weights | npt.ArrayLike | None


def _put(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    eps: float,
    coupled: bool,
    settings: dict[str, Any],
    *,
    lam: float | npt.ArrayLike = 0.0,
    f0: npt.ArrayLike | None = None,
) -> tuple[DeviceProblem, FloatArray]:
    """The problem whose data is `f0` (or f itself) on the device, and f as (n, m)."""
    if isinstance(eps, bool) or not isinstance(eps, int | float | np.number):
        raise TypeError(f"eps must be a number, got {eps!r}")
    kind = np.dtype(settings["dtype"] or np.float32)
    make = {"p": p, "lam": lam, "weights": settings["weights"], "gamma": settings["gamma"]}
    make |= {"coupled": coupled, "eps": eps, "dtype": kind}
    problem = Problem.make(f if f0 is None else f0, graph, **make)
    function = problem.f0 if f0 is None else as_function(graph, f, "f")
    if function.shape != problem.f0.shape:
        raise ValueError(f"f and f0 must have the same shape, got {np.asarray(f).shape} and {np.asarray(f0).shape}")
    return DeviceProblem.put(problem, backends.get(settings["backend"], kind)), function


def gradient_norm(
    f: npt.ArrayLike,
    graph: AnyGraph,
    *,
    eps: float = 0.0,
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> FloatArray:
    """Local variation |grad_w f(u)| at every vertex (eq. 9; with eps, eq. 15).

    Returns
    -------
    array
        One number per vertex, in the shape of `f` without its channels, or one per channel if not `coupled`.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> gradient_norm([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([3., 3., 0.], dtype=float32)
    """
    settings = {"weights": weights, "gamma": gamma, "backend": backend, "dtype": dtype}
    on, function = _put(f, graph, 2.0, eps, coupled, settings)
    norm = on.backend.gradient_norm(on.weighted, on.put_function(function), power=0.5, eps=on.eps, coupled=coupled)
    shape = np.shape(f)
    bare = ((graph.n_vertices,), graph.shape if isinstance(graph, GridGraph) else None)
    # one number per vertex: the axis of the channels goes, where there is one
    return on.backend.get(graph, norm).reshape(shape if shape in bare or not coupled else shape[:-1])


def p_laplacian(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    *,
    eps: float = 0.0,
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> FloatArray:
    """Weighted p-Laplacian of f at every vertex (eq. 12), in the shape of `f`.

    It is the derivative of the p-Dirichlet energy (Property 2), positive semidefinite: the opposite sign of the
    Laplacian of PDEs.

    Parameters
    ----------
    p : float
        Degree > 0. For p < 2 an eps > 0 is needed: the gradient may vanish.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> p_laplacian([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), 2, backend="numpy")
    array([-6.,  6.,  0.], dtype=float32)
    """
    settings = {"weights": weights, "gamma": gamma, "backend": backend, "dtype": dtype}
    on, function = _put(f, graph, p, eps, coupled, settings)
    put = on.put_function(function)
    g = None
    if p != 2:
        g = on.backend.gradient_norm(on.weighted, put, power=(p - 2) / 2, eps=on.eps, coupled=coupled)
    host = on.backend.get(graph, on.backend.p_laplacian(on.weighted, put, g))
    if on.scale is not None:
        # gamma_uv = sqrt(w) s(u): the p-Laplacian of f is s times that of s f under gamma = sqrt(w)
        host = (host * on.scale).astype(host.dtype)
    return host.reshape(np.shape(f))


def laplacian(f: npt.ArrayLike, graph: AnyGraph, **settings: Any) -> FloatArray:
    """Weighted Laplacian, the p-Laplacian of p = 2 (eq. 16), in the shape of `f`; the settings are those of it.

    With ``gamma="combinatorial"`` it is the matrix D - W of Table I times f, with "normalized" I - D^-1/2 W D^-1/2. The
    default "sqrt" gives 2 (D - W) f.

    Examples
    --------
    >>> laplacian([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), gamma="combinatorial", backend="numpy").round(5)
    array([-3.,  3.,  0.], dtype=float32)
    """
    return p_laplacian(f, graph, 2.0, **settings)


def curvature(f: npt.ArrayLike, graph: AnyGraph, *, eps: float, **settings: Any) -> FloatArray:
    """Weighted curvature, the p-Laplacian of p = 1 (eq. 18), in the shape of `f`; the settings are those of it.

    `eps` > 0 is needed: the gradient may vanish.
    """
    return p_laplacian(f, graph, 1.0, eps=eps, **settings)


def dirichlet_energy(f: npt.ArrayLike, graph: AnyGraph, p: float, **settings: Any) -> float:
    """p-Dirichlet energy 1/p sum_u |grad_w f(u)|^p (eq. 20, with eps eq. 15); the settings are those of p_laplacian.

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
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str = "sqrt",
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
    settings = {"weights": weights, "gamma": gamma, "backend": backend, "dtype": dtype}
    # The sum, unlike the derivative, needs no eps > 0: any stands in while the arguments are checked.
    on, function = _put(f, graph, p, eps or 1.0, coupled, settings, lam=lam, f0=f0)
    put = on.put_function(function)
    return on.backend.energy(on.weighted, put, on.f0, on.lam, p=on.p, eps=float(eps), coupled=coupled)
