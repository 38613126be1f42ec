"""NVIDIA Warp: CUDA devices, or the CPU on one thread; the kernels are in ``kernels/warp``.

Kernels are compiled once per device, primitive and set of what is compiled in, and kept; Warp keeps the binaries on
disk. Functions and weights are laid out as ``grid.py`` and ``csr.py`` say.
"""

from __future__ import annotations

import contextlib
import functools
import math
import os
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from ..graph import FloatArray, Graph, GridGraph, opposite_edges
from ..kernels.warp import (
    adjoint,
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
    patch_distance,
    reals,
)
from . import numpy as host
from .base import (
    AnyGraph,
    Array,
    Backend,
    Conductance,
    Device,
    EdgeNorm,
    PatchForm,
    Weighted,
    host_weights,
    padded_for_patches,
)

CUDA_TIER, CPU_TIER = 0, 3

# Segments of a long sum: enough to fill a GPU, few enough for the host to add.
_CPU_SEGMENTS, _CUDA_SEGMENTS = 1 << 12, 1 << 16

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
        steps = np.column_stack([rows, graph.offsets[:, -1], graph.offsets[:, :leading]])
        self.offsets = backend.upload(steps.astype(np.int32), place)
        self._sizes = sizes(*graph.shape[:leading]) if leading else sizes(0)

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
        return self._bind(graph, self._upload_reals(self._layout(graph).pack_weights(weights)))

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

    # Kernels

    def _launch(
        self, dim: tuple[int, ...], make: Callable[..., Any], options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        """Run the kernel that `make` gives for `options`, over a range of work items."""
        kernel = _kernel(self._on.alias, make, *options)
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=[out], device=self._on)

    def _run(
        self, make: Callable[..., Any], weighted: Weighted, options: tuple[Any, ...], inputs: list[Any], out: Any
    ) -> None:
        """Run a kernel that takes the graph first, one work item per vertex."""
        bound = weighted.topology
        self._launch(bound.layout.shape, make, (bound.access, *options), [bound.argument, *inputs], out)

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
        self, make: Callable[..., Any], shape: tuple[int, int], options: tuple[Any, ...], inputs: list[Any], dtype: Any
    ) -> FloatArray:
        """One number per segment of each row."""
        segments, cut = self._segments(shape)
        out = wp.zeros((shape[0], segments), dtype=dtype, device=self._on)
        self._launch((shape[0], segments), make, options, [*inputs, *cut], out)
        partial: FloatArray = out.numpy()
        return partial

    # Primitives

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm) -> Weighted:
        layout = self._layout(graph)
        padded, sites = padded_for_patches(graph, np.asarray(f, self.dtype), form.radius)
        m, shape = padded.shape[0], padded.shape[1:]
        window = form.window(len(shape))
        # The patch as lines along the last axis, each so many padded rows away.
        axes = (*window.shape[:-1], 1)
        lines = np.asarray(np.ravel_multi_index(tuple(np.indices(axes).reshape(len(shape), -1)), (*shape[:-1], 1)))
        lines = lines - lines[len(lines) // 2]
        places = np.stack(np.divmod(sites, shape[-1]), axis=-1).astype(np.int32)
        function = reals.vector(self.real, m)
        inputs: list[Any] = [
            self.upload(np.moveaxis(padded, 0, -1).reshape(-1, shape[-1], m), function),
            self.upload(lines.astype(np.int32), wp.int32),
            self._upload_reals(window.reshape(len(lines), -1)),
            form.shift,
            0.0 if form.scale is None else form.scale,
        ]
        similarity = form.scale is not None
        weights = wp.zeros(layout.weight_shape, dtype=self.real, device=self._on)
        bare = self._bind(graph, None).topology
        if isinstance(layout, _Grid):
            assert isinstance(graph, GridGraph)
            rows, width = layout.shape
            inputs.append(self.upload(places.reshape(rows, width, 2)[:, 0], wp.vec2i))
            inputs.append(self._upload_reals(np.ones(layout.H) if form.spatial is None else form.spatial))
            inputs.append(None if graph.mask is None else self.put(graph, graph.mask.reshape(-1, 1)))
            if layout.H:
                options = (bare.access, m, similarity, graph.mask is not None)
                dim = (rows, layout.H, width)
                self._launch(dim, patch_distance.make_grid, options, [bare.argument, *inputs], weights)
        else:
            inputs.append(self.upload(places, wp.vec2i))
            inputs.append(None if form.spatial is None else self._upload_reals(form.spatial))
            options = (bare.access, m, similarity, form.spatial is not None)
            self._launch(layout.shape, patch_distance.make_csr, options, [bare.argument, *inputs], weights)
        return self._bind(graph, weights)

    def degree(self, weighted: Weighted) -> Array:
        out = self.empty(weighted.graph, 1)
        self._run(degree.make, weighted, (), [], out)
        return out

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        out = self.empty_edges(weighted.graph, _channels(f)) if out is None else out
        self._run(difference.make, weighted, (_channels(f),), [f], out)
        return out

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        out = self.empty(weighted.graph, _channels(H)) if out is None else out
        bound = weighted.topology
        argument = bound.layout.argument(weighted.weights, True)
        self._launch(bound.layout.shape, adjoint.make, (bound.access, _channels(H)), [argument, H], out)
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
        self._run(gradient_norm.make, weighted, options, [f, self._squared(eps), power, edge_power or 0.0], out)
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
        self._run(jacobi_step.make, weighted, (M, *options, isinstance(lam, wp.array)), inputs, out)
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
        return float(self._partial(energy.make, bound.layout.shape, options, inputs, wp.float64).sum())

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        options = (self.real, _channels(a))
        shape = weighted.topology.layout.shape
        return float(self._partial(max_change.make, shape, options, [a, b], self.real).max())

    def finish(self) -> None:
        wp.synchronize_device(self._on)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    return WarpBackend(device, dtype)
