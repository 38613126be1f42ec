"""Cosine transforms in OpenCL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ..cosines import Cosines, CosineSolves, Lines, radices, roots
from ..types import Array
from .geometry import GridGeometry, round_up
from .launching import OpenCLLaunches

_GROUP = 64


@dataclass(frozen=True, eq=False)
class _Place:
    """The eigenvalues, two work spaces, and for each axis its lines, roots and quarter roots."""

    eigenvalues: cl.Buffer
    spaces: tuple[cl.Buffer, cl.Buffer]
    axes: list[tuple[Lines, cl.Buffer, cl.Buffer]]


class OpenCLCosines(OpenCLLaunches, CosineSolves):
    """Cosine transforms, on a GPU; a CPU's are faster in scipy."""

    @property
    def transforms(self) -> bool:
        return self.device.kind == "gpu"

    def cosines(self, graph: GridGraph, eigenvalues: FloatArray, channels: int) -> Cosines:
        if not self.transforms:
            return super().cosines(graph, eigenvalues, channels)
        axes = []
        for axis, n in enumerate(graph.shape):
            axes.append((Lines.of(graph.shape, axis), *map(self.upload, roots(n, self.dtype))))
        numbers = max((lines.count * channels + 1) // 2 * lines.n for lines, *_ in axes)
        spaces = (self._allocate(2 * numbers * self.dtype.itemsize), self._allocate(2 * numbers * self.dtype.itemsize))
        return Cosines(graph, eigenvalues, _Place(self.upload(eigenvalues.astype(self.dtype)), spaces, axes))

    def cosine_solve(self, cosines: Cosines, r: Array, *, out: Array) -> Array:
        if cosines.place is None:
            return super().cosine_solve(cosines, r, out=out)
        geometry, axes = self._geometry(cosines.graph), cosines.place.axes
        assert isinstance(geometry, GridGeometry)
        f = r
        for backward in (False, True):
            for k in range(len(axes)):
                last = k == len(axes) - 1
                axis = axes[len(axes) - 1 - k if backward else k]
                self._along(axis, cosines.place, geometry, f, out, backward, last and not backward)
                f = out
        return out

    def _along(
        self,
        axis: tuple[Lines, cl.Buffer, cl.Buffer],
        place: _Place,
        geometry: GridGeometry,
        f: Array,
        out: Array,
        backward: bool,
        divided: bool,
    ) -> None:
        """Transform along one axis."""
        lines, whole, quarter = axis
        count = lines.count * f.channels
        here, there = place.spaces
        steps = [("-DSTEP=0", 1), *(("-DSTEP=1", radix) for radix in radices(lines.n)), ("-DSTEP=2", 1)]
        size = round_up((count + 1) // 2 * lines.n, _GROUP)
        done = 1
        for step, radix in steps:
            args: list[Any] = [
                np.int32(lines.n),
                np.int64(count),
                *map(np.int32, (backward, lines.by_line, lines.columns, lines.inner, lines.outer)),
                *map(np.int64, (lines.block, geometry.pitch, 1, geometry.plane, geometry.guard)),
                np.int64(lines.rows_along * geometry.pitch or 1),
                *map(np.int32, (geometry.W, radix, done, divided)),
                *(whole, quarter, place.eigenvalues, f.buffer, here, there, out.buffer),
            ]
            self._launch("cosine_solve", (step,), args, (size,), (_GROUP,))
            done, here, there = done * radix, there, here

    def overwrite(self, graph: GridGraph, f: npt.NDArray[Any], *, out: Array) -> None:
        host = self._topology(graph).pack(np.asarray(f, self.dtype))
        with self._shared.waiting():
            cl.enqueue_copy(self._shared.queue, out.buffer, host, is_blocking=True)
