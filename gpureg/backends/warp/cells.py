"""Images on their way to a device of Warp and back; functions blurred and mixed there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import FloatArray, held_type
from ...frame import Frame
from ...graphs.grid import AnyGraph, GridGraph, row_major
from ...kernels.warp import blur, cells, mix
from ..types import Array
from . import memory
from .launching import WarpLaunches
from .layout import channels_of

# Bytes of an image that are converted at a time.
_BAND_BYTES = 1 << 26

# Integers of 64 bits and more have limits that are not numbers of float64: the host converts to them.
TYPES = {
    np.dtype(name): getattr(wp, name)
    for name in ("uint8", "uint16", "uint32", "int8", "int16", "int32", "float16", "float32", "float64")
}


class WarpCells(WarpLaunches):
    """Conversion of images by kernels on a GPU; on a CPU, where no copy is needed, by numpy."""

    @property
    def _converts(self) -> bool:
        """Whether kernels convert, blur and mix."""
        return not self._on.is_cpu

    def _crosses(self, kind: np.dtype[Any], frame: Frame) -> bool:
        return self._converts and kind.newbyteorder("=") in TYPES

    def _cross(
        self,
        grid: GridGraph,
        image: npt.NDArray[Any],
        f: Array,
        frame: Frame,
        units: Sequence[float],
        *,
        back: bool = False,
    ) -> None:
        kind, m = image.dtype.newbyteorder("="), channels_of(f)
        n_rows, W = self._layout(grid).shape
        held = held_type(kind, self.dtype)
        wide = np.dtype(np.float64 if held == np.float64 or not frame.is_narrow else np.float32)
        planar = m == 1 or np.moveaxis(image, -1, 0).flags.c_contiguous
        flat = np.moveaxis(image, -1, 0).reshape(m, n_rows, W) if planar else image.reshape(1, n_rows, W * m)
        host = np.empty(flat.shape, kind) if back else np.ascontiguousarray(flat, kind)
        types: tuple[Any, ...] = (self.real, TYPES[kind], TYPES[held], TYPES[wide], bool(len(units)))
        make, options, factor = cells.make_in, types, 1 / frame.scale
        if back:
            limits = (int(np.iinfo(kind).min), int(np.iinfo(kind).max)) if kind.kind in "iu" else None
            make, options, factor = cells.make_out, (*types, limits), frame.scale
        offset = self.upload(np.zeros(m, wide) if frame.offset is None else np.asarray(frame.offset, wide), types[3])
        unit = self.upload(np.asarray(units if len(units) else (1.0,), held), types[2])
        at_once = min(n_rows, max(1, _BAND_BYTES // (W * m * kind.itemsize)))
        for first in range(0, n_rows, at_once):
            rows = min(at_once, n_rows - first)
            chunk = np.ascontiguousarray(host[:, first : first + rows]).ravel()
            band = memory.empty(len(chunk), dtype=types[1], device=self._on) if back else self.upload(chunk, types[1])
            begin = f.ptr + first * W * m * self.dtype.itemsize
            part = wp.array(ptr=begin, dtype=self.real, shape=(rows * W * m,), device=self._on)
            steps = [W, 1, rows * W] if planar else [W * m, m, 1]
            source, target = (part, band) if back else (band, part)
            inputs = [m, W, *steps, offset, unit, factor, source]
            self._launch((rows, W), make, options, inputs, target, work=rows * W * m)
            if back:
                host[:, first : first + rows] = band.numpy().reshape(host[:, first : first + rows].shape)
        if back:
            image[...] = np.moveaxis(host.reshape(m, *grid.shape), 0, -1) if planar else host.reshape(image.shape)

    def blur(self, grid: GridGraph, f: Array, taps: Sequence[FloatArray]) -> Array:
        if not self._converts:
            return super().blur(grid, f, taps)
        m = channels_of(f)
        rows = (*row_major(grid.shape[:-1]).tolist(), 0)
        for axis, kernel in enumerate(taps):
            if len(kernel) > 1:
                out = self.empty(grid, m)
                inputs = [m, grid.shape[axis], rows[axis], len(kernel) - 1, self._upload_reals(kernel), self._table(f)]
                into = self._table(out)
                self._launch(into.shape, blur.make, (self.real,), inputs, into, work=math.prod(into.shape))
                f = out
        return f

    def mix(self, graph: AnyGraph, f: Array, matrix: FloatArray) -> Array:
        if not self._converts:
            return super().mix(graph, f, matrix)
        factors = np.asarray(matrix, self.dtype)
        out = self.empty(graph, len(factors))
        inputs = [channels_of(f), len(factors), self._upload_reals(factors), self._table(f)]
        shape = self._layout(graph).shape
        self._launch(shape, mix.make, (self.real,), inputs, self._table(out), work=math.prod(shape) * len(factors))
        return out

    def _table(self, f: Array) -> Any:
        """Return a function as an array of numbers, (rows, width m), in the same memory."""
        rows, width = f.shape
        return wp.array(ptr=f.ptr, dtype=self.real, shape=(rows, width * channels_of(f)), device=self._on)
