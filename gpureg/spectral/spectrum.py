"""Compute the first eigenpairs of the Markov matrix, and filters from them (section 4.1 of the paper)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import integer
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..model.problem import as_function
from ..weights.base import AnyWeights
from .markov import stored_weights

if TYPE_CHECKING:
    from scipy import sparse

# A connected part of at most this number of vertices uses a dense eigensolver.
_DENSE = 600
# Neighbours per vertex up to which a sparse factorization is expected to stay sparse.
_FACTORABLE = 30
# Shift above the spectrum: large enough for a definite matrix, small enough to separate eigenvalues near 1.
_ABOVE = 1e-4


class Eigenpairs(NamedTuple):
    """The first eigenpairs of P = D^-1 W.

    Attributes
    ----------
    values : (k,) array
        Eigenvalues a_i, from 1 in descending order; 1 - a_i is a frequency.
    vectors : (n, k) array
        Eigenvectors phi_i, orthonormal in the inner product weighted by `degree`.
    degree : (n,) array
        delta; 1 at a vertex without weight, where P(u, u) = 1.
    """

    values: FloatArray
    vectors: FloatArray
    degree: FloatArray


@door
def eigenpairs(graph: GraphLike, k: int, *, f: npt.ArrayLike | None = None, weights: AnyWeights = None) -> Eigenpairs:
    """Compute the k largest eigenvalues of the Markov matrix P = D^-1 W (section 4.1), and their eigenvectors.

    Uses the symmetric matrix D^-1/2 W D^-1/2 of each connected part (each part has one eigenvalue 1), with a dense
    solver for small parts, otherwise with ARPACK: with shift and factorization on sparse graphs, without on others.

    Parameters
    ----------
    graph : Graph or GridGraph
    k : int
        1 <= k <= n.
    f : array, optional
        The data for weight functions.
    weights : Weights or array, optional
        As in :func:`gpureg.regularize`.

    Returns
    -------
    Eigenpairs
        ``values`` (k,), ``vectors`` (n, k), ``degree`` (n,). The entry of largest absolute value of a vector is
        positive. The same input gives the same output, bit for bit.

    Raises
    ------
    ValueError, TypeError
        k out of range; otherwise as :func:`averaging_filter`.
    RuntimeError
        The eigensolver did not converge.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.spectral.eigenpairs(gr.Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0]]), 4).values.round(6) + 0.0
    array([ 1.,  0.,  0., -1.])
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    graph = as_graph(graph, degrees=True)
    k = integer("k", k, low=1, high=graph.n_vertices)
    stored, w, _, _ = stored_weights(graph, f, weights, 2.0, 0.0, None)
    n, rows = stored.n_vertices, stored.edge_rows()
    W: Any = sparse.csr_array((w, stored.indices, stored.indptr), shape=(n, n), copy=True)
    W.eliminate_zeros()
    total = np.bincount(rows, w, minlength=n)
    alone = ~(total > 1e-290)
    degree = np.where(alone, 1.0, total)
    root = 1 / np.sqrt(degree)
    N = sparse.csr_array(sparse.diags_array(root) @ W @ sparse.diags_array(root))
    N = sparse.csr_array(N + sparse.diags_array(alone.astype(float)))
    count, part = connected_components(W, directed=False)
    # each part has one eigenvalue 1, so that at most k - count + 1 of its eigenvalues are among the first k
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
    """Compute the k largest eigenvalues, (k,), descending, of a symmetric (n, n) matrix, and (n, k) eigenvectors."""
    from scipy import sparse
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, splu

    n = N.shape[0]
    if n <= _DENSE or k >= n - 1:
        a, vectors = np.linalg.eigh(N.toarray())
        return a[::-1][:k], vectors[:, ::-1][:, :k]
    start = np.random.default_rng(1).standard_normal(n)
    # compute a few more: the last ones of a cluster of equal eigenvalues converge late
    more = min(k + 4, n - 1)
    try:
        if N.nnz <= _FACTORABLE * n:
            # the matrix is definite: no pivoting, which would change the symmetric ordering
            shifted = sparse.csc_array(N - (1 + _ABOVE) * sparse.eye_array(n))
            factors = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            inverse = LinearOperator((n, n), matvec=factors.solve, dtype=np.float64)
            _, V = eigsh(N, k=more, sigma=1 + _ABOVE, which="LM", v0=start, OPinv=inverse)
        else:
            _, V = eigsh(N, k=more, which="LA", v0=start, ncv=min(n, max(2 * more + 1, 40)))
    except ArpackNoConvergence as error:
        raise RuntimeError(f"the eigensolver did not converge for {k} pairs of {n} vertices: {error}") from None
    # one Rayleigh-Ritz step makes the vectors orthonormal up to rounding
    V = np.linalg.qr(V)[0]
    a, turn = np.linalg.eigh(V.T @ (N @ V))
    V = V @ turn[:, ::-1]
    return a[::-1][:k], V[:, :k]


@door
def spectral_filter(
    f0: npt.ArrayLike,
    graph: GraphLike,
    k: int,
    *,
    weights: AnyWeights = None,
    pairs: Eigenpairs | None = None,
) -> FloatArray:
    """Project a function onto the first k eigenvectors of P (section 4.1): a low-pass filter.

    With the inner product weighted by the degree::

        f = sum_i <f0, phi_i>_delta phi_i, over i <= k

    Parameters
    ----------
    f0 : array
        (n,) or (n, m), on a grid also its shape with or without channels.
    graph : Graph or GridGraph
    k : int
        1 <= k <= n.
    weights : Weights or array, optional
        As in :func:`gpureg.regularize`; weight functions are computed from `f0`.
    pairs : Eigenpairs, optional
        At least k pairs of this graph from :func:`eigenpairs`, to compute them only once for many functions.

    Returns
    -------
    array
        float64, in the shape of `f0`.

    Raises
    ------
    ValueError, TypeError
        k out of range; pairs of another graph; otherwise as :func:`eigenpairs`.

    Examples
    --------
    >>> import gpureg as gr
    >>> ring = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> gr.spectral.spectral_filter([1.0, 2.0, 3.0, 6.0], ring, 1)
    array([3., 3., 3., 3.])
    """
    graph = as_graph(graph, degrees=True)
    k = integer("k", k, low=1)
    f = as_function(graph, f0, "f0").astype(np.float64)
    if pairs is None:
        pairs = eigenpairs(graph, k, f=f0, weights=weights)
    elif pairs.vectors.shape[0] != graph.n_vertices or k > pairs.vectors.shape[1]:
        raise ValueError(
            f"pairs must hold at least k = {k} eigenvectors of {graph.n_vertices} vertices, got {pairs.vectors.shape}"
        )
    V = pairs.vectors[:, :k]
    result: FloatArray = V @ (V.T @ (pairs.degree[:, None] * f))
    return result.reshape(np.shape(f0))
