"""NVIDIA Warp: CUDA devices, or the CPU; the kernels are in ``kernels/warp``.

Kernels are compiled once per device, primitive and set of what is compiled in, and kept; Warp keeps the binaries on
disk. Functions and weights are laid out as ``grid.py`` and ``csr.py`` say.

On the CPU, Warp runs a launch on the thread that asks for it, without Python's lock. A launch of some size is cut into
pieces here, which the threads of one pool take one after another. No sum crosses a piece, so that the bits do not
depend on the number of threads.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import itertools
import math
import os
import tempfile
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ..graph import FloatArray, Graph, GridGraph, IntArray, opposite_edges
from ..kernels.warp import (
    adjoint,
    aggregate,
    csr,
    degree,
    difference,
    energy,
    euler_step,
    gradient_norm,
    grid,
    jacobi_step,
    max_change,
    p_laplacian,
    pack,
    patch_distance,
    reals,
    similarity_step,
    strip,
)
from . import numpy as host
from .base import (
    AnyGraph,
    Array,
    Backend,
    BackendUnavailable,
    Conductance,
    Device,
    EdgeNorm,
    Kept,
    PatchForm,
    Storage,
    Weighted,
    expect_stored,
    host_weights,
    padded_for_patches,
    padded_shape,
    patch_lines,
    reflected,
)

CUDA_TIER, CPU_TIER = 0, 3

# Segments of a long sum: enough to fill a GPU, few enough for the host to add.
_CPU_SEGMENTS, _CUDA_SEGMENTS = 1 << 12, 1 << 16

# On the CPU: bytes of a pack of neighbouring cells, how much faster an edge is in packs, and vertices in a run.
_PACK_BYTES, _PACK_SPEED, _RUN = 64, 4, 256

# A strip on the CPU: rows, bytes of neighbouring cells, and bytes of what a work item keeps, which fit the first cache.
_STRIP_ROWS, _STRIP_BYTES, _STRIP_SCRATCH = 32, 128, 1 << 15

# Recorded sweeps per graph with its weights: two buffers in turn, and as many dampings.
_SWEEPS = 8

# Pieces per thread, so that a thread that is held up leaves the rest to the others; and the least work of a piece, in
# edges and vertices: a tenth of a millisecond or more, a few times what it costs to hand a piece over.
_PIECES, _LEAST_WORK = 4, 1 << 17

_NO_DRIVER = b"Could not find or load the NVIDIA CUDA driver"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Warp without its greeting and its lines on modules; its warnings stay."""
    level = wp.config.log_level
    if level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_WARNING
    try:
        yield
    finally:
        wp.config.log_level = level


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Drop the one line that Warp's C++ writes to stderr where there is no CUDA driver; no setting of its own does."""
    try:
        stderr = os.dup(2)
    except OSError:  # a process without stderr
        yield
        return
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            said.seek(0)
            for line in said:
                if _NO_DRIVER not in line:
                    os.write(2, line)


def devices() -> list[Device]:
    """All CUDA devices, then the CPU."""
    with _quiet(), _without_driver_warning():
        wp.init()
    processor = host.devices()[0]
    described = []
    for i, device in enumerate(wp.get_devices()):
        gpu = bool(device.is_cuda)
        driver = f"Warp {wp.config.version}"
        if gpu:
            driver += ", CUDA {}.{}".format(*wp.get_cuda_driver_version())
        described.append(
            Device(
                backend="warp",
                id=f"warp:{device.alias}",
                name=device.name if gpu else processor.name,
                driver=driver,
                kind="gpu" if gpu else "cpu",
                memory=int(device.total_memory) if gpu else processor.memory,
                vector_width=1,
                float64=True,
                rank=(CUDA_TIER if gpu else CPU_TIER, i),
                handle=device,
            )
        )
    return sorted(described, key=lambda device: device.rank)


_compiling = threading.RLock()


@functools.cache
def _kernel(alias: str, make: Callable[..., Any], *options: Any) -> Any:
    """The kernel that `make` gives for these options, compiled and loaded."""
    with _compiling, _quiet():
        kernel = make(*options)
        wp.load_module(kernel.module, alias)
        return kernel


def cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # a system without it
        return os.cpu_count() or 1


class _Pool:
    """The threads that help the one that launches; made when they are first needed, in a forked child anew."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._threads: ThreadPoolExecutor | None = None
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._forget)

    def _forget(self) -> None:
        self._lock, self._threads = threading.Lock(), None

    def run(self, commands: list[Any]) -> None:
        """Launch all commands, here and on the other threads, and wait for them."""

        def work() -> None:
            with contextlib.suppress(IndexError):
                while True:
                    waiting.popleft().launch()

        waiting = deque(commands)
        with self._lock:
            if self._threads is None:
                self._threads = ThreadPoolExecutor(max(cores() - 1, 1), thread_name_prefix="gpureg-warp")
        helpers = min(cores(), len(commands)) - 1
        futures = []
        with contextlib.suppress(RuntimeError):  # no new threads while Python exits: all is done here
            futures = [self._threads.submit(work) for _ in range(helpers)]
        try:
            work()
        finally:
            # after an interrupt too: nothing is written once this returns
            waiting.clear()
            wait(futures)
        for future in futures:
            future.result()


_pool = _Pool()


def _launch_all(commands: list[Any]) -> None:
    """Launch the commands that a launch was cut into."""
    if len(commands) == 1:
        commands[0].launch()
    else:
        _pool.run(commands)


def _equal_cuts(size: int, pieces: int) -> list[int]:
    return [size * i // pieces for i in range(pieces + 1)]


class _Csr:
    """A stored graph on the device."""

    def __init__(self, backend: WarpBackend, graph: Graph) -> None:
        if graph.n_edges >= 2**31:
            raise MemoryError(
                f"the graph has {graph.n_edges} directed edges, a Warp array holds less than 2^31: "
                "use a GridGraph, or another backend"
            )
        self.shape = (1, graph.n_vertices)
        self.weight_shape: tuple[int, ...] = (max(graph.n_edges, 1),)
        # not the graph: the layouts are kept for as long as their graph lives
        self._n_edges = graph.n_edges
        self._real = backend.real
        self._struct = csr.struct(self._real)
        self.indptr = backend.upload(graph.indptr.astype(np.int32), wp.int32)
        self.indices = backend.upload(graph.indices.astype(np.int32, copy=False), wp.int32)
        # Made when it is first needed, from what does not keep the graph alive.
        self._upload, self._topology = backend.upload, (graph.indptr, graph.indices)
        self._mirror: Any = None
        self._cuts: dict[int, list[int]] = {}
        self.kept = Kept()

    @property
    def work(self) -> int:
        return self.shape[1] + self._n_edges

    def cuts(self, size: int, pieces: int) -> list[int]:
        """Where to cut the vertices into runs of about as many edges and vertices."""
        if size != self.shape[1]:
            return _equal_cuts(size, pieces)
        if pieces not in self._cuts:
            indptr = self._topology[0]
            ends = indptr + np.arange(len(indptr))
            self._cuts[pieces] = np.searchsorted(ends, np.linspace(0, int(ends[-1]), pieces + 1)).tolist()
        return self._cuts[pieces]

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        return weights

    def unpack_weights(self, packed: FloatArray) -> FloatArray:
        return packed[: self._n_edges]

    def edge_shape(self) -> tuple[int, ...]:
        return (1, 1, self._n_edges)

    def pack_edges(self, values: FloatArray) -> FloatArray:
        return values.reshape(1, 1, self._n_edges, -1) if values.size else values.reshape(1, 1, 0, values.shape[-1])

    def unpack_edges(self, packed: FloatArray) -> FloatArray:
        return packed.reshape(-1, packed.shape[-1])[: self._n_edges]

    def pack_gamma(self, gamma: FloatArray) -> FloatArray:
        return gamma[..., 0]

    def access(self, form: str) -> Any:
        return csr.make(self._real, form)

    def argument(self, weights: Any, mirrored: bool) -> Any:
        argument = self._struct()
        argument.indptr, argument.indices = self.indptr, self.indices
        if weights is not None:
            argument.weights = weights
        if mirrored:
            if self._mirror is None:
                self._mirror = self._upload(opposite_edges(*self._topology).astype(np.int32), wp.int32)
            argument.mirror = self._mirror
        return argument


class _Grid:
    """An implicit grid on the device: the layout that ``grid.py`` describes."""

    def __init__(self, backend: WarpBackend, graph: GridGraph) -> None:
        self.shape = (math.prod(graph.shape[:-1]), graph.shape[-1])
        self.H = graph.half_window
        self.weight_shape = (self.shape[0], max(self.H, 1), self.shape[1])
        self._graph_shape = graph.shape
        self._real = backend.real
        self._struct, place, sizes = grid.struct(self._real, graph.ndim)
        leading = graph.ndim - 1 if graph.ndim > 2 else 0
        strides = [math.prod(graph.shape[d + 1 : -1]) for d in range(graph.ndim - 1)]
        rows = graph.offsets[:, :-1] @ np.array(strides, np.int64)
        self._reach = int(np.abs(graph.offsets[:, -1]).max(initial=0))
        steps = np.column_stack([rows, graph.offsets[:, -1], graph.offsets[:, :leading]])
        self.offsets = backend.upload(steps.astype(np.int32), place)
        self._sizes = sizes(*graph.shape[:leading]) if leading else sizes(0)
        self.kept = Kept()

    @property
    def work(self) -> int:
        return math.prod(self.shape) * (1 + 2 * self.H)

    def cuts(self, size: int, pieces: int) -> list[int]:
        return _equal_cuts(size, pieces)

    def pack_weights(self, weights: FloatArray) -> FloatArray:
        rows, width = self.shape
        return np.ascontiguousarray(weights.reshape(self.H, rows, width).transpose(1, 0, 2))

    def unpack_weights(self, packed: FloatArray) -> FloatArray:
        half = packed[:, : self.H].transpose(1, 0, 2)
        return np.ascontiguousarray(half).reshape(self.H, *self._graph_shape)

    def edge_shape(self) -> tuple[int, ...]:
        return (self.shape[0], 2 * self.H, self.shape[1])

    def pack_edges(self, values: FloatArray) -> FloatArray:
        rows, width = self.shape
        return np.ascontiguousarray(values.reshape(2 * self.H, rows, width, values.shape[-1]).transpose(1, 0, 2, 3))

    def unpack_edges(self, packed: FloatArray) -> FloatArray:
        planes = packed[:, : 2 * self.H].transpose(1, 0, 2, 3)
        return np.ascontiguousarray(planes).reshape(2 * self.H, *self._graph_shape, packed.shape[-1])

    def pack_gamma(self, gamma: FloatArray) -> FloatArray:
        return self.pack_edges(gamma)[..., 0]

    def access(self, form: str) -> Any:
        return grid.make(self._real, len(self._graph_shape), form)

    def argument(self, weights: Any, mirrored: bool) -> Any:
        argument = self._struct()
        argument.n_rows, argument.width = self.shape
        argument.H, argument.sizes, argument.offsets = self.H, self._sizes, self.offsets
        argument.reach = self._reach
        if weights is not None:
            argument.weights = weights
        return argument


@dataclass(frozen=True, eq=False)
class _Bound:
    """A graph with its weights as the kernels take it: how they read it, and their first argument."""

    layout: _Csr | _Grid
    access: Any
    argument: Any


def _channels(x: Array) -> int:
    return int(x.dtype._shape_[0])


class WarpBackend(Backend):
    """The primitives as Warp kernels."""

    name = "warp"

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        self.real = wp.float64 if self.dtype == np.float64 else wp.float32
        self._on = device.handle
        self._layouts: weakref.WeakKeyDictionary[AnyGraph, _Csr | _Grid] = weakref.WeakKeyDictionary()
        # The launches of past sweeps, for as long as their weights live; those of the present one while it is recorded.
        self._sweeps: weakref.WeakKeyDictionary[Weighted, dict[Any, Any]] = weakref.WeakKeyDictionary()
        self._recorded: list[list[Any]] | None = None

    # Buffers

    def upload(self, values: npt.NDArray[Any], dtype: Any) -> Any:
        """A copy of a host array on the device, never empty; a vector's numbers are the last axis."""
        if not values.size:
            values = np.zeros(tuple(max(size, 1) for size in values.shape), values.dtype)
        # Left to guess, Warp takes one axis too many off an array of ones in every axis.
        shape = values.shape[: values.ndim - len(getattr(dtype, "_shape_", ()))]
        return wp.array(np.ascontiguousarray(values), dtype=dtype, shape=shape, device=self._on)

    def _upload_reals(self, values: npt.NDArray[Any]) -> Any:
        return self.upload(values.astype(self.dtype, copy=False), self.real)

    def _layout(self, graph: AnyGraph) -> _Csr | _Grid:
        found = self._layouts.get(graph)
        if found is None:
            found = _Grid(self, graph) if isinstance(graph, GridGraph) else _Csr(self, graph)
            self._layouts[graph] = found
        return found

    def _bind(self, graph: AnyGraph, weights: Any, directed: bool = False) -> Weighted:
        layout = self._layout(graph)
        form = "gamma" if directed else "unit" if weights is None else "weights"
        bound = _Bound(layout, layout.access(form), layout.argument(weights, directed))
        return Weighted(graph, bound, weights, directed)

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        values = np.asarray(f, self.dtype)
        m = values.shape[1]
        return self.upload(values.reshape(*self._layout(graph).shape, m), reals.vector(self.real, m))

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(x.numpy()).reshape(graph.n_vertices, _channels(x))

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return wp.zeros(self._layout(graph).shape, dtype=reals.vector(self.real, channels), device=self._on)

    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        weights = host_weights(graph, weights)
        if weights is None:
            return self._bind(graph, None)
        layout = self._layout(graph)
        return self._bind(graph, layout.kept.copy(weights, lambda host: self._upload_reals(layout.pack_weights(host))))

    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        if weighted.weights is None:
            return None
        return np.array(weighted.topology.layout.unpack_weights(weighted.weights.numpy()))

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return self._bind(graph, self._upload_reals(self._layout(graph).pack_gamma(gamma)), directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        packed = self._layout(graph).pack_edges(values.astype(self.dtype))
        return self.upload(packed, reals.vector(self.real, values.shape[-1]))

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(self._layout(graph).unpack_edges(x.numpy()))

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        shape = tuple(max(size, 1) for size in self._layout(graph).edge_shape())
        return wp.zeros(shape, dtype=reals.vector(self.real, channels), device=self._on)

    # Sizes

    def topology_bytes(self, graph: AnyGraph) -> int:
        return 0 if isinstance(graph, GridGraph) else 4 * (graph.n_vertices + 1 + graph.n_edges)

    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        return graph.n_vertices * channels * self.dtype.itemsize

    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        if isinstance(graph, GridGraph):
            half = graph.n_vertices * max(graph.half_window, 1) * self.dtype.itemsize
            return 2 * half if directed else half
        return max(graph.n_edges, 1) * self.dtype.itemsize

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        if not isinstance(graph, GridGraph):
            return (math.prod(padded_shape(graph, radius)) * channels * self.dtype.itemsize, 8 * graph.n_vertices)
        return self._plane_bytes(graph, channels, radius, graph.forward_offsets)

    def step_bytes(self, graph: GridGraph, channels: int, guide: int | None, radius: int) -> tuple[int, ...]:
        if guide is not None:
            return super().step_bytes(graph, channels, guide, radius)
        return self._plane_bytes(graph, channels, radius, graph.offsets)

    def _plane_bytes(self, graph: GridGraph, channels: int, radius: int, offsets: IntArray) -> tuple[int, ...]:
        """The padded function and the plane that says where the grid is, as strips take them."""
        *rows, width = padded_shape(graph, radius)
        plane = math.prod(rows) * (width + sum(self._guards(offsets, radius))) * self.dtype.itemsize
        return channels * plane, plane

    # Kernels

    def _launch(
        self,
        dim: tuple[int, ...],
        make: Callable[..., Any],
        options: tuple[Any, ...],
        inputs: list[Any],
        out: Any,
        *,
        work: int,
        cuts: Callable[[int, int], list[int]] = _equal_cuts,
    ) -> None:
        """Run the kernel that `make` gives for `options`, over a range of work items that does `work` in all."""
        kernel = _kernel(self._on.alias, make, *options)
        command = wp.launch(
            kernel,
            dim=dim,
            inputs=[*inputs, wp.vec2i(0, 0)],
            outputs=[out],
            device=self._on,
            record_cmd=True,
        )
        commands = [command]
        threads = cores() if self._on.is_cpu else 1
        pieces = min(threads * _PIECES, work // _LEAST_WORK)
        # the rows are cut, or where there are few of them, all of them along their length
        axis = 0 if dim[0] >= pieces else len(dim) - 1
        pieces = min(pieces, dim[axis])
        if threads > 1 and pieces > 1:
            commands = []
            for first, last in itertools.pairwise(cuts(dim[axis], pieces)):
                if last > first:
                    piece = copy.copy(command)
                    piece.params = list(command.params)
                    piece.set_dim((*dim[:axis], last - first, *dim[axis + 1 :]))
                    piece.set_param_at_index(len(inputs), wp.vec2i(0, first) if axis else wp.vec2i(first, 0))
                    commands.append(piece)
        if self._recorded is not None:
            self._recorded.append(commands)
        _launch_all(commands)

    def _run(
        self, make: Callable[..., Any], weighted: Weighted, options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        """Run a kernel that takes the graph first, one work item per vertex."""
        bound = weighted.topology
        self._launch_vertices(bound.layout, make, (bound.access, *options), [bound.argument, *inputs], out)

    def _run_runs(
        self,
        make: Callable[..., Any],
        weighted: Weighted,
        options: tuple[Any, ...],
        inputs: list[Any],
        out: Any,
        edge_norm: bool,
    ) -> None:
        """Run a kernel that takes the graph first; on a CPU a work item is a run of vertices or a pack of them."""
        bound, N = weighted.topology, 1
        layout, (rows, width) = bound.layout, bound.layout.shape
        packs = self._on.is_cpu and not edge_norm and pack.possible(bound.access, options[0])
        if self._on.is_cpu:
            N = _PACK_BYTES // self.dtype.itemsize if packs else _RUN

        def cuts(size: int, pieces: int) -> list[int]:
            return [-(-x // N) for x in layout.cuts(width, pieces)] if rows == 1 else _equal_cuts(size, pieces)

        work = layout.work // _PACK_SPEED if packs else layout.work
        options = (bound.access, *options, N, packs)
        self._launch((rows, -(-width // N)), make, options, [bound.argument, *inputs], out, work=work, cuts=cuts)

    def _launch_vertices(
        self, layout: _Csr | _Grid, make: Callable[..., Any], options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        self._launch(layout.shape, make, options, inputs, out, work=layout.work, cuts=layout.cuts)

    def _segments(self, shape: tuple[int, int]) -> tuple[int, list[int]]:
        """Segments of a row, and the reach, stride and count that cut a row into them (``energy.py``).

        A work item of a CPU runs through neighbouring vertices; on a GPU neighbouring work items do.
        """
        rows, width = shape
        gpu = self.device.kind == "gpu"
        wanted = min(width, -(-(_CUDA_SEGMENTS if gpu else _CPU_SEGMENTS) // rows))
        if gpu:
            wanted = max(wanted, min(width, 32))
        count = -(-width // wanted)
        segments = -(-width // count)
        return segments, [1, segments, count] if gpu else [count, 1, count]

    def _partial(
        self,
        make: Callable[..., Any],
        shape: tuple[int, int],
        options: tuple[Any, ...],
        inputs: list[Any],
        dtype: Any,
        work: int,
    ) -> FloatArray:
        """One number per segment of each row."""
        segments, cut = self._segments(shape)
        out = wp.zeros((shape[0], segments), dtype=dtype, device=self._on)
        self._launch((shape[0], segments), make, options, [*inputs, *cut], out, work=work)
        partial: FloatArray = out.numpy()
        return partial

    # Primitives

    def _strip_width(self) -> int:
        """Cells of a row that a strip treats at once."""
        return _STRIP_BYTES // self.dtype.itemsize if self._on.is_cpu else 1

    def _guards(self, offsets: IntArray, radius: int) -> tuple[int, int]:
        """Zeros before and after a padded row: as far as the window and a pack may reach."""
        left = int(np.abs(offsets[:, -1]).max(initial=0))
        return left, left + 2 * self._strip_width() + 2 * radius

    def _launch_strips(
        self,
        make: Callable[..., Any],
        graph: GridGraph,
        f: FloatArray,
        form: PatchForm,
        backward: bool,
        options: tuple[Any, ...],
        inputs: list[Any],
        out: Any,
    ) -> None:
        """Run a kernel over the strips of ``strip.py``; `backward`: with the whole window, not its forward half."""
        M, ndim, r, width = f.shape[1], graph.ndim, form.radius, graph.shape[-1]
        height = graph.shape[-2] if ndim > 1 else 1
        N, S = self._strip_width(), 1
        if self._on.is_cpu:
            S = min(_STRIP_ROWS, max(_STRIP_SCRATCH // (_STRIP_BYTES * (M + 2)), 1), height)
        half = np.ones(graph.half_window) if form.spatial is None else form.spatial
        offsets, spatial = graph.forward_offsets, half
        if backward:
            offsets, spatial = graph.offsets, np.concatenate([half[::-1], half])
        # Rows in planes, with zeros as far as the window and a pack may reach.
        padded = reflected(graph, np.asarray(f, self.dtype), r)
        left, right = self._guards(offsets, r)
        inside = np.zeros((1, *padded.shape[1:]), self.dtype)
        inside[(slice(None), *(slice(r, r + size) for size in graph.shape))] = 1 if graph.mask is None else graph.mask
        guards = [(0, 0)] * ndim + [(left, right)]
        planes, within = np.pad(padded, guards), np.pad(inside, guards)
        maps = None if form.scale is None else form.maps
        # The patch along the leading axes of a grid of three axes and more, as steps in rows.
        leading = form.window(max(ndim - 2, 0))
        strides = np.array([math.prod(padded.shape[a + 2 : -1]) for a in range(leading.ndim)], np.int64)
        lines = strides @ (np.indices(leading.shape).reshape(leading.ndim, leading.size) - r)

        patches = strip.struct(self.real)()
        patches.f, patches.inside = self._upload_reals(planes.ravel()), self._upload_reals(within.ravel())
        patches.plane, patches.pitch, patches.left = planes[0].size, planes.shape[-1], left
        patches.sizes = self.upload(np.array(graph.shape, np.int32), wp.int32)
        patches.offsets, patches.n_offsets = self.upload(offsets.astype(np.int32).ravel(), wp.int32), len(offsets)
        patches.spatial, patches.profile = self._upload_reals(spatial), self._upload_reals(form.profile)
        patches.lines = self.upload(np.atleast_1d(lines).astype(np.int32), wp.int32)
        patches.line_weights = self._upload_reals(leading.ravel())
        if maps is not None:
            cells = np.moveaxis(maps.reshape(*graph.shape, 2), -1, 0)
            around = [(0, 0)] + [(r, r)] * (ndim - 1) + [(r + left, r + right)]
            patches.maps = self._upload_reals(np.pad(cells, around).ravel())
        patches.shift, patches.scale = form.shift, 0.0 if form.scale is None else form.scale
        patches.cut = form.cut

        dim = (math.prod(graph.shape[:-2]) * -(-height // S), -(-width // N))
        work = graph.n_vertices * (1 + len(offsets)) * len(form.profile) * M // _PACK_SPEED
        options = (self.real, ndim, M, r, maps is not None, *options, N, S)
        self._launch(dim, make, options, [patches, *inputs], out, work=work)

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm, *, storage: Storage = "full") -> Weighted:
        if storage != "full":
            raise BackendUnavailable("Warp stores weights in full: weights in float16, or recomputed, need OpenCL")
        layout, similarity = self._layout(graph), form.scale is not None
        if isinstance(graph, GridGraph):
            weights = wp.zeros(layout.weight_shape, dtype=self.real, device=self._on)
            if graph.half_window:
                self._launch_strips(patch_distance.make_grid, graph, f, form, False, (similarity,), [], weights)
            return self._bind(graph, weights)
        padded, sites = padded_for_patches(graph, np.asarray(f, self.dtype), form.radius)
        m, shape = padded.shape[0], padded.shape[1:]
        window = form.window(len(shape))
        # The patch as lines along the last axis, each so many padded rows away.
        axes = (*window.shape[:-1], 1)
        lines = np.asarray(np.ravel_multi_index(tuple(np.indices(axes).reshape(len(shape), -1)), (*shape[:-1], 1)))
        lines = lines - lines[len(lines) // 2]
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

    def degree(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run(degree.make, weighted, (False,), [], out)
        return out

    def largest_weight(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run(degree.make, weighted, (True,), [], out)
        return out

    def aggregate(
        self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, *, out: Array | None = None
    ) -> Array:
        grid = expect_stored(weighted)
        out = self.empty(grid, _channels(f)) if out is None else out
        access = weighted.topology.access
        # the cells of a patch as differences of places: row, x, and on three axes and more the leading axes
        lines = patch_lines(grid, radius)
        along = np.arange(-radius, radius + 1)
        cells = np.empty((len(lines), len(along), 2 + (grid.ndim - 1 if grid.ndim > 2 else 0)), np.int32)
        cells[..., 0], cells[..., 1] = lines[:, -1:], along
        if grid.ndim > 2:
            cells[..., 2:] = lines[:, None, :-1]
        patch = self.upload(cells.reshape(-1, cells.shape[-1]), access.Place)
        self._run(aggregate.make, weighted, (_channels(f),), [patch, f, share, centre], out)
        return out

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        out = self.empty_edges(weighted.graph, _channels(f)) if out is None else out
        self._run(difference.make, weighted, (_channels(f),), [f], out)
        return out

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, _channels(H)) if out is None else out
        bound = weighted.topology
        argument = bound.layout.argument(weighted.weights, True)
        self._launch_vertices(bound.layout, adjoint.make, (bound.access, _channels(H)), [argument, H], out)
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
        M = _channels(f)
        G = 1 if coupled else M
        out = self.empty(weighted.graph, G) if out is None else out
        options = (M, G, edge_power is not None)
        inputs = [f, self._squared(eps), power, edge_power or 0.0]
        self._run_runs(gradient_norm.make, weighted, options, inputs, out, edge_power is not None)
        return out

    def _squared(self, eps: float) -> float:
        return float(np.asarray(eps, self.dtype)[()] ** 2)

    def _conductance(self, g: Conductance, M: int) -> tuple[tuple[int, str], list[Any]]:
        """Number and kind of the conductances, and the arguments that stand for them."""
        if isinstance(g, EdgeNorm):
            return (1 if g.coupled else M, "edge"), [None, g.power, self._squared(g.eps)]
        if g is None:
            return (1, "none"), [None, 0.0, 0.0]
        return (_channels(g), "vertex"), [g, 0.0, 0.0]

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        M = _channels(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        self._run(p_laplacian.make, weighted, (M, *options), [f, *conductance], out)
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
        M = _channels(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        inputs = [f, f0, *conductance, lam, theta]
        compiled_in = (M, *options, isinstance(lam, wp.array))
        self._run_runs(jacobi_step.make, weighted, compiled_in, inputs, out, isinstance(g, EdgeNorm))
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
        M = _channels(f)
        out = self.empty(weighted.graph, M) if out is None else out
        options, conductance = self._conductance(g, M)
        arrays = (isinstance(lam, wp.array), isinstance(tau, wp.array))
        self._run(euler_step.make, weighted, (M, *options, *arrays), [f, f0, *conductance, lam, tau], out)
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
        bound, M = weighted.topology, _channels(f)
        options = (bound.access, M, 1 if coupled else M, edge_norm, isinstance(lam, wp.array))
        inputs = [bound.argument, f, f0, lam, p, self._squared(eps)]
        return float(
            self._partial(energy.make, bound.layout.shape, options, inputs, wp.float64, bound.layout.work).sum()
        )

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        options = (self.real, _channels(a))
        shape = weighted.topology.layout.shape
        return float(self._partial(max_change.make, shape, options, [a, b], self.real, math.prod(shape)).max())

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
        """Launched from a record the second time: a solver swaps the same two buffers over and over.

        To check and pack the arguments of a launch takes Python longer than a GPU needs for a small graph.
        """
        settings: dict[str, Any] = {"p": p, "eps": eps, "coupled": coupled, "theta": theta, "edge_norm": edge_norm}
        if p != 2 and not edge_norm and g is None:  # an output of its own every time
            return super().sweep(weighted, f, f0, lam, g=g, out=out, **settings)
        arrays = (f, f0, lam, g, out)
        key = (*(x if isinstance(x, float | int) else id(x) for x in arrays), *settings.values(), cores())
        past = self._sweeps.setdefault(weighted, {})
        if key in past:
            for commands in past[key][0]:
                _launch_all(commands)
            return out
        recorder = copy.copy(self)
        recorder._recorded = []
        super(WarpBackend, recorder).sweep(weighted, f, f0, lam, g=g, out=out, **settings)
        if len(past) >= _SWEEPS:
            past.clear()
        # with the arrays, lest another one gets the number of one that is gone
        past[key] = (recorder._recorded, arrays)
        return out

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
        if form.scale is None or guide is not None:
            return super().similarity_step(graph, f, form, f0, lam, guide=guide, largest=largest, out=out)
        out = self.empty(graph, f.shape[1]) if out is None else out
        options = (isinstance(lam, wp.array), largest)
        self._launch_strips(similarity_step.make, graph, f, form, True, options, [f0, lam], out)
        return out

    def finish(self) -> None:
        wp.synchronize_device(self._on)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    return WarpBackend(device, dtype)
