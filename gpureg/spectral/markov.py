"""Compute the Markov matrix of a graph, and p = 2 without data as an iterated averaging filter (section 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray
from ..checks import integer, number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem, as_function
from ..weights import Bilateral, Patch
from ..weights.base import AnyWeights

if TYPE_CHECKING:
    from scipy import sparse


class AveragingFilter(NamedTuple):
    """The coefficients of a sweep as an average (eq. 26): f+ = data f0 + neighbours f.

    Attributes
    ----------
    data : (n,) array
        phi_uu, the coefficient of the data.
    neighbours : (n, n) csr_array
        phi_uv, the coefficients of the neighbours. With `data`, rows sum to 1.
    """

    data: FloatArray
    neighbours: sparse.csr_array


def stored_weights(
    graph: GraphLike, f: npt.ArrayLike | None, weights: AnyWeights, p: float, lam: float | npt.ArrayLike, eps: Any
) -> tuple[Graph, FloatArray, FloatArray | None, Problem]:
    """Return the graph as CSR, (n_edges,) weights, conductances g, (n,) or None, and the problem."""
    graph = as_graph(graph, degrees=True)
    p = number("p", p, above=0)
    if f is None and isinstance(weights, Bilateral | Patch):
        raise ValueError("these weights are computed from data: give f, the function they compare")
    if f is None and p != 2:
        raise ValueError(f"the matrix depends on f for p = {p:g}: give f (for p = 2 it does not)")
    data = np.zeros(graph.n_vertices) if f is None else f
    kind = np.dtype(np.float64)
    problem = Problem.make(data, graph, p=p, lam=lam, weights=weights, eps=eps, dtype=kind)
    on = DeviceProblem.put(problem, backends.get("numpy", kind))
    values = on.backend.get_weights(on.weighted)
    if isinstance(graph, GridGraph):
        half = graph.edges.unit_half() if values is None else values
        stored, values = graph.to_graph(), graph.edges.gather_half(half)
    else:
        stored = graph
        values = np.ones(graph.n_edges) if values is None else values
    g = on.conductances(on.put_function(problem.f0))
    return stored, values.astype(np.float64), None if g is None else np.asarray(g)[:, 0], problem


@door
def averaging_filter(
    graph: GraphLike,
    f: npt.ArrayLike | None = None,
    *,
    p: float = 2.0,
    lam: float | npt.ArrayLike = 1.0,
    eps: float | None = None,
    weights: AnyWeights = None,
) -> AveragingFilter:
    """Compute the coefficients of the averaging form of a sweep at f (eq. 26), for gamma = sqrt(w).

    With alpha of eq. 25::

        phi_uv = alpha_uv / (lam + sum_v alpha_uv)
        phi_uu = lam / (lam + sum_v alpha_uv)

    Parameters
    ----------
    graph : Graph or GridGraph
    f : array, optional
        The function for the conductances, in any shape of :func:`gpureg.regularize`; all channels have the same ones.
        Not needed for p = 2, unless weights are computed from it.
    p, lam, eps, weights
        As in :func:`gpureg.regularize`.

    Returns
    -------
    AveragingFilter
        ``data`` (n,) and ``neighbours`` (n, n): the next iterate is ``data * f0 + neighbours @ f``.

    Raises
    ------
    ValueError, TypeError
        No f with p other than 2 or with weights computed from data; otherwise as :func:`gpureg.regularize`.

    Examples
    --------
    >>> import gpureg as gr
    >>> filter = gr.spectral.averaging_filter(gr.Graph.from_edges([[0, 1], [1, 2]]), lam=2.0)
    >>> filter.data, filter.neighbours.toarray()
    (array([0.5       , 0.33333333, 0.5       ]), array([[0.        , 0.5       , 0.        ],
           [0.33333333, 0.        , 0.33333333],
           [0.        , 0.5       , 0.        ]]))
    """
    from scipy import sparse

    stored, w, g, problem = stored_weights(graph, f, weights, p, lam, eps)
    rows, n = stored.edge_rows(), stored.n_vertices
    alpha = 2 * w if g is None else w * (g[rows] + g[stored.indices])
    total = np.bincount(rows, alpha, minlength=n)
    fidelity = np.broadcast_to(problem.lam, (n, 1))[:, 0]
    # at pinned vertices, or without neighbours, a sweep keeps the data
    keeps = np.isinf(fidelity) | ~(np.where(np.isinf(fidelity), 0, fidelity) + total > 1e-290)
    denominator = np.where(keeps, 1, fidelity + total)
    share = np.where(keeps[rows], 0, alpha / denominator[rows])
    neighbours = sparse.csr_array((share, stored.indices, stored.indptr), shape=(n, n), copy=True)
    return AveragingFilter(np.where(keeps, 1, fidelity / denominator), neighbours)


@door
def markov_matrix(
    graph: GraphLike,
    f: npt.ArrayLike | None = None,
    *,
    p: float = 2.0,
    eps: float | None = None,
    weights: AnyWeights = None,
) -> sparse.csr_array:
    """Compute the Markov matrix P of the process without data (eq. 27).

    P(u, v) = phi_uv, and rows sum to 1. For p = 2 it is D^-1 W; for other p it depends on `f`. At a vertex without
    weight P(u, u) = 1. ``scipy.sparse.linalg.matrix_power(P, t)`` computes P^t, and :func:`gpureg.spectral.diffuse` its
    action.

    Parameters
    ----------
    graph, f, p, eps, weights
        As in :func:`gpureg.spectral.averaging_filter`.

    Returns
    -------
    (n, n) csr_array

    Raises
    ------
    ValueError, TypeError
        As :func:`averaging_filter`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.operators.markov_matrix(gr.Graph.from_edges([[0, 1], [1, 2]])).toarray()
    array([[0. , 1. , 0. ],
           [0.5, 0. , 0.5],
           [0. , 1. , 0. ]])
    """
    from scipy import sparse

    found = averaging_filter(graph, f, p=p, lam=0.0, eps=eps, weights=weights)
    alone = np.flatnonzero(found.data)
    if not len(alone):
        return found.neighbours
    n = len(found.data)
    return sparse.csr_array(found.neighbours + sparse.csr_array((np.ones(len(alone)), (alone, alone)), shape=(n, n)))


@door
def diffuse(f0: npt.ArrayLike, graph: GraphLike, t: int, *, weights: AnyWeights = None) -> FloatArray:
    """Diffuse a function: compute P^t f0 (eq. 28), t plain sweeps with p = 2 and lam = 0, in float64.

    Parameters
    ----------
    f0 : array
        (n,) or (n, m), on a grid also its shape with or without channels. Weight functions are computed from it.
    graph : Graph or GridGraph
    t : int
        Number of steps >= 0.
    weights : Weights or array, optional
        As in :func:`gpureg.regularize`.

    Returns
    -------
    array
        In the shape of `f0`.

    Raises
    ------
    ValueError, TypeError
        A negative t; otherwise as :func:`averaging_filter`.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.spectral.diffuse([0.0, 4.0, 0.0], gr.Graph.from_edges([[0, 1], [1, 2]]), 1)
    array([4., 0., 4.])
    """
    t = integer("t", t, low=0)
    graph = as_graph(graph, degrees=True)
    P = markov_matrix(graph, f0, weights=weights)
    f: FloatArray = as_function(graph, f0, "f0").astype(np.float64)
    for _ in range(t):
        f = P @ f
    return f.reshape(np.shape(f0))
