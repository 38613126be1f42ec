"""How functions and weights lie in OpenCL buffers: what ``csr.cl`` and ``grid.cl`` expect."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray, IntArray
from ...graphs.csr import Graph
from ...graphs.edges import opposite_edges
from ...graphs.grid import GridGraph
from ..types import Kept

Buffer = Any
Upload = Callable[[npt.NDArray[Any]], Buffer]

# Segments of a long sum: enough to fill a GPU, few enough for the host to add.
SEGMENTS = 4096


# Offsets of the largest window that is compiled in and unrolled: every such window is a build of its own.
SMALL_WINDOW = 8

CACHE_LINE = 64

# Bytes that a block of a fused sweep may have in use at a time, and its rows for each row of halo.
WORKING_SET = 6 << 20
HALO = 32

# Columns of a block through a wide window: its weights are read in stretches as long as this.
WIDE_STRETCH = 1024


def window_runs(offsets: IntArray) -> IntArray:
    """Runs of offsets next to each other on one row, (runs, 3): number of the first, its last coordinate, how many.

    No run goes from the backward half to the forward half: the vertex itself lies between them.
    """
    if not len(offsets):
        return np.empty((0, 3), np.int64)
    follows = (offsets[1:, :-1] == offsets[:-1, :-1]).all(axis=1) & (offsets[1:, -1] == offsets[:-1, -1] + 1)
    starts = np.flatnonzero(np.concatenate([[True], ~follows]))
    counts = np.diff(np.append(starts, len(offsets)))
    return np.stack([starts, offsets[starts, -1], counts], axis=1).astype(np.int64)


def round_up(value: int, multiple: int) -> int:
    """The smallest multiple that is not below the value."""
    return -(-value // multiple) * multiple


class Layout(ABC):
    """A graph on the device, and the way between host arrays and flat buffers.

    Attributes
    ----------
    options : tuple of str
        Build options that choose ``csr.cl`` or ``grid.cl``.
    width : int
        Vertices a work item treats.
    global_size, segments : tuple of int
        Work items of a kernel, one per pack of vertices; of a sum, one per segment of `segment` packs.
    group : int or None
        Work items of a group, to a multiple of which their number may be rounded up, that of a sum too; None where that
        number must be kept.
    sum_group : tuple of int or None
        Work items of a sum that go together on a CPU, where their number is kept; None where the driver chooses.
    kept : Kept
        Weights that are on the device already.
    """

    options: tuple[str, ...]
    width: int
    global_size: tuple[int, ...]
    segments: tuple[int, ...]
    segment: int
    group: int | None = None
    sum_group: tuple[int, ...] | None = None

    def __init__(self) -> None:
        self.kept = Kept()

    @abstractmethod
    def size(self, channels: int) -> int:
        """Numbers in a function of so many channels."""

    @abstractmethod
    def pack(self, f: FloatArray) -> FloatArray:
        """A host function (n, channels) as the flat buffer holds it."""

    @abstractmethod
    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        """The way back."""

    @abstractmethod
    def weight_size(self) -> int:
        """Numbers in the weights' buffer."""

    @abstractmethod
    def pack_weights(self, weights: FloatArray) -> FloatArray:
        """Host weights as the flat buffer holds them."""

    @abstractmethod
    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        """The way back."""

    @abstractmethod
    def edge_size(self, channels: int) -> int:
        """Numbers in a function of so many channels on the directed edges."""

    @abstractmethod
    def pack_edges(self, values: FloatArray) -> FloatArray:
        """A host function on the directed edges as the flat buffer holds it."""

    @abstractmethod
    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        """The way back."""

    @abstractmethod
    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        """The kernel arguments GRAPH_ARGS; `mirrored` where the kernel reads the opposite of an edge."""


class CsrLayout(Layout):
    """A stored graph on the device."""

    def __init__(self, upload: Upload, graph: Graph, group: int) -> None:
        super().__init__()
        self.group = group
        self.n, self.n_edges = graph.n_vertices, graph.n_edges
        self.width = 1
        wide = graph.indices.dtype == np.int64
        self.options: tuple[str, ...] = ("-DINDEX=long",) if wide else ()
        self.indptr = upload(graph.indptr)
        self.indices = upload(graph.indices)
        # Made when it is first needed, from what does not keep the graph alive.
        self._upload, self._topology = upload, (graph.indptr, graph.indices)
        self._mirror: Buffer = None
        self.segment = max(1, -(-self.n // SEGMENTS))
        self.segments = (-(-self.n // self.segment),)
        self.global_size: tuple[int, ...] = (self.n,)

    def size(self, channels: int) -> int:
        return self.n * channels

    def pack(self, f: FloatArray) -> FloatArray:
        return f

    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        return flat.reshape(self.n, channels)

    def weight_size(self) -> int:
        return self.n_edges

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        return weights

    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        return flat

    def edge_size(self, channels: int) -> int:
        return self.n_edges * channels

    def pack_edges(self, values: FloatArray) -> FloatArray:
        return values

    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        return flat.reshape(self.n_edges, channels)

    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        if mirrored and self._mirror is None:
            self._mirror = self._upload(opposite_edges(*self._topology).astype(np.int64))
        return [np.int64(self.n), self.indptr, self.indices, weights, self._mirror if mirrored else weights]


@dataclass(frozen=True)
class Blocks:
    """How ``sweep.cl`` cuts a grid: `count` blocks along both axes, of `band` rows and `stretch` columns each.

    A block's ring has `slots` rows of the grid, numbers of `ring_pitch` in a row of one function, `ring_size` in all.
    """

    band: int
    stretch: int
    count: tuple[int, int]
    slots: int
    ring_pitch: int
    ring_size: int


class GridLayout(Layout):
    """An implicit grid on the device: the layout that ``grid.cl`` describes."""

    def __init__(self, upload: Upload, graph: GridGraph, lanes: int, itemsize: int = 4) -> None:
        super().__init__()
        self.N = N = lanes
        # not the graph: the layouts are kept for as long as their graph lives
        self.shape, self.options = graph.shape, ("-DGRID", f"-DNDIM={graph.ndim}")
        self.W = graph.shape[-1]
        self.rows = math.prod(graph.shape[:-1])
        self.H = graph.half_window
        offsets = graph.offsets
        strides = [math.prod(graph.shape[d + 1 : -1]) for d in range(graph.ndim - 1)]
        row_jumps = offsets[:, :-1] @ np.array(strides, np.int64)
        self.reach = int(np.abs(offsets[:, -1]).max(initial=0))
        self.jump = int(np.abs(row_jumps).max(initial=0))
        self.itemsize = itemsize
        self.pitch = self.spread(self.W)
        self.guard = round_up(self.jump * self.pitch + self.reach + N, N)
        self.plane = 2 * self.guard + self.rows * self.pitch
        self.weight_pitch = self.spread(round_up(self.W, N) + self.reach)
        self.weight_guard = round_up(self.reach + N - 1, N)
        self.width = N
        self._rings: Buffer = None
        self.shape_buffer = upload(np.array(graph.shape, np.int32))
        self.offsets = upload(offsets.astype(np.int32))
        self.row_jumps = upload(row_jumps.astype(np.int32))
        runs = window_runs(offsets)
        self.n_runs, self.runs = len(runs), upload(runs.astype(np.int32))
        compiled_in = graph.ndim <= 2 and 0 < len(offsets) <= SMALL_WINDOW
        self.wide = graph.ndim <= 2 and not compiled_in
        if compiled_in:
            self.options += (f"-DWINDOW={len(offsets)}", "-DWINDOW_STEPS=" + ",".join(map(str, offsets[:, -1])))
            self.options += ("-DWINDOW_ROWS=" + ",".join(map(str, row_jumps)),)
        packs = -(-self.W // N)
        per_row = min(packs, max(1, -(-SEGMENTS // self.rows)))
        self.segment = -(-packs // per_row)
        self.segments = (-(-packs // self.segment), self.rows)
        self.sum_group = (1, next(size for size in (8, 4, 2, 1) if self.rows % size == 0))
        self.global_size = (packs, self.rows)

    def spread(self, cells: int) -> int:
        """Numbers from one row of `cells` in whole packs to the next: an odd number of cache lines.

        With 1024 numbers all rows would begin in the same set of a cache, and more than 8 push each other out.
        """
        packs, line = round_up(cells, self.N), CACHE_LINE // self.itemsize
        return packs + line if packs % (2 * line) == 0 else packs

    def blocks(self, channels: int, norms: int, weighted: bool, cores: int, *, wide: bool | None = None) -> Blocks:
        """Blocks for a fused sweep on so many cores; `wide` as ``sweep.cl`` has it, None where the window decides."""
        wide = self.wide if wide is None else wide
        margin = round_up(self.reach, self.N)
        slots, row = (self.jump + 1, 3 * norms + channels) if wide else (2 * self.jump + 1, norms)
        # what a core has in use at a time, in bytes per column: its rows of the ring, f and the weights
        column = self.itemsize * (2 * self.jump + 1) * (norms + channels + (self.H if weighted else 0))
        stretch = WIDE_STRETCH if wide else round_up(max(WORKING_SET // column, 16 * margin), self.N)
        across = -(-self.W // stretch)
        most = max(1, self.rows // (HALO * max(1, self.jump)))
        bands = min(self.rows, max(-(-cores // across), min(most, -(-8 * cores // across))))
        across = max(across, min(-(-cores // bands), -(-self.W // (16 * self.N))))
        stretch = round_up(-(-self.W // across), self.N)
        band = -(-self.rows // bands)
        ring_pitch = self.spread(stretch + 2 * margin + self.N)
        count = (-(-self.W // stretch), -(-self.rows // band))
        return Blocks(band, stretch, count, slots, ring_pitch, slots * row * ring_pitch)

    def rings(self, blocks: Blocks, allocate: Callable[[int], Buffer]) -> Buffer:
        """Scratch for these blocks, kept for the next sweep."""
        nbytes = math.prod(blocks.count) * blocks.ring_size * self.itemsize
        if self._rings is None or self._rings.size < nbytes:
            self._rings = allocate(nbytes)
        return self._rings

    def size(self, channels: int) -> int:
        return self.plane * channels

    def _rows(self, flat: FloatArray, channels: int) -> FloatArray:
        inner = flat.reshape(channels, self.plane)[:, self.guard : self.guard + self.rows * self.pitch]
        return inner.reshape(channels, self.rows, self.pitch)[:, :, : self.W]

    def pack(self, f: FloatArray) -> FloatArray:
        channels = f.shape[1]
        flat = np.zeros(self.size(channels), f.dtype)
        self._rows(flat, channels)[...] = f.reshape(self.rows, self.W, channels).transpose(2, 0, 1)
        return flat

    def unpack(self, flat: FloatArray, channels: int) -> FloatArray:
        return np.ascontiguousarray(self._rows(flat, channels).transpose(1, 2, 0)).reshape(-1, channels)

    def weight_size(self) -> int:
        return self.weight_guard + self.rows * self.H * self.weight_pitch + self.weight_guard

    def _planes(self, flat: FloatArray, count: int) -> FloatArray:
        end = self.weight_guard + self.rows * count * self.weight_pitch
        return flat[self.weight_guard : end].reshape(self.rows, count, self.weight_pitch)[:, :, : self.W]

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        flat = np.zeros(self.weight_size(), weights.dtype)
        self._planes(flat, self.H)[...] = weights.reshape(self.H, self.rows, self.W).transpose(1, 0, 2)
        return flat

    def unpack_weights(self, flat: FloatArray) -> FloatArray:
        half = self._planes(flat, self.H).transpose(1, 0, 2)
        return np.ascontiguousarray(half).reshape(self.H, *self.shape)

    def edge_size(self, channels: int) -> int:
        return self.weight_guard + self.rows * 2 * self.H * channels * self.weight_pitch + self.weight_guard

    def pack_edges(self, values: FloatArray) -> FloatArray:
        K, channels = 2 * self.H, values.shape[-1]
        flat = np.zeros(self.edge_size(channels), values.dtype)
        by_row = values.reshape(K, self.rows, self.W, channels).transpose(1, 0, 3, 2)
        self._planes(flat, K * channels)[...] = by_row.reshape(self.rows, K * channels, self.W)
        return flat

    def unpack_edges(self, flat: FloatArray, channels: int) -> FloatArray:
        K = 2 * self.H
        by_row = self._planes(flat, K * channels).reshape(self.rows, K, channels, self.W)
        return np.ascontiguousarray(by_row.transpose(1, 0, 3, 2)).reshape(K, *self.shape, channels)

    def args(self, weights: Buffer, mirrored: bool) -> list[Any]:
        return [
            np.int32(self.W),
            np.int32(self.rows),
            np.int64(self.pitch),
            np.int64(self.plane),
            np.int64(self.guard),
            np.int32(self.H),
            np.int32(self.reach),
            self.shape_buffer,
            self.offsets,
            self.row_jumps,
            np.int32(self.n_runs),
            self.runs,
            np.int64(self.weight_pitch),
            np.int64(self.weight_guard),
            weights,
        ]
