"""Operators between functions on the vertices and functions on the edges (section 2.2)."""

from __future__ import annotations

from typing import Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.grid import AnyGraph, GridGraph
from ..model.problem import uses_degrees
from .on_device import SETTINGS, Settings, bare, put_function


def _edge_function(graph: AnyGraph, H: npt.ArrayLike) -> FloatArray:
    """Check a function on the edges; return it as (n_edges, m)."""
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


@door(options=SETTINGS)
def difference(f: npt.ArrayLike, graph: GraphLike, **settings: Unpack[Settings]) -> FloatArray:
    """Compute the weighted difference d_w f (eq. 4), a function on the edges.

    Its values are::

        d_w(f)(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u)

    Returns
    -------
    (n_edges,) or (n_edges, m) array
        One row per directed edge; (n_edges,) if `f` has no axis of channels.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.difference([0.0, 3.0, 3.0], gr.Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([ 3., -3.,  0.,  0.], dtype=float32)
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    on, function = put_function(f, graph, 2.0, settings)
    host = on.backend.get_edges(graph, on.backend.difference(on.weighted, on.put_function(function)))
    if isinstance(graph, GridGraph):
        host = graph.edges.gather(host)
    return host[:, 0] if np.shape(f) in bare(graph) else host


@door(options=SETTINGS)
def edge_derivative(
    f: npt.ArrayLike, graph: GraphLike, edges: npt.ArrayLike, **settings: Unpack[Settings]
) -> FloatArray:
    """Compute the derivative of f at u along edges (u, v) (eq. 5), which is d_w(f)(u, v).

    Parameters
    ----------
    edges : (k, 2) int array
        Pairs (u, v) of adjacent vertices.
    weights, gamma, backend, dtype
        As in :func:`difference`.

    Returns
    -------
    (k,) or (k, m) array

    Raises
    ------
    ValueError, TypeError
        A pair that is not an edge; otherwise as :func:`difference`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.edge_derivative([0.0, 3.0, 3.0], gr.Graph.from_edges([[0, 1], [1, 2]]), [[1, 0]], backend="numpy")
    array([-3.], dtype=float32)
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    pairs = np.asarray(edges)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise ValueError(f"edges must be integers of shape (k, 2), got {pairs.dtype} of shape {pairs.shape}")
    n = graph.n_vertices
    stored = graph.to_graph() if isinstance(graph, GridGraph) else graph
    u, v = pairs.astype(np.int64).T
    inside = (pairs >= 0).all(axis=1) & (pairs < n).all(axis=1)
    # rows are sorted: search the number u n + v of an edge by bisection
    numbers = stored.edge_rows() * n + stored.indices
    at = np.minimum(np.searchsorted(numbers, u * n + v), max(len(numbers) - 1, 0))
    found = inside & (numbers[at] == u * n + v) if len(numbers) else np.zeros(len(pairs), bool)
    if not found.all():
        raise ValueError(f"{tuple(pairs[~found][0].tolist())} is not an edge of the graph")
    derivative: FloatArray = difference(f, graph, **settings)[at]
    return derivative


@door(options=SETTINGS)
def adjoint(H: npt.ArrayLike, graph: GraphLike, **settings: Unpack[Settings]) -> FloatArray:
    """Apply the adjoint of the difference to a function on the edges (eq. 7, Proposition 1).

    <d_w f, H> = <f, d_w* H> for every f (eq. 6), with::

        d_w*(H)(u) = sum_v gamma(u, v) (H(v, u) - H(u, v))

    Parameters
    ----------
    H : (n_edges,) or (n_edges, m) array
        One row per directed edge.
    weights : Weights or array, optional
        As in :func:`gpureg.regularize`; a weight function that needs data cannot be used.

    Returns
    -------
    (n,) or (n, m) array

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.adjoint([1.0, 0.0, 0.0, 0.0], gr.Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([-1.,  1.,  0.], dtype=float32)
    """
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    table = _edge_function(graph, H)
    on, _ = put_function(np.zeros(graph.n_vertices), graph, 2.0, settings)
    planes = graph.edges.scatter(table) if isinstance(graph, GridGraph) else table
    host = on.backend.get(graph, on.backend.adjoint(on.weighted, on.backend.put_edges(graph, planes)))
    if on.scale is not None:
        host = (host * on.scale).astype(host.dtype)
    return host[:, 0] if np.ndim(H) == 1 else host


@door(options=SETTINGS)
def divergence(H: npt.ArrayLike, graph: GraphLike, **settings: Unpack[Settings]) -> FloatArray:
    """Compute the divergence of a function on the edges: :func:`adjoint` with the opposite sign, and its settings.

    Its sum over the vertices is 0 if gamma is symmetric (Property 1).

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.divergence([1.0, 0.0, 0.0, 0.0], gr.Graph.from_edges([[0, 1], [1, 2]]), backend="numpy")
    array([ 1., -1.,  0.], dtype=float32)
    """
    return 0 - adjoint(H, graph, **settings)
