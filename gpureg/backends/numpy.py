"""The oracle: the primitives in numpy, float64 by default, in bounded memory.

Written once for both kinds of graph: a grid is a loop over the forward offsets with slices for the two ends of all its
edges, a stored graph a loop over blocks of rows. ``tests/paper.py`` holds it against the equations as literal loops.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graph import FloatArray, GridGraph, IntArray
from .base import AnyGraph, Array, Backend, Device, PatchForm, Weighted, host_weights, padded_for_patches, patch_jumps

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

    def _gather(
        self,
        weighted: Weighted,
        channels: tuple[int, ...],
        terms: Callable[[Any, Any, Any, int], tuple[FloatArray, ...]],
        functions: tuple[FloatArray, ...],
    ) -> tuple[FloatArray, ...]:
        """Sums over the neighbours: ``terms(at_u, at_v, w, sign)`` gives, per edge (u, v), what is added at u.

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
                w = 1 if weighted.weights is None else weighted.weights[h][start][..., None]
                at_start, at_end = [x[start] for x in on_grid], [x[end] for x in on_grid]
                for total, term in zip(sums_on_grid, terms(at_start, at_end, w, 1), strict=True):
                    total[start] += term
                for total, term in zip(sums_on_grid, terms(at_end, at_start, w, -1), strict=True):
                    total[end] += term
            return sums
        for rows, edges in self._row_blocks(graph.indptr):
            u = np.repeat(np.arange(rows.start, rows.stop), np.diff(graph.indptr[rows.start : rows.stop + 1]))
            v = graph.indices[edges]
            w = 1 if weighted.weights is None else weighted.weights[edges][:, None]
            busy = rows.start + np.flatnonzero(np.diff(graph.indptr[rows.start : rows.stop + 1]))
            for total, term in zip(
                sums, terms([x[u] for x in functions], [x[v] for x in functions], w, 1), strict=True
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

    def patch_distance(self, graph: AnyGraph, f: FloatArray, form: PatchForm) -> Weighted:
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
                inside, _ = graph.ends(step)
                weights[h][inside] = self._similarity(rho, form, spatial)
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
            weights[edges] = self._similarity(rho, form, 1.0 if form.spatial is None else form.spatial[edges])
        return Weighted(graph, None, weights)

    def _similarity(self, rho: FloatArray, form: PatchForm, spatial: Any) -> FloatArray:
        if form.scale is None:
            return rho
        similarity: FloatArray = spatial * np.exp(-np.maximum(rho - form.shift, 0) * form.scale)
        return similarity.astype(self.dtype, copy=False)

    def degree(self, weighted: Weighted) -> Array:
        one = np.ones((weighted.graph.n_vertices, 1), self.dtype)
        return self._gather(weighted, (1,), lambda u, v, w, sign: (w * v[0],), (one,))[0]

    def _squared_gradient(self, weighted: Weighted, f: FloatArray, coupled: bool) -> FloatArray:
        def terms(u: Any, v: Any, w: Any, sign: int) -> tuple[FloatArray]:
            square = w * (v[0] - u[0]) ** 2
            return (square.sum(axis=-1, keepdims=True) if coupled else square,)

        return self._gather(weighted, (1 if coupled else f.shape[1],), terms, (f,))[0]

    @staticmethod
    def _into(out: Array | None, value: FloatArray) -> Array:
        if out is None:
            return value
        out[...] = value
        return out

    def gradient_norm(
        self, weighted: Weighted, f: Array, *, power: float, eps: float, coupled: bool, out: Array | None = None
    ) -> Array:
        square = self._squared_gradient(weighted, f, coupled)
        return self._into(out, _raise(square + self.real(eps) ** 2, power))

    def p_laplacian(self, weighted: Weighted, f: Array, g: Array | None, *, out: Array | None = None) -> Array:
        def terms(u: Any, v: Any, w: Any, sign: int) -> tuple[FloatArray]:
            return (w * (2 if g is None else u[1] + v[1]) * (u[0] - v[0]),)

        functions = (f,) if g is None else (f, g)
        return self._into(out, self._gather(weighted, (f.shape[1],), terms, functions)[0])

    def jacobi_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Array | None,
        lam: float | Array,
        *,
        theta: float = 1.0,
        out: Array | None = None,
    ) -> Array:
        def terms(u: Any, v: Any, w: Any, sign: int) -> tuple[FloatArray, FloatArray]:
            a = w * (2 * np.ones_like(u[0][..., :1]) if g is None else u[1] + v[1])
            return a, a * v[0]

        functions = (f,) if g is None else (f, g)
        channels = (1 if g is None else g.shape[1], f.shape[1])
        total, sums = self._gather(weighted, channels, terms, functions)
        lam = np.broadcast_to(np.asarray(lam, self.dtype).reshape(-1, 1), (len(f), 1))
        pinned = np.isinf(lam)
        denominator = np.where(pinned, 0, lam) + total
        keeps_data = pinned | ~(denominator > (1e-290 if self.dtype == np.float64 else 1e-30))
        moved = (np.where(pinned, 0, lam) * f0 + sums) / np.where(keeps_data, 1, denominator)
        if theta != 1:
            moved = f + self.real(theta) * (moved - f)
        return self._into(out, np.where(keeps_data, f0, moved))

    def energy(
        self, weighted: Weighted, f: Array, f0: Array, lam: float | Array, *, p: float, eps: float, coupled: bool
    ) -> float:
        square = self._squared_gradient(weighted, f, coupled).astype(np.float64)
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
