"""The long sums in Warp, in two launches each (``total.py``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph
from ...kernels.warp import dot, duality_gap, energy, max_change, total
from ..duality import prox_case
from ..sums import Number, Numbers
from ..types import Array, Box, Smoothness, Weighted
from . import memory
from .duality import WarpDuality, over_channels
from .layout import channels_of

# Segments of a long sum: enough to use a whole device, few enough for the second stage.
_CPU_SEGMENTS, _CUDA_SEGMENTS = 1 << 12, 1 << 16


class WarpSums(WarpDuality):
    """The long sums, and the largest difference."""

    def numbers(self, count: int) -> Numbers:
        return Numbers(self.upload(np.zeros(count), wp.float64), count)

    def read(self, numbers: Numbers) -> FloatArray:
        values: FloatArray = np.array(numbers.values.numpy())
        return values

    def max_change_into(self, out: Number, graph: AnyGraph, a: Array, b: Array) -> None:
        shape = self._layout(graph).shape
        options = (self.real, channels_of(a))
        self._sum(max_change.make, shape, options, [a, b], out, math.prod(shape), self.real)

    def dot_into(self, out: Number, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> None:
        shape = self._layout(graph).shape
        options = (self.real, channels_of(a), over_channels(over))
        self._sum(dot.make, shape, options, [a, b, over], out, math.prod(shape))

    def energy_into(
        self, out: Number, weighted: Weighted, f: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> None:
        bound, M = weighted.topology, channels_of(f)
        options = (bound.access, M, model.norms(M), model.edge, isinstance(lam, wp.array))
        inputs = [bound.argument, f, f0, lam, model.p, self._squared(model.eps)]
        self._sum(energy.make, bound.layout.shape, options, inputs, out, bound.layout.work)

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
        M, layout = channels_of(f), weighted.topology.layout
        case = prox_case(model.p, model.eps)
        arrays = (isinstance(lam, wp.array), box is not None)
        options = (weighted.topology.access, M, model.norms(M), case, model.edge, *arrays)
        low, high = (None, None) if box is None else (box.low, box.high)
        inputs: list[Any] = [self._mirrored(weighted), f, y, f0, lam, low, high, model.p, model.eps]
        self._sum(duality_gap.make, layout.shape, options, inputs, out, layout.work)

    def _segments(self, shape: tuple[int, int]) -> tuple[int, list[int]]:
        """Return the segments of a row, and their reach, stride and count (``energy.py``).

        On a CPU a work item takes neighbouring vertices; on a GPU neighbouring work items take neighbouring vertices.
        """
        rows, width = shape
        gpu = self.device.kind == "gpu"
        wanted = min(width, -(-(_CUDA_SEGMENTS if gpu else _CPU_SEGMENTS) // rows))
        if gpu:
            wanted = max(wanted, min(width, 32))
        count = -(-width // wanted)
        segments = -(-width // count)
        return segments, [1, segments, count] if gpu else [count, 1, count]

    def _sum(
        self,
        make: Callable[..., Any],
        shape: tuple[int, int],
        options: tuple[Any, ...],
        inputs: list[Any],
        out: Number,
        work: int,
        largest_of: Any = None,
    ) -> None:
        """Run both stages of a sum; with `largest_of`, the type of the parts, of a maximum."""
        segments, cut = self._segments(shape)
        kind, size = largest_of or wp.float64, (shape[0], segments)
        parts = out.numbers.parts.get((size, kind))
        if parts is None:
            parts = out.numbers.parts[size, kind] = memory.zeros(size, dtype=kind, device=self._on)
        self._launch(size, make, options, [*inputs, *cut], parts, work=work)
        threads = 1 if self._on.is_cpu else total.GROUP
        second = (kind, largest_of is not None)
        self._launch((1, threads), total.make, second, [parts, threads, out.at], out.numbers.values, work=1)
