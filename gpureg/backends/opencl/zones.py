"""Partitions in OpenCL."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...graphs.grid import AnyGraph, GridGraph
from ..zones import ROUNDS, Distances, Lengths, Rounds, blocks, guarded
from .geometry import round_up
from .launching import OpenCLLaunches
from .layout import CsrLayout

_GPU_GROUP = 64


class OpenCLZones(OpenCLLaunches, Rounds):
    """Rounds of ``influence_zones.cl``."""

    def _settled(
        self, graph: AnyGraph, lengths: Lengths, mu: Distances, tag: Distances, hop: int
    ) -> tuple[Distances, Distances]:
        gpu, n = self.device.kind == "gpu", graph.n_vertices
        edges, options, far = self._edges(graph, lengths)
        block, line = blocks(graph, None if gpu else int(self.device.handle.max_compute_units))
        items = -(-n // block)
        local = min(_GPU_GROUP, int(self.device.handle.max_work_group_size)) if gpu else 1
        here = [self.upload(x.astype(np.int64, copy=False)) for x in (mu, tag)]
        there = [self._allocate(8 * n), self._allocate(8 * n)]
        changed, heap = self._allocate(4 * items), self._allocate(4 * (1 if gpu else n))
        place = self.upload(np.zeros(1 if gpu else n, np.int32))
        reach = n  # all vertices in the first round, then those near other blocks
        with self._shared.lock:
            moved = True
            while moved:
                for _ in range(ROUNDS if gpu else 1):
                    numbers = [np.int64(number) for number in (block, line, reach, hop)]
                    args = [np.int64(n), *edges, *numbers, *here, place, heap, *there, changed]
                    kernel = self._kernel("influence_zones", options, args)
                    kernel(self._shared.queue, (round_up(items, local),), (local,), *args)
                    here, there = there, here
                    reach = far
                moved = bool(self._download(changed, items, np.int32).any())
        return self._download(here[0], n, np.int64), self._download(here[1], n, np.int64)

    def _edges(self, graph: AnyGraph, lengths: Lengths) -> tuple[list[Any], tuple[str, ...], int]:
        """Return the kernel arguments EDGES_ARGS, the build options, and the largest step of an edge in vertices."""
        if isinstance(graph, GridGraph):
            guard, jumps, padded = guarded(graph, lengths)
            options = ("-DGRID", f"-DH={lengths.shape[1]}")
            return [np.int64(guard), self.upload(jumps), self.upload(padded)], options, guard
        layout = self._topology(graph)
        assert isinstance(layout, CsrLayout)
        return [layout.indptr, layout.indices, self.upload(lengths)], layout.options, graph.n_vertices
