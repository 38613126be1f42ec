"""The step at p = 2 with weights that are computed from patches and not stored, in numpy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import GridGraph
from ..patches import PatchForm, reflected
from ..types import Array
from .patches import NumpyPatches

# Rows that are computed together: their arrays fit the cache, and parts of small images begin at multiples.
_BAND = 24

Slices = tuple[slice, ...]


class NumpySimilarity(NumpyPatches):
    """The fused step."""

    averages = True

    # the sums of a cell are in the order of the bands
    row_block = _BAND

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        cells = self.function_bytes(graph, 1)
        planes = self.patch_bytes(graph, channels if guide is None else guide, radius)
        return (*planes[:1], *(cells,) * (2 + 2 * channels), *planes[4:])

    def similarity_step(
        self,
        graph: GridGraph,
        f: Array | FloatArray,
        form: PatchForm,
        f0: Array,
        lam: float | Array,
        *,
        guide: Array | FloatArray | None = None,
        largest: bool = False,
        out: Array | None = None,
    ) -> Array:
        if form.scale is None:
            return super().similarity_step(graph, f, form, f0, lam, guide=guide, largest=largest, out=out)
        out = self.empty(graph, f.shape[1]) if out is None else out
        compared = reflected(graph, np.asarray(f if guide is None else guide, self.dtype), form.radius)
        values = np.ascontiguousarray(np.asarray(f, self.dtype).T).reshape(-1, *graph.shape)
        total, pull = np.zeros(graph.shape, self.dtype), np.zeros_like(values)
        unit = np.zeros(graph.shape, self.dtype) if largest else None
        for band in _bands(graph):
            for h in range(graph.half_window):
                for start, end, w in self._pairs(graph, compared, form, h, band):
                    for here, there in ((start, end), (end, start)):
                        total[here] += w
                        for sums, at in zip(pull, values, strict=True):
                            sums[here] += w * at[there]
                        if unit is not None:
                            np.maximum(unit[here], w, out=unit[here])
        if unit is not None:
            lam = self._in_units(graph, lam, unit.reshape(-1, 1))
        sums = np.moveaxis(pull, 0, -1).reshape(f.shape)
        out[...] = self._moved(f0, lam, 2 * total.reshape(-1, 1), 2 * sums)
        return out

    def _pairs(
        self, graph: GridGraph, padded: FloatArray, form: PatchForm, h: int, band: slice
    ) -> Iterator[tuple[Slices, Slices, FloatArray]]:
        """Yield the cells of a band, their neighbours along a forward offset, and their weights; or nothing."""
        start, _ = graph.ends(graph.forward_offsets[h])
        A, rows = form.average, start[_axis(graph)]
        first, last = max(rows.start, band.start), min(rows.stop, band.stop)
        if first >= last:
            return
        here, there = _ends(graph, h, slice(first, last))
        if not A:
            yield here, there, self._weights(graph, padded, form, h, here, there)
            return
        # the pairs of more rows
        wide = slice(max(rows.start, first - A), min(rows.stop, last + A))
        w = _over_squares(self._weights(graph, padded, form, h, *_ends(graph, h, wide)), A)
        w = w[first - wide.start : last - wide.start]
        yield here, there, w if graph.mask is None else w * (graph.mask[here] & graph.mask[there])

    def _weights(
        self, graph: GridGraph, padded: FloatArray, form: PatchForm, h: int, here: Slices, there: Slices
    ) -> FloatArray:
        """Compute the weights of the edges along a forward offset between these cells."""
        spatial = 1.0 if form.spatial is None else float(form.spatial[h])
        maps = [] if form.maps is None else [form.maps.reshape(*graph.shape, 2)[at] for at in (here, there)]
        w = self._similarity(self._rho(padded, form, here, there), form, spatial, *maps)
        return w if graph.mask is None else w * (graph.mask[here] & graph.mask[there])


def _axis(graph: GridGraph) -> int:
    """Return the axis that is cut into bands."""
    return max(graph.ndim - 2, 0)


def _bands(graph: GridGraph) -> list[slice]:
    """Return the bands of rows of a grid; a grid with one axis is one band."""
    size = graph.shape[_axis(graph)]
    band = _BAND if graph.ndim > 1 else size
    return [slice(first, min(first + band, size)) for first in range(0, size, band)]


def _ends(graph: GridGraph, h: int, rows: slice) -> tuple[Slices, Slices]:
    """Return the cells with a neighbour along a forward offset, in some rows, and these neighbours, as slices."""
    step, axis = graph.forward_offsets[h], _axis(graph)
    start, end = (list(ends) for ends in graph.ends(step))
    start[axis] = rows
    end[axis] = slice(rows.start + int(step[axis]), rows.stop + int(step[axis]))
    return tuple(start), tuple(end)


def _over_squares(w: FloatArray, radius: int) -> FloatArray:
    """Sum an array on two axes over the square around each cell; cells outside count as 0."""
    for axis in (0, 1):
        total = w.copy()
        for j in range(1, radius + 1):
            low, high = ((slice(None),) * axis + (at,) for at in (slice(None, -j), slice(j, None)))
            total[high] += w[low]
            total[low] += w[high]
        w = total
    return w
