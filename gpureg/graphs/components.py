"""The connected components of a graph, and numbers for each of them: :class:`Components`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .csr import Graph

if TYPE_CHECKING:
    from scipy.sparse import coo_array, csr_array

# Values of a component that a median looks at; more are thinned evenly.
_MOST = 100_000


@dataclass(frozen=True, eq=False)
class Components:
    """The connected components of n vertices.

    Attributes
    ----------
    labels : (n,) int array
        The component of each vertex, from 0.
    count : int
        Number of components, c.
    """

    labels: IntArray
    count: int

    @classmethod
    def of(cls, graph: Graph) -> Components:
        """Find the components of a graph; a vertex without edges is one."""
        from scipy import sparse

        n = graph.n_vertices
        return cls._found(
            sparse.csr_array((np.ones(graph.n_edges, np.int8), graph.indices, graph.indptr), shape=(n, n))
        )

    @classmethod
    def of_edges(cls, n: int, u: IntArray, v: IntArray) -> Components:
        """Find the components of n vertices joined by edges (u, v), (E,) each, in one direction or both."""
        from scipy import sparse

        return cls._found(sparse.coo_array((np.ones(len(u), np.int8), (u, v)), shape=(n, n)))

    @classmethod
    def _found(cls, matrix: coo_array | csr_array) -> Components:
        from scipy.sparse.csgraph import connected_components

        count, labels = connected_components(matrix, directed=False)
        return cls(labels.astype(np.int64), int(count))

    def without(self, known: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return the vertices of components without a known vertex, (n,) each."""
        found: npt.NDArray[np.bool_] = (self.sums(known) == 0)[self.labels]
        return found

    def sizes(self) -> IntArray:
        """Count the vertices of each component, (c,)."""
        return np.bincount(self.labels, minlength=self.count)

    def sums(self, values: FloatArray | npt.NDArray[np.bool_], labels: IntArray | None = None) -> FloatArray:
        """Sum values (k,) of each component, (c,); `labels`, (k,), are their components, by default of vertices."""
        at = self.labels if labels is None else labels
        sums: FloatArray = np.bincount(at, weights=values, minlength=self.count).astype(np.float64)
        return sums

    def means(self, values: FloatArray, labels: IntArray | None = None) -> FloatArray:
        """Average values (k,) over each component, (c,); 0 for a component without values."""
        number = np.bincount(self.labels if labels is None else labels, minlength=self.count)
        means: FloatArray = self.sums(values, labels) / np.maximum(number, 1)
        return means

    def medians(self, values: FloatArray, labels: IntArray | None = None) -> FloatArray:
        """Return the median of values (k,) of each component, (c,); NaN for a component without values."""
        at = self.labels if labels is None else labels
        if self.count == 1 and len(values):
            return np.array([np.median(values)])
        order = np.lexsort((values, at))
        return sorted_medians(values[order], np.searchsorted(at[order], np.arange(self.count + 1)))

    def quantiles(self, values: FloatArray, share: float) -> FloatArray:
        """Return a quantile of values at the vertices, (n,), of each component, (c,): a value, not a mean of two."""
        order = np.lexsort((values, self.labels))
        sizes = self.sizes()
        start = np.cumsum(sizes) - sizes
        quantiles: FloatArray = values[order][start + np.rint(share * (sizes - 1)).astype(np.int64)]
        return quantiles

    def centred(self, points: FloatArray) -> FloatArray:
        """Subtract from points (n, d) the median of their component: float32 has too few digits far from the origin."""
        middles = np.stack([self.medians(x) for x in points.T], axis=1)
        centred: FloatArray = points - middles[self.labels]
        return centred

    def thinned(self, labels: IntArray) -> IntArray:
        """Choose at most 100 000 of the items with these components, (k,), from each, evenly; return their indices."""
        number = np.bincount(labels, minlength=self.count)
        if number.max(initial=0) <= _MOST:
            return np.arange(len(labels))
        order = np.argsort(labels, kind="stable")
        place = np.arange(len(labels)) - np.repeat(np.cumsum(number) - number, number)
        chosen: IntArray = order[place % np.repeat(-(-number // _MOST), number) == 0]
        return chosen


def sorted_medians(values: FloatArray, indptr: npt.NDArray[np.integer]) -> FloatArray:
    """Return the median of each slice of `values`, which is sorted within ``indptr[i]:indptr[i + 1]``; NaN if empty."""
    start, number = indptr[:-1], np.diff(indptr)
    there = number > 0
    low = values[(start + (number - 1) // 2)[there]]
    high = values[(start + number // 2)[there]]
    medians = np.full(len(number), np.nan)
    medians[there] = (low + high) / 2
    return medians
