"""Graphs, functions and weights in OpenCL buffers."""

from __future__ import annotations

import functools
import itertools
import os
import weakref
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyopencl as cl

from ...arrays import FloatArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph, GridGraph
from ..patches import PatchForm
from ..protocol import Backend
from ..types import Array, BackendUnavailable, Device, Weighted, host_weights
from .failing import raise_if_full
from .geometry import GPU_LINE, CsrGeometry, GridGeometry
from .layout import CsrLayout, GridLayout
from .listing import free_memory
from .queue import HostBuffer, queue
from .recording import Record
from .rows import csr_geometry, csr_layout

# Bytes of an array for which numpy asks for huge pages, and bytes of an ordinary page.
_HUGE, _PAGE = 1 << 22, 1 << 12

# Offsets of buffers in a page: buffers that all begin at the start of a page would share the sets of a cache.
_STAGGER = itertools.cycle(range(0, 1 << 12, 5 << 7))

# Work items of a group: on a GPU; on a CPU for a stored graph, and for one with at least _CSR_LARGE vertices.
_GPU_GROUP, _CSR_CPU_GROUP, _CSR_LARGE_GROUP, _CSR_LARGE = 64, 128, 2048, 1 << 18


@dataclass(frozen=True, eq=False)
class Function:
    """A function on the vertices or edges."""

    buffer: cl.Buffer
    channels: int


@dataclass(frozen=True, eq=False)
class Recomputed:
    """The data to recompute weights from: a function of `channels` channels, and the mask as one more channel."""

    compared: cl.Buffer
    nearness: cl.Buffer  # (H,): spatial factors
    channels: int
    scale: float
    masked: bool
    form: PatchForm

    @property
    def options(self) -> tuple[str, ...]:
        """Build options of the kernels that recompute the weights."""
        return ("-DRECOMPUTED", f"-DQ={self.channels}", *(("-DMASKED_WEIGHTS",) if self.masked else ()))


class OpenCLBuffers(Backend):
    """Graphs, functions and weights on an OpenCL device."""

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
        if not device.handle.single_fp_config & cl.device_fp_config.DENORM:
            self._options += ("-DFLUSHED",)
        self._topologies: weakref.WeakKeyDictionary[AnyGraph, CsrLayout | GridLayout] = weakref.WeakKeyDictionary()
        self._geometries: weakref.WeakKeyDictionary[AnyGraph, CsrGeometry | GridGeometry] = weakref.WeakKeyDictionary()
        self._nothing = self.upload(np.zeros(1, self.dtype))
        self._scratch_memory: cl.Buffer = None
        # The launches of recorded work, while recording.
        self._record: Record | None = None

    def _allocate(self, nbytes: int) -> cl.Buffer:
        if os.getpid() != self._shared.process:
            # The driver's threads are in the parent process: a wait here would never end.
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
            # On a CPU we can allocate: numpy asks the system for huge pages, a driver does not. The first access to
            # 150 MB of small pages takes three times as long as computing weights there.
            host = np.empty(nbytes + 2 * _PAGE, np.uint8)
            begin = -host.ctypes.data % _PAGE + next(_STAGGER)
            flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
            buffer = HostBuffer(self._shared.context, flags, hostbuf=host[begin : begin + nbytes])
            weakref.finalize(buffer, self._shared.leaving.append, host)
            return buffer
        try:
            return cl.Buffer(self._shared.context, cl.mem_flags.READ_WRITE, max(nbytes, self.dtype.itemsize))
        except cl.Error as error:
            raise_if_full(self.device.handle, error, allocating=True)
            raise

    def upload(self, host: npt.NDArray[Any]) -> cl.Buffer:
        """Copy a host array to a device buffer."""
        host = np.ascontiguousarray(host)
        buffer = self._allocate(host.nbytes)
        if host.nbytes:
            with self._shared.waiting():
                cl.enqueue_copy(self._shared.queue, buffer, host, is_blocking=True)
        return buffer

    def _zeros(self, size: int) -> cl.Buffer:
        buffer = self._allocate(size * self.dtype.itemsize)
        with self._shared.lock:
            cl.enqueue_fill_buffer(self._shared.queue, buffer, self.real(0), 0, max(size, 1) * self.dtype.itemsize)
        return buffer

    def _between_zeros(self, size: int, guard: int, itemsize: int) -> cl.Buffer:
        """Allocate a buffer with `guard` zeros at each end; a kernel writes all the rest."""
        buffer = self._allocate(size * itemsize)
        nbytes, edge = max(size, 1) * itemsize, guard * itemsize
        for begin in (0, nbytes - edge) if edge else ():
            with self._shared.lock:
                cl.enqueue_fill_buffer(self._shared.queue, buffer, np.uint8(0), begin, edge)
        return buffer

    def _scratch(self, size: int) -> cl.Buffer:
        """Return a scratch buffer of at least `size` numbers, with any content.

        All calls share it: the queue runs their work in order.
        """
        if self._scratch_memory is None or self._scratch_memory.size < size * self.dtype.itemsize:
            self._scratch_memory = self._allocate(size * self.dtype.itemsize)
        return self._scratch_memory

    def _download(self, buffer: cl.Buffer, size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        host = np.empty(size, dtype)
        if size:
            with self._shared.waiting():
                cl.enqueue_copy(self._shared.queue, host, buffer, is_blocking=True)
        return host

    def _topology(self, graph: AnyGraph) -> CsrLayout | GridLayout:
        found = self._topologies.get(graph)
        if found is None:
            geometry = self._geometry(graph)
            if isinstance(graph, GridGraph):
                assert isinstance(geometry, GridGeometry)
                found = GridLayout(self.upload, graph, geometry)
            else:
                assert isinstance(geometry, CsrGeometry)
                gpu = self.device.kind == "gpu"
                found = csr_layout(self.upload, graph, geometry, self._csr_group(graph), gpu)
            self._topologies[graph] = found
        return found

    def _csr_group(self, graph: Graph) -> int:
        large = _CSR_LARGE_GROUP if graph.n_vertices >= _CSR_LARGE else _CSR_CPU_GROUP
        group = _GPU_GROUP if self.device.kind == "gpu" else large
        return min(group, int(self.device.handle.max_work_group_size))

    def channels(self, x: Array) -> int:
        return int(x.channels)

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        host = self._topology(graph).pack(np.asarray(f, self.dtype))
        return Function(self.upload(host), f.shape[1])

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        return topology.unpack(self._download(x.buffer, topology.geometry.size(x.channels), self.dtype), x.channels)

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return Function(self._zeros(self._geometry(graph).size(channels)), channels)

    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        topology = self._topology(graph)
        weights = host_weights(graph, weights)
        buffer = (
            None if weights is None else topology.copies.copy(weights, functools.partial(self._put_weights, topology))
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
        flat = self._download(weighted.weights, topology.geometry.weight_size(), kind)
        return topology.unpack_weights(flat.astype(self.dtype, copy=False))

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return Weighted(graph, self._topology(graph), self.put_edges(graph, gamma).buffer, directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        return Function(self.upload(self._topology(graph).pack_edges(values.astype(self.dtype))), values.shape[-1])

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        topology = self._topology(graph)
        flat = self._download(x.buffer, topology.geometry.edge_size(x.channels), self.dtype)
        return topology.unpack_edges(flat, x.channels)

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        return Function(self._zeros(self._geometry(graph).edge_size(channels)), channels)

    def _geometry(self, graph: AnyGraph) -> CsrGeometry | GridGeometry:
        """Compute the sizes of a graph's buffers, without the device."""
        found = self._geometries.get(graph)
        if found is None:
            found = (
                GridGeometry.of(graph, self.lanes, self.dtype.itemsize, GPU_LINE if self.device.kind == "gpu" else 0)
                if isinstance(graph, GridGraph)
                else csr_geometry(graph, self.device.kind == "gpu")
            )
            self._geometries[graph] = found
        return found

    @property
    def largest_buffer(self) -> int:
        return int(self.device.handle.max_mem_alloc_size)

    @property
    def free_memory(self) -> int:
        return free_memory(self.device)

    def topology_bytes(self, graph: AnyGraph) -> int:
        if isinstance(graph, GridGraph):
            return 0
        return graph.indptr.nbytes + self._geometry(graph).weight_size() * graph.indices.itemsize

    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        return self._geometry(graph).size(channels) * self.dtype.itemsize

    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        geometry = self._geometry(graph)
        return (geometry.edge_size(1) if directed else geometry.weight_size()) * self.dtype.itemsize
