"""Partitions in Warp."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ...graphs.grid import AnyGraph, GridGraph
from ...kernels.warp import influence_zones, influence_zones_gpu
from ..zones import ROUNDS, Distances, Lengths, Rounds, blocks, guarded
from . import memory
from .launching import WarpLaunches
from .layout import Csr
from .pool import cores

# Approximate work per vertex in a round, for the number of pieces of a launch.
_READS = 32


class WarpZones(WarpLaunches, Rounds):
    """Rounds of ``influence_zones.py``, on a GPU of ``influence_zones_gpu.py``."""

    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        here = [self.upload(x, wp.int64) for x in (mu, tag)]
        there = [memory.empty(graph.n_vertices, dtype=wp.int64, device=self._on) for _ in range(2)]
        zones, far = self._zones(graph, lengths)
        zones.hop = hop
        settle = self._settle_tiles if self.device.kind == "gpu" else self._settle_blocks
        found = settle(graph, zones, far, here, there)
        return np.array(found[0].numpy()), np.array(found[1].numpy())

    def _settle_blocks(self, graph: AnyGraph, zones: Any, far: int, here: list[Any], there: list[Any]) -> list[Any]:
        """Repeat rounds of a CPU, until no block changes."""
        n = graph.n_vertices
        zones.block, zones.line = blocks(graph, cores())
        zones.reach = n  # all vertices in the first round, then those near other blocks
        items = -(-n // zones.block)
        changed = memory.zeros(items, dtype=wp.int32, device=self._on)
        zones.place, zones.heap = (memory.zeros(n, dtype=wp.int32, device=self._on) for _ in range(2))
        options = (isinstance(graph, GridGraph),)
        moved = True
        while moved:
            (zones.mu, zones.tag), (zones.mu_out, zones.tag_out) = here, there
            self._launch((items,), influence_zones.make, options, [zones], changed, work=_READS * n)
            here, there = there, here
            zones.reach = far
            moved = bool(changed.numpy().any())
        return here

    def _settle_tiles(self, graph: AnyGraph, zones: Any, far: int, here: list[Any], there: list[Any]) -> list[Any]:
        """Repeat rounds of a GPU over the active tiles, until one changes nothing: a number says which was the last."""
        n = graph.n_vertices
        tiles = -(-n // influence_zones_gpu.TILE)
        active, following = (self.upload(np.full(tiles, value, np.int32), wp.int32) for value in (1, 0))
        changed = memory.zeros(1, dtype=wp.int32, device=self._on)
        options = (isinstance(graph, GridGraph),)
        done = last = 0
        while last == done:
            for _ in range(ROUNDS):
                done += 1
                (zones.mu, zones.tag), (zones.mu_out, zones.tag_out) = here, there
                zones.active, zones.active_out = active, following
                self._launch((n,), influence_zones_gpu.make, options, [zones, done], changed, work=_READS * n)
                here, there, active, following = there, here, following, active
            last = int(changed.numpy()[0])
        return here

    def _zones(self, graph: AnyGraph, lengths: Lengths) -> tuple[Any, int]:
        """Return the graph with its lengths, and the largest step of an edge in vertices."""
        zones = influence_zones.struct()()
        zones.n = graph.n_vertices
        if isinstance(graph, GridGraph):
            guard, jumps, padded = guarded(graph, lengths)
            if padded.size >= 2**31:
                raise MemoryError(
                    f"the grid has {padded.size} edges, a Warp array can have less than 2^31: use another backend"
                )
            zones.H, zones.guard = graph.half_window, guard
            zones.jumps = self.upload(jumps.astype(np.int32), wp.int32)
            zones.lengths = self.upload(padded.reshape(-1), wp.int32)
            return zones, guard
        layout = self._layout(graph)
        assert isinstance(layout, Csr)
        zones.indptr, zones.indices = layout.indptr, layout.indices
        zones.lengths = self.upload(lengths, wp.int32)
        return zones, graph.n_vertices
