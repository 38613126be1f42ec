"""Tell noise from shape in the heights that a filter removed from a mesh: :class:`Whiteness`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.components import Components
from ..graphs.csr import Graph

# The correlation of neighbours in the removed heights, sum of h(u) h(v) over sum of h(u)^2 along edges: below _WHITE
# for removed noise (from -0.01 to -0.05 the results differ little), above _SHAPE around a vertex for removed shape.
_WHITE, _SHAPE = -0.03, 0.1

# Averages over neighbours for the correlation around a vertex.
_AROUND = 30

# A border with fewer vertices is not judged by itself.
_BORDER = 20


@dataclass(frozen=True, eq=False)
class Whiteness:
    """The test of whiteness on the graph of a mesh with some components; `border`, (n,) bool, are border vertices."""

    graph: Graph
    parts: Components
    border: npt.NDArray[np.bool_]

    @cached_property
    def _adjacency(self) -> Any:
        from scipy import sparse

        graph = self.graph
        return sparse.csr_array((np.ones(graph.n_edges), graph.indices, graph.indptr), shape=(graph.n_vertices,) * 2)

    @cached_property
    def _degree(self) -> FloatArray:
        return np.diff(self.graph.indptr).astype(np.float64)

    def local_shape(self, heights: FloatArray) -> npt.NDArray[np.bool_]:
        """Find the vertices around which the heights (n,) are correlated, (n,) bool."""
        A, degree = self._adjacency, np.maximum(self._degree, 1)
        sums = np.stack([heights * (A @ heights), self._degree * heights**2], axis=1)
        for _ in range(_AROUND):
            sums = (sums + A @ (sums / degree[:, None])) / 2
        shape: npt.NDArray[np.bool_] = sums[:, 0] > _SHAPE * sums[:, 1]
        return shape

    def refuses(self, heights: FloatArray, moving: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Find the components in which the heights of the vertices that move are not white, (c,) bool."""
        return self._correlated(heights, moving)

    def shaped_border(self, heights: FloatArray, moving: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Find the vertices on borders of components where the heights along the borders are not white, (n,) bool."""
        there = moving & self.border
        enough = self.parts.sums(there.astype(np.float64)) >= _BORDER
        if not enough.any():
            return np.zeros_like(there)
        found = enough & self._correlated(heights, there)
        return self.border & found[self.parts.labels]

    def _correlated(self, heights: FloatArray, among: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        A = self._adjacency
        h, one = np.where(among, heights, 0.0), among.astype(np.float64)
        both, own = self.parts.sums(h * (A @ h)), self.parts.sums(h**2 * (A @ one))
        # of few edges it has to be clearer, because it is known less well: from 2500 on this adds nothing
        edges = np.maximum(self.parts.sums(one * (A @ one)) / 2, 1)
        chance = np.maximum(1.5 / np.sqrt(edges) - 0.03, 0)
        correlated: npt.NDArray[np.bool_] = both > (_WHITE - chance) * own
        correlated |= own == 0
        return correlated
