"""Groups of patches on a GPU: what a work group has in local memory, and the ranges of references of the step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ..groups import GroupForm

# Work items of a reference: of the search, and of the step for small and large patches, as in the kernels.
_SEARCH, _SMALL, _LARGE, _SMALL_CELLS = 128, 64, 128, 32
# Distances of a work item, and cells of a line of a patch, at most: more would not be in registers.
_DISTANCES, _LINE = 64, 9
# Local memory that a kernel may use without options of a driver: 48 KiB on NVIDIA's, 64 on AMD's.
_LOCAL_BYTES = 48 << 10
# Bytes that the alignment of arrays may take.
_ALIGNMENT = 128
# Bytes of the tiles of a range of references.
_TILE_BYTES = 1 << 26


@dataclass(frozen=True)
class GroupTiles:
    """The tiles of groups of one form, as in ``group_tile.cl``.

    Parameters
    ----------
    form : GroupForm
    channels : int
    itemsize : int
        Bytes of a number.
    """

    form: GroupForm
    channels: int
    itemsize: int

    @property
    def cells(self) -> int:
        """Number of cells of a tile; its rows are of even length."""
        *above, last = (2 * (w + p) + 1 for w, p in zip(self.form.window, self.form.patch, strict=True))
        return math.prod(above) * (last + 1)

    @property
    def step_items(self) -> int:
        """Work items of a reference in the step."""
        return _SMALL if self.form.cells <= _SMALL_CELLS else _LARGE

    @property
    def search_items(self) -> int:
        """Work items of a reference in the search."""
        return _SEARCH

    def fits_search(self, local_bytes: int, items: int) -> bool:
        """Whether the search has room: registers for the distances, local memory for the window."""
        side = 2 * self.form.window[-1] + 1
        rows = self.form.places // side
        segments = 1 if rows > _SEARCH else min(side, _SEARCH // rows)
        run = -(-side // segments)
        own = -(-rows // _SEARCH) * run
        room = self.itemsize * (self.cells + segments * run - side) + 2 * _SEARCH
        return own <= _DISTANCES and _SEARCH <= items and room <= min(local_bytes, _LOCAL_BYTES)

    def fits_step(self, local_bytes: int, items: int, *, far: bool = False) -> bool:
        """Whether the step has room: work items for the rows of the matrix, local memory for matrix and tiles.

        With `far` the tiles are in global memory.
        """
        cells, most = self.form.cells, self.form.most
        if cells > self.step_items or 2 * self.form.patch[-1] + 1 > _LINE or self.step_items > items:
            return False
        lines = cells // (2 * self.form.patch[-1] + 1)
        parts = self.step_items // cells
        columns = 4 * -(-cells // (4 * parts))
        batch = 3 * (self.step_items // lines)
        numbers = 2 * self.cells * (not far) + cells * (cells + batch + 3) + 2 * parts * columns
        return self.itemsize * numbers + 8 * most + _ALIGNMENT <= min(local_bytes, _LOCAL_BYTES)

    @property
    def numbers(self) -> int:
        """Numbers of the tiles of a reference."""
        return self.channels * self.cells

    def at_once(self, count: int) -> int:
        """Return the number of references in a range, of `count` in total."""
        return min(count, max(1, _TILE_BYTES // (self.itemsize * self.numbers + self.form.places)))

    def ranges(self, shape: tuple[int, ...]) -> Iterator[tuple[int, int, list[range]]]:
        """Yield the ranges of references, first and last + 1, and the cells along each axis that they change."""
        lattice, counts = self.form.lattice(shape), self.form.counts(shape)
        count = math.prod(counts)
        size = self.at_once(count)
        for first in range(0, count, size):
            last = min(first + size, count)
            cells, behind, whole = [], count, False
            for axis, extent in enumerate(shape):
                # of the axes in order, the first that the range has more than one position of takes all of the next
                behind //= counts[axis]
                begin, end = first // behind % counts[axis], (last - 1) // behind % counts[axis]
                reach = self.form.window[axis] + self.form.patch[axis]
                low, high = (0, extent - 1) if whole else (int(lattice[axis][begin]), int(lattice[axis][end]))
                cells.append(range(max(0, low - reach), min(extent, high + reach + 1)))
                whole = whole or begin != end
            yield first, last, cells
