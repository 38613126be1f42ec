"""The primitives of multigrid in Warp."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ...arrays import IntArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph
from ...kernels.warp import prolong, relax, restrict
from ..multilevel import Aggregates, lists_of
from ..types import Array, Weighted
from .duality import WarpDuality
from .layout import channels_of


class WarpMultilevel(WarpDuality):
    """The primitives of multigrid."""

    def aggregates(self, fine: AnyGraph, coarse: Graph, of: IntArray) -> Aggregates:
        if fine.n_vertices >= 2**31:
            raise MemoryError("a Warp array has less than 2^31 vertices: use another backend")
        lists = [self.upload(array.astype(np.int32), wp.int32) for array in lists_of(of, coarse.n_vertices)]
        return Aggregates(fine, coarse, lists)

    def _over_lists(self, make: Any, aggregates: Aggregates, inputs: list[Any], out: Array, M: int) -> None:
        """Run a kernel with one work item per aggregate."""
        places, starts = aggregates.handle
        n = aggregates.coarse.n_vertices
        self._launch((1, n), make, (self.real, M), [starts, places, *inputs], out, work=n + aggregates.fine.n_vertices)

    def _restrict(self, aggregates: Aggregates, x: Array, y: Array, out: Array) -> None:
        self._over_lists(restrict.make, aggregates, [x, y], out, channels_of(x))

    def prolong(self, aggregates: Aggregates, e: Array, x: Array) -> Array:
        self._over_lists(prolong.make, aggregates, [e], x, channels_of(x))
        return x

    def _relax(self, weighted: Weighted, x: Array, r: Array, lam: float | Array, step: Array, out: Array) -> None:
        options = (channels_of(x), isinstance(lam, wp.array))
        self._run(relax.make, weighted, options, [x, r, None, lam, step], out)
