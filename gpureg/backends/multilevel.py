"""The protocol of multigrid: transfers between a graph and one with fewer vertices, and the smoother.

A level of multigrid is a graph of ours with weights and a fidelity lam. Its matrix is that of eq. 25 at p = 2:

    (A x)(u) = lam(u) x(u) + 2 sum_v gamma(u, v) (gamma(u, v) x(u) - gamma(v, u) x(v))

A vertex a of the next level stands for an aggregate of vertices u. The equations are in ``kernels/README.md``.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import IntArray
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph
from .duality import Duality
from .types import Array, Weighted


@dataclass(frozen=True, eq=False)
class Aggregates:
    """Which vertices of a graph each vertex of a smaller graph stands for, on a device.

    Attributes
    ----------
    fine, coarse : Graph or GridGraph
        The graph, and the smaller one.
    handle : object
        The lists of the vertices of each aggregate, in the form of the backend.
    """

    fine: AnyGraph
    coarse: Graph
    handle: Any


@dataclass(frozen=True, eq=False)
class Smoother:
    """A Jacobi sweep for a matrix A with the diagonal D: x + step (r - A x), with step = omega/D.

    Attributes
    ----------
    step : device function, (n, 1)
        omega/D; 0 at pinned vertices.
    over : device function, (n, 1)
        D/omega; infinity at pinned vertices.
    """

    step: Array
    over: Array


def lists_of(of: IntArray, n_coarse: int) -> tuple[IntArray, IntArray]:
    """Return the vertices of each aggregate one after the other, and where each begins, (n_coarse + 1,).

    `of`, (n,), is the aggregate of each vertex, or -1.
    """
    members = np.argsort(of, kind="stable")[np.count_nonzero(of < 0) :]
    starts = np.concatenate([[0], np.cumsum(np.bincount(of[members], minlength=n_coarse))])
    return members, starts


class Multilevel(Duality):
    """The primitives of multigrid."""

    @abstractmethod
    def aggregates(self, fine: AnyGraph, coarse: Graph, of: IntArray) -> Aggregates:
        """Put the aggregate of each vertex of `fine`, (n,), on the device; -1 for one in none, as all pinned ones."""

    def restrict(self, aggregates: Aggregates, x: Array, y: Array, *, out: Array | None = None) -> Array:
        """Sum x - y, functions on the fine graph, over the vertices of each aggregate."""
        out = self._out(aggregates.coarse, self.channels(x), out)
        self._restrict(aggregates, x, y, out)
        return out

    @abstractmethod
    def _restrict(self, aggregates: Aggregates, x: Array, y: Array, out: Array) -> None: ...

    @abstractmethod
    def prolong(self, aggregates: Aggregates, e: Array, x: Array) -> Array:
        """Add to x(u), on the fine graph, the value e(a) of its aggregate; nothing where there is none. Return x."""

    def relax(
        self, weighted: Weighted, x: Array, r: Array, lam: float | Array, step: Array, *, out: Array | None = None
    ) -> Array:
        """Do one Jacobi sweep, x + step (r - A x), with the matrix A above; `out` must not be x.

        `step` has 1 channel. Where it is 0 the result is x.
        """
        out = self._out(weighted.graph, self.channels(x), out)
        self._relax(weighted, x, r, lam, step, out)
        return out

    @abstractmethod
    def _relax(self, weighted: Weighted, x: Array, r: Array, lam: float | Array, step: Array, out: Array) -> None: ...

    # The two halves of a cycle on one level; a backend with a fused kernel overrides them

    def descend(
        self,
        aggregates: Aggregates,
        weighted: Weighted,
        r: Array,
        lam: float | Array,
        smoother: Smoother,
        *,
        scratch: tuple[Array, Array],
        out: Array,
    ) -> Array:
        """Restrict the residual r - A x of the sweep from zero, x = step r, to the next level.

        `scratch` are two functions like r; :meth:`ascend` needs what is left in them.
        """
        x, product = scratch
        self.combine(weighted.graph, 0.0, r, 1.0, r, over=smoother.over, out=x)
        self.gradient(weighted, x, None, None, lam, out=product)
        return self.restrict(aggregates, r, product, out=out)

    def ascend(
        self,
        aggregates: Aggregates,
        weighted: Weighted,
        e: Array,
        r: Array,
        lam: float | Array,
        smoother: Smoother,
        *,
        scratch: tuple[Array, Array],
        out: Array,
    ) -> Array:
        """Add the correction e of the next level to x = step r, and do one sweep."""
        return self.relax(weighted, self.prolong(aggregates, e, scratch[0]), r, lam, smoother.step, out=out)
