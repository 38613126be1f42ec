"""Groups of patches in numpy: the reference for the devices."""

from __future__ import annotations

import functools
import math

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray, IntArray
from ...graphs.grid import GridGraph, row_major
from ..groups import GroupForm, GroupPrimitives, Groups, group_planes, largest_trace
from ..patches import patch_jumps
from ..types import Array

# Numbers in an array of distances, or of patches.
_BAND = 1 << 22


class NumpyGroups(GroupPrimitives):
    """Groups by a table of distances, and the step by batches of matrices."""

    def patch_groups(
        self, graph: GridGraph, guide: FloatArray, form: GroupForm, *, level: FloatArray | None = None
    ) -> Groups:
        planes = group_planes(graph, guide.astype(self.dtype, copy=False), form)
        references = form.references(graph.shape)
        members = np.zeros((len(references), form.most), np.int32)
        sizes = np.zeros(len(references), np.int32)
        limit = np.full(len(references), form.flat * form.cells * len(planes))
        if level is not None:
            limit = limit * np.ravel(level)[references]
        wide = np.pad(planes, [(0, 0), *((w, w) for w in form.window)])
        lattice = form.lattice(graph.shape)
        row = math.prod(map(len, lattice[1:]))
        for band in _bands(len(lattice[0]), row * form.places):
            those = slice(band.start * row, band.stop * row)
            distance = _distances(graph, planes, wide, form, (lattice[0][band], *lattice[1:]))
            members[those], sizes[those] = _members(distance, limit[those].astype(self.dtype), form)
        if graph.mask is not None:
            outside = ~graph.mask.ravel()[references]
            sizes[outside], members[outside] = 0, 0
        return Groups(graph, form, members, sizes)

    def get_groups(self, groups: Groups) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        return groups.members.copy(), groups.sizes.copy()

    def group_step(self, groups: Groups, f0: FloatArray, guide: FloatArray, variance: float | FloatArray) -> Array:
        graph, form = groups.graph, groups.form
        noisy, pilot = (group_planes(graph, x.astype(self.dtype, copy=False), form) for x in (f0, guide))
        noise = None
        if np.ndim(variance) > 0:
            noise = group_planes(graph, np.asarray(variance, self.dtype).reshape(-1, 1), form)[0].ravel()
        padded = noisy.shape[1:]
        size, channels = math.prod(padded), len(noisy)
        filled = np.flatnonzero(groups.sizes)
        references = np.stack(np.unravel_index(form.references(graph.shape)[filled], graph.shape), axis=1)
        steps = form.offsets() @ row_major(padded)
        centres = (references + np.array(form.patch)) @ row_major(padded)
        cells = _cells(form, padded)
        total, count = np.zeros((channels, size), self.dtype), np.zeros(size, self.dtype)
        for band in _bands(len(references), form.cells * (4 * form.most + 2 * form.cells)):
            sizes = groups.sizes[filled[band]]
            most = int(sizes.max())
            used = np.arange(most) < sizes[:, None]
            # (groups, members, cells) indices in a padded plane; the reference where there is no member
            where = (centres[band, None] + steps[groups.members[filled[band], :most]] * used)[..., None] + cells
            present = used[..., None].astype(self.dtype)
            n = sizes[:, None].astype(self.dtype)
            diagonal = np.full((len(n), form.cells), self.real(0 if noise is not None else variance))
            if noise is not None:
                diagonal = (noise[where] * present).sum(axis=1) / n
            covers = where[used].ravel()
            count += np.bincount(covers, minlength=size).astype(self.dtype)
            for c in range(channels):
                a, b = noisy[c].ravel().take(where), pilot[c].ravel().take(where)
                a = (a - ((a * present).sum(axis=1) / n)[:, None]) * present
                b = (b - ((b * present).sum(axis=1) / n)[:, None]) * present
                matrix = b.swapaxes(1, 2) @ b / np.maximum(n - 1, 1)[..., None]
                index = np.arange(form.cells)
                trace = matrix[:, index, index].sum(axis=1)
                matrix[:, index, index] += diagonal
                singular = trace > largest_trace(self.dtype) * diagonal.min(axis=1)
                matrix[singular] = np.eye(form.cells)
                # a solution, not an inverse, whose rounding errors would be those of the large values of a
                change = np.linalg.solve(matrix, a.swapaxes(1, 2)).swapaxes(1, 2) * diagonal[:, None, :]
                change[singular] = (noisy[c] - pilot[c]).ravel()[where[singular]]
                # one after the other, so that parts of a grid give the same bits
                np.add.at(total[c], covers, change[used].ravel())
        change = np.divide(total, count, out=noisy.reshape(channels, -1) - pilot.reshape(channels, -1), where=count > 0)
        value = (noisy.reshape(channels, -1) - change).reshape(noisy.shape)
        inner = tuple(slice(r, r + size) for r, size in zip(form.patch, graph.shape, strict=True))
        return np.ascontiguousarray(np.moveaxis(value[:, *inner], 0, -1).reshape(-1, channels))


def _distances(
    graph: GridGraph, planes: FloatArray, wide: FloatArray, form: GroupForm, lattice: tuple[IntArray, ...]
) -> FloatArray:
    """Compute the squared differences of patches, (references, places), for references at these positions.

    `wide` are the planes, padded by the window. For each place of the window, squared differences of cells are summed
    over the patches of the references alone.
    Infinity for places outside the grid or its mask.
    """
    first, last = int(lattice[0][0]), int(lattice[0][-1]) + 2 * form.patch[0] + 1
    distance = np.full((form.places, math.prod(map(len, lattice))), np.inf, planes.dtype)
    own = planes[:, first:last]
    squares = np.empty_like(own)
    for place, offset in enumerate(form.offsets()):
        there = [at + step for at, step in zip(lattice, offset, strict=True)]
        inside = functools.reduce(
            np.logical_and.outer, [(at >= 0) & (at < size) for at, size in zip(there, graph.shape, strict=True)]
        )
        if not inside.any():
            continue
        if graph.mask is not None:
            clipped = [np.clip(at, 0, size - 1) for at, size in zip(there, graph.shape, strict=True)]
            inside &= graph.mask[np.ix_(*clipped)]
        begin = [w + int(step) for w, step in zip(form.window, offset, strict=True)]
        begin[0] += first
        box = [slice(start, start + size) for start, size in zip(begin, own.shape[1:], strict=True)]
        np.subtract(wide[:, *box], own, out=squares)
        np.multiply(squares, squares, out=squares)
        total: FloatArray = squares[0] if len(squares) == 1 else squares.sum(axis=0)
        # along the first axis first, whose rows are contiguous
        for axis, at in enumerate(lattice):
            cells = at - (first if axis == 0 else 0)
            patch = total.take(cells, axis)
            for j in range(1, 2 * form.patch[axis] + 1):
                patch += total.take(cells + j, axis)
            total = patch
        distance[place] = np.where(inside, total, np.inf).ravel()
    return np.ascontiguousarray(distance.T)


def _members(
    distance: FloatArray, limit: FloatArray, form: GroupForm
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Choose the members of groups, (references, most) and (references,), from distances, (references, places)."""
    known = np.isfinite(distance)
    n = min(form.nearest, form.places)
    nearest = np.partition(distance, n - 1, axis=1)[:, n - 1]
    # a window with fewer patches: all of them
    nearest = np.where(np.isfinite(nearest), nearest, np.where(known, distance, 0).max(axis=1))
    chosen = known & (distance <= np.maximum(nearest, limit)[:, None])
    total = chosen.sum(axis=1, keepdims=True)
    rank = np.cumsum(chosen, axis=1) - 1
    spread = (rank + 1) * form.most // np.maximum(total, 1) > rank * form.most // np.maximum(total, 1)
    chosen &= (total <= form.most) | spread
    sizes = chosen.sum(axis=1).astype(np.int32)
    members = np.zeros((len(distance), form.most), np.int32)
    rows, columns = np.nonzero(chosen)
    members[rows, (np.cumsum(chosen, axis=1) - 1)[rows, columns]] = columns
    return members, sizes


def _cells(form: GroupForm, padded: tuple[int, ...]) -> IntArray:
    """Return the cells of a patch as index steps from its middle in a padded plane, (M,)."""
    return patch_jumps(tuple(2 * r + 1 for r in form.patch), row_major(padded))


def _bands(count: int, each: int) -> list[slice]:
    """Return ranges of groups with a bounded number of numbers in total."""
    size = max(1, _BAND // each)
    return [slice(first, min(first + size, count)) for first in range(0, count, size)]
