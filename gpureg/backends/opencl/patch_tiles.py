"""Patches on a GPU: the blocks of cells of ``patch_tile.cl``, and what a work group has in registers and local memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ..patches import PatchForm
from .geometry import round_up
from .strips import exp2_scale

# Work items of a group, and steps along a row that a tile has room for, as in the kernel.
ITEMS, CHUNK = 128, 24
# Rows of a block: the first that has room.
_ROWS = (16, 8, 4)
# Largest patches, and largest averaged ones: beyond them the kernels have no sums.
_RADIUS, _AVERAGE = 8, 3
# 32-bit numbers of a work item in registers at most, of 255 registers: the rest is for addresses and products.
_REGISTERS = 150
# Local memory that a kernel may use without options of a driver: 48 KiB on NVIDIA's, 64 on AMD's.
_LOCAL_BYTES = 48 << 10
# Bits of a word of a mask.
_WORD = 32


@dataclass(frozen=True)
class PatchTiles:
    """A grid of two axes, cut into blocks of cells, for patches of one form.

    Parameters
    ----------
    graph : GridGraph
    form : PatchForm
    itemsize : int
        Bytes of a number.
    compared : int
        Channels that the patches compare, Q.
    channels : int
        Channels of the function that is averaged, M.
    guided : bool
        Whether that is another function than the patches compare.
    largest : bool
        Whether the largest weight around each vertex is found.
    """

    graph: GridGraph
    form: PatchForm
    itemsize: int
    compared: int
    channels: int
    guided: bool
    largest: bool

    @property
    def _points(self) -> bool:
        """Whether single cells are compared, without sums."""
        return self.form.radius + self.form.average == 0

    def registers(self, rows: int) -> int:
        """Return the 32-bit numbers of a work item for blocks of `rows` rows."""
        radius = self.form.radius
        numbers = rows * (2 + 2 * self.channels + self.largest + 4 * (self.form.maps is not None))
        if self._points:
            numbers += rows * self.compared * (1 + self.guided)
        else:
            numbers += (self.compared + 1) * (rows + 2 * radius)
        return numbers * self.itemsize // 4

    def local_bytes(self, rows: int) -> int:
        """Return the bytes of local memory of a work group for blocks of `rows` rows."""
        average = self.form.average
        numbers = self.compared * (rows + 2 * self.form.radius) * (ITEMS + CHUNK)
        if not self._points:
            numbers += (1 if average else 2) * rows * ITEMS + 32
        if average:
            numbers += (rows + 2 * average) * ITEMS + 32
        return self.itemsize * numbers

    def rows(self, local_bytes: int) -> int | None:
        """Return the number of rows of a block, S, or None if no block has room in a GPU with this local memory."""
        form = self.form
        if form.radius > _RADIUS or form.average > _AVERAGE or (form.profile != form.profile[::-1]).any():
            return None
        for rows in _ROWS:
            if rows > 2 * form.average and self.registers(rows) <= _REGISTERS and self.local_bytes(rows) <= min(local_bytes, _LOCAL_BYTES):
                return rows
        return None

    def size(self, rows: int) -> tuple[int, int]:
        """Return the number of work items along both axes."""
        (height, width), rim = self.graph.shape, 2 * self.form.average
        columns = (ITEMS - 2 * self.form.radius) // 4 * 4
        return -(-width // (columns - rim)) * ITEMS, -(-height // (rows - rim))

    def options(self, rows: int) -> tuple[str, ...]:
        """Return the build options for blocks of `rows` rows."""
        form = self.form
        options = [f"-DR={form.radius}", f"-DQ={self.compared}", f"-DM={self.channels}", f"-DS={rows}"]
        options += [f"-DA={form.average}"] if form.average else []
        flags = {
            "FLAT": bool((form.profile == 1).all()),
            "SHIFTED_DISTANCE": form.shift != 0,
            "MASKED": self.graph.mask is not None,
            "MAPS": form.maps is not None,
            "CUT": form.cut != 0,
            "GUIDED": self.guided,
            "LARGEST": self.largest,
        }
        return (*options, *(f"-D{name}" for name, given in flags.items() if given))

    @property
    def reach(self) -> tuple[int, int]:
        """Largest offset along each axis, in cells."""
        y, x = np.abs(self.graph.offsets).max(axis=0, initial=0).tolist()
        return y, x

    def spatial(self) -> FloatArray:
        """Compute s for all steps along both axes, (2 reach + 1, 2 reach + 1): 0 where the window has no offset."""
        form, offsets = self.form, self.graph.offsets
        half = np.ones(self.graph.half_window) if form.spatial is None else form.spatial
        y, x = self.reach
        factors = np.zeros((2 * y + 1, 2 * x + 1))
        factors[offsets[:, 0] + y, offsets[:, 1] + x] = np.concatenate([half[::-1], half])
        return factors

    @property
    def mask_left(self) -> int:
        """Bits of a row of the mask before its first cell."""
        return round_up(self.reach[1] + self.form.average, _WORD)

    def mask_words(self) -> npt.NDArray[np.uint32]:
        """Return the mask as bits, (height, words), with zeros for all cells that a block may ask for."""
        height, width = self.graph.shape
        bits = round_up(self.mask_left + width + ITEMS + self.reach[1] + 3 * _WORD, _WORD)
        wide = np.zeros((height, bits), np.bool_)
        wide[:, self.mask_left : self.mask_left + width] = self.graph.mask
        return np.packbits(wide, axis=1, bitorder="little").view("<u4")

    def scale(self, real: Any) -> float:
        """Return the factor of a distance in exp2, < 0, as that of an infinite distance must be 0."""
        limits = np.finfo(real)
        return min(exp2_scale(self.form.scale or 0.0, float(limits.max)), -float(limits.tiny))
