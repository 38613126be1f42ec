"""The primitives of multigrid, in numpy."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray, IntArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph
from ..multilevel import Aggregates, Multilevel, lists_of
from ..types import Array, Weighted
from .duality import NumpyDuality


class NumpyMultilevel(NumpyDuality, Multilevel):
    """The primitives of multigrid."""

    def aggregates(self, fine: AnyGraph, coarse: Graph, of: IntArray) -> Aggregates:
        return Aggregates(fine, coarse, lists_of(of, coarse.n_vertices))

    def _restrict(self, aggregates: Aggregates, x: Array, y: Array, out: Array) -> None:
        members, starts = aggregates.handle
        out[...] = 0
        some = starts[1:] > starts[:-1]
        if some.any():
            out[some] = np.add.reduceat(x[members] - y[members], starts[:-1][some], axis=0)

    def prolong(self, aggregates: Aggregates, e: Array, x: Array) -> Array:
        members, starts = aggregates.handle
        x[members] += np.repeat(e, np.diff(starts), axis=0)
        return x

    def _relax(self, weighted: Weighted, x: Array, r: Array, lam: float | Array, step: Array, out: Array) -> None:
        product: FloatArray = self.gradient(weighted, x, None, None, lam)
        out[...] = x + step * (r - product)
