"""Smooth paths and rings of vertices exactly for p = 2, with the leverage of each vertex: :class:`Chain`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph


@dataclass(frozen=True, eq=False)
class Chain:
    """Paths and rings, the vertices of one after those of another.

    Attributes
    ----------
    sizes : (k,) int array
        Number of vertices of each path or ring, >= 1.
    rings : (k,) bool array
        Whether the last vertex of a piece is joined to the first.
    """

    sizes: IntArray
    rings: npt.NDArray[np.bool_]

    @cached_property
    def starts(self) -> IntArray:
        """The first vertex of each piece, (k,)."""
        return np.cumsum(self.sizes) - self.sizes

    @cached_property
    def _joined(self) -> npt.NDArray[np.bool_]:
        """Whether vertex i is joined to i + 1, (n - 1,)."""
        joined = np.ones(int(self.sizes.sum()) - 1, bool)
        joined[self.starts[1:] - 1] = False
        return joined

    @cached_property
    def _closing(self) -> tuple[IntArray, IntArray]:
        """The first and the last vertex of each ring, (r,) each."""
        first = self.starts[self.rings]
        return first, first + self.sizes[self.rings] - 1

    def graph(self, positions: FloatArray) -> Graph:
        """Make the graph of the pieces with these positions of the vertices, (n, d)."""
        u = np.flatnonzero(self._joined)
        edges = np.concatenate([np.stack([u, u + 1], axis=1), np.stack(self._closing, axis=1)])
        return Graph.from_edges(edges, n_vertices=len(positions), positions=positions)

    def squared_steps(self, f: FloatArray) -> FloatArray:
        """Sum the squared differences (n, d) along the edges of each piece, (k,)."""
        square = np.zeros(len(f))
        square[:-1] = (np.diff(f, axis=0) ** 2).sum(axis=1) * self._joined
        first, last = self._closing
        square[last] = ((f[first] - f[last]) ** 2).sum(axis=1)
        sums: FloatArray = np.add.reduceat(square, self.starts)
        return sums

    def smooth(self, f: FloatArray, lam: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Minimise the energy of p = 2 and w = 1.

        Parameters
        ----------
        f : (n, d) array
        lam : (n,) array
            Fidelity of each vertex, > 0.

        Returns
        -------
        u : (n, d) array
            The minimiser ``(lam + 2 L)^-1 lam f``, with the graph's Laplacian L.
        h : (n,) array
            The leverage: the derivative of u at a vertex by f at the same vertex, in 0..1.

        Notes
        -----
        The matrix is tridiagonal. With the pivots from above, a_i - b_i^2 / d_(i-1), and those from below, the diagonal
        of its inverse is 1 / (d_above + d_below - a). The corner entries of a ring are a change of rank one, which the
        formula of Sherman and Morrison adds; as rings have no vertex in common, one more right-hand side serves all.
        """
        from scipy.linalg import lapack

        n = len(f)
        if n == 1:
            return f.copy(), np.ones(1)
        a = lam.astype(np.float64)
        a[:-1] += 2.0 * self._joined
        a[1:] += 2.0 * self._joined
        first, last = self._closing
        corner = np.zeros(n)
        corner[first] = corner[last] = 1
        # the two ends of a ring lack an edge each, and the change of rank one takes 2 from both
        a += 4 * corner
        b = -2.0 * self._joined
        pivots, low, _ = lapack.dpttrf(a, b)
        below = lapack.dpttrf(a[::-1], b[::-1])[0][::-1]
        inverse = 1 / (pivots + below - a)
        right = np.empty((n, f.shape[1] + 1), order="F")
        right[:, :-1] = lam[:, None] * f
        right[:, -1] = corner
        x, _ = lapack.dpttrs(pivots, low, right)
        u, z = x[:, :-1], x[:, -1]
        if len(first):
            factor = 2 / (1 - 2 * (z[first] + z[last]))
            sizes = self.sizes[self.rings]
            total = factor[:, None] * (u[first] + u[last])
            inside = np.repeat(self.rings, self.sizes)
            inverse[inside] += np.repeat(factor, sizes) * z[inside] ** 2
            u[inside] += np.repeat(total, sizes, axis=0) * z[inside, None]
        return u, np.clip(lam * inverse, 0, 1)
