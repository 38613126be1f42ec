"""Sizes and strides of functions and weights in OpenCL buffers, computed without a device."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...graphs.grid import GridGraph, row_major

# Offsets of the largest window that is compiled in and unrolled; each window needs its own build.
SMALL_WINDOW = 8

CACHE_LINE = 64

# Bytes that a GPU reads at once. Rows of at least two such lines begin at one; shorter rows would become much longer.
GPU_LINE = 128

# Bytes in use at a time by a block of a fused sweep, and its rows per row of halo.
WORKING_SET = 6 << 20
HALO = 32

# Columns of a block with a wide window: its weights are read in stretches of this length.
WIDE_STRETCH = 1024


def round_up(value: int, multiple: int) -> int:
    """Round a value up to a multiple."""
    return -(-value // multiple) * multiple


class Geometry(ABC):
    """Sizes of the buffers of a graph."""

    @abstractmethod
    def size(self, channels: int) -> int:
        """Return the size of a function of `channels` channels, in numbers."""

    @abstractmethod
    def weight_size(self) -> int:
        """Return the size of the weights, in numbers."""

    @abstractmethod
    def edge_size(self, channels: int) -> int:
        """Return the size of a function on the directed edges, in numbers."""


@dataclass(frozen=True)
class CsrGeometry(Geometry):
    """The sizes of a stored graph: its numbers of vertices and of directed edges."""

    n: int
    n_edges: int

    def size(self, channels: int) -> int:
        return self.n * channels

    def weight_size(self) -> int:
        return self.n_edges

    def edge_size(self, channels: int) -> int:
        return self.n_edges * channels


@dataclass(frozen=True)
class SlicedGeometry(CsrGeometry):
    """The sizes of a stored graph in slices of rows; `n_edges` counts the places of edges."""


@dataclass(frozen=True)
class Blocks:
    """The blocks of ``sweep.cl``: `count` along each axis, of `band` rows and `stretch` columns.

    The ring of a block has `slots` rows, `ring_pitch` numbers per row of one function, `ring_size` numbers in total.
    """

    band: int
    stretch: int
    count: tuple[int, int]
    slots: int
    ring_pitch: int
    ring_size: int


@dataclass(frozen=True)
class GridGeometry(Geometry):
    """An implicit grid, in the layout of ``grid.cl``.

    Attributes
    ----------
    shape : tuple of int
        The shape of the grid.
    half_window : int
        Number of forward offsets, H.
    reach : int
        Largest offset along the last axis, in cells.
    jump : int
        Largest offset in rows.
    lanes : int
        Numbers in a pack, N.
    itemsize : int
        Bytes of a number.
    line : int
        Bytes at whose multiples rows begin, on a GPU; 0 if they only begin at whole packs.
    """

    shape: tuple[int, ...]
    half_window: int
    reach: int
    jump: int
    lanes: int
    itemsize: int
    line: int = 0

    @classmethod
    def of(cls, graph: GridGraph, lanes: int, itemsize: int, line: int = 0) -> GridGeometry:
        """Make the geometry of a grid graph; `line` is for rows that are at least twice as long."""
        columns, rows = graph.offsets[:, -1], graph.offsets[:, :-1] @ row_major(graph.shape[:-1])
        reach, jump = (int(np.abs(steps).max(initial=0)) for steps in (columns, rows))
        line = line if graph.shape[-1] * itemsize >= 2 * line else 0
        return cls(graph.shape, graph.half_window, reach, jump, lanes, itemsize, line)

    @cached_property
    def W(self) -> int:
        """Cells of a row."""
        return self.shape[-1]

    @cached_property
    def rows(self) -> int:
        """Number of rows: the product of all axes but the last."""
        return math.prod(self.shape[:-1])

    @property
    def multiple(self) -> int:
        """Numbers at whose multiples rows begin."""
        return max(self.lanes, self.line // self.itemsize)

    @property
    def stream_lanes(self) -> int:
        """Numbers in a pack of a kernel without neighbours: 16 bytes if a GPU's rows are aligned, otherwise N."""
        return 16 // self.itemsize if self.line else self.lanes

    @cached_property
    def pitch(self) -> int:
        """Numbers from one row of a function to the next."""
        return self.spread(self.W)

    @cached_property
    def guard(self) -> int:
        """Zeros before and after the rows of a function."""
        return round_up(self.jump * self.pitch + self.reach + self.lanes, self.multiple)

    @cached_property
    def plane(self) -> int:
        """Numbers in one channel of a function."""
        return 2 * self.guard + self.rows * self.pitch

    @cached_property
    def weight_pitch(self) -> int:
        """Numbers from one row of weights to the next."""
        return self.spread(round_up(self.W, self.lanes) + self.reach)

    @cached_property
    def weight_guard(self) -> int:
        """Zeros before and after the rows of weights."""
        return round_up(self.reach + self.lanes - 1, self.multiple)

    @property
    def compiled_in(self) -> bool:
        """Whether the window is compiled in and unrolled."""
        return len(self.shape) <= 2 and 0 < 2 * self.half_window <= SMALL_WINDOW

    @property
    def wide(self) -> bool:
        """Whether a fused sweep uses ``sweep_wide.cl``, for windows that are not compiled in."""
        return len(self.shape) <= 2 and not self.compiled_in

    def size(self, channels: int) -> int:
        return self.plane * channels

    def weight_size(self) -> int:
        return self.weight_guard + self.rows * self.half_window * self.weight_pitch + self.weight_guard

    def edge_size(self, channels: int) -> int:
        return self.weight_guard + self.rows * 2 * self.half_window * channels * self.weight_pitch + self.weight_guard

    def spread(self, cells: int) -> int:
        """Return the pitch of rows of `cells` cells: whole packs, and on a CPU not an even number of cache lines.

        With a pitch of 1024 all rows would begin in the same set of a cache, which has room for about 8.
        """
        if self.line:
            return round_up(cells, self.multiple)
        packs, line = round_up(cells, self.lanes), CACHE_LINE // self.itemsize
        return packs + line if packs % (2 * line) == 0 else packs

    def blocks(self, channels: int, norms: int, weighted: bool, cores: int, *, wide: bool | None = None) -> Blocks:
        """Compute the blocks of a fused sweep on `cores` cores; `wide` is :attr:`wide` by default."""
        wide = self.wide if wide is None else wide
        margin = round_up(self.reach, self.lanes)
        slots, row = (self.jump + 1, 3 * norms + channels) if wide else (2 * self.jump + 1, norms)
        # bytes in use at a time per column of a block: its rows of the ring, f and the weights
        column = self.itemsize * (2 * self.jump + 1) * (norms + channels + (self.half_window if weighted else 0))
        stretch = WIDE_STRETCH if wide else round_up(max(WORKING_SET // column, 16 * margin), self.lanes)
        across = -(-self.W // stretch)
        most = max(1, self.rows // (HALO * max(1, self.jump)))
        bands = min(self.rows, max(-(-cores // across), min(most, -(-8 * cores // across))))
        across = max(across, min(-(-cores // bands), -(-self.W // (16 * self.lanes))))
        stretch = round_up(-(-self.W // across), self.lanes)
        band = -(-self.rows // bands)
        ring_pitch = self.spread(stretch + 2 * margin + self.lanes)
        count = (-(-self.W // stretch), -(-self.rows // band))
        return Blocks(band, stretch, count, slots, ring_pitch, slots * row * ring_pitch)
