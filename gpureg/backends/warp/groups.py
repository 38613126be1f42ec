"""Groups of patches in Warp."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import FloatArray, IntArray
from ...graphs.grid import GridGraph, row_major
from ...kernels.warp import group_step, patch_groups
from ...kernels.warp.lanes import LANES
from ..groups import GroupForm, Groups, as_column, largest_trace
from ..patches import patch_jumps
from ..types import Array
from . import memory
from .planes import WarpPlanes
from .pool import PACK_SPEED

# Numbers in the scratch memory of a launch; a GPU needs more work items at once.
_CPU_BAND, _CUDA_BAND = 1 << 22, 1 << 25
# Bytes of a vector on a CPU, and the most vectors of distances at once: both sums and values fit the registers.
_VECTOR_BYTES, _MOST_VECTORS = 32, 6


class WarpGroups(WarpPlanes):
    """Groups of patches."""

    def patch_groups(
        self,
        graph: GridGraph,
        guide: Array | FloatArray,
        form: GroupForm,
        *,
        level: Array | FloatArray | None = None,
    ) -> Groups:
        compared = self.on_device(graph, guide)
        channels = self.channels(compared)
        N, lanes, _ = self._team()
        width = 2 * form.window[-1] + 1
        packs = -(-width // N)
        U = -(-packs // -(-packs // (_MOST_VECTORS if N > 1 else 1)))
        line = -(-packs // U) * U * N
        # zeros around the planes for the window, and for the last pack of its lines
        margins = [w + p for w, p in zip(form.window, form.patch, strict=True)]
        shape = tuple(size + 2 * margin for size, margin in zip(graph.shape, margins, strict=True))
        shape = (*shape[:-1], shape[-1] + line - width)
        place = (form.patch, shape, form.window)
        references = form.references(graph.shape)

        search = patch_groups.struct(self.real)()
        search.g = self._planes(graph, compared, *place)
        search.inside = self._planes(graph, self._mask_function(graph), *place, reflects=False)
        if level is not None:
            search.level = self._planes(graph, as_column(level), *place, reflects=False)
        search.channels, search.plane, search.pitch = channels, math.prod(shape), shape[-1]
        search.live = self._indices(_live_rows(graph, margins))
        search.centres = self._indices(_centres(graph, references, margins, shape))
        search.limit = form.flat * form.cells * channels
        search.lines = self._indices(_jumps(form.window[:-1], shape[:-1]))
        search.width, search.patch = width, self._indices(_jumps(form.patch, shape))
        search.nearest, search.most = min(form.nearest, form.places), form.most
        each = math.prod(2 * w + 1 for w in form.window[:-1]) * line
        band = min(self._band(each), len(references))
        search.scratch = memory.empty(band * each, dtype=self.real, device=self._on)
        members = memory.zeros((len(references), form.most), dtype=wp.int32, device=self._on)
        sizes = memory.zeros(len(references), dtype=wp.int32, device=self._on)
        for begin in range(0, len(references), band):
            items = min(band, len(references) - begin)
            work = items * form.places * form.cells * channels // PACK_SPEED
            inputs = [search, begin, members]
            self._launch((items * lanes,), patch_groups.make, (self.real, N, U, lanes), inputs, sizes, work=work)
        return Groups(graph, form, members, sizes)

    def get_groups(self, groups: Groups) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        return np.array(groups.members.numpy()), np.array(groups.sizes.numpy())

    def group_step(
        self,
        groups: Groups,
        f0: Array | FloatArray,
        guide: Array | FloatArray,
        variance: float | Array | FloatArray,
    ) -> Array:
        graph, form = groups.graph, groups.form
        noisy, pilot = (self.on_device(graph, x) for x in (f0, guide))
        m = self.channels(noisy)
        shape = tuple(size + 2 * r for size, r in zip(graph.shape, form.patch, strict=True))
        place = (form.patch, shape, (0,) * graph.ndim)
        N, lanes, whole = self._team()
        order, starts, phases = _blocks(graph, form)

        step = group_step.struct(self.real)()
        step.noisy, step.pilot = (self._planes(graph, x, *place) for x in (noisy, pilot))
        if isinstance(variance, wp.array | np.ndarray):
            step.noise = self._planes(graph, as_column(variance), *place)
        else:
            step.variance = float(variance)
        step.worst = largest_trace(self.dtype)
        step.channels, step.plane = m, math.prod(shape)
        step.centres = self._indices(_centres(graph, form.references(graph.shape), form.patch, shape))
        step.steps, step.patch = self._indices(_jumps(form.window, shape)), self._indices(_jumps(form.patch, shape))
        step.members, step.sizes = groups.members, groups.sizes
        step.order, step.starts = self._indices(order), self._indices(starts)
        multiple = max(N, 4)
        step.pitch = P = -(-form.cells // multiple) * multiple
        step.total = memory.zeros(m * math.prod(shape), dtype=self.real, device=self._on)
        count = memory.zeros(math.prod(shape), dtype=self.real, device=self._on)
        # two tables of the patches of a group, two of its matrices, and five rows
        each = (2 * -(-form.most // 4) * 4 + 2 * P + 5) * P * m
        items = np.arange(len(starts)) if whole else starts
        bands = _bands(items, phases, self._band(each))
        most = max(int(items[b] - items[a]) for a, b in bands)
        step.scratch = memory.zeros(most * each, dtype=self.real, device=self._on)
        for a, b in bands:
            work = int(starts[b] - starts[a]) * m * form.most * form.cells**2 // PACK_SPEED
            dim = (int(items[b] - items[a]) * m * lanes,)
            self._launch(dim, group_step.make, (self.real, N, lanes, whole), [step, a], count, work=work)
            if not whole:
                dim = ((b - a) * m * lanes,)
                self._launch(dim, group_step.make_add, (self.real, lanes), [step, a], count, work=work)
        out = self.empty(graph, m)
        rows, width = out.shape
        lines = np.indices(graph.shape[:-1]).reshape(graph.ndim - 1, rows)
        begins = row_major(shape)[:-1] @ (lines + np.array(form.patch[:-1], np.int64)[:, None]) + form.patch[-1]
        inputs = [step, count, self._indices(begins), width]
        self._launch(
            (rows, width), group_step.make_average, (self.real,), inputs, self._numbers(out), work=rows * width * m
        )
        return out

    def _team(self) -> tuple[int, int, bool]:
        """Return the numbers of a vector, the threads of a work item, and whether a work item is a block of groups."""
        if self._on.is_cpu:
            return _VECTOR_BYTES // self.dtype.itemsize, 1, True
        return 1, LANES, False

    def _band(self, each: int) -> int:
        """Return how many work items a launch has at most, if each needs so many numbers of scratch memory."""
        return max(1, (_CPU_BAND if self._on.is_cpu else _CUDA_BAND) // each)

    def _indices(self, values: npt.NDArray[Any]) -> Any:
        return self.upload(values.astype(np.int32), wp.int32)


def _live_rows(graph: GridGraph, margins: list[int]) -> npt.NDArray[Any]:
    """Return 1 for each row of a padded plane with cells inside the mask, 0 for the others."""
    rows = np.ones(graph.shape[:-1]) if graph.mask is None else np.asarray(graph.mask.any(axis=-1))
    live = np.zeros(tuple(size + 2 * margin for size, margin in zip(rows.shape, margins[:-1], strict=True)))
    live[tuple(slice(margin, margin + size) for size, margin in zip(rows.shape, margins[:-1], strict=True))] = rows
    return live.ravel()


def _centres(graph: GridGraph, references: IntArray, margins: Any, shape: tuple[int, ...]) -> IntArray:
    """Return the cells of the references in a plane of this shape that is padded by the margins."""
    at = np.stack(np.unravel_index(references, graph.shape), axis=1)
    centres: IntArray = (at + np.array(margins)) @ row_major(shape)
    return centres


def _jumps(radii: tuple[int, ...], shape: tuple[int, ...]) -> IntArray:
    """Return the index steps from the middle of a box of these radii to its cells, in an array of this shape."""
    return patch_jumps(tuple(2 * r + 1 for r in radii), row_major(shape))


def _blocks(graph: GridGraph, form: GroupForm) -> tuple[IntArray, IntArray, IntArray]:
    """Return the references by phase and block, where the blocks begin, and the blocks where the phases begin.

    A phase is the set of blocks whose indices have the same parities: they write no cell in common.
    """
    along = [at // side for at, side in zip(form.lattice(graph.shape), form.block, strict=True)]
    blocks = np.stack([x.ravel() for x in np.meshgrid(*along, indexing="ij")])
    counts = blocks.max(axis=1) + 1
    number = row_major(tuple(counts)) @ blocks
    phase = row_major((2,) * graph.ndim) @ (blocks % 2)
    # stable: row-major order in a block
    order = np.lexsort((number, phase))
    key = phase[order] * math.prod(counts) + number[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    phases = np.flatnonzero(np.diff(phase[order][first], prepend=-1))
    return order, np.append(first, len(order)), np.append(phases, len(first))


def _bands(items: IntArray, phases: IntArray, most: int) -> list[tuple[int, int]]:
    """Cut each phase into runs of blocks with at most so many work items, or of one block."""
    bands = []
    for begin, end in zip(phases[:-1].tolist(), phases[1:].tolist(), strict=True):
        while begin < end:
            stop = max(begin + 1, min(end, int(np.searchsorted(items, items[begin] + most, "right")) - 1))
            bands.append((begin, stop))
            begin = stop
    return bands
