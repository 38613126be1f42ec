"""The levels of multigrid for a matrix of a graph, made on the host: unsmoothed aggregation by pairs.

The matrix of a level is A = diag(lam) + 2 (D - W), with weights W >= 0 and the degrees D of W. If P has a column for
each aggregate, 1 at its vertices, then P'AP is again such a matrix: its lam and W are sums over the aggregates. So
every level is a graph of ours. See Notay, "An aggregation-based algebraic multigrid method", Electronic Transactions on
Numerical Analysis 37, 2010. Here a level has one matching: with aggregates of four, a pair of strong neighbours can be
glued to another pair by an edge a 10^5 times weaker, and the cycle loses its speed (five times the iterations on an
image with bilateral weights).
"""

from __future__ import annotations

import hashlib
import weakref
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph

Mask = npt.NDArray[np.bool_]

# An edge is strong if its weight is at least this share of the largest one around a vertex.
_STRONG = 0.25
# Rounds of proposals of a matching; what is still single then joins a neighbour.
_ROUNDS = 6
# Vertices of the last level, whose matrix is inverted.
COARSEST = 200


@dataclass(frozen=True, eq=False)
class Couplings:
    """The weights of a level: A without its row sums.

    Attributes
    ----------
    indptr : (n + 1,) int array
    indices : (edges,) int array
        The neighbours of each vertex, sorted.
    weights : (edges,) float array
        W, in the order of `indices`; > 0.
    """

    indptr: IntArray
    indices: IntArray
    weights: FloatArray

    @classmethod
    def of_edges(cls, n: int, start: IntArray, end: IntArray, weights: FloatArray) -> Couplings:
        """Make the weights of a graph from its directed edges, in any order; repeated edges are added up."""
        from scipy.sparse import coo_array

        W = coo_array((weights, (start, end)), shape=(n, n)).tocsr()
        W.sort_indices()
        values: FloatArray = W.data
        return cls(W.indptr, W.indices, values)

    @classmethod
    def of_rows(cls, indptr: IntArray, indices: IntArray, weights: FloatArray, used: Mask) -> Couplings:
        """Make the weights from rows of a graph, of which only some edges are `used`, (edges,)."""
        if used.all():
            return cls(indptr, indices, weights)
        before = np.concatenate([[0], np.cumsum(used)])
        return cls(before[indptr], indices[used], weights[used])

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.indptr) - 1

    def rows(self) -> IntArray:
        """Return the vertex at which each edge begins."""
        found: IntArray = np.repeat(np.arange(self.n, dtype=np.int32), np.diff(self.indptr))
        return found

    def degree(self) -> FloatArray:
        """Return the sum of the weights around each vertex, (n,)."""
        found: FloatArray = np.bincount(self.rows(), self.weights, minlength=self.n).astype(np.float64)
        return found

    def product(self, lam: FloatArray, x: FloatArray) -> FloatArray:
        """Return A x for the row sums `lam` and x, (n,) each."""
        from scipy.sparse import csr_array

        W = csr_array((self.weights, self.indices, self.indptr), shape=(self.n, self.n))
        found: FloatArray = (lam + 2 * self.degree()) * x - 2 * (W @ x)
        return found

    def coarse(self, of: IntArray, n: int) -> Couplings:
        """Return the weights of P'AP for the aggregate of each vertex, -1 for none, of `n` aggregates."""
        start, end = of[self.rows()], of[self.indices]
        across = start != end
        return Couplings.of_edges(n, start[across], end[across], self.weights[across])


@dataclass(frozen=True, eq=False)
class Coarsening:
    """A level below the first one.

    Attributes
    ----------
    of : (n,) int array
        The aggregate of each vertex of the level before, or -1.
    graph : Graph
        The aggregates, with their weights.
    """

    of: IntArray
    graph: Graph

    def sums(self, lam: FloatArray) -> FloatArray:
        """Sum row sums of the level before, (n,), over the aggregates."""
        inside = self.of >= 0
        found: FloatArray = np.bincount(self.of[inside], lam[inside], minlength=self.graph.n_vertices).astype(
            np.float64
        )
        return found


def coarsened(matrix: Couplings) -> list[Coarsening]:
    """Return the levels below these weights, down to :data:`COARSEST` vertices; none if no vertices are coupled."""
    levels: list[Coarsening] = []
    while len(matrix.indices) and (matrix.n > COARSEST or not levels):
        of, n = matched(matrix)
        matrix = matrix.coarse(of, n)
        levels.append(Coarsening(of, Graph.trusted(matrix.indptr, matrix.indices, matrix.weights)))
    return levels


# The levels of a graph, by its weights and free vertices: a second problem on it needs no setup.
_KEPT: weakref.WeakKeyDictionary[AnyGraph, dict[bytes, list[Coarsening]]] = weakref.WeakKeyDictionary()
# Of one graph, those of so many weights.
_MOST_KEPT = 2


def levels_of(graph: AnyGraph, matrix: Couplings) -> list[Coarsening]:
    """Return the levels below the weights of a graph; they are kept as long as the graph."""
    key = _digest(matrix)
    kept = _KEPT.setdefault(graph, {})
    found = kept.get(key)
    if found is None:
        found = coarsened(matrix)
        while len(kept) >= _MOST_KEPT:
            kept.pop(next(iter(kept)), None)
        kept[key] = found
    return found


def _digest(matrix: Couplings) -> bytes:
    """Return a number that tells matrices of one graph apart."""
    hashed = hashlib.blake2b(digest_size=16)
    for array in (matrix.indptr, matrix.weights):
        hashed.update(np.ascontiguousarray(array).data)
    return hashed.digest()


def matched(matrix: Couplings) -> tuple[IntArray, int]:
    """Match the vertices in pairs; return the aggregate of each, (n,), and the number of aggregates.

    In each round a free vertex proposes to its heaviest strong neighbour that is free; two that have chosen each other
    are a pair. A vertex that is still single joins the pair of its heaviest neighbour. One without neighbours is
    in no aggregate (-1): the smoother solves its row.
    """
    n, rows, ends = matrix.n, matrix.rows(), matrix.indices
    first = np.flatnonzero(np.diff(matrix.indptr) > 0)
    begin = matrix.indptr[:-1][first]
    largest = np.zeros(n)
    largest[first] = np.maximum.reduceat(matrix.weights, begin)
    strong = np.flatnonzero(matrix.weights >= np.repeat(_STRONG * largest, np.diff(matrix.indptr)))
    u, v = rows[strong], ends[strong]
    key = _ordered(u, v, matrix.weights[strong])
    partner = np.full(n, -1, np.int32)
    for _ in range(_ROUNDS):
        if not len(u):
            break
        chosen = _heaviest(u, v, key, n)
        mutual = np.flatnonzero(chosen >= 0)
        mutual = mutual[chosen[chosen[mutual]] == mutual]
        partner[mutual] = chosen[mutual]
        single = partner < 0
        left = np.flatnonzero(single[u] & single[v])
        u, v, key = u[left], v[left], key[left]
    pairs = np.flatnonzero((partner >= 0) & (np.arange(n) < partner))
    of = np.full(n, -1, np.int32)
    of[pairs] = of[partner[pairs]] = np.arange(len(pairs))
    single = partner < 0
    around = np.flatnonzero(np.repeat(single, np.diff(matrix.indptr)))
    u, v = rows[around], ends[around]
    heaviest = _heaviest(u, v, _ordered(u, v, matrix.weights[around]), n)
    alone = np.flatnonzero(heaviest >= 0)
    of[alone] = of[heaviest[alone]]
    # those whose heaviest neighbour is in no pair either
    rest = alone[of[alone] < 0]
    of[rest] = len(pairs) + np.arange(len(rest))
    return of, len(pairs) + len(rest)


def _heaviest(u: IntArray, v: IntArray, key: FloatArray, n: int) -> IntArray:
    """Return the neighbour with the largest key of each vertex, (n,), -1 without one; edges are sorted by `u`."""
    found = np.full(n, -1, np.int32)
    if len(u):
        begin = np.flatnonzero(np.concatenate([[True], u[1:] != u[:-1]]))
        best = np.maximum.reduceat(key, begin)
        hits = np.flatnonzero(key == np.repeat(best, np.diff(begin, append=len(u))))
        # backwards, so that of equal keys the first counts
        found[u[hits][::-1]] = v[hits][::-1]
    return found


def _ordered(u: IntArray, v: IntArray, weights: FloatArray) -> FloatArray:
    """Return the weights of edges, equal ones ordered by a hash: a uniform grid has no long chain of proposals."""
    keys: FloatArray = weights * (1 + 1e-6 * _hashed(u, v))
    return keys


def _hashed(u: IntArray, v: IntArray) -> FloatArray:
    """Return a number in [0, 1) for each edge, the same for its opposite."""
    a, b = np.minimum(u, v).astype(np.uint64), np.maximum(u, v).astype(np.uint64)
    h = (a * np.uint64(0x9E3779B97F4A7C15)) ^ (b * np.uint64(0xC2B2AE3D27D4EB4F))
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    numbers: FloatArray = (h >> np.uint64(32)).astype(np.float64) / 2.0**32
    return numbers
