"""The primitives that compare patches, in OpenCL."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph, GridGraph, row_major
from ..patches import PatchForm, padded_for_patches, padded_shape, patch_jumps, patch_lines
from ..types import Array, Device, Storage, Weighted, expect_storage, expect_stored
from .buffers import Recomputed
from .geometry import GridGeometry
from .layout import GridLayout
from .strips import PACKS, ROWS, Strips, exp2_scale
from .tiled_patches import OpenCLTiledPatches


class OpenCLPatches(OpenCLTiledPatches):
    """Weights computed from patches, and one step with weights that are not stored."""

    averages = True
    storages = ("full", "half", "none")

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        if device.kind == "cpu":
            self.row_block, self.column_block = ROWS, PACKS * self.lanes

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        if not isinstance(graph, GridGraph):
            return (channels * math.prod(padded_shape(graph, radius)) * self.dtype.itemsize,)
        planes = self._plane_bytes(self._strips(graph, PatchForm(np.ones(2 * radius + 1)), 1), channels)
        return (self.function_bytes(graph, channels), *planes)

    def _plane_bytes(self, strips: Strips, channels: int) -> tuple[int, ...]:
        """Return the bytes of the padded planes of all channels, and of the mask and its plane."""
        plane = strips.plane * self.dtype.itemsize
        mask = () if strips.graph.mask is None else (self.function_bytes(strips.graph, 1), plane)
        return (channels * plane, *mask)

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        if self._always_tiled(graph, channels, channels if guide is None else guide, radius):
            return () if guide is None else (self.function_bytes(graph, guide),)
        strips = self._strips(graph, PatchForm(np.ones(2 * radius + 1)), 1 + channels)
        arrays = self._plane_bytes(strips, channels)
        if guide is not None:
            arrays += (self.function_bytes(graph, guide), self._plane_bytes(strips, guide)[0])
        if graph.ndim == 2 and not strips.gpu:
            slots = strips.slots()
            arrays += (slots.ring * slots.blocks * slots.size * self.dtype.itemsize,)
        return arrays

    def _planes_of(self, strips: Strips, f: Array | FloatArray, *, zeros: bool = False) -> cl.Buffer:
        """Return the padded planes of a function for kernels that compare patches."""
        grid, function = strips.graph, self.on_device(strips.graph, f)
        return self._padded(grid, function, (strips.form.radius,) * grid.ndim, (strips.pitch, strips.left), zeros=zeros)

    def _strip_args(
        self, strips: Strips, compared: cl.Buffer, steps: npt.NDArray[np.int32], spatial: FloatArray
    ) -> list[Any]:
        """Return the kernel arguments STRIP_ARGS; `compared` are padded planes."""
        form, mask = strips.form, strips.graph.mask
        inside = compared if mask is None else self._planes_of(strips, mask.reshape(-1, 1), zeros=True)
        mapped = form.scale is not None and form.maps is not None
        maps = self._planes_of(strips, form.maps, zeros=True) if mapped else compared
        return strips.args(self.upload, (compared, inside, maps), steps, spatial, self.real)

    def _recomputed(self, graph: GridGraph, f: Array | FloatArray, form: PatchForm, half: FloatArray) -> Recomputed:
        masked = graph.mask is not None
        if graph.mask is not None:
            f = np.concatenate([self.on_host(graph, f), graph.mask.reshape(-1, 1)], axis=1, dtype=self.dtype)
        compared = self.on_device(graph, f)
        channels = compared.channels - masked
        scale = exp2_scale(form.scale or 0.0, float(np.finfo(self.dtype).max))
        nearness = self.upload(half.astype(self.dtype))
        return Recomputed(compared.buffer, nearness, channels, scale, masked, form)

    def patch_distance(
        self, graph: AnyGraph, f: Array | FloatArray, form: PatchForm, *, storage: Storage = "full"
    ) -> Weighted:
        expect_storage(graph, form, storage)
        topology = self._topology(graph)
        similarity = () if form.scale is None else ("-DSIMILARITY",)
        if isinstance(topology, GridLayout):
            assert isinstance(graph, GridGraph)
            geometry = topology.geometry
            half = np.ones(graph.half_window) if form.spatial is None else form.spatial
            if storage == "none":
                return Weighted(graph, topology, self._recomputed(graph, f, form, half), storage=storage)
            itemsize = 2 if storage == "half" else self.dtype.itemsize
            weights = self._between_zeros(geometry.weight_size(), geometry.weight_guard, itemsize)
            if graph.half_window:
                strips = self._strips(graph, form, 1)
                function = self.on_device(graph, f)
                steps = graph.forward_offsets.astype(np.int32)
                args = self._strip_args(strips, self._planes_of(strips, function), steps, half)
                args += [np.int64(geometry.weight_pitch), np.int64(geometry.weight_guard), weights]
                options = ("-DGRID", *strips.options(function.channels), *similarity)
                options += ("-DHALF_WEIGHTS",) if storage == "half" else ()
                self._launch_strips("patch_distance", options, args, strips.size, strips)
            return Weighted(graph, topology, weights, storage=storage)
        weights = self._allocate(topology.geometry.weight_size() * self.dtype.itemsize)
        padded, sites = padded_for_patches(graph, self.on_host(graph, f), form.radius)
        channels, shape = padded.shape[0], padded.shape[1:]
        window = form.window(len(shape))
        jumps = patch_jumps(window.shape, row_major(shape))
        spatial = self._nothing
        if form.spatial is not None:
            spatial = self.upload(topology.pack_weights(form.spatial.astype(self.dtype)))
        args = [
            self.upload(padded),
            np.int64(padded[0].size),
            np.int32(len(jumps)),
            self.upload(jumps),
            self.upload(window.ravel().astype(self.dtype)),
            self.real(form.shift),
            self.real(exp2_scale(form.scale or 0.0, float(np.finfo(self.dtype).max))),
            self.real(form.cut),
            self.upload(sites),
            spatial,
            self._nothing if form.maps is None else self.upload(form.maps.astype(self.dtype)),
            weights,
        ]
        options = (f"-DM={channels}", *similarity, *(() if form.spatial is None else ("-DSPATIAL",)))
        options += () if form.maps is None else ("-DMAPS",)
        self._run("patch_distance", Weighted(graph, topology, None), args, options, sums=0)
        return Weighted(graph, topology, weights)

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
        geometry = self._geometry(graph)
        assert isinstance(geometry, GridGeometry)
        function, other = self.on_device(graph, f), None if guide is None else self.on_device(graph, guide)
        M = function.channels
        Q = M if other is None else other.channels
        out = self.empty(graph, M) if out is None else out
        tiles = self._patch_tiles(graph, form, Q, M, guided=other is not None, largest=largest)
        if tiles is not None:
            self._tiled_step(tiles, function, function if other is None else other, f0, lam, out)
            return out
        strips = self._strips(graph, form, 1 + M)
        values = self._planes_of(strips, function)
        compared = values if other is None else self._planes_of(strips, other)
        lams, lam_options = self._lam(lam)
        layout = [
            np.int64(geometry.pitch),
            np.int64(geometry.plane),
            np.int64(geometry.guard),
            f0.buffer,
            *lams,
            out.buffer,
        ]
        options = (*strips.options(Q), *(("-DLARGEST",) if largest else ()))
        pairs = graph.ndim == 2 and not strips.gpu and not largest
        args = [*self._strip_args(strips, compared, *strips.offsets(pairs)), values]
        if not pairs:
            for first, count in strips.channel_groups(M):
                own = (*options, f"-DM={count}", *lam_options)
                self._launch_strips("similarity_step", own, [*args, np.int32(first), *layout], strips.size, strips)
            return out
        slots = strips.slots()
        options += (f"-DM={M}", f"-DREACH={slots.reach}", f"-DSIDE={slots.side}")
        blocks, ring = np.int32(slots.blocks), np.int32(slots.ring)
        sizes = [np.int32(s) for s in graph.shape]
        with self._shared.lock:
            buffer = self._scratch(slots.ring * slots.blocks * slots.size)
            for first in range(0, slots.strips, slots.at_once):
                size = (slots.blocks, min(slots.at_once, slots.strips - first))
                place = [np.int32(first), blocks, ring, buffer]
                self._launch_strips("similarity_step", (*options, "-DPAIRS"), [*args, *place], size, strips)
                finish = [*sizes, *place, *layout]
                self._launch_strips("similarity_step", (*options, *lam_options, "-DSLOTS"), finish, size, strips)
        return out

    def _aggregate(self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, out: Array) -> None:
        grid = expect_stored(weighted)
        lines = patch_lines(grid, radius)
        if weighted.weights is None:
            weighted = self.prepare(grid, grid.edges.unit_half())
        args = [np.int32(len(lines)), self.upload(lines), f.buffer, share.buffer, centre.buffer, out.buffer]
        self._run("aggregate", weighted, args, (f"-DM={f.channels}", f"-DR={radius}"))
