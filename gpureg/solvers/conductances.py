"""A V-cycle for the matrix lam + d* c d, with conductances c of the edges that change from step to step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from ..backends import Weighted
from ..backends.curvature import least_square
from ..graphs.csr import Graph
from ..model.matrices import Edges, undirected_edges
from ..model.on_device import DeviceProblem
from .cycle import Cycle
from .levels import Couplings, Mask, coarsened


@dataclass(frozen=True, eq=False)
class Conductances:
    """The matrix on the host, without c: rows and columns of pinned vertices are left out.

    Attributes
    ----------
    problem : DeviceProblem
    edges : Edges
        With both values of gamma in the device's variable.
    lam : (n,) array
    used : (E,) bool array
        The edges that couple two free vertices.
    pattern : three int arrays
        indptr, indices and the order of the couplings: those of the used edges, then the same backwards.
    """

    problem: DeviceProblem
    edges: Edges
    lam: FloatArray
    used: Mask
    pattern: tuple[IntArray, IntArray, IntArray]

    @classmethod
    def of(cls, problem: DeviceProblem) -> Conductances:
        """Make the matrix of a problem."""
        from scipy.sparse import coo_array

        backend, graph, n = problem.backend, problem.weighted.graph, problem.weighted.graph.n_vertices
        lam = problem.lam if isinstance(problem.lam, float) else backend.get(graph, problem.lam)[:, 0]
        lam = np.broadcast_to(np.asarray(lam, np.float64), (n,))
        edges = undirected_edges(problem, scaled=False)
        edges = edges[(edges.there > 0) | (edges.back > 0)]
        free = np.isfinite(lam)
        used = free[edges.u] & free[edges.v] & (edges.there * edges.back > 0)
        u, v = edges.u[used], edges.v[used]
        ends = np.concatenate([u, v]), np.concatenate([v, u])
        pattern = coo_array((np.arange(2 * len(u)), ends), shape=(n, n)).tocsr()
        pattern.sort_indices()
        return cls(problem, edges, lam, used, (pattern.indptr, pattern.indices, pattern.data))

    def of_edges(self, f: FloatArray, p: float, eps: float, least: float) -> FloatArray:
        """Compute the conductances of the edge norm, (E,), from f on the device, (n, m); those of eq. 30."""
        edges = self.edges
        d = edges.back[:, None] * f[edges.v] - edges.there[:, None] * f[edges.u]
        return raised((d**2).sum(axis=1) + eps**2, (p - 2) / 2, least)

    def of_vertices(self, g: FloatArray) -> FloatArray:
        """Return the conductances g(u) + g(v), (E,), for g on the vertices, (n,)."""
        found: FloatArray = g[self.edges.u] + g[self.edges.v]
        return found

    def cycle(self, c: FloatArray) -> Cycle:
        """Make the V-cycle for conductances of both directions of each edge together, (E,)."""
        problem, edges, n = self.problem, self.edges, len(self.lam)
        free, used = np.isfinite(self.lam), self.used
        W = edges.there * edges.back * c / 2
        degree = _around(edges, edges.there**2 * c, edges.back**2 * c, n)
        # a gamma that is not symmetric has rows with another sum than lam
        excess = degree - 2 * _around(edges, W, W, n) if problem.weighted.directed else np.zeros(n)
        lam, diagonal = self.lam + excess, (self.lam + degree)[:, None]
        indptr, indices, order = self.pattern
        matrix = Couplings(indptr, indices, np.concatenate([W[used], W[used]])[order])
        pinned = np.where(used, 0, W)
        sums = np.where(free, lam + 2 * _around(edges, pinned, pinned, n), 0)
        backend, graph = problem.backend, problem.weighted.graph
        return Cycle.put(
            backend,
            self._weighted(W),
            backend.put(graph, lam[:, None]),
            diagonal,
            sums,
            coarsened(matrix),
            problem.channels,
        )

    def _weighted(self, W: FloatArray) -> Weighted:
        """Return the graph with these weights on the device."""
        backend, graph, edges = self.problem.backend, self.problem.weighted.graph, self.edges
        if isinstance(graph, Graph):
            weights = np.zeros(graph.n_edges)
            weights[edges.place] = weights[edges.place_back] = W
            return backend.prepare(graph, weights)
        # only the forward half is stored
        weights = np.zeros(graph.half_window * graph.n_vertices)
        weights[edges.place - len(weights)] = W
        return backend.prepare(graph, weights.reshape(graph.half_window, *graph.shape))


def raised(q: FloatArray, power: float, least: float) -> FloatArray:
    """Compute q^power for q >= 0, at least a share `least` of the largest one; q = 0 counts as a tiny number."""
    found: FloatArray = np.maximum(q, least_square(np.float64)) ** power
    return np.maximum(found, least * float(found.max(initial=0))) if least else found


def _around(edges: Edges, at_u: FloatArray, at_v: FloatArray, n: int) -> FloatArray:
    """Sum numbers of the edges, (E,), at both ends, (n,)."""
    found = np.bincount(edges.u, at_u, minlength=n) + np.bincount(edges.v, at_v, minlength=n)
    return found.astype(np.float64)
