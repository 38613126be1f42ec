"""Partitions in Warp."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from ...graphs.grid import AnyGraph, GridGraph
from ...kernels.warp import influence_zones
from ..zones import ROUNDS, Distances, Lengths, Rounds, blocks, guarded
from . import memory
from .launching import WarpLaunches
from .layout import Csr
from .pool import cores

# Approximate work per vertex in a round, for the number of pieces of a launch.
_READS = 32


class WarpZones(WarpLaunches, Rounds):
    """Rounds of ``influence_zones.py``."""

    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        cpu, n = self._on.is_cpu, graph.n_vertices
        zones, far = self._zones(graph, lengths)
        zones.block, zones.line = blocks(graph, cores() if cpu else None)
        zones.reach, zones.hop = n, hop  # all vertices in the first round, then those near other blocks
        items = -(-n // zones.block)
        here = [self.upload(x, wp.int64) for x in (mu, tag)]
        there = [memory.empty(n, dtype=wp.int64, device=self._on) for _ in range(2)]
        changed = memory.zeros(items, dtype=wp.int32, device=self._on)
        zones.place, zones.heap = (memory.zeros(n if cpu else 1, dtype=wp.int32, device=self._on) for _ in range(2))
        options = (isinstance(graph, GridGraph),)
        moved = True
        while moved:
            for _ in range(1 if cpu else ROUNDS):
                (zones.mu, zones.tag), (zones.mu_out, zones.tag_out) = here, there
                self._launch((items,), influence_zones.make, options, [zones], changed, work=_READS * n)
                here, there = there, here
                zones.reach = far
            moved = bool(changed.numpy().any())
        return np.array(here[0].numpy()), np.array(here[1].numpy())

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
