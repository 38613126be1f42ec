"""A V-cycle of multigrid on the host, as the preconditioner of systems with the Hessian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray
from ..solvers.levels import Couplings, coarsened

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# The relaxation of the Jacobi sweeps.
_OMEGA = 2 / 3


@dataclass(frozen=True, eq=False)
class _Level:
    matrix: csr_array
    over: FloatArray  # (n, 1): its diagonal, relaxed
    up: csr_array  # (n, aggregates)
    down: csr_array


@dataclass(frozen=True, eq=False)
class HostCycle:
    """An approximate inverse of a symmetric matrix whose entries beside the diagonal are <= 0.

    On each level one Jacobi sweep from zero, the correction of the next level, and one more sweep.

    Attributes
    ----------
    levels : list of _Level
    last : (k, k) array
        The inverse on the last level.
    """

    levels: list[_Level]
    last: FloatArray

    @classmethod
    def of(cls, matrix: csr_array) -> HostCycle:
        """Make the levels of a positive definite matrix with more vertices than the last level may have."""
        from scipy.sparse import csr_array

        n = matrix.shape[0]
        rows = np.repeat(np.arange(n, dtype=np.int32), np.diff(matrix.indptr))
        used = (rows != matrix.indices) & (matrix.data < 0)
        couplings = Couplings.of_edges(n, rows[used], matrix.indices[used], -matrix.data[used] / 2)
        levels = []
        for coarsening in coarsened(couplings):
            inside = np.flatnonzero(coarsening.of >= 0)
            shape = (matrix.shape[0], coarsening.graph.n_vertices)
            up = csr_array((np.ones(len(inside)), (inside, coarsening.of[inside])), shape=shape)
            down = csr_array(up.T)
            levels.append(_Level(matrix, matrix.diagonal()[:, None] / _OMEGA, up, down))
            matrix = csr_array(down @ matrix @ up)
        if not levels:
            return cls([_Level(matrix, matrix.diagonal()[:, None], csr_array((n, 0)), csr_array((0, n)))], np.eye(0))
        return cls(levels, np.linalg.inv(matrix.toarray()))

    def solve(self, r: FloatArray, at: int = 0) -> FloatArray:
        """Solve for right-hand sides (n, m) on a level."""
        if at == len(self.levels):
            found: FloatArray = self.last @ r
            return found
        level = self.levels[at]
        x: FloatArray = r / level.over
        x = x + level.up @ self.solve(level.down @ (r - level.matrix @ x), at + 1)
        x = x + (r - level.matrix @ x) / level.over
        return x
