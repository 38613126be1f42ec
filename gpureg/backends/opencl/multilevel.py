"""The primitives of multigrid in OpenCL."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...arrays import IntArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph
from ..multilevel import Aggregates, Smoother, lists_of
from ..types import Array, Weighted
from .duality import OpenCLDuality
from .geometry import GridGeometry, round_up
from .layout import CsrLayout, GridLayout


class _Lists(NamedTuple):
    """The lists of the aggregates on the device.

    Attributes
    ----------
    n : int
        Number of aggregates.
    starts, places : buffer
    options : tuple of str
        Their type.
    of : buffer or None
        The aggregate of each vertex, for the kernels of a whole level.
    """

    n: int
    starts: Any
    places: Any
    options: tuple[str, ...]
    of: Any


class OpenCLMultilevel(OpenCLDuality):
    """The primitives of multigrid."""

    def aggregates(self, fine: AnyGraph, coarse: Graph, of: IntArray) -> Aggregates:
        members, starts = lists_of(of, coarse.n_vertices)
        layout = self._topology(fine)
        places = members
        if isinstance(layout, GridLayout):
            at = layout.geometry
            row, x = np.divmod(members, at.W)
            places = at.guard + row * at.pitch + x
        wide = fine.n_vertices * 2 >= 2**31 or (len(places) > 0 and int(places.max()) >= 2**31)
        kind, options = (np.int64, ("-DINDEX=long",)) if wide else (np.int32, ())
        fused = type(layout) is CsrLayout and not wide
        lists = _Lists(
            coarse.n_vertices,
            self.upload(starts.astype(kind)),
            self.upload(places.astype(kind)),
            options,
            self.upload(of.astype(np.int32)) if fused else None,
        )
        return Aggregates(fine, coarse, lists)

    def _over_lists(self, primitive: str, aggregates: Aggregates, channels: int, args: list[Any]) -> None:
        """Run a kernel with one work item per aggregate."""
        lists: _Lists = aggregates.handle
        geometry = self._geometry(aggregates.fine)
        # where channel c of a vertex is: in planes on a grid, interleaved on a stored graph
        unit, stride = (1, geometry.plane) if isinstance(geometry, GridGeometry) else (channels, 1)
        group = self._csr_group(aggregates.coarse)
        numbers = [np.int64(lists.n), lists.starts, lists.places, np.int64(unit), np.int64(stride)]
        options = (f"-DM={channels}", *lists.options)
        self._launch(primitive, options, [*numbers, *args], (round_up(max(lists.n, 1), group),), (group,))

    def _restrict(self, aggregates: Aggregates, x: Array, y: Array, out: Array) -> None:
        self._over_lists("restrict", aggregates, x.channels, [x.buffer, y.buffer, out.buffer])

    def prolong(self, aggregates: Aggregates, e: Array, x: Array) -> Array:
        self._over_lists("prolong", aggregates, x.channels, [e.buffer, x.buffer])
        return x

    def _relax(self, weighted: Weighted, x: Array, r: Array, lam: float | Array, step: Array, out: Array) -> None:
        lams, options = self._lam(lam)
        args, options = [x.buffer, r.buffer, *lams, step.buffer, out.buffer], (f"-DM={x.channels}", *options)
        self._run("relax", weighted, args, options, sums=x.channels)

    # A level that is a stored graph, one row a work item, takes one launch each way.

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
        lists: _Lists = aggregates.handle
        if lists.of is None:
            return super().descend(aggregates, weighted, r, lam, smoother, scratch=scratch, out=out)
        lams, options = self._lam(lam)
        args = [np.int64(lists.n), lists.starts, lists.places, r.buffer, *lams, smoother.step.buffer, out.buffer]
        group = self._csr_group(aggregates.coarse)
        size = (round_up(max(lists.n, 1), group),)
        self._run("descend", weighted, args, (f"-DM={r.channels}", *options), size, local=(group,))
        return out

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
        lists: _Lists = aggregates.handle
        if lists.of is None:
            return super().ascend(aggregates, weighted, e, r, lam, smoother, scratch=scratch, out=out)
        lams, options = self._lam(lam)
        args = [lists.of, e.buffer, r.buffer, *lams, smoother.step.buffer, out.buffer]
        self._run("ascend", weighted, args, (f"-DM={r.channels}", *options))
        return out
