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
# What is added to the diagonal of the last level for each of its vertices, as a share.
_ROUNDINGS = 64 * float(np.finfo(np.float64).eps)
# The levels whose system is solved by two cycles x and y, as _FIRST x + _SECOND y with y for the residual of _FIRST x.
# If M is the matrix of a cycle, this multiplies by q(M A) M, q(t) = 3.2 - 2.4 t: symmetric, positive for eigenvalues of
# M A below 1.33, as they all are, and flatter than M alone over [0.1, 1]. It takes no products of vectors, costs a
# quarter more, and halves the steps of conjugate gradients, whose number grows with the levels between two such ones.
_TWICE = (2, 5)
_FIRST, _SECOND = 1.2, 2.0


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
    again : two device functions, (n, m), or None
        The residual and the solution of a second cycle.
    """

    weighted: Weighted
    lam: float | Array
    smoother: Smoother
    aggregates: Aggregates
    scratch: tuple[Array, Array]
    r: Array
    x: Array
    again: tuple[Array, Array] | None


@dataclass(frozen=True, eq=False)
class Cycle:
    """An approximate inverse of the matrix of eq. 25 at p = 2, symmetric and positive definite.

    On each level one Jacobi sweep from zero, the correction of the next level, and one more sweep. Two of the levels
    are solved twice. The last level has the inverse of its matrix, applied as the matrix of a complete graph.

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
        for at, level in enumerate(coarse):
            below = level.graph
            smoother = _smoother(backend, weighted.graph, diagonal)
            aggregates = backend.aggregates(weighted.graph, below, level.of)
            scratch, again = _two(backend, weighted.graph, channels), None
            r, x = _two(backend, below, channels)
            if at in _TWICE:
                again = _two(backend, weighted.graph, channels)
            levels.append(_Level(weighted, lam, smoother, aggregates, scratch, r, x, again))
            sums = level.sums(sums)
            weighted, lam = backend.prepare(below, below.weights), backend.put(below, sums[:, None])
            diagonal = (sums + 2 * below.degree())[:, None]
        if not coarse:
            return cls(graph, [], over, None, over)
        # a matrix that is singular to working precision must not get an inverse of rounding errors
        diagonal = diagonal * (1 + _ROUNDINGS * len(diagonal))
        inverse = np.linalg.inv(coarse[-1].graph.to_scipy().toarray() * -2 + np.diag(diagonal[:, 0]))
        complete = _complete(inverse / -2)
        last = backend.prepare(complete, complete.weights)
        return cls(graph, levels, over, last, backend.put(complete, inverse.sum(axis=1)[:, None]))

    def solve(self, backend: Backend, r: Array, out: Array) -> None:
        """Do one cycle for the right-hand side r, (n, m); `backend` is that of `put`, or one that records."""
        if self.levels:
            self._solve(backend, 0, r, out)
        else:
            backend.combine(self.graph, 0.0, r, 1.0, r, over=self.diagonal, out=out)

    def _solve(self, backend: Backend, at: int, r: Array, out: Array) -> None:
        """Solve the system of a level, by one cycle or by two."""
        if at == len(self.levels):
            assert self.last is not None
            backend.gradient(self.last, r, None, None, self.last_lam, out=out)
            return
        level = self.levels[at]
        self._cycle(backend, at, r, out)
        if level.again is None:
            return
        graph, (left, more) = level.weighted.graph, level.again
        backend.gradient(level.weighted, out, None, None, level.lam, out=left)
        backend.combine(graph, -_FIRST, left, 1.0, r, out=left)
        self._cycle(backend, at, left, more)
        backend.combine(graph, _SECOND, more, _FIRST, out, out=out)

    def _cycle(self, backend: Backend, at: int, r: Array, out: Array) -> None:
        """Do one cycle from a level on."""
        level = self.levels[at]
        aggregates, weighted, lam, smoother = level.aggregates, level.weighted, level.lam, level.smoother
        backend.descend(aggregates, weighted, r, lam, smoother, scratch=level.scratch, out=level.r)
        self._solve(backend, at + 1, level.r, level.x)
        backend.ascend(aggregates, weighted, level.x, r, lam, smoother, scratch=level.scratch, out=out)


def _two(backend: Backend, graph: AnyGraph, channels: int) -> tuple[Array, Array]:
    """Allocate two functions on a graph."""
    return backend.empty(graph, channels), backend.empty(graph, channels)


def _smoother(backend: Backend, graph: AnyGraph, diagonal: FloatArray) -> Smoother:
    """Make the smoother of a level with this diagonal, (n, 1); a row with the diagonal 0 is left as it is."""
    over = np.where(diagonal > 0, diagonal / OMEGA, np.inf)
    return Smoother(backend.put(graph, 1 / over), backend.put(graph, over))


def _complete(weights: FloatArray) -> Graph:
    """Return the complete graph with the entries of a square matrix off its diagonal as weights."""
    n = len(weights)
    others = ~np.eye(n, dtype=bool)
    columns = np.broadcast_to(np.arange(n), (n, n))[others]
    return Graph.trusted(np.arange(n + 1) * max(n - 1, 0), columns, weights[others])
