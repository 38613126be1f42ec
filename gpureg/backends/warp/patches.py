"""The primitives that compare patches, in Warp."""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    similarity_step_gpu,
    strip,
)
from ...kernels.warp.similarity_step_gpu import ITEMS
from ..patches import PatchForm, padded_for_patches, padded_shape, patch_jumps, patch_lines
from ..types import Array, Storage, Weighted, expect_storage, expect_stored
from . import memory
from .layout import Recomputed, channels_of
from .planes import WarpPlanes
from .pool import PACK_SPEED
from .tiles import Tiles

# A block of cells on the CPU: its rows, bytes of a pack, and packs of a row with two sums per cell, or fewer packs with
# more sums: the sums of a work item fit the L2 cache.
_ROWS, _PACK_BYTES, _PACKS = 32, 64, 8

# With a row length of a multiple of this, neighbouring rows would share the sets of a cache.
_ALIASING_BYTES = 1 << 12


@dataclass(frozen=True)
class _Blocks:
    """A grid, cut into blocks of S rows of B packs of N cells, and the planes that their kernels read.

    Attributes
    ----------
    graph : GridGraph
    radius, average : int
        Radius of a patch, and of a square of patches whose weights are added, in cells.
    N, S, B : int
    itemsize : int
        Bytes of a number.
    """

    graph: GridGraph
    radius: int
    average: int
    N: int
    S: int
    B: int
    itemsize: int

    @property
    def count(self) -> tuple[int, int]:
        """Number of strips of blocks, and of blocks in a strip."""
        *lead, height, width = (1, *self.graph.shape)
        if self.graph.ndim == 1:
            return 1, -(-width // (self.B * self.N))
        return math.prod(lead) * -(-height // self.S), -(-width // (self.B * self.N))

    @property
    def reach(self) -> int:
        """Largest offset along the last axis, in cells."""
        return int(np.abs(self.graph.offsets[:, -1]).max(initial=0))

    @property
    def left(self) -> int:
        """Zeros in a padded row before its first patch."""
        return self.reach + self.average

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells of a plane along each axis."""
        span = self.B + -(-2 * self.average // self.N)
        beyond = span + -(-2 * self.radius // self.N) - self.B
        pitch = self.left + self.count[1] * self.B * self.N + beyond * self.N + self.reach
        pitch = -(-pitch // self.N) * self.N
        if self.N > 1 and pitch * self.itemsize % _ALIASING_BYTES == 0:
            pitch += self.N
        return *(size + 2 * self.radius for size in self.graph.shape[:-1]), pitch


class WarpPatches(WarpPlanes):
    """Weights computed from patches, and one step with weights that are not stored."""

    averages = True
    storages = ("full", "half", "none")

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        if not isinstance(graph, GridGraph):
            return (math.prod(padded_shape(graph, radius)) * channels * self.dtype.itemsize, 8 * graph.n_vertices)
        return self._plane_bytes(graph, channels, radius)

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        planes = self._plane_bytes(graph, channels, radius)
        return planes if guide is None else planes + self._plane_bytes(graph, guide, radius)

    def _plane_bytes(self, graph: GridGraph, channels: int, radius: int) -> tuple[int, ...]:
        """Return the bytes of a function and the mask on the device, and of their planes."""
        tiles = self._tiles(graph, PatchForm(np.ones(2 * radius + 1), average=radius), 1, 1)
        blocks = self._blocks(graph, radius, 0, 2) if tiles is None else tiles
        plane = math.prod(blocks.shape) * self.dtype.itemsize
        mask = () if graph.mask is None else (self.function_bytes(graph, 1),)
        return self.function_bytes(graph, channels), *mask, channels * plane, plane

    def _blocks(self, graph: GridGraph, radius: int, average: int, sums: int) -> _Blocks:
        """Return the blocks for patches of a radius, averaged over a radius, with so many sums per cell."""
        N, S, B = 1, 1, 1
        if self.device.kind == "cpu":
            N, S = _PACK_BYTES // self.dtype.itemsize, _ROWS if graph.ndim > 1 else 1
            while B * sums < _PACKS * 2 and B < _PACKS:
                B *= 2
        return _Blocks(graph, radius, average, N, S, B, self.dtype.itemsize)

    def _patches(
        self, blocks: _Blocks | Tiles, form: PatchForm, compared: Array, offsets: IntArray, spatial: FloatArray
    ) -> Any:
        """Return the struct of ``strip.py``; `compared` is a function on the device."""
        graph, r, ndim, shape = blocks.graph, form.radius, blocks.graph.ndim, blocks.shape
        place = ((r,) * ndim, shape, (0,) * (ndim - 1) + (blocks.left,))
        maps = None if form.scale is None else form.maps
        # The patch along the leading axes, on three axes or more, as steps in rows.
        leading = form.window(max(ndim - 2, 0))
        lines = patch_jumps(leading.shape, row_major(shape[:-1])[: leading.ndim])

        patches = strip.struct(self.real)()
        patches.f = self._planes(graph, compared, *place)
        patches.inside = self._planes(graph, self._mask_function(graph), *place, reflects=False)
        patches.masked = graph.mask is not None
        if maps is not None:
            patches.maps = self._planes(graph, maps, *place, reflects=False)
        patches.plane, patches.pitch, patches.left = math.prod(shape), shape[-1], blocks.left
        patches.sizes = self.upload(np.array(graph.shape, np.int32), wp.int32)
        patches.offsets, patches.n_offsets = self.upload(offsets.astype(np.int32).ravel(), wp.int32), len(offsets)
        patches.spatial, patches.profile = self._upload_reals(spatial), self._upload_reals(form.profile)
        patches.lines = self.upload(lines.astype(np.int32), wp.int32)
        patches.line_weights = self._upload_reals(leading.ravel())
        patches.shift, patches.scale = form.shift, 0.0 if form.scale is None else form.scale
        patches.cut = form.cut
        return patches

    def _source(self, blocks: _Blocks, form: PatchForm, compared: Array) -> tuple[Any, ...]:
        """Return the form of the source of ``strip.py``."""
        sums = (self.channels(compared), form.radius, blocks.average, bool((form.profile == 1).all()))
        maps = form.scale is not None and form.maps is not None
        return (blocks.graph.ndim, *sums, maps, blocks.N, blocks.S, blocks.B)

    def _work(self, graph: GridGraph, form: PatchForm, offsets: IntArray, channels: int) -> int:
        """Return the work of a launch over the cells of a grid."""
        return graph.n_vertices * (1 + len(offsets)) * len(form.profile) * channels // PACK_SPEED

    def patch_distance(
        self, graph: AnyGraph, f: Array | FloatArray, form: PatchForm, *, storage: Storage = "full"
    ) -> Weighted:
        expect_storage(graph, form, storage)
        layout, similarity = self._layout(graph), form.scale is not None
        if isinstance(graph, GridGraph):
            half = np.ones(graph.half_window) if form.spatial is None else form.spatial
            if storage == "none":
                compared, masked = self.on_host(graph, f), graph.mask is not None
                if graph.mask is not None:
                    compared = np.concatenate([compared, graph.mask.reshape(-1, 1)], axis=1, dtype=self.dtype)
                data = Recomputed(
                    self.put(graph, compared), self._upload_reals(half), compared.shape[1] - masked, masked, form
                )
                return self._bind(graph, data, storage=storage)
            kind = wp.float16 if storage == "half" else self.real
            weights = memory.zeros(layout.weight_shape, dtype=kind, device=self._on)
            if graph.half_window:
                function, offsets = self.on_device(graph, f), graph.forward_offsets
                blocks = self._blocks(graph, form.radius, 0, 2)
                patches = self._patches(blocks, form, function, offsets, half)
                work = self._work(graph, form, offsets, self.channels(function))
                made = (self.real, similarity, storage == "half", self._source(blocks, form, function))
                self._launch(blocks.count, patch_distance.make_grid, made, [patches], weights, work=work)
            return self._bind(graph, weights, storage=storage)
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
        weights = memory.zeros(layout.weight_shape, dtype=self.real, device=self._on)
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
        if form.scale is None:
            return super().similarity_step(graph, f, form, f0, lam, guide=guide, largest=largest, out=out)
        values = self.on_device(graph, f)
        compared, M = values if guide is None else self.on_device(graph, guide), self.channels(values)
        out = self.empty(graph, M) if out is None else out
        blocks: _Blocks | Tiles = self._blocks(graph, form.radius, form.average, 1 + M + largest)
        tiles = self._tiles(graph, form, self.channels(compared), M)
        blocks = blocks if tiles is None else tiles
        half = np.ones(graph.half_window) if form.spatial is None else form.spatial
        patches = self._patches(blocks, form, compared, graph.offsets, np.concatenate([half[::-1], half]))
        planes = patches.f
        if guide is not None:
            before = (0,) * (graph.ndim - 1) + (blocks.left,)
            planes = self._planes(graph, values, (form.radius,) * graph.ndim, blocks.shape, before)
        work = self._work(graph, form, graph.offsets, self.channels(compared))
        options: tuple[Any, ...] = (self.real, M, isinstance(lam, wp.array), largest)
        if isinstance(blocks, Tiles):
            flat, items = bool((form.profile == 1).all()), 1 if self._on.is_cpu else ITEMS
            source = (blocks.compared, form.radius, form.average, flat, form.maps is not None, blocks.rows)
            inputs = [patches, planes, self._upload_reals(blocks.table(form).ravel()), wp.vec2i(*blocks.reach), f0, lam]
            options = (*options, source, items)
            self._launch((blocks.count, items), similarity_step_gpu.make, options, inputs, out, work=work)
            return out
        options = (*options, self._source(blocks, form, compared))
        self._launch(blocks.count, similarity_step.make, options, [patches, planes, f0, lam], out, work=work)
        return out

    def _tiles(self, graph: GridGraph, form: PatchForm, compared: int, channels: int) -> Tiles | None:
        """Return the blocks whose threads share a tile; None on a CPU, and where there is no room or are more axes."""
        if self.device.kind == "cpu" or graph.ndim != 2:
            return None
        return Tiles(graph, form.radius, form.average, compared, channels, self.dtype.itemsize).that_fit()
