"""Apply operators to functions on the vertices (sections 2.3 to 2.6)."""

from __future__ import annotations

from typing import Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..model.problem import uses_degrees
from .on_device import CHANNELS, SETTINGS, SMOOTHED, Channels, Settings, Smoothed, bare, put_function


@door(options=SETTINGS)
def gradient_norm(
    f: npt.ArrayLike,
    graph: GraphLike,
    p: float = 2.0,
    *,
    eps: float = 0.0,
    coupled: bool = True,
    **settings: Unpack[Settings],
) -> FloatArray:
    """Compute the local variation |grad_w f(u)|_p at every vertex: the L^2 norm of eq. 9, or the L^p norm of eq. 10.

    Parameters
    ----------
    p : float, default 2
        Exponent > 0 of the norm: (sum_v |d_w(f)(u, v)|^p)^(1/p).
    eps : float, default 0
        Smoothing: of the norm for p = 2 (eq. 15), otherwise of every difference, (d^2 + eps^2)^(1/2).

    Returns
    -------
    array
        One number per vertex, in the shape of `f` without channels; with ``coupled=False`` in the shape of `f`.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.gradient_norm([0.0, 3.0, 3.0], gr.Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([3., 3., 0.], dtype=float32)
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    number("p", p, above=0)
    on, function = put_function(f, graph, 2.0, {"eps": eps, "coupled": coupled, **settings})
    powers = {"power": 0.5} if p == 2 else {"power": 1 / float(p), "edge_power": float(p) / 2}
    norm = on.backend.gradient_norm(on.weighted, on.put_function(function), eps=on.eps, coupled=coupled, **powers)
    shape = np.shape(f)
    # with one number per vertex, drop the axis of channels, if there is one
    return on.backend.get(graph, norm).reshape(shape if shape in bare(graph) or not coupled else shape[:-1])


@door(options=SMOOTHED)
def p_laplacian(f: npt.ArrayLike, graph: GraphLike, p: float, **settings: Unpack[Smoothed]) -> FloatArray:
    """Compute the weighted p-Laplacian of f at every vertex (eq. 12), in the shape of `f`.

    It is the derivative of the p-Dirichlet energy (Property 2). It is positive semidefinite, with the opposite sign of
    the Laplacian of PDEs.

    Parameters
    ----------
    p : float
        Degree > 0. p < 2 needs eps > 0, because the gradient may be 0.
    eps : float, default 0
        Smoothing of the gradient norm (eq. 15).
    norm : {"vertex", "edge"}, default "vertex"
        "edge" gives the derivative of eq. 30: sum_v gamma(u, v) |d|^(p - 2) (gamma(u, v) f(u) - gamma(v, u) f(v)).
    coupled, weights, gamma, backend, dtype
        As in :func:`gpureg.regularize`.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.p_laplacian([0.0, 3.0, 3.0], gr.Graph.from_edges([[0, 1], [1, 2]]), 2, backend="numpy")
    array([-6.,  6.,  0.], dtype=float32)
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    on, function = put_function(f, graph, p, settings)
    put = on.put_function(function)
    host = on.backend.get(graph, on.backend.p_laplacian(on.weighted, put, on.conductances(put)))
    if on.scale is not None:
        # gamma_uv = sqrt(w) s(u): the p-Laplacian of f is s times that of s f under gamma = sqrt(w)
        host = (host * on.scale).astype(host.dtype)
    return host.reshape(np.shape(f))


@door(options=SMOOTHED)
def laplacian(f: npt.ArrayLike, graph: GraphLike, **settings: Unpack[Smoothed]) -> FloatArray:
    """Compute the weighted Laplacian, the p-Laplacian for p = 2 (eq. 16), with the same shape and settings.

    With ``gamma="combinatorial"`` it is the matrix D - W of Table I times f, with "normalized" I - D^-1/2 W D^-1/2
    times f. The default "sqrt" gives 2 (D - W) f.

    Examples
    --------
    >>> import gpureg as gr
    >>> path = gr.Graph.from_edges([[0, 1], [1, 2]])
    >>> gr.operators.laplacian([0.0, 3.0, 3.0], path, gamma="combinatorial", backend="numpy").round(5)
    array([-3.,  3.,  0.], dtype=float32)
    """
    return p_laplacian(f, graph, 2.0, **settings)


@door(options=CHANNELS)
def curvature(f: npt.ArrayLike, graph: GraphLike, *, eps: float, **settings: Unpack[Channels]) -> FloatArray:
    """Compute the weighted curvature, the p-Laplacian for p = 1 (eq. 18), with the same shape and settings.

    `eps` must be > 0, because the gradient may be 0.
    """
    return p_laplacian(f, graph, 1.0, eps=eps, **settings)
