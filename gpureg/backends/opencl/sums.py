"""The long sums in OpenCL, in two launches each (``sums.cl``)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph
from ..sums import Number, Numbers
from ..types import Array, Box, Smoothness, Weighted
from .buffers import Function
from .duality import OpenCLDuality, norm_options
from .geometry import round_up
from .rows import TeamLayout

# The first stage of a sum on a GPU: work groups at most. They fill any device of today, and the second stage adds
# their parts in one group.
_GROUPS = 1024

# Work items of a group of a sum, a power of two; of the second stage on a CPU, where barriers are loops.
_GROUP, _CPU_GROUP = 256, 16


class OpenCLSums(OpenCLDuality):
    """The long sums, and the largest difference."""

    def numbers(self, count: int) -> Numbers:
        return Numbers(self.upload(np.zeros((count, self._halves), self._sum_type)), count)

    def read(self, numbers: Numbers) -> FloatArray:
        found = self._download(numbers.values, numbers.count * self._halves, self._sum_type)
        values: FloatArray = found.astype(np.float64).reshape(numbers.count, self._halves).sum(axis=1)
        return values

    def max_change_into(self, out: Number, graph: AnyGraph, a: Array, b: Array) -> None:
        args, options = [a.buffer, b.buffer], (f"-DM={a.channels}",)
        self._sum("max_change", self._bare(graph), args, options, out, "-DMAXIMUM")

    def dot_into(self, out: Number, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> None:
        overs, over_options = self._over(over)
        args, options = [a.buffer, b.buffer, *overs], (f"-DM={a.channels}", *over_options)
        self._sum("dot", self._bare(graph), args, options, out)

    def energy_into(
        self, out: Number, weighted: Weighted, f: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> None:
        lams, lam_options = self._lam(lam)
        G, sums = model.norms(f.channels), self._nothing
        options = (f"-DM={f.channels}", f"-DG={G}", *lam_options, *(("-DEDGE_NORM",) if model.edge else ()))
        with self._shared.lock:  # the queue runs in order: scratch memory is another call's only after the last launch
            if isinstance(weighted.topology, TeamLayout):
                # teams add up what is around a vertex; below, a work item would have all edges of one
                sums, options = self._scratch(weighted.graph.n_vertices * G), (*options, "-DSUMS")
                edge_power = model.p / 2 if model.edge else None
                self._gradient_norm(weighted, f, 1.0, model.eps, G == 1, edge_power, Function(sums, G))
            args = [f.buffer, f0.buffer, sums, *lams, self.real(model.p), self.real(model.eps) ** 2]
            self._sum("energy", weighted, args, options, out)

    def duality_gap_into(
        self,
        out: Number,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        box: Box | None = None,
    ) -> None:
        (lams, lam_options), (ends, box_options) = self._lam(lam), self._box(box)
        args = [f.buffer, y.buffer, f0.buffer, *lams, *ends, self.real(model.p), self.real(model.eps)]
        options = (*norm_options(f.channels, model), *lam_options, *box_options)
        self._sum("duality_gap", weighted, args, options, out)

    @property
    def _halves(self) -> int:
        """Numbers of the device in a long sum: one float64, or two float32."""
        return 1 if self.device.float64 else 2

    def _sum(
        self,
        primitive: str,
        weighted: Weighted,
        args: list[Any],
        options: tuple[str, ...],
        out: Number,
        *second_stage: str,
    ) -> None:
        """Run both stages of a sum."""
        layout = weighted.topology
        group = min(_GROUP, 1 << (int(self.device.handle.max_work_group_size).bit_length() - 1))
        size: tuple[int, ...]
        local: tuple[int, ...] | None
        if self.device.kind == "gpu":
            count = min(_GROUPS, -(-math.prod(layout.global_size) // group))
            size, local = (count * group,), (group,)
            options = (*options, f"-DGROUP={group}")
        else:
            count = round_up(math.prod(layout.segments), layout.group or 1)
            # A few segments per group: by default PoCL makes one group of a whole row, which uses only one core.
            size, local = layout.segments, layout.sum_group
        parts = out.numbers.parts.get("parts")
        nbytes = count * self._halves * self._sum_type.itemsize
        if parts is None or parts.size < nbytes:
            parts = out.numbers.parts["parts"] = self._allocate(nbytes)
        args = [np.int64(layout.segment), *args, parts]
        self._run(primitive, weighted, args, options, size, exact=True, local=local)
        group = group if self.device.kind == "gpu" else min(group, _CPU_GROUP)
        args = [np.int32(count), parts, np.int32(out.at), out.numbers.values]
        self._launch("total", (f"-DGROUP={group}", *second_stage), args, (group,), (group,))
