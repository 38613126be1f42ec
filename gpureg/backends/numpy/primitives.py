"""The oracle: the primitives in numpy, float64 by default, in bounded memory.

``tests/paper.py`` holds it against the equations as literal loops.
"""

from __future__ import annotations

import os
import platform
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray
from ...graphs.edges import opposite_edges
from ...graphs.grid import AnyGraph, GridGraph
from ..patches import PatchForm, over_patches, padded_for_patches, patch_jumps
from ..protocol import Backend
from ..types import Array, Conductance, Device, EdgeNorm, Storage, Weighted, expect_storage, expect_stored
from .duality import NumpyOptimization
from .edges import Edges, conductance_of, raised
from .zones import NumpyZones

TIER = 4


def devices() -> list[Device]:
    """The one device numpy has."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        memory = 0
    name = platform.processor() or platform.machine()
    return [Device("numpy", "numpy", name, f"numpy {np.__version__}", "cpu", memory, 1, True, (TIER,))]


class NumpyBackend(NumpyOptimization, NumpyZones):
    """The primitives in numpy."""

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
        return self._into(out, raised(square, power))

    def p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, *, out: Array | None = None) -> Array:
        return self._into(out, 0 - self._flow(weighted, f, g))

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
        def terms(u: Any, v: Any, edges: Edges) -> tuple[FloatArray, FloatArray]:
            conductance = conductance_of(g, u, v, edges)
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
            smoothness = raised(square + float(eps) ** 2, p / 2).sum() / p
        lam = np.broadcast_to(np.asarray(lam, np.float64).reshape(-1, 1), (len(f), 1))
        fidelity = (np.where(np.isinf(lam), 0, lam) * (f - f0).astype(np.float64) ** 2).sum() / 2
        return float(smoothness + fidelity)

    def max_change(self, weighted: Weighted, a: Array, b: Array) -> float:
        change = float(np.abs(a - b).max(initial=0))
        return change if np.isfinite(change) else float("inf")


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """The backend on this device."""
    return NumpyBackend(device, dtype)
