"""Partitions in OpenCL."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...graphs.grid import AnyGraph, GridGraph, row_major
from ..zones import ROUNDS, TILE, Distances, Lengths, Rounds, blocks, guarded
from .geometry import round_up
from .launching import OpenCLLaunches
from .layout import CsrLayout
from .rows import SlicedLayout

# Columns of a tile of a grid that has rows.
_TILE_COLUMNS = 32


class OpenCLZones(OpenCLLaunches, Rounds):
    """Rounds of ``influence_zones.cl``, on a GPU of ``influence_zones_gpu.cl``."""

    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        n = graph.n_vertices
        here = [self.upload(x.astype(np.int64, copy=False)) for x in (mu, tag)]
        there = [self._allocate(8 * n), self._allocate(8 * n)]
        with self._shared.lock:
            settle = self._settle_tiles if self.device.kind == "gpu" else self._settle_blocks
            found = settle(graph, lengths, here, there, hop)
            return self._download(found[0], n, np.int64), self._download(found[1], n, np.int64)

    def _settle_blocks(
        self, graph: AnyGraph, lengths: Lengths, here: list[Any], there: list[Any], hop: int
    ) -> list[Any]:
        """Repeat rounds of a CPU, until no block changes."""
        n = graph.n_vertices
        edges, options, far = self._edges(graph, lengths)
        block, line = blocks(graph, int(self.device.handle.max_compute_units))
        items = -(-n // block)
        changed, heap, place = self._allocate(4 * items), self._allocate(4 * n), self.upload(np.zeros(n, np.int32))
        reach, moved = n, True  # all vertices in the first round, then those near other blocks
        while moved:
            numbers = [np.int64(number) for number in (block, line, reach, hop)]
            args = [np.int64(n), *edges, *numbers, *here, place, heap, *there, changed]
            kernel = self._kernel("influence_zones", options, args)
            kernel(self._shared.queue, (items,), (1,), *args)
            here, there = there, here
            reach = far
            moved = bool(self._download(changed, items, np.int32).any())
        return here

    def _settle_tiles(
        self, graph: AnyGraph, lengths: Lengths, here: list[Any], there: list[Any], hop: int
    ) -> list[Any]:
        """Repeat rounds of a GPU over the active tiles, until one changes nothing: a number says which was the last."""
        rows, width = (graph.n_vertices // graph.shape[-1], graph.shape[-1]) if isinstance(graph, GridGraph) else (1, 0)
        width = width or graph.n_vertices
        size = min(TILE, int(self.device.handle.max_work_group_size))
        wide = size if rows == 1 else min(_TILE_COLUMNS, size)
        local = (wide, size // wide)
        over = round_up(width, local[0]), round_up(rows, local[1])
        tiles = over[0] // local[0] * (over[1] // local[1])
        edges, options, _ = self._edges(graph, lengths)
        options += (f"-DWIDE={local[0]}", f"-DHIGH={local[1]}")
        active, following = self.upload(np.ones(tiles, np.int32)), self.upload(np.zeros(tiles, np.int32))
        changed, done, last = self.upload(np.zeros(1, np.int32)), 0, 0
        while last == done:
            for _ in range(ROUNDS):
                done += 1
                numbers = [np.int64(width), np.int64(rows), *edges, np.int64(hop), np.int32(done)]
                args = [*numbers, *here, active, *there, following, changed]
                kernel = self._kernel("influence_zones_gpu", options, args)
                kernel(self._shared.queue, over, local, *args)
                here, there, active, following = there, here, following, active
            last = int(self._download(changed, 1, np.int32)[0])
        return here

    def _edges(self, graph: AnyGraph, lengths: Lengths) -> tuple[list[Any], tuple[str, ...], int]:
        """Return the kernel arguments EDGES_ARGS, the build options, and the largest step of an edge in vertices."""
        if isinstance(graph, GridGraph):
            guard, jumps, padded = guarded(graph, lengths)
            options = ("-DGRID", f"-DH={lengths.shape[1]}")
            if self.device.kind == "gpu":
                forward = graph.forward_offsets
                rows = forward[:, :-1] @ row_major(graph.shape[:-1])
                jumps = np.stack([rows, forward[:, -1]], axis=1).astype(np.int32)
            return [np.int64(guard), self.upload(jumps), self.upload(padded)], options, guard
        layout = self._topology(graph)
        assert isinstance(layout, CsrLayout)
        stored = [layout.indptr, layout.indices]
        if isinstance(layout, SlicedLayout):
            stored = [self.upload(graph.indptr), self.upload(graph.indices)]
        return [*stored, self.upload(lengths)], layout.index_options, graph.n_vertices
