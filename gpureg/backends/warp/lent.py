"""Data that lie on a device of Warp already, as functions, and functions as such data."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import held_type
from ...exchange import Memory
from ...frame import AS_GIVEN, Frame
from ...graphs.grid import AnyGraph
from ...kernels.warp import cells, reals
from ..types import Array
from . import memory as allocated
from .cells import TYPES, WarpCells

# Numbers that one launch converts at most: its indices are 32-bit.
_MOST = 1 << 31


class WarpLent(WarpCells):
    """Data on the same device: a function has their layout, C order, so that they are used or converted there."""

    def reads(self, memory: Memory) -> bool:
        return memory.numbers.device == self._on and memory.dtype in TYPES and memory.numbers.size < _MOST

    def put_memory(self, graph: AnyGraph, memory: Memory, frame: Frame, *, fresh: bool = False) -> Array:
        numbers = memory.numbers
        m = numbers.size // graph.n_vertices
        if frame == AS_GIVEN and memory.dtype == self.dtype:
            found = self._seen_as(numbers, reals.vector(self.real, m), self._layout(graph).shape)
            return wp.clone(found) if fresh else found
        f = self.empty(graph, m)
        self._convert(graph, numbers, f, memory.dtype, frame)
        return f

    def get_memory(self, graph: AnyGraph, f: Array, frame: Frame, dtype: npt.DTypeLike) -> Any:
        kind = np.dtype(dtype)
        if frame == AS_GIVEN and kind == self.dtype:
            return self._seen_as(f, self.real, (math.prod(f.shape) * self.channels(f),))
        numbers = allocated.empty(math.prod(f.shape) * self.channels(f), dtype=TYPES[kind], device=self._on)
        self._convert(graph, numbers, f, kind, frame, back=True)
        return numbers

    def _seen_as(self, array: Any, dtype: Any, shape: tuple[int, ...]) -> Any:
        """Return an array with the same memory, which lives as long as it."""
        found = wp.array(ptr=array.ptr, dtype=dtype, shape=shape, device=self._on)
        found._ref = array
        return found

    def _convert(
        self, graph: AnyGraph, numbers: Any, f: Array, kind: np.dtype[Any], frame: Frame, *, back: bool = False
    ) -> None:
        """Convert numbers, (n m,), to a function; or with `back` the function to the numbers."""
        m, (n_rows, width) = self.channels(f), self._layout(graph).shape
        held = held_type(kind, self.dtype)
        wide = np.dtype(np.float64 if held == np.float64 or not frame.is_narrow else np.float32)
        own = self._seen_as(f, self.real, (n_rows * width * m,))
        offset = self.upload(np.zeros(m, wide) if frame.offset is None else np.asarray(frame.offset, wide), TYPES[wide])
        unit = self.upload(np.ones(1, held), TYPES[held])
        types: tuple[Any, ...] = (self.real, TYPES[kind], TYPES[held], TYPES[wide], False)
        place = [m, width, width * m, m, 1, offset, unit]
        if back:
            limits = (int(np.iinfo(kind).min), int(np.iinfo(kind).max)) if kind.kind in "iu" else None
            make, options, factor, pair = cells.make_out, (*types, limits), frame.scale, (own, numbers)
        else:
            make, options, factor, pair = cells.make_in, types, 1 / frame.scale, (numbers, own)
        self._launch((n_rows, width), make, options, [*place, factor, pair[0]], pair[1], work=n_rows * width * m)
