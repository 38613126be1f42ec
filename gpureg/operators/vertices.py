"""Operators of sections 2 and 3 of the paper, on any graph and device: :mod:`gpureg.operators`.

Each takes a function on the vertices, (n,), (n, m), or on a grid its shape with or without a last axis of channels, and
the settings ``weights``, ``gamma``, ``backend`` and ``dtype`` of :func:`gpureg.regularize`; channels share a gradient
norm unless ``coupled`` is False (section 5.1). ``eps`` smooths the gradient norm (eq. 15) and is 0 unless given.
``norm`` is that of :func:`gpureg.regularize`. A function on the edges has one value per stored directed edge,
(n_edges,) or (n_edges, m), in the order of the graph's rows; for a grid, of ``grid.to_graph()``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import backends
from .arrays import FloatArray
from .graphs.csr import Graph
from .graphs.grid import AnyGraph, GridGraph
from .problem import DeviceProblem, Problem, as_function
from .spectral import markov_matrix
from .weights import Weights

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
    make["norm"] = settings.get("norm", "vertex")
    make |= {"coupled": coupled, "eps": eps, "dtype": kind}
    problem = Problem.make(f if f0 is None else f0, graph, **make)
    function = problem.f0 if f0 is None else as_function(graph, f, "f")
    if function.shape != problem.f0.shape:
        raise ValueError(f"f and f0 must have the same shape, got {np.asarray(f).shape} and {np.asarray(f0).shape}")
    return DeviceProblem.put(problem, backends.get(settings["backend"], kind)), function


def _edge_function(graph: AnyGraph, H: npt.ArrayLike) -> FloatArray:
    """A function on the edges as (n_edges, m), after checking it."""
    array = np.asarray(H)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"H must hold real numbers, got {array.dtype}")
    if array.ndim not in (1, 2) or len(array) != graph.n_edges or (array.ndim == 2 and not array.shape[1]):
        raise ValueError(
            f"H must have shape ({graph.n_edges},) or ({graph.n_edges}, m), one row per directed edge, "
            f"got {array.shape}"
        )
    table: FloatArray = array.reshape(graph.n_edges, array.shape[1] if array.ndim == 2 else 1).astype(np.float64)
    if not np.isfinite(table).all():
        raise ValueError(f"H must be finite, got {table[~np.isfinite(table)][0]}")
    return table


def difference(
    f: npt.ArrayLike,
    graph: AnyGraph,
    *,
    weights: AnyWeights = None,
    gamma: str | npt.ArrayLike = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> FloatArray:
    """Weighted difference d_w f (eq. 4), a function on the edges.

    d_w(f)(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u).

    Returns
    -------
    (n_edges,) or (n_edges, m) array
        One row per directed edge; (n_edges,) where `f` has no axis of channels.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> difference([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([ 3., -3.,  0.,  0.], dtype=float32)
    """
    settings = {"weights": weights, "gamma": gamma, "backend": backend, "dtype": dtype}
    on, function = _put(f, graph, 2.0, 0.0, True, settings)
    host = on.backend.get_edges(graph, on.backend.difference(on.weighted, on.put_function(function)))
    if isinstance(graph, GridGraph):
        host = graph.window_to_edges(host)
    return host[:, 0] if np.shape(f) in _bare(graph) else host


def _bare(graph: AnyGraph) -> tuple[tuple[int, ...], ...]:
    """Shapes of a function without an axis of channels."""
    return ((graph.n_vertices,), graph.shape) if isinstance(graph, GridGraph) else ((graph.n_vertices,),)


def edge_derivative(f: npt.ArrayLike, graph: AnyGraph, edges: npt.ArrayLike, **settings: Any) -> FloatArray:
    """Derivative of f at u along the edges (u, v) (eq. 5): the difference d_w(f)(u, v) at these edges.

    Parameters
    ----------
    edges : (k, 2) int array
        Pairs (u, v) of adjacent vertices.
    **settings
        As :func:`difference`.

    Returns
    -------
    (k,) or (k, m) array

    Raises
    ------
    ValueError, TypeError
        A pair that is no edge; otherwise as :func:`difference`.

    Examples
    --------
    >>> edge_derivative([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), [[1, 0]], backend="numpy")
    array([-3.], dtype=float32)
    """
    pairs = np.asarray(edges)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise ValueError(f"edges must be integers of shape (k, 2), got {pairs.dtype} of shape {pairs.shape}")
    n = graph.n_vertices
    stored = graph.to_graph() if isinstance(graph, GridGraph) else graph
    u, v = pairs.astype(np.int64).T
    inside = (pairs >= 0).all(axis=1) & (pairs < n).all(axis=1)
    # rows are sorted: an edge's number u n + v is found by bisection
    numbers = stored.edge_rows() * n + stored.indices
    at = np.minimum(np.searchsorted(numbers, u * n + v), max(len(numbers) - 1, 0))
    found = inside & (numbers[at] == u * n + v) if len(numbers) else np.zeros(len(pairs), bool)
    if not found.all():
        raise ValueError(f"{tuple(pairs[~found][0].tolist())} is no edge of the graph")
    derivative: FloatArray = difference(f, graph, **settings)[at]
    return derivative


def adjoint(
    H: npt.ArrayLike,
    graph: AnyGraph,
    *,
    weights: AnyWeights = None,
    gamma: str | npt.ArrayLike = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> FloatArray:
    """Adjoint of the difference, of a function on the edges (eq. 7, Proposition 1).

    d_w*(H)(u) = sum_v gamma(u, v) (H(v, u) - H(u, v)), so that <d_w f, H> = <f, d_w* H> for every f (eq. 6).

    Parameters
    ----------
    H : (n_edges,) or (n_edges, m) array
        One row per directed edge.
    weights : Weights or array, optional
        As :func:`gpureg.regularize`; a weight function must not look at data, for there is none here.

    Returns
    -------
    (n,) or (n, m) array

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> adjoint([1.0, 0.0, 0.0, 0.0], Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([-1.,  1.,  0.], dtype=float32)
    """
    if not isinstance(graph, Graph | GridGraph):
        raise TypeError(f"graph must be a Graph or a GridGraph, got {type(graph).__name__}")
    table = _edge_function(graph, H)
    settings = {"weights": weights, "gamma": gamma, "backend": backend, "dtype": dtype}
    on, _ = _put(np.zeros(graph.n_vertices), graph, 2.0, 0.0, True, settings)
    planes = graph.edges_to_window(table) if isinstance(graph, GridGraph) else table
    host = on.backend.get(graph, on.backend.adjoint(on.weighted, on.backend.put_edges(graph, planes)))
    if on.scale is not None:
        host = (host * on.scale).astype(host.dtype)
    return host[:, 0] if np.ndim(H) == 1 else host


def divergence(H: npt.ArrayLike, graph: AnyGraph, **settings: Any) -> FloatArray:
    """Divergence of a function on the edges, the opposite of its :func:`adjoint`, whose settings it takes.

    It sums to 0 over the vertices where gamma is symmetric (Property 1).

    Examples
    --------
    >>> divergence([1.0, 0.0, 0.0, 0.0], Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([ 1., -1.,  0.], dtype=float32)
    """
    return 0 - adjoint(H, graph, **settings)


def gradient_norm(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float = 2.0,
    *,
    eps: float = 0.0,
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str | npt.ArrayLike = "sqrt",
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
) -> FloatArray:
    """Local variation |grad_w f(u)|_p at every vertex: the L^2 norm of eq. 9, or the L^p norm of eq. 10.

    Parameters
    ----------
    p : float, default 2
        Exponent > 0 of the norm: (sum_v |d_w(f)(u, v)|^p)^(1/p).
    eps : float, default 0
        Smoothing: of the whole norm for p = 2 (eq. 15), of every difference, (d^2 + eps^2)^(1/2), otherwise.

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
    if isinstance(p, bool) or not isinstance(p, int | float | np.number):
        raise TypeError(f"p must be a number, got {p!r}")
    if not (np.isfinite(p) and p > 0):
        raise ValueError(f"p must be finite and > 0, got {p}")
    on, function = _put(f, graph, 2.0, eps, coupled, settings)
    powers = {"power": 0.5} if p == 2 else {"power": 1 / float(p), "edge_power": float(p) / 2}
    norm = on.backend.gradient_norm(on.weighted, on.put_function(function), eps=on.eps, coupled=coupled, **powers)
    shape = np.shape(f)
    # one number per vertex: the axis of the channels goes, where there is one
    return on.backend.get(graph, norm).reshape(shape if shape in _bare(graph) or not coupled else shape[:-1])


def p_laplacian(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    *,
    eps: float = 0.0,
    norm: str = "vertex",
    coupled: bool = True,
    weights: AnyWeights = None,
    gamma: str | npt.ArrayLike = "sqrt",
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
    norm : {"vertex", "edge"}, default "vertex"
        "edge" gives the derivative of eq. 30: sum_v gamma(u, v) |d|^(p - 2) (gamma(u, v) f(u) - gamma(v, u) f(v)).

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> p_laplacian([0.0, 3.0, 3.0], Graph.from_edges([[0, 1], [1, 2]]), 2, backend="numpy")
    array([-6.,  6.,  0.], dtype=float32)
    """
    settings = {"weights": weights, "gamma": gamma, "norm": norm, "backend": backend, "dtype": dtype}
    on, function = _put(f, graph, p, eps, coupled, settings)
    put = on.put_function(function)
    host = on.backend.get(graph, on.backend.p_laplacian(on.weighted, put, on.conductances(put)))
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
    norm: str = "vertex",
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
    on, function = _put(f, graph, p, eps or 1.0, coupled, settings, lam=lam, f0=f0)
    put = on.put_function(function)
    return on.backend.energy(
        on.weighted, put, on.f0, on.lam, p=on.p, eps=float(eps), coupled=coupled, edge_norm=on.edge_norm
    )
