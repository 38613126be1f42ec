"""Graphs in OpenCL: buffers, functions and weights in them, launches over a graph. Nothing here knows a primitive.

Programs are built once per device, primitive and set of build options, and kept; pyopencl keeps the binaries on disk.
Functions and weights are laid out as ``layout.py`` says.
"""

from __future__ import annotations

import functools
import itertools
import math
import os
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ... import kernels
from ...arrays import FloatArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph, GridGraph
from ..patches import PatchForm
from ..protocol import Backend
from ..types import Array, BackendUnavailable, Conductance, Device, EdgeNorm, Weighted, host_weights
from .layout import CsrLayout, GridLayout, round_up
from .queue import HostBuffer, queue
from .strips import Strips

GPU_TIER, CPU_TIER = 1, 2

# Bytes from which numpy asks for huge pages, and of an ordinary page.
_HUGE, _PAGE = 1 << 22, 1 << 12

# Where in a page the buffers of a kernel begin: all at its start would share the sets of a cache.
_STAGGER = itertools.cycle(range(0, 1 << 12, 5 << 7))

# Primitives that read both directions of an edge, whatever gamma is.
_MIRRORED = ("adjoint", "primal", "duality_gap")

# Work items of a group: on a GPU; on a stored graph on a CPU, and on one of so many vertices.
_GPU_GROUP, _CSR_CPU_GROUP, _CSR_LARGE_GROUP, _CSR_LARGE = 64, 128, 2048, 1 << 18


@dataclass(frozen=True, eq=False)
class Function:
    """A function on the vertices or edges."""

    buffer: cl.Buffer
    channels: int


@dataclass(frozen=True, eq=False)
class Recomputed:
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


class OpenCLGraph(Backend):
    """Graphs, functions on them and launches over them."""

    name = "opencl"

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        self._shared = queue(device.handle)
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
            buffer = HostBuffer(self._shared.context, flags, hostbuf=host[begin : begin + nbytes])
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
        return Function(self.upload(host), f.shape[1])

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        return topology.unpack(self._download(x.buffer, topology.size(x.channels), self.dtype), x.channels)

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return Function(self._zeros(self._topology(graph).size(channels)), channels)

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
        if isinstance(weighted.weights, Recomputed):
            of = weighted.weights
            f = self.get(weighted.graph, Function(of.compared, of.channels + of.masked))[:, : of.channels]
            return self.get_weights(self.patch_distance(weighted.graph, f, of.form))
        topology = weighted.topology
        kind = np.float16 if weighted.storage == "half" else self.dtype
        flat = self._download(weighted.weights, topology.weight_size(), kind)
        return topology.unpack_weights(flat.astype(self.dtype, copy=False))

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return Weighted(graph, self._topology(graph), self.put_edges(graph, gamma).buffer, directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        return Function(self.upload(self._topology(graph).pack_edges(values.astype(self.dtype))), values.shape[-1])

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        flat = self._download(x.buffer, topology.edge_size(x.channels), self.dtype)
        return topology.unpack_edges(flat, x.channels)

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        return Function(self._zeros(self._topology(graph).edge_size(channels)), channels)

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

    # Kernels

    def _kernel(self, primitive: str, options: tuple[str, ...], args: list[Any]) -> cl.Kernel:
        """The kernel with these build options, which takes arguments such as these."""
        key = (primitive, self._options + options)
        found = self._shared.kernels.get(key)
        if found is None:
            source = kernels.opencl_source(primitive)
            program = cl.Program(self._shared.context, source).build(options=list(key[1]))
            found = self._shared.kernels[key] = program.all_kernels()[0]
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
        if isinstance(weights, Recomputed):
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
            self._nothing if weights is None else weights, weighted.directed or primitive in _MIRRORED
        )
        args = [*graph_args, *(extra if isinstance(layout, GridLayout) else ()), *args]
        with self._shared.lock:
            self._kernel(primitive, options, args)(self._shared.queue, size, local, *args)

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

    def _number(self, x: float | Array, option: str) -> tuple[list[Any], tuple[str, ...]]:
        """A number, or one value per vertex, as the two arguments that stand for it."""
        if isinstance(x, Function):
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

    def finish(self) -> None:
        with self._shared.waiting():
            self._shared.queue.finish()
