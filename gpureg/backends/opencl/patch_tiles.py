"""Patches on a GPU: the blocks of cells of ``patch_tile.cl``, and what fits in registers and local memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
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
_ROWS = (16, 12, 8, 4)
# Channels of a launch, where all of them have no room.
_CHANNELS = 4
# Largest patches, and largest averaged ones: beyond them the kernels have no sums.
_RADIUS, LARGEST_AVERAGE = 8, 3
# 32-bit numbers of a work item in registers at most, of 255 registers: the rest is for addresses and products.
_REGISTERS = 160
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
        Channels of a launch of the function that is averaged, M.
    guided : bool
        Whether that is another function than the patches compare, or has other channels.
    largest : bool
        Whether the largest weight around each vertex is found.
    rows : int
        Rows of a block, S.
    """

    graph: GridGraph
    form: PatchForm
    itemsize: int
    compared: int
    channels: int
    guided: bool
    largest: bool
    rows: int = _ROWS[0]

    @property
    def _points(self) -> bool:
        """Whether single cells are compared, without sums."""
        return self.form.radius + self.form.average == 0

    @property
    def registers(self) -> int:
        """32-bit numbers of a work item."""
        rows, form, more = self.rows, self.form, self.rows // 4 + self.form.average
        numbers = rows * (2 + 2 * self.channels + self.largest)
        if self._points:
            numbers += rows * self.compared * (1 + self.guided)
        else:
            numbers += (self.compared + 1) * (rows + 2 * form.radius)
        addresses = rows // 2 * self.guided
        if form.maps is not None:
            numbers, addresses = numbers + 4 * rows, addresses + rows // 2
        addresses += 3 * more * (self.graph.mask is not None)
        return numbers * self.itemsize // 4 + addresses

    @property
    def local_bytes(self) -> int:
        """Bytes of local memory of a work group."""
        rows, average = self.rows, self.form.average
        numbers = self.compared * (rows + 2 * self.form.radius) * (ITEMS + CHUNK)
        if not self._points:
            numbers += (1 if average else 2) * rows * ITEMS + 32
        if average:
            numbers += (rows + 2 * average) * ITEMS + 32
        return self.itemsize * numbers

    def that_fits(self, local_bytes: int) -> PatchTiles | None:
        """Return blocks of as many rows as have room, or None if a GPU with this local memory has room for none.

        All channels are in one launch if they have room, otherwise a few.
        """
        form = self.form
        if form.radius > _RADIUS or form.average > LARGEST_AVERAGE or (form.profile != form.profile[::-1]).any():
            return None
        for rows in _ROWS:
            blocks = replace(self, rows=rows)
            fits = blocks.registers <= _REGISTERS and blocks.local_bytes <= min(local_bytes, _LOCAL_BYTES)
            if fits and rows > 2 * form.average:
                return blocks
        if self.channels <= _CHANNELS:
            return None
        return replace(self, channels=_CHANNELS, guided=True).that_fits(local_bytes)

    def launches(self, channels: int) -> Iterator[tuple[int, PatchTiles]]:
        """Yield the first channel and the blocks of each launch for a function of `channels` channels."""
        for first in range(0, channels, self.channels):
            yield first, replace(self, channels=min(self.channels, channels - first))

    @property
    def size(self) -> tuple[int, int]:
        """Number of work items along both axes."""
        (height, width), rim = self.graph.shape, 2 * self.form.average
        columns = (ITEMS - 2 * self.form.radius) // 4 * 4
        return -(-width // (columns - rim)) * ITEMS, -(-height // (self.rows - rim))

    @property
    def options(self) -> tuple[str, ...]:
        """Build options."""
        form = self.form
        options = [f"-DR={form.radius}", f"-DQ={self.compared}", f"-DM={self.channels}", f"-DS={self.rows}"]
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
