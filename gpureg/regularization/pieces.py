"""Partition any graph by the process with p < 1: merge the vertices with equal values, for decreasing lam."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..model.result import Result
from .regularize import regularize

Labels = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Pieces:
    """A partition of a graph's vertices into connected pieces.

    Attributes
    ----------
    labels : (n,) int32 array
        The piece of each vertex, numbered from 0 in the order of their first vertices.
    values : (k, m) float array
        The mean over each piece of the regularized function.
    sizes : (k,) float array
        The mass of each piece: its number of vertices, if every vertex has mass 1.
    graph : Graph
        The adjacency of the pieces, with the sum of the weights between two pieces.
    results : tuple of Result
        The runs that led here.
    """

    labels: Labels
    values: FloatArray
    sizes: FloatArray
    graph: Graph
    results: tuple[Result, ...] = ()

    @property
    def n_pieces(self) -> int:
        """Number of pieces."""
        return len(self.sizes)

    def joined(self, part: IntArray) -> Pieces:
        """Merge pieces: piece i becomes part of the new piece `part[i]`; `part` is (k,)."""
        first = np.sort(np.unique(part, return_index=True)[1])
        number = np.empty(len(first), np.int32)
        number[part[first]] = np.arange(len(first))
        new = number[part]
        sizes: FloatArray = np.bincount(new, self.sizes).astype(np.float64)
        sums = [np.bincount(new, self.sizes * f) for f in self.values.T]
        values = np.stack(sums, axis=1) / np.where(sizes > 0, sizes, 1)[:, None]
        return Pieces(new[self.labels], values, sizes, contracted(self.graph, new), self.results)


def whole(f0: FloatArray, graph: Graph, weights: FloatArray | None = None, sizes: FloatArray | None = None) -> Pieces:
    """Make a partition with one piece per vertex, with the values `f0`, (n, m), and (n_edges,) weights."""
    n = graph.n_vertices
    weighted = Graph(graph.indptr, graph.indices, graph.weights if weights is None else weights)
    return Pieces(np.arange(n, dtype=np.int32), f0, np.ones(n) if sizes is None else sizes, weighted)


def contracted(graph: Graph, labels: IntArray) -> Graph:
    """Return the adjacency graph of the pieces, weighted by the sum of the weights between two; `labels` is (n,)."""
    from scipy import sparse

    k = int(labels.max()) + 1 if len(labels) else 0
    u, v = labels[graph.edge_rows()], labels[graph.indices]
    between = u != v
    w = np.ones(graph.n_edges) if graph.weights is None else graph.weights
    W = sparse.csr_array((w[between], (u[between], v[between])), shape=(k, k))
    W.sum_duplicates()
    # the sums of both directions can differ by rounding
    W = (W + W.T) / 2
    return Graph(W.indptr, W.indices, np.asarray(W.data))


def met(values: FloatArray, graph: Graph, tol: float) -> IntArray:
    """Label the components, (n,), joined by edges on which the function (n, m) differs by at most `tol`."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    n = graph.n_vertices
    u, v = graph.edge_rows(), graph.indices
    near = np.linalg.norm(values[u] - values[v], axis=1) <= tol
    links = sparse.csr_array((np.ones(int(near.sum()), bool), (u[near], v[near])), shape=(n, n))
    found: IntArray = connected_components(links, directed=False)[1]
    return found


def coarser(start: Pieces, lam: Iterable[float], *, p: float, merge_tol: float, **settings: Any) -> Iterator[Pieces]:
    """Yield coarser and coarser partitions: regularize the pieces' values with each lam, and merge equal neighbours.

    A piece's fidelity is lam times its size, as if its vertices were counted one by one. Adjacent values at most
    `merge_tol` apart are merged. `settings` are those of :func:`gpureg.regularize`.
    """
    now = start
    for fidelity in lam:
        result = regularize(now.values, now.graph, p=p, lam=fidelity * now.sizes, **settings)
        value = result.value.astype(np.float64)
        moved = Pieces(now.labels, value, now.sizes, now.graph, (*now.results, result))
        now = moved.joined(met(value, now.graph, merge_tol))
        yield now
