"""OpenCL: any GPU with a driver, or a CPU through PoCL; the kernels are in ``kernels/opencl``.

Programs are built once per device, primitive and set of build options, and kept; pyopencl keeps the binaries on disk.
Functions and weights are laid out as ``opencl_layout.py`` says.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
import os
import re
import threading
import weakref
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from .. import kernels
from ..graph import FloatArray, Graph, GridGraph
from .base import (
    AnyGraph,
    Array,
    Backend,
    BackendUnavailable,
    Conductance,
    Device,
    EdgeNorm,
    PatchForm,
    Storage,
    Weighted,
    expect_storage,
    expect_stored,
    host_weights,
    padded_for_patches,
    padded_shape,
    patch_jumps,
    patch_lines,
)
from .opencl_layout import CsrLayout, GridLayout, round_up
from .opencl_strips import PACKS, ROWS, Strips, exp2_scale

GPU_TIER, CPU_TIER = 1, 2

# Bytes from which numpy asks for huge pages, and of an ordinary page.
_HUGE, _PAGE = 1 << 22, 1 << 12

# Where in a page the buffers of a kernel begin: all at its start would share the sets of a cache.
_STAGGER = itertools.cycle(range(0, 1 << 12, 5 << 7))

# Work items of a group: on a GPU; on a stored graph on a CPU, and on one of so many vertices.
_GPU_GROUP, _CSR_CPU_GROUP, _CSR_LARGE_GROUP, _CSR_LARGE = 64, 128, 2048, 1 << 18


def _pocl_version(device: cl.Device) -> tuple[int, int] | None:
    match = re.search(r"PoCL (\d+)\.(\d+)", device.platform.version)
    return (int(match[1]), int(match[2])) if match else None


def vector_width(device: cl.Device) -> int:
    """float32 values a grid kernel treats at a time: 1 on a GPU, the native vector on a CPU.

    PoCL 3.0 (LLVM 14) reports 16 and then dies on float16 code, so it gets 8.
    """
    if device.type & cl.device_type.GPU:
        return 1
    native = int(device.native_vector_width_float) or 1
    width = max(w for w in (1, 2, 4, 8, 16) if w <= native)
    pocl = _pocl_version(device)
    return min(width, 8) if pocl is not None and pocl < (3, 1) else width


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


class _HostBuffer(cl.Buffer):  # type: ignore[misc]
    """A buffer in memory of the host; a class of its own, so that its end can be seen."""


@dataclass(frozen=True)
class _Queue:
    """What all work on one device shares: context, queue, and the kernels built so far."""

    context: cl.Context
    queue: cl.CommandQueue
    kernels: dict[tuple[str, tuple[str, ...]], cl.Kernel]
    lock: threading.RLock  # a kernel object holds its arguments: one caller at a time
    process: int
    # Host memory of buffers that are no more: what was queued may still use it, until a wait is over.
    leaving: deque[npt.NDArray[np.uint8]]

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Around a call that waits for all that was queued before it."""
        gone = []
        with contextlib.suppress(IndexError):
            while True:
                gone.append(self.leaving.popleft())
        try:
            yield
        except BaseException:  # it may not have waited
            self.leaving.extend(gone)
            raise


@functools.cache
def _queue(device: cl.Device) -> _Queue:
    context = cl.Context([device])
    return _Queue(context, cl.CommandQueue(context), {}, threading.RLock(), os.getpid(), deque())


@dataclass(frozen=True, eq=False)
class _Function:
    buffer: cl.Buffer
    channels: int


@dataclass(frozen=True, eq=False)
class _Recomputed:
    """What weights that are not stored are computed from: a function of `channels`, with the mask as one more."""

    compared: cl.Buffer
    nearness: cl.Buffer  # (H,): spatial factors
    channels: int
    scale: float
    masked: bool
    form: PatchForm

    @property
    def options(self) -> tuple[str, ...]:
        """Build options of the kernels that compute them."""
        return ("-DRECOMPUTED", f"-DQ={self.channels}", *(("-DMASKED_WEIGHTS",) if self.masked else ()))


class OpenCLBackend(Backend):
    """The primitives as OpenCL C kernels."""

    name = "opencl"
    averages = True
    storages = ("full", "half", "none")

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        self._shared = _queue(device.handle)
        double = self.dtype == np.float64
        self.lanes = max(1, device.vector_width // 2) if double else device.vector_width
        self._sum_type = np.dtype(np.float64 if device.float64 else np.float32)
        self._options: tuple[str, ...] = ()
        if double:
            self._options += ("-DDOUBLE",)
        if device.float64:
            self._options += ("-DSUM_DOUBLE",)
        self._topologies: weakref.WeakKeyDictionary[AnyGraph, CsrLayout | GridLayout] = weakref.WeakKeyDictionary()
        self._nothing = self.upload(np.zeros(1, self.dtype))
        self._kept: cl.Buffer = None
        if device.kind == "cpu":
            self.row_block, self.column_block = ROWS, PACKS * self.lanes

    # Buffers

    def _allocate(self, nbytes: int) -> cl.Buffer:
        if os.getpid() != self._shared.process:
            # The driver's threads stayed in the parent: a wait here would have no end.
            raise BackendUnavailable(
                "OpenCL does not survive a fork: start processes by spawn (multiprocessing.set_start_method), "
                "or use backend='numpy' in them"
            )
        limit = int(self.device.handle.max_mem_alloc_size)
        if nbytes > limit:
            raise MemoryError(
                f"the job needs one buffer of {nbytes / 2**30:.2f} GiB, {self.device.id} gives {limit / 2**30:.2f} GiB "
                "at most: use a smaller window, or another backend"
            )
        if self.device.kind == "cpu" and nbytes >= _HUGE:
            # A CPU's memory is ours: numpy asks the system for huge pages, a driver does not, and to touch 150 MB of
            # small ones for the first time takes three times as long as to compute weights into them.
            host = np.empty(nbytes + 2 * _PAGE, np.uint8)
            begin = -host.ctypes.data % _PAGE + next(_STAGGER)
            flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
            buffer = _HostBuffer(self._shared.context, flags, hostbuf=host[begin : begin + nbytes])
            weakref.finalize(buffer, self._shared.leaving.append, host)
            return buffer
        return cl.Buffer(self._shared.context, cl.mem_flags.READ_WRITE, max(nbytes, self.dtype.itemsize))

    def upload(self, host: npt.NDArray[Any]) -> cl.Buffer:
        """A host array as a device buffer."""
        host = np.ascontiguousarray(host)
        buffer = self._allocate(host.nbytes)
        if host.nbytes:
            with self._shared.waiting():
                cl.enqueue_copy(self._shared.queue, buffer, host, is_blocking=True)
        return buffer

    def _zeros(self, size: int) -> cl.Buffer:
        buffer = self._allocate(size * self.dtype.itemsize)
        cl.enqueue_fill_buffer(self._shared.queue, buffer, self.real(0), 0, max(size, 1) * self.dtype.itemsize)
        return buffer

    def _between_zeros(self, size: int, guard: int, itemsize: int) -> cl.Buffer:
        """A buffer of which only so many numbers at either end are 0: for what a kernel fills wholly."""
        buffer = self._allocate(size * itemsize)
        nbytes, edge = max(size, 1) * itemsize, guard * itemsize
        for begin in (0, nbytes - edge) if edge else ():
            cl.enqueue_fill_buffer(self._shared.queue, buffer, np.uint8(0), begin, edge)
        return buffer

    def _scratch(self, size: int) -> cl.Buffer:
        """A buffer of at least so many numbers, of any content, for the work queued next.

        It is kept from one call to another: the queue does one thing after the other.
        """
        if self._kept is None or self._kept.size < size * self.dtype.itemsize:
            self._kept = self._allocate(size * self.dtype.itemsize)
        return self._kept

    def _download(self, buffer: cl.Buffer, size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        host = np.empty(size, dtype)
        if size:
            with self._shared.waiting():
                cl.enqueue_copy(self._shared.queue, host, buffer, is_blocking=True)
        return host

    def _topology(self, graph: AnyGraph) -> CsrLayout | GridLayout:
        found = self._topologies.get(graph)
        if found is None:
            found = (
                GridLayout(self.upload, graph, self.lanes, self.dtype.itemsize)
                if isinstance(graph, GridGraph)
                else CsrLayout(self.upload, graph, self._csr_group(graph))
            )
            self._topologies[graph] = found
        return found

    def _csr_group(self, graph: Graph) -> int:
        large = _CSR_LARGE_GROUP if graph.n_vertices >= _CSR_LARGE else _CSR_CPU_GROUP
        group = _GPU_GROUP if self.device.kind == "gpu" else large
        return min(group, int(self.device.handle.max_work_group_size))

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        host = self._topology(graph).pack(np.asarray(f, self.dtype))
        return _Function(self.upload(host), f.shape[1])

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        return topology.unpack(self._download(x.buffer, topology.size(x.channels), self.dtype), x.channels)

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return _Function(self._zeros(self._topology(graph).size(channels)), channels)

    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        topology = self._topology(graph)
        weights = host_weights(graph, weights)
        buffer = (
            None if weights is None else topology.kept.copy(weights, functools.partial(self._put_weights, topology))
        )
        return Weighted(graph, topology, buffer)

    def _put_weights(self, topology: CsrLayout | GridLayout, weights: FloatArray) -> cl.Buffer:
        return self.upload(topology.pack_weights(np.asarray(weights, self.dtype)))

    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        if weighted.weights is None:
            return None
        if isinstance(weighted.weights, _Recomputed):
            of = weighted.weights
            f = self.get(weighted.graph, _Function(of.compared, of.channels + of.masked))[:, : of.channels]
            return self.get_weights(self.patch_distance(weighted.graph, f, of.form))
        topology = weighted.topology
        kind = np.float16 if weighted.storage == "half" else self.dtype
        flat = self._download(weighted.weights, topology.weight_size(), kind)
        return topology.unpack_weights(flat.astype(self.dtype, copy=False))

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return Weighted(graph, self._topology(graph), self.put_edges(graph, gamma).buffer, directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        return _Function(self.upload(self._topology(graph).pack_edges(values.astype(self.dtype))), values.shape[-1])

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        flat = self._download(x.buffer, topology.edge_size(x.channels), self.dtype)
        return topology.unpack_edges(flat, x.channels)

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        return _Function(self._zeros(self._topology(graph).edge_size(channels)), channels)

    # Sizes

    def _layout(self, graph: AnyGraph) -> CsrLayout | GridLayout:
        """The graph's layout without anything on the device, where nothing is there yet."""

        def nothing(host: npt.NDArray[Any]) -> None:
            return None

        found = self._topologies.get(graph)
        if found is not None:
            return found
        return (
            GridLayout(nothing, graph, self.lanes, self.dtype.itemsize)
            if isinstance(graph, GridGraph)
            else CsrLayout(nothing, graph, self._csr_group(graph))
        )

    @property
    def largest_buffer(self) -> int:
        return int(self.device.handle.max_mem_alloc_size)

    def topology_bytes(self, graph: AnyGraph) -> int:
        return 0 if isinstance(graph, GridGraph) else graph.indptr.nbytes + graph.indices.nbytes

    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        return self._layout(graph).size(channels) * self.dtype.itemsize

    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        layout = self._layout(graph)
        return (layout.edge_size(1) if directed else layout.weight_size()) * self.dtype.itemsize

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

    # Kernels

    def _kernel(self, primitive: str, options: tuple[str, ...], args: list[Any]) -> cl.Kernel:
        """The kernel with these build options, which takes arguments such as these."""
        key = (primitive, self._options + options)
        found = self._shared.kernels.get(key)
        if found is None:
            source = kernels.opencl_source(primitive)
            program = cl.Program(self._shared.context, source).build(options=list(key[1]))
            found = self._shared.kernels[key] = cl.Kernel(program, primitive)
            # Not told their types, pyopencl tries what each scalar might be: 0.15 ms a launch instead of 0.02.
            found.set_arg_types([arg.dtype if isinstance(arg, np.generic) else None for arg in args])
        return found

    def _run(
        self,
        primitive: str,
        weighted: Weighted,
        args: list[Any],
        options: tuple[str, ...] = (),
        size: tuple[int, ...] | None = None,
        *,
        exact: bool = False,
        local: tuple[int, ...] | None = None,
    ) -> None:
        """Run a kernel over the graph's packs, or over `size` work items, in groups of `local`.

        Work groups have a size of ours where a driver, left to choose, would take groups of 1 for a prime number of
        work items: on a GPU, and on a stored graph. A kernel that numbers its work items by their count (a sum on a
        grid) asks for an `exact` size, which is then left to the driver.
        """
        layout = weighted.topology
        options = (*layout.options, f"-DN={layout.width}", *options)
        weights, extra = weighted.weights, [self._nothing, self.real(0), self.real(0)]
        if isinstance(weights, _Recomputed):
            options += weights.options
            extra = [weights.nearness, self.real(weights.form.shift), self.real(weights.scale)]
            weights = weights.compared
        elif weights is not None:
            options += ("-DGAMMA",) if weighted.directed else ("-DWEIGHTED",)
            options += ("-DHALF_WEIGHTS",) if weighted.storage == "half" else ()
        size = size or layout.global_size
        group = layout.group or (_GPU_GROUP if self.device.kind == "gpu" and not exact else None)
        if group is not None:
            local = (min(group, self.device.handle.max_work_group_size), *(1,) * (len(size) - 1))
            size = (round_up(size[0], local[0]), *size[1:])
        graph_args = layout.args(
            self._nothing if weights is None else weights, weighted.directed or primitive == "adjoint"
        )
        args = [*graph_args, *(extra if isinstance(layout, GridLayout) else ()), *args]
        with self._shared.lock:
            self._kernel(primitive, options, args)(self._shared.queue, size, local, *args)

    def _number(self, x: float | Array, option: str) -> tuple[list[Any], tuple[str, ...]]:
        """A number, or one value per vertex, as the two arguments that stand for it."""
        if isinstance(x, _Function):
            return [x.buffer, self.real(0)], (option,)
        return [self._nothing, self.real(x)], ()

    def _lam(self, lam: float | Array) -> tuple[list[Any], tuple[str, ...]]:
        return self._number(lam, "-DLAM_ARRAY")

    def _g(self, g: Conductance, channels: int) -> tuple[list[Any], tuple[str, ...]]:
        """The arguments CONDUCTANCE_ARGS."""
        if isinstance(g, EdgeNorm):
            norms = 1 if g.coupled else channels
            return [self._nothing, self.real(g.power), self.real(g.eps) ** 2], ("-DEDGE_NORM", f"-DG={norms}")
        if g is None:
            return [self._nothing, self.real(0), self.real(0)], ()
        return [g.buffer, self.real(0), self.real(0)], ("-DCONDUCTANCES", f"-DG={g.channels}")

    def _recomputed(self, graph: GridGraph, f: FloatArray, form: PatchForm, half: FloatArray) -> _Recomputed:
        channels, masked = f.shape[1], graph.mask is not None
        if graph.mask is not None:
            f = np.concatenate([f, graph.mask.reshape(-1, 1)], axis=1, dtype=self.dtype)
        scale = exp2_scale(form.scale or 0.0, float(np.finfo(self.dtype).max))
        nearness = self.upload(half.astype(self.dtype))
        return _Recomputed(self.put(graph, f).buffer, nearness, channels, scale, masked, form)

    def _launch_strips(
        self, primitive: str, options: tuple[str, ...], args: list[Any], size: tuple[int, int], strips: Strips
    ) -> None:
        """Run a kernel over blocks of cells: on a CPU a group is one of them."""
        local = (1, 1)
        if strips.gpu:
            local = (min(64, self.device.handle.max_work_group_size), 1)
            size = (round_up(size[0], local[0]), size[1])
        with self._shared.lock:
            self._kernel(primitive, options, args)(self._shared.queue, size, local, *args)

    def _strips(self, graph: GridGraph, form: PatchForm, sums: int) -> Strips:
        return Strips(graph, form, self.lanes, self.dtype.itemsize, self.device.kind == "gpu", sums)

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

    def _partial(
        self, primitive: str, weighted: Weighted, args: list[Any], options: tuple[str, ...], dtype: Any
    ) -> Any:
        """One number per segment of the graph."""
        layout = weighted.topology
        count = round_up(math.prod(layout.segments), layout.group or 1)
        out = self._allocate(count * np.dtype(dtype).itemsize)
        # A few segments to a group: PoCL, left to choose, makes a row of them one group, which keeps one core busy.
        local = layout.sum_group if self.device.kind == "cpu" else None
        args = [np.int64(layout.segment), *args, out]
        self._run(primitive, weighted, args, options, layout.segments, exact=True, local=local)
        return self._download(out, count, dtype)

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

    def finish(self) -> None:
        with self._shared.waiting():
            self._shared.queue.finish()


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    if np.dtype(dtype) == np.float64 and not device.float64:
        raise BackendUnavailable(f"{device.id} ({device.name}) does not compute in float64; use dtype float32")
    return OpenCLBackend(device, dtype)
