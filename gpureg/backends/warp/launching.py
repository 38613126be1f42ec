"""Graphs, functions and launches in NVIDIA Warp.

Kernels are compiled once per device, primitive and options, and cached; Warp caches the binaries on disk. Functions
and weights have the layouts of ``grid.py`` and ``csr.py``.

On the CPU, Warp runs a launch on the calling thread, without Python's global lock. A large launch is cut into pieces
here, which a pool of threads takes one by one. No sum crosses a piece, so the bits do not depend on the number of
threads.
"""

from __future__ import annotations

import copy
import itertools
import math
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph, GridGraph
from ...kernels.warp import pack, reals
from ..bands import BY_ROWS, Bands
from ..failures import build_failed
from ..protocol import Backend
from ..recorded import Parameter, Replay, Work
from ..types import Array, Conductance, Device, Smoothness, Storage, Weighted, host_weights
from . import memory, pool
from .layout import Bound, Csr, Grid, Recomputed, channels_of, equal_cuts, form_of
from .pool import PACK_BYTES, PACK_SPEED, PIECES, RUN, CompileError, compiled, launch_all
from .recording import Record


class WarpLaunches(Backend):
    """Graphs and functions on a Warp device, and launches of kernels over them."""

    name = "warp"

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        self.real = wp.float64 if self.dtype == np.float64 else wp.float32
        self._on = device.handle
        self._layouts: weakref.WeakKeyDictionary[AnyGraph, Csr | Grid] = weakref.WeakKeyDictionary()
        # The launches of recorded work, while recording.
        self._record: Record | None = None
        self._bands = Bands()

    # Buffers

    def upload(self, values: npt.NDArray[Any], dtype: Any) -> Any:
        """Copy a host array to the device, never empty; the last axis has the components of vectors."""
        if not values.size:
            values = np.zeros(tuple(max(size, 1) for size in values.shape), values.dtype)
        # Without a shape, Warp removes one axis too many from an array of size 1 on every axis.
        shape = values.shape[: values.ndim - len(getattr(dtype, "_shape_", ()))]
        return memory.copied(np.ascontiguousarray(values), dtype=dtype, shape=shape, device=self._on)

    def _upload_reals(self, values: npt.NDArray[Any]) -> Any:
        return self.upload(values.astype(self.dtype, copy=False), self.real)

    def _layout(self, graph: AnyGraph) -> Csr | Grid:
        found = self._layouts.get(graph)
        if found is None:
            if isinstance(graph, GridGraph):
                found = Grid(self.real, self.upload, graph)
            else:
                found = Csr(self.real, self.upload, graph)
            self._layouts[graph] = found
        return found

    def _bind(self, graph: AnyGraph, weights: Any, directed: bool = False, storage: Storage = "full") -> Weighted:
        layout = self._layout(graph)
        form = "gamma" if directed else form_of(weights)
        bound = Bound(layout, layout.access(form), layout.argument(weights, directed))
        return Weighted(graph, bound, weights, directed, storage)

    def channels(self, x: Array) -> int:
        return channels_of(x)

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        values = np.asarray(f, self.dtype)
        m = values.shape[1]
        return self.upload(values.reshape(*self._layout(graph).shape, m), reals.vector(self.real, m))

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(x.numpy()).reshape(graph.n_vertices, channels_of(x))

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return memory.zeros(self._layout(graph).shape, dtype=reals.vector(self.real, channels), device=self._on)

    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        weights = host_weights(graph, weights)
        if weights is None:
            return self._bind(graph, None)
        layout = self._layout(graph)
        return self._bind(
            graph, layout.copies.copy(weights, lambda host: self._upload_reals(layout.pack_weights(host)))
        )

    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        if weighted.weights is None:
            return None
        if isinstance(weighted.weights, Recomputed):
            return self.get_weights(self._stored(weighted.graph, weighted.weights))
        return np.array(weighted.topology.layout.unpack_weights(weighted.weights.numpy())).astype(self.dtype)

    def _stored(self, graph: AnyGraph, weights: Recomputed) -> Weighted:
        """Store weights that are computed at each use."""
        compared = self.get(graph, weights.compared)[:, : weights.channels]
        return self.patch_distance(graph, compared, weights.form)

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return self._bind(graph, self._upload_reals(self._layout(graph).pack_gamma(gamma)), directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        packed = self._layout(graph).pack_edges(values.astype(self.dtype))
        return self.upload(packed, reals.vector(self.real, values.shape[-1]))

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(self._layout(graph).unpack_edges(x.numpy()))

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        shape = tuple(max(size, 1) for size in self._layout(graph).edge_shape())
        return memory.zeros(shape, dtype=reals.vector(self.real, channels), device=self._on)

    # Sizes

    @property
    def free_memory(self) -> int:
        return min(int(self._on.free_memory), self.device.memory) if self._on.is_cuda else self.device.memory

    def topology_bytes(self, graph: AnyGraph) -> int:
        return 0 if isinstance(graph, GridGraph) else 4 * (graph.n_vertices + 1 + graph.n_edges)

    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        return graph.n_vertices * channels * self.dtype.itemsize

    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        if isinstance(graph, GridGraph):
            half = graph.n_vertices * max(graph.half_window, 1) * self.dtype.itemsize
            return 2 * half if directed else half
        return max(graph.n_edges, 1) * self.dtype.itemsize

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
        cuts: Callable[[int, int], list[int]] = equal_cuts,
    ) -> None:
        """Run the kernel that `make` makes for `options` over `dim` work items; `work` is their work in total."""
        try:
            kernel = compiled(self._on.alias, make, *options)
        except CompileError as error:
            raise build_failed(self.device, self.dtype, error.kernel, str(error)) from error
        command = wp.launch(
            kernel,
            dim=dim,
            inputs=[*inputs, wp.vec2i(0, 0)],
            outputs=[out],
            device=self._on,
            block_dim=getattr(kernel, "threads", None),
            record_cmd=True,
        )
        commands = [command]
        threads = pool.cores() if self._on.is_cpu else 1
        pieces = min(threads * PIECES, work // pool.LEAST_WORK)
        # cut along the rows or, if there are few rows, across them
        axis = 0 if dim[0] >= pieces else len(dim) - 1
        pieces = min(pieces, dim[axis])

        def piece(first: int, last: int) -> Any:
            part = copy.copy(command)
            part.params = list(command.params)
            part.set_dim((*dim[:axis], last - first, *dim[axis + 1 :]))
            part.set_param_at_index(len(inputs), wp.vec2i(0, first) if axis else wp.vec2i(first, 0))
            return part

        if threads > 1 and pieces > 1:
            commands = [piece(a, b) for a, b in itertools.pairwise(cuts(dim[axis], pieces)) if b > a]
        elif self.device.watched and make.__module__.rpartition(".")[2] in BY_ROWS:
            key, items = (make, options), math.prod(dim) // max(dim[axis], 1)
            if self._record is None:
                self._bands.run(key, dim[axis], items, lambda *band: piece(*band).launch(), self.finish)
                return
            commands = [piece(*band) for band in self._bands.known(key, dim[axis], items)]
        if self._record is not None:
            self._record.add(commands, [*inputs, out])
        launch_all(commands)

    def record(self, work: Work, parameters: Sequence[Parameter]) -> Replay:
        recorder = copy.copy(self)
        recorder._record = Record(self._on)
        work(recorder, *parameters)
        return recorder._record.replay

    def _run(
        self, make: Callable[..., Any], weighted: Weighted, options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        """Run a kernel whose first argument is the graph, with one work item per vertex."""
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
        """Run a kernel whose first argument is the graph; on a CPU a work item is a run or a pack of vertices."""
        bound, N = weighted.topology, 1
        layout, (rows, width) = bound.layout, bound.layout.shape
        packs = self._on.is_cpu and not edge_norm and pack.possible(bound.access, options[0])
        if self._on.is_cpu:
            N = PACK_BYTES // self.dtype.itemsize if packs else RUN

        def cuts(size: int, pieces: int) -> list[int]:
            return [-(-x // N) for x in layout.cuts(width, pieces)] if rows == 1 else equal_cuts(size, pieces)

        work = layout.work // PACK_SPEED if packs else layout.work
        options = (bound.access, *options, N, packs)
        self._launch((rows, -(-width // N)), make, options, [bound.argument, *inputs], out, work=work, cuts=cuts)

    def _launch_vertices(
        self, layout: Csr | Grid, make: Callable[..., Any], options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        self._launch(layout.shape, make, options, inputs, out, work=layout.work, cuts=layout.cuts)

    def _mirrored(self, weighted: Weighted) -> Any:
        """Return the graph as a kernel argument, with the indices of opposite edges."""
        return weighted.topology.layout.argument(weighted.weights, True)

    # Kernel arguments

    def _squared(self, eps: float) -> float:
        return float(np.asarray(eps, self.dtype)[()] ** 2)

    def _conductance(self, g: Conductance, M: int) -> tuple[tuple[int, str], list[Any]]:
        """Return the number and kind of the conductances, and their kernel arguments."""
        if isinstance(g, Smoothness):
            return (g.norms(M), "edge"), [None, g.power, self._squared(g.eps)]
        if g is None:
            return (1, "none"), [None, 0.0, 0.0]
        return (channels_of(g), "vertex"), [g, 0.0, 0.0]
