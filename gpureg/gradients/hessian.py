"""The Hessian of the energy at a function, and the matrix of a primal-dual step: products, diagonal, sparse matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from .energy import Point

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Hessian:
    """A matrix of the values that are computed, vertex by vertex and channel by channel.

    It is frozen + along' factor turned + turned' factor along. For p = 2 it is that of one channel, the same for all.

    Attributes
    ----------
    frozen : (k, k) sparse array
        lam + d* c d of one channel: the matrix for fixed conductances.
    channels : int
        Channels of the matrix, m.
    along, turned : (groups, k m) sparse arrays
        h -> <df, dh> and h -> <y, dh>, summed over each group of edges; without rows for p = 2.
    factor : (groups,) array
    """

    frozen: csr_array
    channels: int
    along: csr_array
    turned: csr_array
    factor: FloatArray

    @classmethod
    def of(cls, point: Point, held: tuple[FloatArray, FloatArray] | None = None) -> Hessian:
        """Make the Hessian at a point.

        Parameters
        ----------
        point : Point
        held : (groups,) array and (D, m) array, optional
            A factor and a function y: the part -1/2 factor (y <df, .> + df <y, .>) instead of bend df <df, .>, as in
            the system of a primal-dual step.
        """
        from scipy.sparse import csr_array, diags_array

        e, m = point.energy, point.f.shape[1]
        chosen = np.flatnonzero(e.solved)
        inner = e.adjoint @ (diags_array(e.share * point.c[e.group]) @ e.matrix)
        frozen = csr_array(csr_array(inner + diags_array(e.lam[:, 0]))[chosen][:, chosen])
        if e.p == 2:
            none = csr_array((0, len(chosen)))
            return cls(frozen, 1, none, none, np.zeros(0))
        along = _along(point, point.df)
        if held is None:
            return cls(frozen, m, along, along, e.share * point.bend / 2)
        return cls(frozen, m, along, _along(point, held[1]), -held[0] / 2)

    def product(self, x: FloatArray) -> FloatArray:
        """Multiply by x, (k m,)."""
        found: FloatArray = (self.frozen @ x.reshape(-1, self.channels)).ravel()
        if self.turned is self.along:
            found = found + self.along.T @ (2 * self.factor * (self.along @ x))
            return found
        found = found + self.along.T @ (self.factor * (self.turned @ x))
        found = found + self.turned.T @ (self.factor * (self.along @ x))
        return found

    def diagonal(self) -> FloatArray:
        """Return the diagonal, (k m,)."""
        found: FloatArray = np.repeat(self.frozen.diagonal(), self.channels)
        found = found + 2 * (self.along.multiply(self.turned).T @ self.factor)
        return found

    @property
    def entries(self) -> int:
        """About the entries of the sparse matrix, or more."""
        rows = np.diff(self.along.indptr).astype(np.int64)
        return int((rows**2).sum()) + self.frozen.nnz * self.channels

    @property
    def is_compact(self) -> bool:
        """Whether products by the sparse matrix are faster than by its parts: on grids, where its entries overlap."""
        return self.entries <= 4 * (self.frozen.nnz * self.channels + 2 * self.along.nnz)

    @property
    def band(self) -> int:
        """A bound on the bandwidth of the matrix with the vertices in a good order."""
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        order = reverse_cuthill_mckee(self.frozen, symmetric_mode=True)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        rows = np.repeat(place, np.diff(self.frozen.indptr))
        # two edges of a vertex join its neighbours
        steps = 1 if self.channels == 1 and not self.along.shape[0] else 2
        return steps * self.channels * int(np.abs(rows - place[self.frozen.indices]).max(initial=0))

    def matrix(self) -> csr_array:
        """Make the sparse matrix, (k m, k m)."""
        from scipy.sparse import csr_array, diags_array, kron

        whole = csr_array(kron(self.frozen, diags_array(np.ones(self.channels))))
        if not self.along.shape[0]:
            return whole
        half = self.along.T @ (diags_array(self.factor) @ self.turned)
        return csr_array(whole + half + half.T)


def _along(point: Point, x: FloatArray) -> csr_array:
    """Return the matrix of h -> <x, dh> summed over each group, (groups, k m), for x (D, m)."""
    from scipy.sparse import coo_array, csr_array

    e, (n, m) = point.energy, point.f.shape
    row, channel = np.arange(len(x)) if e.on.edge_norm else e.start, np.arange(m)
    rows = np.broadcast_to(row[:, None], x.shape).ravel()
    values = np.concatenate([(x * e.other[:, None]).ravel(), (-x * e.own[:, None]).ravel()])
    columns = np.concatenate([(ends[:, None] * m + channel).ravel() for ends in (e.end, e.start)])
    entries = (values, (np.concatenate([rows, rows]), columns))
    whole = coo_array(entries, shape=(len(point.q), n * m)).tocsr()
    return csr_array(whole[:, np.flatnonzero(np.repeat(e.solved, m))])
