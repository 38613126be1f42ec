"""Cosine transforms in Warp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ...kernels.warp import cosine_solve as kernel
from ..cosines import Cosines, CosineSolves, Lines, radices, roots
from ..types import Array
from . import memory
from .launching import WarpLaunches
from .layout import channels_of


@dataclass(frozen=True, eq=False)
class _Place:
    """The eigenvalues, two work spaces, and for each axis its lines, roots and quarter roots."""

    eigenvalues: Any
    spaces: tuple[Any, Any]
    axes: list[tuple[Lines, Any, Any]]


class WarpCosines(WarpLaunches, CosineSolves):
    """Cosine transforms, on a GPU; a CPU's are faster in scipy."""

    @property
    def transforms(self) -> bool:
        return self.device.kind == "gpu"

    def cosines(self, graph: GridGraph, eigenvalues: FloatArray, channels: int) -> Cosines:
        if not self.transforms:
            return super().cosines(graph, eigenvalues, channels)
        pair = wp.types.vector(2, self.real)
        axes = []
        for axis, n in enumerate(graph.shape):
            tables = (self.upload(table, pair) for table in roots(n, self.dtype))
            axes.append((Lines.of(graph.shape, axis), *tables))
        numbers = max((lines.count * channels + 1) // 2 * lines.n for lines, *_ in axes)
        spaces = tuple(memory.empty(numbers, dtype=pair, device=self._on) for _ in range(2))
        place = _Place(self._upload_reals(eigenvalues.ravel()), (spaces[0], spaces[1]), axes)
        return Cosines(graph, eigenvalues, place)

    def cosine_solve(self, cosines: Cosines, r: Array, *, out: Array) -> Array:
        if cosines.place is None:
            return super().cosine_solve(cosines, r, out=out)
        axes, f = cosines.place.axes, r
        for k, axis in enumerate(axes):
            self._along(axis, cosines, f, out, divided=k == len(axes) - 1)
            f = out
        for axis in reversed(axes):
            self._along(axis, cosines, f, out, backward=True)
        return out

    def _along(
        self,
        axis: tuple[Lines, Any, Any],
        cosines: Cosines,
        f: Array,
        out: Array,
        *,
        backward: bool = False,
        divided: bool = False,
    ) -> None:
        """Transform along one axis."""
        lines, whole, quarter = axis
        channels, width = channels_of(f), cosines.graph.shape[-1]
        here, there = cosines.place.spaces
        done = 1
        for step, radix in ((0, 1), *((1, radix) for radix in radices(lines.n)), (2, 1)):
            at = kernel.struct(self.real)()
            at.n, at.lines, at.backward, at.by_line = lines.n, lines.count * channels, backward, lines.by_line
            at.columns, at.inner, at.outer, at.block = lines.columns, lines.inner, lines.outer, lines.block
            at.width, at.channels, at.along = width, channels, lines.rows_along * width or 1
            at.radix, at.done, at.divided = radix, done, divided
            at.roots, at.quarter, at.over = whole, quarter, cosines.place.eigenvalues
            at.f, at.source, at.to = self._flat(f), here, there
            size = (lines.count * channels + 1) // 2 * lines.n
            self._launch((size,), kernel.make, (self.real, step), [at], self._flat(out), work=0)
            done, here, there = done * radix, there, here

    def _flat(self, x: Array) -> Any:
        """Return the numbers of a function as an array of one axis, which keeps the function alive."""
        flat = wp.array(ptr=x.ptr, dtype=self.real, shape=(x.size * channels_of(x),), device=self._on)
        flat._ref = x
        return flat

    def overwrite(self, graph: GridGraph, f: npt.NDArray[Any], *, out: Array) -> None:
        out.assign(np.asarray(f, self.dtype).reshape(*out.shape, -1))
