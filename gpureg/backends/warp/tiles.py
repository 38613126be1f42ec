"""Blocks of cells of a grid of two axes for a GPU, whose threads share a tile (``similarity_step_gpu.py``)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ...kernels.warp.similarity_step_gpu import ITEMS
from ..patches import PatchForm

# Rows of a block: the first that has room.
_ROWS = (16, 12, 8, 4)
# 32-bit numbers of a thread in registers at most, of 255 registers: the rest is for addresses and products.
_REGISTERS = 160
# Bytes of shared memory that a kernel may use without options.
_SHARED_BYTES = 48 << 10


@dataclass(frozen=True)
class Tiles:
    """A grid, cut into blocks of cells, and the planes that their kernel reads.

    Attributes
    ----------
    graph : GridGraph
    radius, average : int
        Radius of a patch, and of a square of patches whose weights are added, in cells.
    compared, channels : int
        Channels that the patches compare, and of the function.
    itemsize : int
        Bytes of a number.
    rows : int
        Rows of a block.
    """

    graph: GridGraph
    radius: int
    average: int
    compared: int
    channels: int
    itemsize: int
    rows: int = _ROWS[0]

    @property
    def _columns(self) -> int:
        return (ITEMS - 2 * self.radius - 2 * self.average) // 4 * 4

    @property
    def registers(self) -> int:
        """32-bit numbers of a thread."""
        cells = self.rows + 2 * self.radius + 2 * self.average
        numbers = (self.compared + 1) * cells + (2 * self.channels + 2) * self.rows + 8 * self.average
        return numbers * self.itemsize // 4

    @property
    def shared_bytes(self) -> int:
        """Bytes of shared memory of a block."""
        tile = self.compared * (self.rows + 2 * self.radius + 2 * self.average) * (ITEMS + 24)
        return (tile + 2 * (self.rows + 2 * self.average) * ITEMS + 16) * self.itemsize

    def that_fit(self) -> Tiles | None:
        """Return blocks of as many rows as have room, or None if there is room for none."""
        for rows in _ROWS:
            tiles = replace(self, rows=rows)
            if tiles.registers <= _REGISTERS and tiles.shared_bytes <= _SHARED_BYTES and tiles._columns > ITEMS // 2:
                return tiles
        return None

    @property
    def count(self) -> int:
        """Number of blocks."""
        height, width = self.graph.shape
        return -(-height // self.rows) * -(-width // self._columns)

    @property
    def reach(self) -> tuple[int, int]:
        """Largest offset along each axis, in cells."""
        y, x = np.abs(self.graph.offsets).max(axis=0, initial=0).tolist()
        return y, x

    @property
    def left(self) -> int:
        """Zeros in a padded row before its first patch."""
        return self.reach[1] + self.average

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells of a plane along each axis."""
        height, width = self.graph.shape
        pitch = self.left + -(-width // self._columns) * self._columns + ITEMS + self.reach[1] + 4
        return height + 2 * self.radius, -(-pitch // 32) * 32

    def table(self, form: PatchForm) -> FloatArray:
        """Compute s for all steps along both axes, (2 reach + 1 along each): 0 where the window has no offset."""
        half = np.ones(self.graph.half_window) if form.spatial is None else form.spatial
        (y, x), offsets = self.reach, self.graph.offsets
        factors = np.zeros((2 * y + 1, 2 * x + 1))
        factors[offsets[:, 0] + y, offsets[:, 1] + x] = np.concatenate([half[::-1], half])
        return factors
