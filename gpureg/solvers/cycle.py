"""A V-cycle of multigrid on a device, as the preconditioner of conjugate gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Weighted
from ..backends.multilevel import Aggregates, Smoother
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph
from .levels import Coarsening

# The relaxation of the Jacobi sweeps.
OMEGA = 2 / 3


@dataclass(frozen=True, eq=False)
class _Level:
    """One level on the device.

    Attributes
    ----------
    weighted : Weighted
    lam : float or device function, (n, 1)
    smoother : Smoother
    aggregates : Aggregates
        Those of the next level.
    scratch : two device functions, (n, m)
    r, x : device functions, (n, m), of the next level
        Its right-hand side and its solution.
    """

    weighted: Weighted
    lam: float | Array
    smoother: Smoother
    aggregates: Aggregates
    scratch: tuple[Array, Array]
    r: Array
    x: Array


@dataclass(frozen=True, eq=False)
class Cycle:
    """An approximate inverse of the matrix of eq. 25 at p = 2, symmetric and positive definite.

    On each level one Jacobi sweep from zero, the correction of the next level, and one more sweep. The last level has
    the inverse of its matrix, which is applied as the matrix of a complete graph.

    Attributes
    ----------
    graph : Graph or GridGraph
        That of the first level.
    levels : list of _Level
        Empty if no vertices are coupled: then the diagonal is all of the matrix.
    diagonal : device function, (n, 1)
        That of the first level; infinity at pinned vertices.
    last : Weighted or None
        The inverse on the last level; its row sums are `last_lam`.
    """

    graph: AnyGraph
    levels: list[_Level]
    diagonal: Array
    last: Weighted | None
    last_lam: Array

    @classmethod
    def put(
        cls,
        backend: Backend,
        weighted: Weighted,
        lam: float | Array,
        diagonal: FloatArray,
        sums: FloatArray,
        coarse: list[Coarsening],
        channels: int,
    ) -> Cycle:
        """Put the levels on the device.

        Parameters
        ----------
        backend : Backend
        weighted : Weighted
            The graph of the first level.
        lam : float or device function, (n, 1)
            Its fidelity.
        diagonal : (n, 1) array
            The diagonal of its matrix; infinity at pinned vertices.
        sums : (n,) array
            The sums of the rows of its matrix over the columns that are not pinned.
        coarse : list of Coarsening
            The other levels.
        channels : int
            Number of right-hand sides, m.
        """
        levels: list[_Level] = []
        graph = weighted.graph
        over = backend.put(graph, diagonal)
        for level in coarse:
            below = level.graph
            smoother = _smoother(backend, weighted.graph, diagonal)
            aggregates = backend.aggregates(weighted.graph, below, level.of)
            scratch = backend.empty(weighted.graph, channels), backend.empty(weighted.graph, channels)
            r, x = backend.empty(below, channels), backend.empty(below, channels)
            levels.append(_Level(weighted, lam, smoother, aggregates, scratch, r, x))
            sums = level.sums(sums)
            weighted, lam = backend.prepare(below, below.weights), backend.put(below, sums[:, None])
            diagonal = (sums + 2 * below.degree())[:, None]
        if not coarse:
            return cls(graph, [], over, None, over)
        inverse = np.linalg.inv(coarse[-1].graph.to_scipy().toarray() * -2 + np.diag(diagonal[:, 0]))
        complete = _complete(len(inverse))
        last = backend.prepare(complete, -inverse[complete.edge_rows(), complete.indices] / 2)
        return cls(graph, levels, over, last, backend.put(complete, inverse.sum(axis=1)[:, None]))

    def solve(self, backend: Backend, r: Array, out: Array) -> None:
        """Do one cycle for the right-hand side r, (n, m); `backend` is that of `put`, or one that records."""
        if self.levels:
            self._down(backend, 0, r, out)
        else:
            backend.combine(self.graph, 0.0, r, 1.0, r, over=self.diagonal, out=out)

    def _down(self, backend: Backend, at: int, r: Array, out: Array) -> None:
        level = self.levels[at]
        backend.descend(
            level.aggregates, level.weighted, r, level.lam, level.smoother, scratch=level.scratch, out=level.r
        )
        if at + 1 < len(self.levels):
            self._down(backend, at + 1, level.r, level.x)
        else:
            assert self.last is not None
            backend.gradient(self.last, level.r, None, None, self.last_lam, out=level.x)
        backend.ascend(
            level.aggregates,
            level.weighted,
            level.x,
            r,
            level.lam,
            level.smoother,
            scratch=level.scratch,
            out=out,
        )


def _smoother(backend: Backend, graph: AnyGraph, diagonal: FloatArray) -> Smoother:
    """Make the smoother of a level with this diagonal, (n, 1); a row with the diagonal 0 is left as it is."""
    over = np.where(diagonal > 0, diagonal / OMEGA, np.inf)
    return Smoother(backend.put(graph, 1 / over), backend.put(graph, over))


def _complete(n: int) -> Graph:
    """Return the complete graph of n vertices."""
    columns = np.broadcast_to(np.arange(n), (n, n))
    others = columns[~np.eye(n, dtype=bool)]
    return Graph(np.arange(n + 1) * max(n - 1, 0), others)
