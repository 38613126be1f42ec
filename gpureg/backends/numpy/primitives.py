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
from ...graphs.grid import GridGraph
from ..protocol import Backend
from ..types import Array, Conductance, Device, EdgeNorm, Weighted
from .duality import NumpyDuality
from .edges import Edges, conductance_of, raised
from .patches import NumpyPatches
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


class NumpyBackend(NumpyDuality, NumpyPatches, NumpyZones):
    """The primitives in numpy."""

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
