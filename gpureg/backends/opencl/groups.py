"""Groups of patches in OpenCL."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ..groups import GroupForm, Groups, as_column, largest_trace
from ..types import Array, BackendUnavailable
from .buffers import Function
from .cells import OpenCLCells
from .geometry import GridGeometry, round_up
from .group_tiles import GroupTiles

_AXES = 3
# Numbers of a pack at most: 49 cells are 7 packs of 8 with 7 numbers unused, or 4 of 16 with 15.
_LANES = 8
# Places of a window that fit the type of members on the device.
_PLACES = 1 << 16
# Work items of a group on a GPU, cells of a row, where sums are added and divided.
_CELLS = 64


@dataclass(frozen=True)
class _Lattice:
    """The lattice of references and the planes of a grid, as in ``lattice.cl``; along x, y, z.

    Parameters
    ----------
    graph : GridGraph
    form : GroupForm
    lanes : int
        N.
    """

    graph: GridGraph
    form: GroupForm
    lanes: int

    def along(self, values: tuple[int, ...], beyond: int) -> tuple[int, int, int]:
        """Return numbers of the axes in the order x, y, z; `beyond` for an axis that the grid does not have."""
        x, y, z = (*values[::-1], *(beyond,) * (_AXES - len(values)))
        return x, y, z

    @property
    def padded(self) -> tuple[int, int, int]:
        """Sides of a padded plane; a pack of a line of a patch may end in the rest of its row."""
        sides = [size + 2 * r for size, r in zip(self.graph.shape, self.form.patch, strict=True)]
        # in the next row it would write where another block adds at the same time
        sides[-1] += self.wide - (2 * self.form.patch[-1] + 1) if self.wide <= 16 else 0
        return self.along(tuple(sides), 1)

    @property
    def wide(self) -> int:
        """Numbers of a pack that holds a line of a patch: WIDE of ``group_step.cl``; more than 16 if none does."""
        return next(pack for pack in (4, 8, 16, _PLACES) if pack >= 2 * self.form.patch[-1] + 1)

    @property
    def before(self) -> int:
        """Numbers before and after the planes: a row of the window, and packs that extend beyond it."""
        return round_up(2 * self.form.window[-1] + 1 + 2 * self.lanes + 16, self.lanes)

    @property
    def row(self) -> tuple[int, int]:
        """Numbers of a padded row, and before its first cell."""
        return self.padded[0], 0

    @property
    def numbers(self) -> int:
        """Numbers of a plane."""
        return math.prod(self.padded)

    def size(self, channels: int) -> int:
        """Return the numbers of a buffer of planes."""
        return 2 * self.before + channels * self.numbers

    def options(self) -> tuple[str, ...]:
        """Return the build options."""
        names = ("X", "Y", "Z")
        patch, window = self.along(self.form.patch, 0), self.along(self.form.window, 0)
        radii = [f"-DP{name}={r}" for name, r in zip(names, patch, strict=True)]
        radii += [f"-DW{name}={r}" for name, r in zip(names, window, strict=True)]
        return (f"-DN={self.lanes}", *radii, f"-DMOST={self.form.most}")

    def args(self, channels: int) -> list[Any]:
        """Return the kernel arguments LATTICE_ARGS."""
        shape = self.graph.shape
        counts = self.form.counts(shape)
        width, height, _ = self.padded
        return [
            _int4(self.along(shape, 1)),
            _int4(self.along(self.form.step, 1)),
            _int4(self.along(counts, 1)),
            np.int64(self.numbers),
            np.int64(width),
            np.int64(width * height),
            np.int64(self.before),
            np.int32(channels),
        ]


class OpenCLGroups(OpenCLCells):
    """Groups of patches: the search and the step are one kernel each, on a GPU one work group a reference.

    A form whose tiles have no room in the local memory of a GPU has them in global memory. One whose matrix has none
    uses the kernels of a CPU, one work item a reference or a block of them, with private arrays in memory.
    """

    def _lattice(self, graph: GridGraph, form: GroupForm) -> _Lattice:
        if graph.ndim > _AXES or form.places > _PLACES:
            raise BackendUnavailable(
                f"groups of patches in OpenCL need at most {_AXES} axes and {_PLACES} cells of a window: use numpy"
            )
        return _Lattice(graph, form, min(self.lanes, _LANES))

    def _lattice_planes(self, lattice: _Lattice, f: Array | FloatArray) -> cl.Buffer:
        """Return the padded planes of a function between zeros."""
        grid = lattice.graph
        return self._padded(grid, self.on_device(grid, f), lattice.form.patch, lattice.row, before=lattice.before)

    def patch_groups(
        self,
        graph: GridGraph,
        guide: Array | FloatArray,
        form: GroupForm,
        *,
        level: Array | FloatArray | None = None,
    ) -> Groups:
        lattice, compared = self._lattice(graph, form), self.on_device(graph, guide)
        channels = compared.channels
        counts = form.counts(graph.shape)
        inside, levels = self._nothing, self._nothing
        if graph.mask is not None:
            inside = self._lattice_planes(lattice, graph.mask.reshape(-1, 1))
        if level is not None:
            levels = self._lattice_planes(lattice, as_column(level))
        members = self._allocate(2 * math.prod(counts) * form.most)
        sizes = self._allocate(4 * math.prod(counts))
        args = [
            *lattice.args(channels),
            self._lattice_planes(lattice, compared),
            inside,
            np.int32(graph.mask is not None),
            levels,
            np.int32(level is not None),
            np.int32(form.nearest),
            self.real(form.flat * form.cells * channels),
            members,
            sizes,
        ]
        tiles, size = GroupTiles(form, channels, self.dtype.itemsize), lattice.along(counts, 1)
        if self.device.kind == "gpu" and tiles.fits_search(*self._room):
            self._on_lattice("patch_groups_gpu", lattice.options(), args, size, tiles.search_items)
        else:
            self._on_lattice("patch_groups", lattice.options(), args, size)
        return Groups(graph, form, members, sizes)

    @property
    def _room(self) -> tuple[int, int]:
        """Bytes of local memory, and work items of a group."""
        handle = self.device.handle
        return int(handle.local_mem_size), int(handle.max_work_group_size)

    def _on_lattice(
        self, primitive: str, options: tuple[str, ...], args: list[Any], size: tuple[int, ...], items: int = 1
    ) -> None:
        """Run a kernel with `items` work items in each of the groups along the axes of `size`."""
        local = (items, *(1,) * (len(size) - 1))
        size = (size[0] * items, *size[1:])
        self._launch(primitive, options, args, size, local)

    def get_groups(self, groups: Groups) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        count = math.prod(groups.form.counts(groups.graph.shape))
        sizes = self._download(groups.sizes, count, np.int32)
        members = self._download(groups.members, count * groups.form.most, np.uint16).astype(np.int32)
        members = members.reshape(count, groups.form.most)
        members[np.arange(groups.form.most) >= sizes[:, None]] = 0
        return members, sizes

    def group_step(
        self,
        groups: Groups,
        f0: Array | FloatArray,
        guide: Array | FloatArray,
        variance: float | Array | FloatArray,
    ) -> Array:
        graph, form, data = groups.graph, groups.form, self.on_device(groups.graph, f0)
        channels = data.channels
        lattice = self._lattice(graph, form)
        geometry = self._geometry(graph)
        assert isinstance(geometry, GridGeometry)
        noisy, pilot = self._lattice_planes(lattice, data), self._lattice_planes(lattice, guide)
        variances, mapped = self._nothing, isinstance(variance, Function) or np.ndim(variance) > 0
        if mapped:
            variances = self._lattice_planes(lattice, as_column(variance))
        sums, counts = self._zeros(lattice.size(channels)), self._zeros(lattice.size(1))
        of_groups = [
            noisy,
            pilot,
            variances,
            np.int32(mapped),
            self.real(0 if mapped else variance),
            self.real(largest_trace(self.dtype)),
            groups.members,
            groups.sizes,
        ]
        tiles = GroupTiles(form, channels, self.dtype.itemsize)
        near = tiles.fits_step(*self._room)
        if self.device.kind == "gpu" and (near or tiles.fits_step(*self._room, far=True)):
            self._add_tiles(lattice, tiles, of_groups, (sums, counts), far=not near)
        else:
            self._add_blocks(lattice, channels, [*of_groups, sums, counts])
        out = self.empty(graph, channels)
        layout = [np.int64(geometry.pitch), np.int64(geometry.plane), np.int64(geometry.guard)]
        args = [*lattice.args(channels), noisy, pilot, sums, counts, *layout, out.buffer]
        cells = _CELLS if self.device.kind == "gpu" else 1
        size = (-(-graph.shape[-1] // (lattice.lanes * cells)), math.prod(graph.shape[:-1]))
        self._on_lattice("group_step", (*lattice.options(), "-DMEAN", f"-DCELLS={cells}"), args, size, cells)
        return out

    def _add_blocks(self, lattice: _Lattice, channels: int, of_groups: list[Any]) -> None:
        """Add the changes of all groups, a block of references per work item."""
        graph, form = lattice.graph, lattice.form
        block = lattice.along(form.block, 1)
        blocks = [-(-size // side) for size, side in zip(lattice.along(graph.shape, 1), block, strict=True)]
        # a line of a patch is added in packs of 4, 8 or 16, where that does not reach another block
        gap = block[0] - 2 * (form.window[-1] + form.patch[-1])
        wide = lattice.wide
        options = (*lattice.options(), *(("-DGAP",) if wide <= 16 and gap >= wide - 2 * form.patch[-1] - 1 else ()))
        for parity in itertools.product(*((0, 1) if number > 1 else (0,) for number in blocks[::-1])):
            first = parity[::-1]
            size = tuple((number - start + 1) // 2 for number, start in zip(blocks, first, strict=True))
            args = [*lattice.args(channels), _int4(first), _int4(block), *of_groups]
            self._on_lattice("group_step", options, args, size)

    def _add_tiles(
        self,
        lattice: _Lattice,
        tiles: GroupTiles,
        of_groups: list[Any],
        whole: tuple[cl.Buffer, cl.Buffer],
        *,
        far: bool,
    ) -> None:
        """Add the changes of all groups, a work group per reference, which has the sums in a tile of its own.

        `whole` are the sums and counts of the grid. With `far` the tiles have no room in local memory.
        """
        shape, form = lattice.graph.shape, lattice.form
        lattice_args = lattice.args(tiles.channels)
        at_once = tiles.at_once(math.prod(form.counts(shape)))
        scratch, marks = self._scratch(at_once * tiles.numbers), self._allocate(at_once * form.places)
        values = self._allocate(at_once * tiles.cells * tiles.itemsize) if far else self._nothing
        options = (*lattice.options(), *(("-DFAR",) if far else ()))
        for first, last, cells in tiles.ranges(shape):
            args = [*lattice_args, np.int32(first), *of_groups, scratch, marks, values]
            self._on_lattice("group_step_gpu", options, args, (last - first,), tiles.step_items)
            begin, size = (
                lattice.along(tuple(values), beyond)
                for values, beyond in (([x.start for x in cells], 0), ([len(x) for x in cells], 1))
            )
            args = [*lattice_args, _int4(begin), np.int32(first), np.int32(last)]
            args += [scratch, marks, of_groups[-1], *whole]
            self._on_lattice("group_gather", lattice.options(), args, (-(-size[0] // _CELLS), *size[1:]), _CELLS)


def _int4(values: tuple[int, ...]) -> Any:
    return cl.cltypes.make_int4(*values, *(0,) * (4 - len(values)))
