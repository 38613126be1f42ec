"""The primitives that compare patches, in Warp."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from ...arrays import FloatArray, IntArray
from ...graphs.grid import AnyGraph, GridGraph, row_major
from ...kernels.warp import (
    aggregate,
    patch_distance,
    reals,
    similarity_step,
    strip,
)
from ..patches import PatchForm, padded_for_patches, padded_shape, patch_jumps, patch_lines, reflected
from ..types import Array, BackendUnavailable, Storage, Weighted, expect_stored
from .cells import WarpCells
from .layout import channels_of
from .pool import PACK_SPEED

# A strip on the CPU: rows, bytes of neighbouring cells, and bytes of scratch per work item, which fit the L1 cache.
_STRIP_ROWS, _STRIP_BYTES, _STRIP_SCRATCH = 32, 128, 1 << 15


class WarpPatches(WarpCells):
    """Weights computed from patches, and one step with weights that are not stored."""

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        if not isinstance(graph, GridGraph):
            return (math.prod(padded_shape(graph, radius)) * channels * self.dtype.itemsize, 8 * graph.n_vertices)
        return self._plane_bytes(graph, channels, radius, graph.forward_offsets)

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        if guide is not None:
            return super().step_bytes(graph, channels, guide, radius)
        return self._plane_bytes(graph, channels, radius, graph.offsets)

    def _plane_bytes(self, graph: GridGraph, channels: int, radius: int, offsets: IntArray) -> tuple[int, ...]:
        """Return the bytes of the padded function, and of the plane with the mask, for strips."""
        *rows, width = padded_shape(graph, radius)
        plane = math.prod(rows) * (width + sum(self._guards(offsets, radius))) * self.dtype.itemsize
        return channels * plane, plane

    def _strip_width(self) -> int:
        """Return the number of neighbouring cells of a row that a strip computes at once."""
        return _STRIP_BYTES // self.dtype.itemsize if self._on.is_cpu else 1

    def _guards(self, offsets: IntArray, radius: int) -> tuple[int, int]:
        """Return the zeros before and after a padded row: the reach of the window and of a pack."""
        left = int(np.abs(offsets[:, -1]).max(initial=0))
        return left, left + 2 * self._strip_width() + 2 * radius

    def _launch_strips(
        self,
        make: Callable[..., Any],
        graph: GridGraph,
        f: Array | FloatArray,
        form: PatchForm,
        backward: bool,
        options: tuple[Any, ...],
        inputs: list[Any],
        out: Any,
    ) -> None:
        """Run a kernel over the strips of ``strip.py``; `backward`: the whole window instead of its forward half."""
        f = self.on_host(graph, f)
        M, ndim, r, width = f.shape[1], graph.ndim, form.radius, graph.shape[-1]
        height = graph.shape[-2] if ndim > 1 else 1
        N, S = self._strip_width(), 1
        if self._on.is_cpu:
            S = min(_STRIP_ROWS, max(_STRIP_SCRATCH // (_STRIP_BYTES * (M + 2)), 1), height)
        half = np.ones(graph.half_window) if form.spatial is None else form.spatial
        offsets, spatial = graph.forward_offsets, half
        if backward:
            offsets, spatial = graph.offsets, np.concatenate([half[::-1], half])
        # Planes of rows with zeros on both sides, as far as the window and a pack reach.
        padded = reflected(graph, f, r)
        left, right = self._guards(offsets, r)
        inside = np.zeros((1, *padded.shape[1:]), self.dtype)
        inside[(slice(None), *(slice(r, r + size) for size in graph.shape))] = 1 if graph.mask is None else graph.mask
        guards = [(0, 0)] * ndim + [(left, right)]
        planes, within = np.pad(padded, guards), np.pad(inside, guards)
        maps = None if form.scale is None else form.maps
        # The patch along the leading axes, on three axes or more, as steps in rows.
        leading = form.window(max(ndim - 2, 0))
        lines = patch_jumps(leading.shape, row_major(padded.shape[1:-1])[: leading.ndim])

        patches = strip.struct(self.real)()
        patches.f, patches.inside = self._upload_reals(planes.ravel()), self._upload_reals(within.ravel())
        patches.plane, patches.pitch, patches.left = planes[0].size, planes.shape[-1], left
        patches.sizes = self.upload(np.array(graph.shape, np.int32), wp.int32)
        patches.offsets, patches.n_offsets = self.upload(offsets.astype(np.int32).ravel(), wp.int32), len(offsets)
        patches.spatial, patches.profile = self._upload_reals(spatial), self._upload_reals(form.profile)
        patches.lines = self.upload(lines.astype(np.int32), wp.int32)
        patches.line_weights = self._upload_reals(leading.ravel())
        if maps is not None:
            cells = np.moveaxis(maps.reshape(*graph.shape, 2), -1, 0)
            around = [(0, 0)] + [(r, r)] * (ndim - 1) + [(r + left, r + right)]
            patches.maps = self._upload_reals(np.pad(cells, around).ravel())
        patches.shift, patches.scale = form.shift, 0.0 if form.scale is None else form.scale
        patches.cut = form.cut

        dim = (math.prod(graph.shape[:-2]) * -(-height // S), -(-width // N))
        work = graph.n_vertices * (1 + len(offsets)) * len(form.profile) * M // PACK_SPEED
        options = (self.real, ndim, M, r, maps is not None, *options, N, S)
        self._launch(dim, make, options, [patches, *inputs], out, work=work)

    def patch_distance(
        self, graph: AnyGraph, f: Array | FloatArray, form: PatchForm, *, storage: Storage = "full"
    ) -> Weighted:
        if storage != "full":
            raise BackendUnavailable("Warp stores weights in full: float16 weights and recomputed weights need OpenCL")
        layout, similarity = self._layout(graph), form.scale is not None
        if isinstance(graph, GridGraph):
            weights = wp.zeros(layout.weight_shape, dtype=self.real, device=self._on)
            if graph.half_window:
                self._launch_strips(patch_distance.make_grid, graph, f, form, False, (similarity,), [], weights)
            return self._bind(graph, weights)
        padded, sites = padded_for_patches(graph, self.on_host(graph, f), form.radius)
        m, shape = padded.shape[0], padded.shape[1:]
        window = form.window(len(shape))
        # The lines of the patch along the last axis, as steps in padded rows.
        lines = patch_jumps(window.shape[:-1], row_major(shape[:-1]))
        places = np.stack(np.divmod(sites, shape[-1]), axis=-1).astype(np.int32)
        function = reals.vector(self.real, m)
        bare = self._bind(graph, None).topology
        inputs: list[Any] = [
            bare.argument,
            self.upload(np.moveaxis(padded, 0, -1).reshape(-1, shape[-1], m), function),
            self.upload(lines.astype(np.int32), wp.int32),
            self._upload_reals(window.reshape(len(lines), -1)),
            form.shift,
            0.0 if form.scale is None else form.scale,
            form.cut,
            self.upload(places, wp.vec2i),
            None if form.spatial is None else self._upload_reals(form.spatial),
            None if form.maps is None else self._upload_reals(form.maps.ravel()),
        ]
        weights = wp.zeros(layout.weight_shape, dtype=self.real, device=self._on)
        options = (bare.access, m, similarity, form.spatial is not None, form.maps is not None)
        self._launch_vertices(layout, patch_distance.make_csr, options, inputs, weights)
        return self._bind(graph, weights)

    def _aggregate(self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, out: Array) -> None:
        grid = expect_stored(weighted)
        access = weighted.topology.access
        # the cells of a patch as steps in row, x and, on three axes or more, along the leading axes
        lines = patch_lines(grid, radius)
        along = np.arange(-radius, radius + 1)
        cells = np.empty((len(lines), len(along), 2 + (grid.ndim - 1 if grid.ndim > 2 else 0)), np.int32)
        cells[..., 0], cells[..., 1] = lines[:, -1:], along
        if grid.ndim > 2:
            cells[..., 2:] = lines[:, None, :-1]
        patch = self.upload(cells.reshape(-1, cells.shape[-1]), access.Place)
        self._run(aggregate.make, weighted, (channels_of(f),), [patch, f, share, centre], out)

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
        if form.scale is None or guide is not None:
            return super().similarity_step(graph, f, form, f0, lam, guide=guide, largest=largest, out=out)
        f = self.on_host(graph, f)
        out = self.empty(graph, f.shape[1]) if out is None else out
        options = (isinstance(lam, wp.array), largest)
        self._launch_strips(similarity_step.make, graph, f, form, True, options, [f0, lam], out)
        return out
