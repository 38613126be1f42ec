"""The layouts of functions and weights in OpenCL buffers, as in ``csr.cl`` and ``grid.cl``."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray, IntArray
from ...graphs.csr import Graph
from ...graphs.edges import opposite_edges
from ...graphs.grid import GridGraph, row_major
from ..types import DeviceCopies
from .geometry import Blocks, CsrGeometry, Geometry, GridGeometry

Buffer = Any
Upload = Callable[[npt.NDArray[Any]], Buffer]

# Segments of a long sum: enough to use a whole device, few enough for the host to add.
SEGMENTS = 4096


def window_runs(offsets: IntArray) -> IntArray:
    """Find runs of adjacent offsets on one row, (runs, 3): index of the first, its last coordinate, and their number.

    No run contains both backward and forward offsets: the vertex itself lies between them.
    """
    if not len(offsets):
        return np.empty((0, 3), np.int64)
    follows = (offsets[1:, :-1] == offsets[:-1, :-1]).all(axis=1) & (offsets[1:, -1] == offsets[:-1, -1] + 1)
    starts = np.flatnonzero(np.concatenate([[True], ~follows]))
    counts = np.diff(np.append(starts, len(offsets)))
    return np.stack([starts, offsets[starts, -1], counts], axis=1).astype(np.int64)


@dataclass(frozen=True)
class Collected:
    """What a kernel collects over the edges of a vertex, whose work items several may be.

    Attributes
    ----------
    sums : int
        Numbers per vertex.
    itemsize : int
        Bytes of a number.
    for_edges : bool
        Whether the kernel needs them to write at all edges of the vertex.
    """

    sums: int
    itemsize: int
    for_edges: bool = False


@dataclass(frozen=True)
class Launch:
    """One launch of a kernel over a graph.

    Attributes
    ----------
    options : tuple of str
        Build options that choose the form of the graph.
    args : list
        The kernel arguments GRAPH_ARGS.
    size : tuple of int
        Work items.
    """

    options: tuple[str, ...]
    args: list[Any]
    size: tuple[int, ...]


class Layout(ABC):
    """A graph on the device, and the conversion between host arrays and flat buffers.

    Attributes
    ----------
    geometry : Geometry
        The sizes of its buffers.
    options : tuple of str
        Build options that choose ``csr.cl`` or ``grid.cl``.
    width : int
        Vertices per work item.
    global_size, segments : tuple of int
        Work items of a kernel, one per pack of vertices; of a sum, one per segment.
    segment : int
        Packs of a segment.
    group : int or None
        Work items of a group; the number of work items is rounded up to a multiple, also for a sum. None: no rounding.
    sum_group : tuple of int or None
        Work items of a group of a sum on a CPU, without rounding; None: the driver chooses.
    copies : DeviceCopies
        The cache of weights on the device.
    """

    geometry: Geometry
    options: tuple[str, ...]
    width: int
    global_size: tuple[int, ...]
    segments: tuple[int, ...]
    segment: int
    group: int | None = None
    sum_group: tuple[int, ...] | None = None

    def __init__(self) -> None:
        self.copies = DeviceCopies()

    @abstractmethod
    def pack(self, f: FloatArray) -> FloatArray:
        """Convert a host function (n, channels) to its flat buffer."""

    @abstractmethod
    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        """Convert a flat buffer to a host function (n, channels)."""

    @abstractmethod
    def pack_weights(self, weights: FloatArray) -> FloatArray:
        """Convert host weights to their flat buffer."""

    @abstractmethod
    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        """Convert a flat buffer to host weights."""

    @abstractmethod
    def pack_edges(self, values: FloatArray) -> FloatArray:
        """Convert a host function on the directed edges to its flat buffer."""

    @abstractmethod
    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        """Convert a flat buffer to a host function on the directed edges."""

    @abstractmethod
    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        """Return the kernel arguments GRAPH_ARGS; `mirrored` if the kernel reads the opposite of an edge."""

    def launches(
        self, weights: Buffer, mirrored: bool, collected: Collected | None, allocate: Callable[[int], Buffer]
    ) -> Iterator[Launch]:
        """Return the launches of a kernel, one after the other; without `collected` no work items share a vertex."""
        yield Launch(self.options, self.args(weights, mirrored), self.global_size)


class CsrLayout(Layout):
    """A stored graph on the device."""

    def __init__(self, upload: Upload, graph: Graph, geometry: CsrGeometry, group: int) -> None:
        super().__init__()
        self.geometry: CsrGeometry = geometry
        self.group = group
        self.width = 1
        wide = graph.indices.dtype == np.int64
        self.index_options: tuple[str, ...] = ("-DINDEX=long",) if wide else ()
        self.options = self.index_options
        # For the mirror, made at first use. A reference to the graph would keep it in the weak cache of layouts.
        self._upload, self._topology = upload, (graph.indptr, graph.indices)
        self.indptr, self.indices = self._put_edges_of(graph)
        self._mirror: Buffer = None
        self.segment = max(1, -(-geometry.n // SEGMENTS))
        self.segments = (-(-geometry.n // self.segment),)
        self.global_size: tuple[int, ...] = (geometry.n,)

    def _put_edges_of(self, graph: Graph) -> tuple[Buffer, Buffer]:
        """Upload where the rows begin, and the neighbours."""
        return self._upload(graph.indptr), self._upload(graph.indices)

    def _opposite(self) -> IntArray:
        """Return the index of the opposite of each edge."""
        return opposite_edges(*self._topology).astype(np.int64)

    def pack(self, f: FloatArray) -> FloatArray:
        return f

    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        return flat.reshape(self.geometry.n, channels)

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        return weights

    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        return flat

    def pack_edges(self, values: FloatArray) -> FloatArray:
        return values

    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        return flat.reshape(self.geometry.n_edges, channels)

    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        if mirrored and self._mirror is None:
            self._mirror = self._upload(self._opposite())
        return [np.int64(self.geometry.n), self.indptr, self.indices, weights, self._mirror if mirrored else weights]


class GridLayout(Layout):
    """An implicit grid on the device, in the layout of ``grid.cl``."""

    def __init__(self, upload: Upload, graph: GridGraph, geometry: GridGeometry) -> None:
        super().__init__()
        # no reference to the graph, which would keep it in the weak cache of layouts
        self.geometry: GridGeometry = geometry
        self.width = N = geometry.lanes
        offsets = graph.offsets
        row_jumps = offsets[:, :-1] @ row_major(graph.shape[:-1])
        self._rings: Buffer = None
        self.shape_buffer = upload(np.array(graph.shape, np.int32))
        self.offsets = upload(offsets.astype(np.int32))
        self.row_jumps = upload(row_jumps.astype(np.int32))
        runs = window_runs(offsets)
        self.n_runs, self.runs = len(runs), upload(runs.astype(np.int32))
        self.options = ("-DGRID", f"-DNDIM={graph.ndim}")
        if geometry.compiled_in:
            self.options += (f"-DWINDOW={len(offsets)}", "-DWINDOW_STEPS=" + ",".join(map(str, offsets[:, -1])))
            self.options += ("-DWINDOW_ROWS=" + ",".join(map(str, row_jumps)),)
        packs, rows = -(-geometry.W // N), geometry.rows
        per_row = min(packs, max(1, -(-SEGMENTS // rows)))
        self.segment = -(-packs // per_row)
        self.segments = (-(-packs // self.segment), rows)
        self.sum_group = (1, next(size for size in (8, 4, 2, 1) if rows % size == 0))
        self.global_size = (packs, rows)

    def rings(self, blocks: Blocks, allocate: Callable[[int], Buffer]) -> Buffer:
        """Return scratch memory for these blocks; it is reused by the next sweep."""
        nbytes = math.prod(blocks.count) * blocks.ring_size * self.geometry.itemsize
        if self._rings is None or self._rings.size < nbytes:
            self._rings = allocate(nbytes)
        return self._rings

    def _rows(self, flat: FloatArray, channels: int) -> FloatArray:
        at = self.geometry
        inner = flat.reshape(channels, at.plane)[:, at.guard : at.guard + at.rows * at.pitch]
        return inner.reshape(channels, at.rows, at.pitch)[:, :, : at.W]

    def pack(self, f: FloatArray) -> FloatArray:
        channels = f.shape[1]
        flat = np.zeros(self.geometry.size(channels), f.dtype)
        by_row = f.reshape(self.geometry.rows, self.geometry.W, channels)
        self._rows(flat, channels)[...] = by_row.transpose(2, 0, 1)
        return flat

    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        return np.ascontiguousarray(self._rows(flat, channels).transpose(1, 2, 0)).reshape(-1, channels)

    def _planes(self, flat: FloatArray, count: int) -> FloatArray:
        at = self.geometry
        end = at.weight_guard + at.rows * count * at.weight_pitch
        return flat[at.weight_guard : end].reshape(at.rows, count, at.weight_pitch)[:, :, : at.W]

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        at, H = self.geometry, self.geometry.half_window
        flat = np.zeros(at.weight_size(), weights.dtype)
        self._planes(flat, H)[...] = weights.reshape(H, at.rows, at.W).transpose(1, 0, 2)
        return flat

    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        half = self._planes(flat, self.geometry.half_window).transpose(1, 0, 2)
        return np.ascontiguousarray(half).reshape(self.geometry.half_window, *self.geometry.shape)

    def pack_edges(self, values: FloatArray) -> FloatArray:
        at, K, channels = self.geometry, 2 * self.geometry.half_window, values.shape[-1]
        flat = np.zeros(at.edge_size(channels), values.dtype)
        by_row = values.reshape(K, at.rows, at.W, channels).transpose(1, 0, 3, 2)
        self._planes(flat, K * channels)[...] = by_row.reshape(at.rows, K * channels, at.W)
        return flat

    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        at, K = self.geometry, 2 * self.geometry.half_window
        by_row = self._planes(flat, K * channels).reshape(at.rows, K, channels, at.W)
        return np.ascontiguousarray(by_row.transpose(1, 0, 3, 2)).reshape(K, *at.shape, channels)

    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        at = self.geometry
        return [
            np.int32(at.W),
            np.int32(at.rows),
            np.int64(at.pitch),
            np.int64(at.plane),
            np.int64(at.guard),
            np.int32(at.half_window),
            np.int32(at.reach),
            self.shape_buffer,
            self.offsets,
            self.row_jumps,
            np.int32(self.n_runs),
            self.runs,
            np.int64(at.weight_pitch),
            np.int64(at.weight_guard),
            weights,
        ]
