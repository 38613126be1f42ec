"""Images on their way to an OpenCL device and back; functions padded, blurred and mixed there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray, held_type
from ...frame import AS_GIVEN, Frame
from ...graphs.grid import AnyGraph, GridGraph, row_major
from ..types import Array, Weighted
from .buffers import Function
from .geometry import GridGeometry, round_up
from .launching import OpenCLLaunches
from .layout import GridLayout

# Bytes of an image that are converted at a time.
_BAND_BYTES = 1 << 25

# Cells of a row that a work item converts on a CPU.
_RUN = 1 << 12

# Functions of fewer numbers are packed on the host of a CPU: a launch takes longer.
_FEW = 1 << 14

# Work items of a group along a row.
_GROUP = 64

# The OpenCL types of an image's numbers; others are converted on the host.
_TYPES = {
    "u1": "uchar", "u2": "ushort", "u4": "uint", "u8": "ulong",
    "i1": "char", "i2": "short", "i4": "int", "i8": "long",
    "f2": "half", "f4": "float", "f8": "double",
}  # fmt: skip


class OpenCLCells(OpenCLLaunches):
    """Conversion of images by kernels, in bands of rows."""

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        if not isinstance(graph, GridGraph) or (self._shares_memory and f.size < _FEW):
            return super().put(graph, f)
        out = self._target(graph, f.shape[1])
        # in the backend's type: one kernel for all
        self._cross(graph, np.asarray(f, self.dtype).reshape(*graph.shape, -1), out, AS_GIVEN, ())
        return out

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        if not isinstance(graph, GridGraph) or (self._shares_memory and graph.n_vertices * x.channels < _FEW):
            return super().get(graph, x)
        out = np.empty((*graph.shape, x.channels), self.dtype)
        self._cross(graph, out, x, AS_GIVEN, (), back=True)
        return out.reshape(graph.n_vertices, -1)

    def _target(self, grid: GridGraph, channels: int) -> Array:
        """Allocate a function whose rows a kernel writes to their ends; the guards around its planes are 0."""
        geometry = self._geometry(grid)
        assert isinstance(geometry, GridGeometry)
        size, plane, guard = (
            n * self.dtype.itemsize for n in (geometry.size(channels), geometry.plane, geometry.guard)
        )
        buffer = self._allocate(size)
        for c in range(channels + 1):
            # of two planes the guards are beside each other
            begin, end = max(c * plane - guard, 0), min(c * plane + guard, size)
            with self._shared.lock:
                cl.enqueue_fill_buffer(self._shared.queue, buffer, np.uint8(0), begin, end - begin)
        return Function(buffer, channels)

    def _crosses(self, kind: np.dtype[Any], frame: Frame) -> bool:
        wide = kind.itemsize == 8 or held_type(kind, self.dtype) == np.float64 or not frame.is_narrow
        return kind.str[1:] in _TYPES and (self.device.float64 or not wide)

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
        geometry = self._geometry(grid)
        assert isinstance(geometry, GridGeometry)
        kind, m, W = image.dtype.newbyteorder("="), f.channels, geometry.W
        held = held_type(kind, self.dtype)
        wide = np.dtype(np.float64 if held == np.float64 or not frame.is_narrow else np.float32)
        planar = m == 1 or np.moveaxis(image, -1, 0).flags.c_contiguous
        flat = np.moveaxis(image, -1, 0).reshape(m, geometry.rows, W) if planar else image.reshape(1, -1, W * m)
        own = back and flat.flags.c_contiguous and flat.dtype.isnative and np.may_share_memory(flat, image)
        host = flat if own else np.empty(flat.shape, kind) if back else np.ascontiguousarray(flat, kind)
        at_once = (
            geometry.rows if self._shares_memory else min(geometry.rows, max(1, _BAND_BYTES // (W * m * kind.itemsize)))
        )
        options = (f"-DHELD={_name(held)}", f"-DWIDE={_name(wide)}", *_of_cells(kind))
        options += ("-DUNITS",) if len(units) else ()
        options += ("-DOFFSETS",) if frame.offset is not None else ()
        options += ("-DOUT",) if back else ()
        offset = self._nothing if frame.offset is None else self.upload(np.asarray(frame.offset, wide))
        unit = self.upload(np.asarray(units, held)) if len(units) else self._nothing
        gpu = self.device.kind == "gpu"
        run, local = (1, min(_GROUP, self.device.handle.max_work_group_size)) if gpu else (_RUN, 1)
        options += (f"-DRUN={run}", f"-DSTEP={1 if planar else m}")
        # inwards the ends of rows, which are 0, are written too
        size = round_up(-(-(W if back else geometry.pitch) // run), local)
        with self._shared.lock:
            band = None if self._shares_memory else self._scratch(-(-host[:, :at_once].nbytes // self.dtype.itemsize))
            for first in range(0, geometry.rows, at_once):
                rows = min(at_once, geometry.rows - first)
                chunk = host[:, first : first + rows]
                there = self._as_buffer(chunk, back) if band is None else band
                if band is not None and not back:
                    self._copy(band, chunk)
                args = [
                    np.int32(m),
                    np.int32(W),
                    np.int32(rows),
                    np.int64(first),
                    np.int64(W if planar else W * m),
                    np.int64(rows * W if planar else 1),
                    np.int64(geometry.pitch),
                    np.int64(geometry.plane),
                    np.int64(geometry.guard),
                    offset,
                    unit,
                    wide.type(frame.scale if back else 1 / frame.scale),
                    there,
                    f.buffer,
                ]
                kernel = self._kernel("cells", options, args)
                try:
                    kernel(self._shared.queue, (size, rows), (local, 1), *args)
                    if band is None:
                        self._wait_for(there, chunk, back)
                except BaseException:  # an interruption: the kernel may still use the memory of the host
                    self._shared.queue.finish()
                    raise
                if band is not None and back:
                    self._copy(band, chunk, back=True)
        if back and not own:
            image[...] = np.moveaxis(host.reshape(m, *grid.shape), 0, -1) if planar else host.reshape(image.shape)

    @property
    def _shares_memory(self) -> bool:
        """Whether a kernel reads and writes the memory of the host, so that an image need not be copied."""
        return self.device.kind == "cpu"

    def _as_buffer(self, host: npt.NDArray[Any], written: bool) -> cl.Buffer:
        """Return a buffer in the memory of a contiguous host array."""
        access = cl.mem_flags.WRITE_ONLY if written else cl.mem_flags.READ_ONLY
        return cl.Buffer(self._shared.context, access | cl.mem_flags.USE_HOST_PTR, hostbuf=host)

    def _wait_for(self, buffer: cl.Buffer, host: npt.NDArray[Any], written: bool) -> None:
        """Wait until a kernel has read a host array, or until what it has written is there."""
        with self._shared.waiting():
            if not written:
                self._shared.queue.finish()
                return
            access, queue = cl.map_flags.READ, self._shared.queue
            mapped, _ = cl.enqueue_map_buffer(queue, buffer, access, 0, host.shape, host.dtype, is_blocking=True)
            mapped.base.release(queue)

    def _copy(self, buffer: cl.Buffer, chunk: npt.NDArray[Any], *, back: bool = False) -> None:
        """Copy the rows of a band, a contiguous array for each index of the first axis, to a buffer or back."""
        with self._shared.waiting():
            for i, part in enumerate(chunk):
                if back:
                    cl.enqueue_copy(self._shared.queue, part, buffer, src_offset=i * part.nbytes, is_blocking=True)
                else:
                    cl.enqueue_copy(self._shared.queue, buffer, part, dst_offset=i * part.nbytes, is_blocking=True)

    def _padded(
        self,
        grid: GridGraph,
        f: Array,
        beyond: tuple[int, ...],
        row: tuple[int, int],
        *,
        before: int = 0,
        zeros: bool = False,
    ) -> cl.Buffer:
        """Return the planes of a function with cells beyond the grid, as in ``padded.cl``.

        Parameters
        ----------
        grid : GridGraph
        f : Array
        beyond : tuple of int
            Cells on each side of each axis.
        row : (width, left)
            Numbers in a row of the result, and before its first cell.
        before : int
            Zeros before the first plane and after the last one.
        zeros : bool
            Zeros beyond the grid instead of reflected cells.
        """
        layout = self._topology(grid)
        geometry = layout.geometry
        assert isinstance(layout, GridLayout) and isinstance(geometry, GridGeometry)
        n_rows = math.prod(size + 2 * r for size, r in zip(grid.shape[:-1], beyond[:-1], strict=True))
        width, left = row
        out = self._between_zeros(2 * before + f.channels * n_rows * width, before, self.dtype.itemsize)
        args = [
            np.int32(f.channels),
            layout.shape_buffer,
            self.upload(np.array(beyond, np.int32)),
            np.int64(geometry.pitch),
            np.int64(geometry.plane),
            np.int64(geometry.guard),
            np.int32(n_rows),
            np.int32(width),
            np.int32(left),
            np.int64(before),
            f.buffer,
            out,
        ]
        options = (f"-DNDIM={grid.ndim}", f"-DN={self.lanes}", *(("-DZERO_BEYOND",) if zeros else ()))
        local = min(_GROUP, self.device.handle.max_work_group_size) if self.device.kind == "gpu" else 1
        size = (round_up(-(-width // self.lanes), local), n_rows)
        with self._shared.lock:
            self._kernel("padded", options, args)(self._shared.queue, size, (local, 1), *args)
        return out

    def blur(self, grid: GridGraph, f: Array, taps: Sequence[FloatArray]) -> Array:
        weighted = Weighted(grid, self._topology(grid), None)
        rows = (*row_major(grid.shape[:-1]).tolist(), 0)
        for axis, kernel in enumerate(taps):
            if len(kernel) > 1:
                out = self.empty(grid, f.channels)
                place = [
                    np.int32(f.channels),
                    np.int32(grid.shape[axis]),
                    np.int32(rows[axis]),
                    np.int32(len(kernel) - 1),
                ]
                args = [*place, self.upload(kernel.astype(self.dtype)), f.buffer, out.buffer]
                self._run("blur", weighted, args)
                f = out
        return f

    def mix(self, graph: AnyGraph, f: Array, matrix: FloatArray) -> Array:
        out = self.empty(graph, len(matrix))
        factors = np.asarray(matrix, self.dtype)
        args = [np.int32(f.channels), np.int32(len(factors)), self.upload(factors), f.buffer, out.buffer]
        weighted = Weighted(graph, self._topology(graph), None)
        self._run("mix", weighted, args)
        return out


def _name(kind: np.dtype[Any]) -> str:
    return "double" if kind == np.float64 else "float"


def _of_cells(kind: np.dtype[Any]) -> tuple[str, ...]:
    """Return the build options for the type of an image's numbers."""
    name = _TYPES[kind.str[1:]]
    if name == "half":
        return ("-DHALF_CELLS",)
    return (f"-DCELL={name}", *(("-DINTEGER_CELLS",) if kind.kind in "iu" else ()))
