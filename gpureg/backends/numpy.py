"""The oracle: the primitives in numpy, float64 by default, in bounded memory.

Written once for both kinds of graph: a grid is a loop over the forward offsets with slices for the two ends of all its
edges, a stored graph a loop over blocks of rows. ``tests/paper.py`` holds it against the equations as literal loops.
"""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graph import FloatArray, GridGraph, IntArray, opposite_edges
from .base import (
    AnyGraph,
    Array,
    Backend,
    Conductance,
    Device,
    EdgeNorm,
    PatchForm,
    Storage,
    Weighted,
    expect_storage,
    expect_stored,
    host_weights,
    over_patches,
    padded_for_patches,
    padded_shape,
    patch_jumps,
)

TIER = 4

# Stored edges treated at a time.
_BLOCK = 1 << 18


def devices() -> list[Device]:
    """The one device numpy has."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        memory = 0
    name = platform.processor() or platform.machine()
    return [Device("numpy", "numpy", name, f"numpy {np.__version__}", "cpu", memory, 1, True, (TIER,))]


def _raise(x: FloatArray, power: float) -> FloatArray:
    """x^power; the exponents of p = 1 and p = 2 avoid pow, as the kernels do."""
    if power == 1:
        return x
    if power == 0.5:
        return np.sqrt(x)
    if power == -0.5:
        return 1 / np.sqrt(x)
    return np.power(x, power)


@dataclass(frozen=True)
class _Edges:
    """Some edges (u, v), all the same way round: their weight w, or gamma(u, v) and gamma(v, u)."""

    w: Any
    own: Any = None
    other: Any = None

    def difference(self, f_u: FloatArray, f_v: FloatArray) -> FloatArray:
        """d_w(f)(u, v), up to the factor sqrt(w) that :meth:`squared` and :meth:`flow` bring in."""
        d: FloatArray = f_v - f_u if self.own is None else self.other * f_v - self.own * f_u
        return d

    def squared(self, d: FloatArray) -> FloatArray:
        """d_w(f)(u, v)^2."""
        square: FloatArray = self.w * d**2 if self.own is None else d**2
        return square

    def derived(self, d: FloatArray) -> FloatArray:
        """d_w(f)(u, v)."""
        derivative: FloatArray = np.sqrt(self.w) * d if self.own is None else d
        return derivative

    def flow(self, d: FloatArray) -> FloatArray:
        """gamma(u, v) d_w(f)(u, v)."""
        flow: FloatArray = (self.w if self.own is None else self.own) * d
        return flow

    @property
    def gamma(self) -> Any:
        """gamma(u, v)."""
        return np.sqrt(self.w) if self.own is None else self.own

    @property
    def hold(self) -> Any:
        """gamma(u, v)^2."""
        return self.w if self.own is None else self.own**2

    @property
    def pull(self) -> Any:
        """gamma(u, v) gamma(v, u)."""
        return self.w if self.own is None else self.own * self.other

    @property
    def present(self) -> Any:
        """Whether there is an edge at all."""
        return self.w > 0 if self.own is None else (self.own > 0) | (self.other > 0)


Terms = Callable[[Any, Any, _Edges], tuple[FloatArray, ...]]


def _conductance(g: Conductance, u: Any, v: Any, edges: _Edges) -> Any:
    """The conductance of edges whose ends have the functions `u` and `v`: f, then g where there is one."""
    if isinstance(g, EdgeNorm):
        square = edges.squared(edges.difference(u[0], v[0]))
        if g.coupled:
            square = square.sum(axis=-1, keepdims=True)
        return _raise(square + square.dtype.type(g.eps) ** 2, g.power)
    return 2 * np.ones_like(u[0][..., :1]) if g is None else u[1] + v[1]


class NumpyBackend(Backend):
    """The primitives in numpy."""

    name = "numpy"

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        return np.array(f, self.dtype)

    def get(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(x)

    def empty(self, graph: AnyGraph, channels: int) -> Array:
        return np.zeros((graph.n_vertices, channels), self.dtype)

    def prepare(self, graph: AnyGraph, weights: FloatArray | None) -> Weighted:
        weights = host_weights(graph, weights)
        return Weighted(graph, None, None if weights is None else weights.astype(self.dtype))

    def get_weights(self, weighted: Weighted) -> FloatArray | None:
        return None if weighted.weights is None else np.array(weighted.weights)

    def prepare_gamma(self, graph: AnyGraph, gamma: FloatArray) -> Weighted:
        return Weighted(graph, None, gamma.astype(self.dtype), directed=True)

    def put_edges(self, graph: AnyGraph, values: FloatArray) -> Array:
        return np.array(values, self.dtype)

    def get_edges(self, graph: AnyGraph, x: Array) -> FloatArray:
        return np.array(x)

    def empty_edges(self, graph: AnyGraph, channels: int) -> Array:
        shape = (len(graph.offsets), *graph.shape) if isinstance(graph, GridGraph) else (graph.n_edges,)
        return np.zeros((*shape, channels), self.dtype)

    def topology_bytes(self, graph: AnyGraph) -> int:
        return 0

    def function_bytes(self, graph: AnyGraph, channels: int) -> int:
        return graph.n_vertices * channels * self.dtype.itemsize

    def edge_bytes(self, graph: AnyGraph, *, directed: bool = False) -> int:
        if isinstance(graph, GridGraph):
            return graph.n_vertices * graph.half_window * (2 if directed else 1) * self.dtype.itemsize
        return graph.n_edges * self.dtype.itemsize

    def patch_bytes(self, graph: AnyGraph, channels: int, radius: int) -> tuple[int, ...]:
        # the padded function, a copy, a difference and its square; distances and sums of slabs on the way
        cells = math.prod(padded_shape(graph, radius)) * self.dtype.itemsize
        return (cells * channels,) * 4 + (cells,) * 4

    def sweep_bytes(self, graph: AnyGraph, channels: int) -> int:
        # sums, terms and what they are made of, over the vertices or over a block of edges
        rows = graph.n_vertices if isinstance(graph, GridGraph) else graph.n_vertices + 2 * _BLOCK
        return (6 * channels + 8) * rows * self.dtype.itemsize

    def _along(self, weighted: Weighted, h: int) -> tuple[_Edges, _Edges]:
        """The edges of a grid along forward offset h, from their start and back."""
        graph, weights = weighted.graph, weighted.weights
        assert isinstance(graph, GridGraph)
        start, end = graph.ends(graph.forward_offsets[h])
        if not weighted.directed:
            edges = _Edges(self.real(1) if weights is None else weights[h][start][..., None])
            return edges, edges
        H = graph.half_window
        own, other = weights[H + h][start], weights[H - 1 - h][end]
        return _Edges(None, own, other), _Edges(None, other, own)

    def _of_rows(self, weighted: Weighted, edges: slice, opposite: IntArray | None) -> _Edges:
        """The edges of a stored graph in this range."""
        weights = weighted.weights
        if weighted.directed:
            assert opposite is not None
            return _Edges(None, weights[edges], weights[opposite[edges]])
        return _Edges(self.real(1) if weights is None else weights[edges][:, None])

    def _gather(
        self, weighted: Weighted, channels: tuple[int, ...], terms: Terms, functions: tuple[FloatArray, ...]
    ) -> tuple[FloatArray, ...]:
        """Sums over the neighbours: ``terms(at_u, at_v, edges)`` gives, per edge (u, v), what is added at u.

        `at_u` and `at_v` are the functions at either end, with the channel last; one array per number in `channels`
        comes back, (n, channels).
        """
        graph = weighted.graph
        sums = tuple(np.zeros((graph.n_vertices, c), self.dtype) for c in channels)
        if isinstance(graph, GridGraph):
            on_grid = [x.reshape(*graph.shape, -1) for x in functions]
            sums_on_grid = [x.reshape(*graph.shape, -1) for x in sums]
            for h, step in enumerate(graph.forward_offsets):
                start, end = graph.ends(step)
                there, back = self._along(weighted, h)
                at_start, at_end = [x[start] for x in on_grid], [x[end] for x in on_grid]
                for total, term in zip(sums_on_grid, terms(at_start, at_end, there), strict=True):
                    total[start] += term
                for total, term in zip(sums_on_grid, terms(at_end, at_start, back), strict=True):
                    total[end] += term
            return sums
        opposite = opposite_edges(graph.indptr, graph.indices) if weighted.directed else None
        for rows, edges in self._row_blocks(graph.indptr):
            u = np.repeat(np.arange(rows.start, rows.stop), np.diff(graph.indptr[rows.start : rows.stop + 1]))
            v = graph.indices[edges]
            these = self._of_rows(weighted, edges, opposite)
            busy = rows.start + np.flatnonzero(np.diff(graph.indptr[rows.start : rows.stop + 1]))
            for total, term in zip(
                sums, terms([x[u] for x in functions], [x[v] for x in functions], these), strict=True
            ):
                if len(busy):
                    full = np.broadcast_to(term, (len(v), total.shape[1]))
                    total[busy] = np.add.reduceat(full, graph.indptr[busy] - edges.start, axis=0)
        return sums

    @staticmethod
    def _row_blocks(indptr: IntArray) -> Iterator[tuple[slice, slice]]:
        """Blocks of rows that hold about _BLOCK edges, with the range of these edges."""
        n, begin = len(indptr) - 1, 0
        while begin < n:
            end = int(np.searchsorted(indptr, indptr[begin] + _BLOCK, side="right")) - 1
            end = min(n, max(begin + 1, end))
            yield slice(begin, end), slice(int(indptr[begin]), int(indptr[end]))
            begin = end

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm, *, storage: Storage = "full") -> Weighted:
        expect_storage(graph, form, storage)
        weighted = self._patch_distance(graph, f, form)
        if storage == "half":
            # held as wide as all else: the oracle of what float16 leaves of them
            return Weighted(graph, None, weighted.weights.astype(np.float16).astype(self.dtype), storage=storage)
        return weighted

    def _patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm) -> Weighted:
        padded, sites = padded_for_patches(graph, f.astype(self.dtype), form.radius)
        profile = form.profile.astype(self.dtype)
        if isinstance(graph, GridGraph):
            weights = np.zeros((graph.half_window, *graph.shape), self.dtype)
            around = GridGraph(padded.shape[1:])
            for h, step in enumerate(graph.forward_offsets):
                start, end = around.ends(step)
                rho: FloatArray = ((padded[:, *end] - padded[:, *start]) ** 2).sum(axis=0)
                for axis in range(graph.ndim):
                    length = rho.shape[axis] - len(profile) + 1
                    slabs = (rho.take(range(j, j + length), axis) for j in range(len(profile)))
                    rho = sum((g * slab for g, slab in zip(profile, slabs, strict=True)), np.zeros((), self.dtype))
                spatial = 1.0 if form.spatial is None else float(form.spatial[h])
                inside, there = graph.ends(step)
                maps = [] if form.maps is None else [form.maps.reshape(*graph.shape, 2)[at] for at in (inside, there)]
                weights[h][inside] = self._similarity(rho, form, spatial, *maps)
            if graph.mask is not None:
                weights[graph.unit_half_weights() == 0] = 0
            return Weighted(graph, None, weights)
        ndim = 1 if graph.grid is None else graph.grid.ndim
        window = form.window(ndim).astype(self.dtype)
        jumps = patch_jumps(window.shape, padded.shape[1:])
        flat, g = padded.reshape(len(padded), -1), window.ravel()
        weights = np.empty(graph.n_edges, self.dtype)
        for rows, edges in self._row_blocks(graph.indptr):
            u = np.repeat(np.arange(rows.start, rows.stop), np.diff(graph.indptr[rows.start : rows.stop + 1]))
            a, b = sites[u], sites[graph.indices[edges]]
            rho = np.zeros(len(a), self.dtype)
            for jump, g_j in zip(jumps, g, strict=True):
                rho += g_j * ((flat[:, a + jump] - flat[:, b + jump]) ** 2).sum(axis=0)
            maps = [] if form.maps is None else [form.maps[u], form.maps[graph.indices[edges]]]
            factor = 1.0 if form.spatial is None else form.spatial[edges]
            weights[edges] = self._similarity(rho, form, factor, *maps)
        return Weighted(graph, None, weights)

    def _similarity(self, rho: FloatArray, form: PatchForm, spatial: Any, *maps: FloatArray) -> FloatArray:
        """What the weights make of distances; `maps` are those of either end."""
        if form.scale is None:
            return rho
        kept = rho - form.shift
        if maps:
            at_u, at_v = (x.astype(self.dtype) for x in maps)
            kept = np.maximum(kept - (at_u[..., 0] + at_v[..., 0]), 0) * (at_u[..., 1] * at_v[..., 1])
        near = np.exp(-np.maximum(kept, 0) * form.scale)
        similarity: FloatArray = spatial * np.where(near < form.cut, 0, near)
        return similarity.astype(self.dtype, copy=False)

    def degree(self, weighted: Weighted) -> Array:
        one = np.ones((weighted.graph.n_vertices, 1), self.dtype)
        return self._gather(weighted, (1,), lambda u, v, edges: (edges.hold * v[0],), (one,))[0]

    def largest_weight(self, weighted: Weighted) -> Array:
        graph, largest = weighted.graph, np.zeros((weighted.graph.n_vertices, 1), self.dtype)
        if isinstance(graph, GridGraph):
            on_grid = largest.reshape(*graph.shape, 1)
            for h, step in enumerate(graph.forward_offsets):
                for at, edges in zip(graph.ends(step), self._along(weighted, h), strict=True):
                    on_grid[at] = np.maximum(on_grid[at], edges.hold)
            return largest
        opposite = opposite_edges(graph.indptr, graph.indices) if weighted.directed else None
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        np.maximum.at(largest, graph.edge_rows(), np.broadcast_to(edges.hold, (graph.n_edges, 1)))
        return largest

    def aggregate(
        self, weighted: Weighted, f: Array, share: Array, centre: Array, radius: int, *, out: Array | None = None
    ) -> Array:
        grid = expect_stored(weighted)

        values, shares = f.reshape(*grid.shape, -1), share.reshape(grid.shape)
        total = over_patches(centre.reshape(grid.shape), radius)[..., None] * values
        for h, step in enumerate(grid.forward_offsets):
            start, end = grid.ends(step)
            w = self.real(1) if weighted.weights is None else weighted.weights[h][start]
            for here, there in ((start, end), (end, start)):
                given = np.zeros(grid.shape, self.dtype)
                given[here] = w * shares[here]
                total[here] += over_patches(given, radius)[here][..., None] * values[there]
        return self._into(out, total.reshape(f.shape))

    def difference(self, weighted: Weighted, f: Array, *, out: Array | None = None) -> Array:
        graph = weighted.graph
        result = self.empty_edges(graph, f.shape[1])
        if isinstance(graph, GridGraph):
            H, on_grid = graph.half_window, f.reshape(*graph.shape, -1)
            for h, step in enumerate(graph.forward_offsets):
                start, end = graph.ends(step)
                there, back = self._along(weighted, h)
                result[H + h][start] = there.derived(there.difference(on_grid[start], on_grid[end]))
                result[H - 1 - h][end] = back.derived(back.difference(on_grid[end], on_grid[start]))
            return self._into(out, result)
        opposite = opposite_edges(graph.indptr, graph.indices) if weighted.directed else None
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        result[...] = edges.derived(edges.difference(f[graph.edge_rows()], f[graph.indices]))
        return self._into(out, result)

    def adjoint(self, weighted: Weighted, H: Array, *, out: Array | None = None) -> Array:
        graph = weighted.graph
        total = np.zeros((graph.n_vertices, H.shape[-1]), self.dtype)
        if isinstance(graph, GridGraph):
            half, on_grid = graph.half_window, total.reshape(*graph.shape, -1)
            for h, step in enumerate(graph.forward_offsets):
                start, end = graph.ends(step)
                there, back = self._along(weighted, h)
                outward = H[half - 1 - h][end] - H[half + h][start]  # H(v, u) - H(u, v), u at the start
                on_grid[start] += there.gamma * outward
                on_grid[end] -= back.gamma * outward
            return self._into(out, total)
        opposite = opposite_edges(graph.indptr, graph.indices)
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        np.add.at(total, graph.edge_rows(), edges.gamma * (H[opposite] - H))
        return self._into(out, total)

    def _squared_gradient(
        self, weighted: Weighted, f: FloatArray, coupled: bool, eps2: Any, edge_power: float | None = None
    ) -> FloatArray:
        """|grad f|^2 + eps^2, or the sum of (d^2 + eps^2)^edge_power over the edges that are there."""

        def terms(u: Any, v: Any, edges: _Edges) -> tuple[FloatArray]:
            square = edges.squared(edges.difference(u[0], v[0]))
            if coupled:
                square = square.sum(axis=-1, keepdims=True)
            if edge_power is None:
                return (square,)
            return (np.where(edges.present, _raise(square + eps2, edge_power), 0),)

        total = self._gather(weighted, (1 if coupled else f.shape[1],), terms, (f,))[0]
        return total + eps2 if edge_power is None else total

    @staticmethod
    def _into(out: Array | None, value: FloatArray) -> Array:
        if out is None:
            return value
        out[...] = value
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
        square = self._squared_gradient(weighted, f, coupled, self.real(eps) ** 2, edge_power)
        return self._into(out, _raise(square, power))

    def _flow(self, weighted: Weighted, f: Array, g: Conductance) -> FloatArray:
        """The p-Laplacian with the opposite sign."""

        def terms(u: Any, v: Any, edges: _Edges) -> tuple[FloatArray]:
            return (_conductance(g, u, v, edges) * edges.flow(edges.difference(u[0], v[0])),)

        functions = (f,) if g is None or isinstance(g, EdgeNorm) else (f, g)
        return self._gather(weighted, (f.shape[1],), terms, functions)[0]

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        return self._into(out, 0 - self._flow(weighted, f, g))

    def _column(self, number: float | Array, n: int) -> FloatArray:
        """A number or a function as one value per vertex, (n, 1)."""
        return np.broadcast_to(np.asarray(number, self.dtype).reshape(-1, 1), (n, 1))

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
        def terms(u: Any, v: Any, edges: _Edges) -> tuple[FloatArray, FloatArray]:
            conductance = _conductance(g, u, v, edges)
            return edges.hold * conductance, edges.pull * conductance * v[0]

        functions = (f,) if g is None or isinstance(g, EdgeNorm) else (f, g)
        if isinstance(g, EdgeNorm):
            norms = 1 if g.coupled else f.shape[1]
        else:
            norms = 1 if g is None else g.shape[1]
        total, sums = self._gather(weighted, (norms, f.shape[1]), terms, functions)
        lam = self._column(lam, len(f))
        pinned = np.isinf(lam)
        denominator = np.where(pinned, 0, lam) + total
        keeps_data = pinned | ~(denominator > (1e-290 if self.dtype == np.float64 else 1e-30))
        moved = (np.where(pinned, 0, lam) * f0 + sums) / np.where(keeps_data, 1, denominator)
        if theta != 1:
            moved = f + self.real(theta) * (moved - f)
        return self._into(out, np.where(keeps_data, f0, moved))

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
        lam = self._column(lam, len(f))
        pinned = np.isinf(lam)
        push = np.where(pinned, 0, lam) * (f0 - f) + self._flow(weighted, f, g)
        return self._into(out, np.where(pinned, f0, f + self._column(tau, len(f)) * push))

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
        if edge_norm:
            sums = self._squared_gradient(weighted, f, coupled, self.real(eps) ** 2, p / 2)
            smoothness = sums.astype(np.float64).sum() / (2 * p)
        else:
            square = self._squared_gradient(weighted, f, coupled, 0).astype(np.float64)
            smoothness = _raise(square + float(eps) ** 2, p / 2).sum() / p
        lam = np.broadcast_to(np.asarray(lam, np.float64).reshape(-1, 1), (len(f), 1))
        fidelity = (np.where(np.isinf(lam), 0, lam) * (f - f0).astype(np.float64) ** 2).sum() / 2
        return float(smoothness + fidelity)

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        change = float(np.abs(a - b).max(initial=0))
        return change if np.isfinite(change) else float("inf")


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    return NumpyBackend(device, dtype)
