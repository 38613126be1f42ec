"""Slopes of functions on a graph, and the least Lipschitz constant of pinned values: :func:`least_constant`.

An edge has the length 1/gamma_uv, so that its slope is gamma_uv (f(v) - f(u)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Rounds of the search for the steepest pair of pinned vertices: 3 to 7 are needed.
_MOST_PATHS = 100
EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Slopes:
    """A graph with a gamma > 0 on its edges, and the vertices whose values are pinned.

    Attributes
    ----------
    indptr, end : int arrays
        The directed edges of each vertex, as in a CSR matrix.
    gamma : (D,) float array
        One value per directed edge; both directions have the same.
    pinned : (n,) bool array
        Every vertex that is not pinned is connected to a pinned one.
    """

    indptr: IntArray
    end: IntArray
    gamma: FloatArray
    pinned: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, u: IntArray, v: IntArray, gamma: FloatArray, pinned: npt.NDArray[np.bool_]) -> Slopes:
        """Make it from edges that are given once, (E,) each."""
        from scipy.sparse import coo_array

        n = len(pinned)
        both = np.concatenate([gamma, gamma]), (np.concatenate([u, v]), np.concatenate([v, u]))
        A = coo_array(both, shape=(n, n)).tocsr()
        return cls(A.indptr.astype(np.int64), A.indices.astype(np.int64), A.data, pinned)

    @property
    def start(self) -> IntArray:
        """The vertex at which each directed edge starts, (D,)."""
        return np.repeat(np.arange(len(self.pinned)), np.diff(self.indptr))

    def length_of(self, u: IntArray, v: IntArray) -> FloatArray:
        """Return the lengths of the edges (u, v), (k,) each."""
        n = len(self.pinned)
        number = self.start * n + self.end  # sorted, as the rows are
        lengths: FloatArray = 1 / self.gamma[np.searchsorted(number, u * n + v)]
        return lengths

    def largest(self, f: FloatArray) -> float:
        """Compute the largest slope of a function, (n,)."""
        return float((self.gamma * np.abs(f[self.end] - f[self.start])).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Distances:
    """Shortest paths from the pinned vertices, in a graph with one more vertex that has an edge to each of them.

    Attributes
    ----------
    matrix : (n + 1, n + 1) sparse array
        Its lengths change from call to call.
    lengths : (D,) float array
        1/gamma of each directed edge.
    pinned : (k,) int array
    """

    matrix: csr_array
    lengths: FloatArray
    pinned: IntArray

    @classmethod
    def of(cls, slopes: Slopes) -> Distances:
        """Make the graph of paths."""
        from scipy.sparse import csr_array

        n, pinned = len(slopes.pinned), np.flatnonzero(slopes.pinned)
        lengths = 1 / slopes.gamma
        indptr = np.append(slopes.indptr, slopes.indptr[-1] + len(pinned))
        columns = np.concatenate([slopes.end, pinned])
        data = np.concatenate([lengths, np.zeros(len(pinned))])
        return cls(csr_array((data, columns, indptr), shape=(n + 1, n + 1)), lengths, pinned)

    def from_values(self, values: FloatArray, slope: float) -> tuple[FloatArray, IntArray]:
        """Compute min over pinned a of values(a) + slope dist(a, u), (n,), and the vertex before u on the path, (n,).

        The vertex before is n where u itself is the best a.
        """
        from scipy.sparse.csgraph import dijkstra

        n, low = self.matrix.shape[0] - 1, float(values.min())
        self.matrix.data[: len(self.lengths)] = slope * self.lengths
        self.matrix.data[len(self.lengths) :] = values - low
        distance, before = dijkstra(self.matrix, indices=[n], return_predecessors=True)
        return distance[0, :n] + low, before[0, :n].astype(np.int64)


@dataclass(frozen=True)
class Steepest:
    """The steepest pair of pinned vertices: its slope is the least Lipschitz constant of the pinned values.

    Attributes
    ----------
    slope : float
        |f(a) - f(b)| / length of the path: every function with these values has an edge on the path as steep as this.
    path : (k,) int array
        The vertices from a to b; empty if the slope is 0.
    """

    slope: float
    path: IntArray


def least_constant(slopes: Slopes, f: FloatArray) -> Steepest:
    """Find the largest (f(b) - f(a)) / dist(a, b) over the pinned vertices, for f, (n,), connected ones.

    From a slope K that is too small, the shortest paths from all values f(a) + K dist(a, b) at once show pairs that are
    steeper; the steepest of them is the next K. The last shortest paths show that none is steeper (Dinkelbach's method
    for a largest ratio).
    """
    best, distances = Steepest(0.0, np.empty(0, np.int64)), Distances.of(slopes)
    values = f[distances.pinned]
    if not len(slopes.end) or not len(values) or not np.ptp(values) > 0:
        return best
    total = float(distances.lengths.sum())
    # first the paths from the vertices of the least value alone
    reached = distances.from_values(np.where(values > values.min(), total, 0.0), 1.0)
    for _ in range(_MOST_PATHS):
        found = _steepest_path(slopes, distances.pinned, f, reached[1])
        if not found.slope > best.slope * (1 + 8 * EPS) and best.slope > 0:
            break
        best = found if found.slope > best.slope else best
        reached = distances.from_values(values, best.slope or float(np.ptp(values)) / total)
    return best


def _steepest_path(slopes: Slopes, pinned: IntArray, f: FloatArray, before: IntArray) -> Steepest:
    """Return the steepest of the paths that end at pinned vertices, by the vertex before each, (n,)."""
    n = len(f)
    moved = (before >= 0) & (before < n)
    root, length = np.where(moved, before, np.arange(n)), np.zeros(n)
    length[moved] = slopes.length_of(root[moved], np.flatnonzero(moved))
    # the first vertex of each path, and its length: the paths are joined by doubling
    while not np.array_equal(root, root[root]):
        length, root = length + length[root], root[root]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(length[pinned] > 0, (f[pinned] - f[root[pinned]]) / length[pinned], 0.0)
    at = int(ratio.argmax())
    if not ratio[at] > 0:
        return Steepest(0.0, np.empty(0, np.int64))
    path = [int(pinned[at])]
    while 0 <= before[path[-1]] < n:
        path.append(int(before[path[-1]]))
    return Steepest(float(ratio[at]), np.array(path[::-1]))
