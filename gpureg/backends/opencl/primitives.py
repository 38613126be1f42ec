"""OpenCL: any GPU with a driver, or a CPU through PoCL; the kernels are in ``kernels/opencl``."""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph, GridGraph
from ..patches import PatchForm, padded_for_patches, padded_shape, patch_jumps, patch_lines
from ..protocol import Backend
from ..types import Array, BackendUnavailable, Conductance, Device, Storage, Weighted, expect_storage, expect_stored
from .duality import OpenCLOptimization
from .launching import Recomputed
from .layout import GridLayout
from .queue import vector_width
from .strips import PACKS, ROWS, Strips, exp2_scale
from .zones import OpenCLZones

GPU_TIER, CPU_TIER = 1, 2


def devices() -> list[Device]:
    """All OpenCL devices, GPUs first; among CPUs the newest driver first."""
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # no driver at all
        return []
    found = []
    for platform in platforms:
        try:
            members = platform.get_devices()
        except cl.Error:  # a driver without a device
            continue
        for device in members:
            found.append(device)
    described = []
    for i, device in enumerate(found):
        gpu = bool(device.type & cl.device_type.GPU)
        version = [float(number) for number in re.findall(r"\d+", device.driver_version)[:2]] + [0.0, 0.0]
        memory = int(device.global_mem_size)
        described.append(
            Device(
                backend="opencl",
                id=f"opencl:{i}",
                name=device.name.strip(),
                driver=f"{device.platform.name} {device.driver_version}",
                kind="gpu" if gpu else "cpu",
                memory=memory,
                vector_width=vector_width(device),
                float64=bool(device.double_fp_config),
                # the larger GPU first, then the newer driver
                rank=(GPU_TIER if gpu else CPU_TIER, -memory if gpu else 0, -version[0], -version[1], i),
                handle=device,
            )
        )
    return described


class OpenCLBackend(OpenCLOptimization, OpenCLZones):
    """The primitives as OpenCL C kernels."""

    name = "opencl"
    averages = True
    storages = ("full", "half", "none")

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        if device.kind == "cpu":
            self.row_block, self.column_block = ROWS, PACKS * self.lanes

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        if not isinstance(graph, GridGraph):
            return (channels * math.prod(padded_shape(graph, radius)) * self.dtype.itemsize,)
        return self._plane_bytes(self._strips(graph, PatchForm(np.ones(2 * radius + 1)), 1), channels)

    def _plane_bytes(self, strips: Strips, channels: int) -> tuple[int, ...]:
        """Padded planes of so many channels, and the mask's."""
        plane = strips.plane * self.dtype.itemsize
        return (channels * plane, *(() if strips.graph.mask is None else (plane,)))

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        strips = self._strips(graph, PatchForm(np.ones(2 * radius + 1)), 1 + channels)
        arrays = self._plane_bytes(strips, channels)
        if guide is not None:
            arrays += self._plane_bytes(strips, guide)[:1]
        if graph.ndim == 2 and not strips.gpu:
            slots = strips.slots()
            arrays += (slots.ring * slots.blocks * slots.size * self.dtype.itemsize,)
        return arrays

    def sweep_bytes(self, graph: AnyGraph, channels: int) -> int:
        layout = self._layout(graph)
        if not isinstance(layout, GridLayout) or self.device.kind == "gpu":
            return 0
        blocks = layout.blocks(channels, 1, True, self.device.handle.max_compute_units)
        return math.prod(blocks.count) * blocks.ring_size * self.dtype.itemsize

    def _recomputed(self, graph: GridGraph, f: FloatArray, form: PatchForm, half: FloatArray) -> Recomputed:
        channels, masked = f.shape[1], graph.mask is not None
        if graph.mask is not None:
            f = np.concatenate([f, graph.mask.reshape(-1, 1)], axis=1, dtype=self.dtype)
        scale = exp2_scale(form.scale or 0.0, float(np.finfo(self.dtype).max))
        nearness = self.upload(half.astype(self.dtype))
        return Recomputed(self.put(graph, f).buffer, nearness, channels, scale, masked, form)

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm, *, storage: Storage = "full") -> Weighted:
        expect_storage(graph, form, storage)
        topology, f = self._topology(graph), np.asarray(f, self.dtype)
        similarity = () if form.scale is None else ("-DSIMILARITY",)
        if isinstance(topology, GridLayout):
            assert isinstance(graph, GridGraph)
            half = np.ones(topology.H) if form.spatial is None else form.spatial
            if storage == "none":
                return Weighted(graph, topology, self._recomputed(graph, f, form, half), storage=storage)
            itemsize = 2 if storage == "half" else self.dtype.itemsize
            weights = self._between_zeros(topology.weight_size(), topology.weight_guard, itemsize)
            if topology.H:
                strips = self._strips(graph, form, 1)
                planes = self.upload(strips.planes(f))
                steps = graph.forward_offsets.astype(np.int32)
                args = strips.args(self.upload, planes, steps, half, self.real)
                args += [np.int64(topology.weight_pitch), np.int64(topology.weight_guard), weights]
                options = ("-DGRID", *strips.options(f.shape[1]), *similarity)
                options += ("-DHALF_WEIGHTS",) if storage == "half" else ()
                self._launch_strips("patch_distance", options, args, strips.size, strips)
            return Weighted(graph, topology, weights, storage=storage)
        weights = self._allocate(topology.weight_size() * self.dtype.itemsize)
        padded, sites = padded_for_patches(graph, f, form.radius)
        channels, shape = padded.shape[0], padded.shape[1:]
        window = form.window(len(shape))
        jumps = patch_jumps(window.shape, shape)
        spatial = self._nothing if form.spatial is None else self.upload(form.spatial.astype(self.dtype))
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
        self._run("patch_distance", Weighted(graph, topology, None), args, options)
        return Weighted(graph, topology, weights)

    def similarity_step(
        self,
        graph: GridGraph,
        f: FloatArray,
        form: PatchForm,
        f0: Array,
        lam: float | Array,
        *,
        guide: FloatArray | None = None,
        largest: bool = False,
        out: Array | None = None,
    ) -> Array:
        if form.scale is None:
            return super().similarity_step(graph, f, form, f0, lam, guide=guide, largest=largest, out=out)
        layout = self._topology(graph)
        assert isinstance(layout, GridLayout)
        M = f.shape[1]
        out = self.empty(graph, M) if out is None else out
        strips = self._strips(graph, form, 1 + M)
        values = self.upload(strips.planes(np.asarray(f, self.dtype)))
        compared, Q = values, M
        if guide is not None:
            compared, Q = self.upload(strips.planes(np.asarray(guide, self.dtype))), guide.shape[1]
        lams, lam_options = self._lam(lam)
        function = [
            np.int64(layout.pitch),
            np.int64(layout.plane),
            np.int64(layout.guard),
            f0.buffer,
            *lams,
            out.buffer,
        ]
        options = (*strips.options(Q), f"-DM={M}")
        options += ("-DLARGEST",) if largest else ()
        pairs = graph.ndim == 2 and not strips.gpu and not largest
        args = [*strips.args(self.upload, compared, *strips.offsets(pairs), self.real), values]
        if not pairs:
            self._launch_strips("similarity_step", (*options, *lam_options), [*args, *function], strips.size, strips)
            return out
        slots = strips.slots()
        options += (f"-DREACH={slots.reach}", f"-DSIDE={slots.side}")
        blocks, ring = np.int32(slots.blocks), np.int32(slots.ring)
        sizes = [np.int32(s) for s in graph.shape]
        with self._shared.lock:
            buffer = self._scratch(slots.ring * slots.blocks * slots.size)
            for first in range(0, slots.strips, slots.at_once):
                size = (slots.blocks, min(slots.at_once, slots.strips - first))
                place = [np.int32(first), blocks, ring, buffer]
                self._launch_strips("similarity_step", (*options, "-DPAIRS"), [*args, *place], size, strips)
                finish = [*sizes, *place, *function]
                self._launch_strips("similarity_step", (*options, *lam_options, "-DSLOTS"), finish, size, strips)
        return out

    def degree(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run("degree", weighted, [out.buffer])
        return out

    def largest_weight(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run("degree", weighted, [out.buffer], ("-DLARGEST",))
        return out

    def aggregate(
        self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, *, out: Array | None = None
    ) -> Array:
        grid = expect_stored(weighted)
        out = self.empty(grid, f.channels) if out is None else out
        lines = patch_lines(grid, radius)
        if weighted.weights is None:
            weighted = self.prepare(grid, grid.unit_half_weights())
        args = [np.int32(len(lines)), self.upload(lines), f.buffer, share.buffer, centre.buffer, out.buffer]
        self._run("aggregate", weighted, args, (f"-DM={f.channels}", f"-DR={radius}"))
        return out

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        out = self.empty_edges(weighted.graph, f.channels) if out is None else out
        self._run("difference", weighted, [f.buffer, out.buffer], (f"-DM={f.channels}",))
        return out

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, H.channels) if out is None else out
        self._run("adjoint", weighted, [H.buffer, out.buffer], (f"-DM={H.channels}",))
        return out

    def gradient_norm(
        self,
        weighted: Weighted,
        f: Array,
        *,
        power: float,
        eps: float,
        coupled: bool,
        edge_power: float | None = None,
        out: Array | None = None,
    ) -> Array:
        G = 1 if coupled else f.channels
        out = self.empty(weighted.graph, G) if out is None else out
        args = [f.buffer, self.real(eps) ** 2, self.real(power), self.real(edge_power or 0), out.buffer]
        options = (f"-DM={f.channels}", f"-DG={G}", *(() if edge_power is None else ("-DEDGE_NORM",)))
        self._run("gradient_norm", weighted, args, options)
        return out

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, f.channels) if out is None else out
        conductance, options = self._g(g, f.channels)
        self._run("p_laplacian", weighted, [f.buffer, *conductance, out.buffer], (f"-DM={f.channels}", *options))
        return out

    def jacobi_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        *,
        theta: float = 1.0,
        out: Array | None = None,
    ) -> Array:
        out = self.empty(weighted.graph, f.channels) if out is None else out
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        args = [f.buffer, f0.buffer, *conductance, *lams, self.real(theta), out.buffer]
        self._run("jacobi_step", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options))
        return out

    def sweep(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        *,
        p: float,
        eps: float,
        coupled: bool,
        theta: float,
        edge_norm: bool = False,
        g: Array | None,
        out: Array,
    ) -> Array:
        layout = weighted.topology
        fused = isinstance(layout, GridLayout) and self.device.kind == "cpu" and not weighted.directed
        if not fused or edge_norm or p == 2:
            return super().sweep(
                weighted, f, f0, lam, p=p, eps=eps, coupled=coupled, theta=theta, edge_norm=edge_norm, g=g, out=out
            )
        G = 1 if coupled else f.channels
        stored = weighted.weights is not None and weighted.storage != "none"
        cores = self.device.handle.max_compute_units
        blocks = layout.blocks(f.channels, G, stored, cores, wide=layout.wide and weighted.storage != "none")
        lams, lam_options = self._lam(lam)
        args = [
            f.buffer,
            f0.buffer,
            self.real((p - 2) / 2),
            self.real(eps) ** 2,
            *lams,
            self.real(theta),
            np.int32(blocks.band),
            np.int32(blocks.stretch),
            np.int32(layout.jump),
            np.int32(blocks.slots),
            np.int64(blocks.ring_pitch),
            layout.rings(blocks, self._allocate),
            out.buffer,
        ]
        options = (f"-DM={f.channels}", f"-DG={G}", *lam_options)
        self._run("sweep", weighted, args, options, blocks.count, exact=True, local=(1, 1))
        return out

    def euler_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        tau: float | Array,
        *,
        out: Array | None = None,
    ) -> Array:
        out = self.empty(weighted.graph, f.channels) if out is None else out
        conductance, g_options = self._g(g, f.channels)
        lams, lam_options = self._lam(lam)
        taus, tau_options = self._number(tau, "-DTAU_ARRAY")
        args = [f.buffer, f0.buffer, *conductance, *lams, *taus, out.buffer]
        self._run("euler_step", weighted, args, (f"-DM={f.channels}", *g_options, *lam_options, *tau_options))
        return out

    def energy(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        lam: float | Array,
        *,
        p: float,
        eps: float,
        coupled: bool,
        edge_norm: bool = False,
    ) -> float:
        G = 1 if coupled else f.channels
        lams, lam_options = self._lam(lam)
        args = [f.buffer, f0.buffer, *lams, self.real(p), self.real(eps) ** 2]
        options = (f"-DM={f.channels}", f"-DG={G}", *lam_options, *(("-DEDGE_NORM",) if edge_norm else ()))
        return float(self._partial("energy", weighted, args, options, self._sum_type).astype(np.float64).sum())

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        args = [a.buffer, b.buffer]
        bare = Weighted(weighted.graph, weighted.topology, None)
        return float(self._partial("max_change", bare, args, (f"-DM={a.channels}",), self.dtype).max(initial=0))


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    if np.dtype(dtype) == np.float64 and not device.float64:
        raise BackendUnavailable(f"{device.id} ({device.name}) does not compute in float64; use dtype float32")
    return OpenCLBackend(device, dtype)
