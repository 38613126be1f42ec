"""How functions and weights lie in OpenCL buffers: what ``csr.cl`` and ``grid.cl`` expect."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graph import FloatArray, Graph, GridGraph, opposite_edges
from .base import Kept

Buffer = Any
Upload = Callable[[npt.NDArray[Any]], Buffer]

# Segments of a long sum: enough to fill a GPU, few enough for the host to add.
SEGMENTS = 4096


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
    kept : Kept
        Weights that are on the device already.
    """

    options: tuple[str, ...]
    width: int
    global_size: tuple[int, ...]
    segments: tuple[int, ...]
    segment: int
    group: int | None = None

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


class GridLayout(Layout):
    """An implicit grid on the device: the layout that ``grid.cl`` describes."""

    def __init__(self, upload: Upload, graph: GridGraph, lanes: int) -> None:
        super().__init__()
        N = lanes
        # not the graph: the layouts are kept for as long as their graph lives
        self.shape, self.options = graph.shape, ("-DGRID", f"-DNDIM={graph.ndim}")
        self.W = graph.shape[-1]
        self.rows = math.prod(graph.shape[:-1])
        self.H = graph.half_window
        offsets = graph.offsets
        strides = [math.prod(graph.shape[d + 1 : -1]) for d in range(graph.ndim - 1)]
        row_jumps = offsets[:, :-1] @ np.array(strides, np.int64)
        self.reach = int(np.abs(offsets[:, -1]).max(initial=0))
        self.pitch = round_up(self.W, N)
        self.guard = round_up(int(np.abs(row_jumps).max(initial=0)) * self.pitch + self.reach + N, N)
        self.plane = 2 * self.guard + self.rows * self.pitch
        self.weight_pitch = round_up(self.pitch + self.reach, N)
        self.weight_guard = round_up(self.reach, N)
        self.width = N
        self.shape_buffer = upload(np.array(graph.shape, np.int32))
        self.offsets = upload(offsets.astype(np.int32))
        self.row_jumps = upload(row_jumps.astype(np.int32))
        packs = -(-self.W // N)
        per_row = min(packs, max(1, -(-SEGMENTS // self.rows)))
        self.segment = -(-packs // per_row)
        self.segments = (-(-packs // self.segment), self.rows)
        self.global_size = (packs, self.rows)

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
            self.shape_buffer,
            self.offsets,
            self.row_jumps,
            np.int64(self.weight_pitch),
            np.int64(self.weight_guard),
            weights,
        ]
