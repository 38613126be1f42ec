"""Diffusion and spectrum (section 4.1 of the paper): the Markov matrix of the process, and its eigenvectors.

A sweep of the Gauss-Jacobi process is f+ = phi_uu f0 + sum_v phi_uv f(v) (eq. 26). Without data, with gamma = sqrt(w),
it is a step of a random walk, f+ = P f (eq. 27), and for p = 2 P = D^-1 W does not depend on f (eq. 28). P is symmetric
in the inner product <f, h>_delta = sum_u delta(u) f(u) h(u), delta being the degree, and not in the Euclidean one; its
eigenvalues lie in [-1, 1].
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import backends
from .arrays import FloatArray
from .graphs.csr import Graph
from .graphs.grid import AnyGraph, GridGraph
from .problem import DeviceProblem, Problem, as_function
from .weights import Bilateral, Patch, Weights

if TYPE_CHECKING:
    from scipy import sparse

__all__ = [
    "AveragingFilter",
    "Eigenpairs",
    "averaging_filter",
    "diffuse",
    "eigenpairs",
    "markov_matrix",
    "spectral_filter",
]

AnyWeights = Weights | npt.ArrayLike | None

# Up to so many vertices a connected part goes through a dense eigensolver.
_DENSE = 600
# Neighbours a vertex up to which a sparse factorisation is taken to stay sparse.
_FACTORABLE = 30
# Shift of the factorised matrix: so far above the spectrum that it is definite, near enough to part eigenvalues at 1.
_ABOVE = 1e-4


class AveragingFilter(NamedTuple):
    """One sweep as an average (eq. 26): f+ = data f0 + neighbours f.

    Attributes
    ----------
    data : (n,) array
        phi_uu, the share of the data.
    neighbours : (n, n) csr_array
        phi_uv, the shares of the neighbours. With `data`, rows sum to 1.
    """

    data: FloatArray
    neighbours: sparse.csr_array


class Eigenpairs(NamedTuple):
    """The first eigenpairs of P = D^-1 W.

    Attributes
    ----------
    values : (k,) array
        Eigenvalues a_i, from 1 downwards; 1 - a_i is a frequency.
    vectors : (n, k) array
        Eigenvectors phi_i, orthonormal in the inner product weighted by `degree`.
    degree : (n,) array
        delta, 1 at a vertex without weight (which stays where it is: P(u, u) = 1).
    """

    values: FloatArray
    vectors: FloatArray
    degree: FloatArray


def _stored(
    graph: AnyGraph, f: npt.ArrayLike | None, weights: AnyWeights, p: float, lam: float | npt.ArrayLike, eps: Any
) -> tuple[Graph, FloatArray, FloatArray | None, Problem]:
    """The graph as CSR, its weights one per directed edge, the conductances g (n,) or None, and the problem."""
    if not isinstance(graph, Graph | GridGraph):
        raise TypeError(f"graph must be a Graph or a GridGraph, got {type(graph).__name__}")
    if f is None and isinstance(weights, Bilateral | Patch):
        raise ValueError("these weights are computed from data: give f, the function they compare")
    if f is None and p != 2:
        raise ValueError(f"the matrix depends on f for p = {p:g}: give f (for p = 2 it does not)")
    data = np.zeros(graph.n_vertices) if f is None else f
    kind = np.dtype(np.float64)
    problem = Problem.make(
        data, graph, p=p, lam=lam, weights=weights, gamma="sqrt", norm="vertex", coupled=True, eps=eps, dtype=kind
    )
    on = DeviceProblem.put(problem, backends.get("numpy", kind))
    values = on.backend.get_weights(on.weighted)
    if isinstance(graph, GridGraph):
        half = graph.unit_half_weights() if values is None else values
        stored, values = graph.to_graph(), graph.half_to_edges(half)
    else:
        stored = graph
        values = np.ones(graph.n_edges) if values is None else values
    g = on.conductances(on.put_function(problem.f0))
    return stored, values.astype(np.float64), None if g is None else np.asarray(g)[:, 0], problem


def averaging_filter(
    graph: AnyGraph,
    f: npt.ArrayLike | None = None,
    *,
    p: float = 2.0,
    lam: float | npt.ArrayLike = 1.0,
    eps: float | None = None,
    weights: AnyWeights = None,
) -> AveragingFilter:
    """Coefficients of the averaging form of a sweep at f (eq. 26), for gamma = sqrt(w).

    phi_uv = alpha_uv / (lam + sum_v alpha_uv) and phi_uu = lam / (lam + sum_v alpha_uv), with alpha of eq. 25.

    Parameters
    ----------
    graph : Graph or GridGraph
    f : array, optional
        Where the conductances are taken, in any shape of :func:`gpureg.regularize`; channels share them. Not needed for
        p = 2, unless weights are computed from it.
    p, lam, eps, weights
        As :func:`gpureg.regularize`.

    Returns
    -------
    AveragingFilter
        ``data`` (n,) and ``neighbours`` (n, n): the next iterate is ``data * f0 + neighbours @ f``.

    Raises
    ------
    ValueError, TypeError
        p other than 2, or weights computed from data, without f; otherwise as :func:`gpureg.regularize`.

    Examples
    --------
    >>> filter = averaging_filter(Graph.from_edges([[0, 1], [1, 2]]), lam=2.0)
    >>> filter.data, filter.neighbours.toarray()
    (array([0.5       , 0.33333333, 0.5       ]), array([[0.        , 0.5       , 0.        ],
           [0.33333333, 0.        , 0.33333333],
           [0.        , 0.5       , 0.        ]]))
    """
    from scipy import sparse

    stored, w, g, problem = _stored(graph, f, weights, p, lam, eps)
    rows, n = stored.edge_rows(), stored.n_vertices
    alpha = 2 * w if g is None else w * (g[rows] + g[stored.indices])
    total = np.bincount(rows, alpha, minlength=n)
    fidelity = np.broadcast_to(np.asarray(problem.lam, np.float64), (n,))
    # pinned, or nothing around: the data stays, as the sweep has it
    keeps = np.isinf(fidelity) | ~(np.where(np.isinf(fidelity), 0, fidelity) + total > 1e-290)
    denominator = np.where(keeps, 1, fidelity + total)
    share = np.where(keeps[rows], 0, alpha / denominator[rows])
    neighbours = sparse.csr_array((share, stored.indices, stored.indptr), shape=(n, n), copy=True)
    return AveragingFilter(np.where(keeps, 1, fidelity / denominator), neighbours)


def markov_matrix(
    graph: AnyGraph,
    f: npt.ArrayLike | None = None,
    *,
    p: float = 2.0,
    eps: float | None = None,
    weights: AnyWeights = None,
) -> sparse.csr_array:
    """Markov matrix P of the process without data (eq. 27): P(u, v) = phi_uv, rows sum to 1.

    For p = 2 it is D^-1 W; for other p it depends on `f`. A vertex without weight stays where it is, P(u, u) = 1. Its
    powers are P^t: ``scipy.sparse.linalg.matrix_power(P, t)``, or :func:`diffuse` for their action.

    Parameters
    ----------
    graph, f, p, eps, weights
        As :func:`averaging_filter`.

    Returns
    -------
    (n, n) csr_array

    Raises
    ------
    ValueError, TypeError
        As :func:`averaging_filter`.

    Examples
    --------
    >>> markov_matrix(Graph.from_edges([[0, 1], [1, 2]])).toarray()
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


def diffuse(f0: npt.ArrayLike, graph: AnyGraph, t: int, *, weights: AnyWeights = None) -> FloatArray:
    """P^t f0 (eq. 28): t plain sweeps with p = 2 and lam = 0, in float64.

    Parameters
    ----------
    f0 : array
        (n,) or (n, m), on a grid also its shape with or without channels. Weight functions are computed from it.
    t : int
        Steps >= 0.

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
    >>> diffuse([0.0, 4.0, 0.0], Graph.from_edges([[0, 1], [1, 2]]), 1)
    array([4., 0., 4.])
    """
    if isinstance(t, bool) or not isinstance(t, int | np.integer):
        raise TypeError(f"t must be an integer, got {t!r}")
    if t < 0:
        raise ValueError(f"t must be >= 0, got {t}")
    P = markov_matrix(graph, f0, weights=weights)
    f: FloatArray = as_function(graph, f0, "f0").astype(np.float64)
    for _ in range(t):
        f = P @ f
    return f.reshape(np.shape(f0))


def eigenpairs(graph: AnyGraph, k: int, *, f: npt.ArrayLike | None = None, weights: AnyWeights = None) -> Eigenpairs:
    """First k eigenpairs of the Markov matrix P = D^-1 W (section 4.1), from the eigenvalue 1 downwards.

    Through the symmetric D^-1/2 W D^-1/2, connected part by part (so that the eigenvalue 1 comes as often as there are
    parts), dense where a part is small, otherwise by ARPACK: shifted and factorised on sparse graphs, plain on others.

    Parameters
    ----------
    graph : Graph or GridGraph
    k : int
        1 <= k <= n.
    f : array, optional
        What weight functions are computed from.
    weights : Weights or array, optional
        As :func:`gpureg.regularize`.

    Returns
    -------
    Eigenpairs
        ``values`` (k,), ``vectors`` (n, k), ``degree`` (n,). The largest entry of a vector is positive. The same input
        gives the same bits.

    Raises
    ------
    ValueError, TypeError
        k out of range; otherwise as :func:`averaging_filter`.
    RuntimeError
        The eigensolver did not converge.

    Examples
    --------
    >>> eigenpairs(Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0]]), 4).values.round(6) + 0.0
    array([ 1.,  0.,  0., -1.])
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    if isinstance(k, bool) or not isinstance(k, int | np.integer):
        raise TypeError(f"k must be an integer, got {k!r}")
    stored, w, _, _ = _stored(graph, f, weights, 2.0, 0.0, None)
    n, rows = stored.n_vertices, stored.edge_rows()
    if not 1 <= k <= n:
        raise ValueError(f"k must lie in 1..{n}, the number of vertices, got {k}")
    W: Any = sparse.csr_array((w, stored.indices, stored.indptr), shape=(n, n), copy=True)
    W.eliminate_zeros()
    total = np.bincount(rows, w, minlength=n)
    alone = ~(total > 1e-290)
    degree = np.where(alone, 1.0, total)
    root = 1 / np.sqrt(degree)
    N = sparse.csr_array(sparse.diags_array(root) @ W @ sparse.diags_array(root))
    N = sparse.csr_array(N + sparse.diags_array(alone.astype(float)))
    count, part = connected_components(W, directed=False)
    # A part has its own 1; of the others at most k - count + 1 are among the first.
    wanted = max(1, k - count + 1)
    order = np.argsort(part, kind="stable")
    ends = np.cumsum(np.bincount(part))
    values, places, columns = [], [], []
    for members in np.split(order, ends[:-1])[: max(k, 1) if wanted == 1 else count]:
        a, vectors = _first(N[members][:, members], min(wanted, len(members)))
        values.append(a)
        for i in range(len(a)):
            places.append(members)
            columns.append(vectors[:, i])
    merged = np.concatenate(values)
    first = np.argsort(-merged, kind="stable")[:k]
    out = np.zeros((n, k))
    for i, j in enumerate(first):
        vector = columns[j] * root[places[j]]
        out[places[j], i] = vector * np.sign(vector[np.argmax(np.abs(vector))])
    return Eigenpairs(merged[first], out, degree)


def _first(N: sparse.csr_array, k: int) -> tuple[FloatArray, FloatArray]:
    """The k largest eigenvalues of a symmetric matrix of one connected part, downwards, with orthonormal vectors."""
    from scipy import sparse
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, splu

    n = N.shape[0]
    if n <= _DENSE or k >= n - 1:
        a, vectors = np.linalg.eigh(N.toarray())
        return a[::-1][:k], vectors[:, ::-1][:, :k]
    start = np.random.default_rng(1).standard_normal(n)
    # a few more than asked for: the last ones of a cluster of equal eigenvalues come late
    more = min(k + 4, n - 1)
    try:
        if N.nnz <= _FACTORABLE * n:
            # Definite: no pivoting, so that the ordering for symmetric matrices holds.
            shifted = sparse.csc_array(N - (1 + _ABOVE) * sparse.eye_array(n))
            factors = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            inverse = LinearOperator((n, n), matvec=factors.solve, dtype=np.float64)
            _, V = eigsh(N, k=more, sigma=1 + _ABOVE, which="LM", v0=start, OPinv=inverse)
        else:
            _, V = eigsh(N, k=more, which="LA", v0=start, ncv=min(n, max(2 * more + 1, 40)))
    except ArpackNoConvergence as error:
        raise RuntimeError(f"the eigensolver did not converge for {k} pairs of {n} vertices: {error}") from None
    # One step of Rayleigh and Ritz: orthonormal to rounding.
    V = np.linalg.qr(V)[0]
    a, turn = np.linalg.eigh(V.T @ (N @ V))
    V = V @ turn[:, ::-1]
    return a[::-1][:k], V[:, :k]


def spectral_filter(
    f0: npt.ArrayLike,
    graph: AnyGraph,
    k: int,
    *,
    weights: AnyWeights = None,
    pairs: Eigenpairs | None = None,
) -> FloatArray:
    """Projection of a function on the first k eigenvectors of P (section 4.1): a low-pass filter.

    f = sum_i <f0, phi_i>_delta phi_i over i <= k, with the inner product weighted by the degree.

    Parameters
    ----------
    f0 : array
        (n,) or (n, m), on a grid also its shape with or without channels.
    graph : Graph or GridGraph
    k : int
        1 <= k <= n.
    weights : Weights or array, optional
        As :func:`gpureg.regularize`; weight functions are computed from `f0`.
    pairs : Eigenpairs, optional
        At least k pairs of this graph from :func:`eigenpairs`, computed once for many functions.

    Returns
    -------
    array
        float64, in the shape of `f0`.

    Raises
    ------
    ValueError, TypeError
        k out of range, pairs of another graph; otherwise as :func:`eigenpairs`.

    Examples
    --------
    >>> ring = Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> spectral_filter([1.0, 2.0, 3.0, 6.0], ring, 1)
    array([3., 3., 3., 3.])
    """
    f = as_function(graph, f0, "f0").astype(np.float64)
    if pairs is None:
        pairs = eigenpairs(graph, k, f=f0, weights=weights)
    elif pairs.vectors.shape[0] != graph.n_vertices or not 1 <= k <= pairs.vectors.shape[1]:
        raise ValueError(
            f"pairs must hold at least k = {k} eigenvectors of {graph.n_vertices} vertices, got {pairs.vectors.shape}"
        )
    V = pairs.vectors[:, :k]
    result: FloatArray = V @ (V.T @ (pairs.degree[:, None] * f))
    return result.reshape(np.shape(f0))
