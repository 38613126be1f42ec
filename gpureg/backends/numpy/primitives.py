"""The primitives in numpy, in bounded memory: the reference for the devices.

``tests/paper.py`` checks them against loops that follow the equations.
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
from ..types import Array, Conductance, Device, Smoothness, Weighted
from .curvature import NumpyCurvature
from .edges import Edges, conductance_of, raised
from .groups import NumpyGroups
from .multilevel import NumpyMultilevel
from .scalars import NumpyScalars
from .similarity import NumpySimilarity
from .zones import NumpyZones

TIER = 4


def devices() -> list[Device]:
    """Return the one device of numpy."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        memory = 0
    name = platform.processor() or platform.machine()
    return [Device("numpy", "numpy", name, f"numpy {np.__version__}", "cpu", memory, 1, True, (TIER,))]


class NumpyBackend(NumpyScalars, NumpyCurvature, NumpyMultilevel, NumpyGroups, NumpySimilarity, NumpyZones):
    """The primitives in numpy."""

    def _degree(self, weighted: Weighted, out: Array) -> None:
        one = np.ones((weighted.graph.n_vertices, 1), self.dtype)
        out[...] = self._gather(weighted, (1,), lambda u, v, edges: (edges.hold * v[0],), (one,))[0]

    def _largest_weight(self, weighted: Weighted, out: Array) -> None:
        graph = weighted.graph
        out[...] = 0
        if isinstance(graph, GridGraph):
            on_grid = out.reshape(*graph.shape, 1)
            for h, step in enumerate(graph.forward_offsets):
                for at, edges in zip(graph.ends(step), self._along(weighted, h), strict=True):
                    on_grid[at] = np.maximum(on_grid[at], edges.hold)
            return
        opposite = opposite_edges(graph.indptr, graph.indices) if weighted.directed else None
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        np.maximum.at(out, graph.edge_rows(), np.broadcast_to(edges.hold, (graph.n_edges, 1)))

    def _difference(self, weighted: Weighted, f: Array, out: Array) -> None:
        graph = weighted.graph
        if isinstance(graph, GridGraph):
            H, on_grid = graph.half_window, f.reshape(*graph.shape, -1)
            out[...] = 0
            for h, step in enumerate(graph.forward_offsets):
                start, end = graph.ends(step)
                there, back = self._along(weighted, h)
                out[H + h][start] = there.derived(there.difference(on_grid[start], on_grid[end]))
                out[H - 1 - h][end] = back.derived(back.difference(on_grid[end], on_grid[start]))
            return
        opposite = opposite_edges(graph.indptr, graph.indices) if weighted.directed else None
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        out[...] = edges.derived(edges.difference(f[graph.edge_rows()], f[graph.indices]))

    def _adjoint(self, weighted: Weighted, H: Array, out: Array) -> None:
        graph = weighted.graph
        out[...] = 0
        if isinstance(graph, GridGraph):
            half, on_grid = graph.half_window, out.reshape(*graph.shape, -1)
            for h, step in enumerate(graph.forward_offsets):
                start, end = graph.ends(step)
                there, back = self._along(weighted, h)
                outward = H[half - 1 - h][end] - H[half + h][start]  # H(v, u) - H(u, v), u at the start
                on_grid[start] += there.gamma * outward
                on_grid[end] -= back.gamma * outward
            return
        opposite = opposite_edges(graph.indptr, graph.indices)
        edges = self._of_rows(weighted, slice(0, graph.n_edges), opposite)
        np.add.at(out, graph.edge_rows(), edges.gamma * (H[opposite] - H))

    def _gradient_norm(
        self,
        weighted: Weighted,
        f: Array,
        power: float,
        eps: float,
        coupled: bool,
        edge_power: float | None,
        out: Array,
    ) -> None:
        square = self._squared_gradient(weighted, f, coupled, self.real(eps) ** 2, edge_power)
        out[...] = raised(square, power)

    def _p_laplacian(self, weighted: Weighted, f: Array, g: Conductance, out: Array) -> None:
        out[...] = 0 - self._flow(weighted, f, g)

    def _jacobi_step(
        self, weighted: Weighted, f: Array, f0: Array, g: Conductance, lam: float | Array, theta: float, out: Array
    ) -> None:
        def terms(u: Any, v: Any, edges: Edges) -> tuple[FloatArray, FloatArray]:
            conductance = conductance_of(g, u, v, edges)
            return edges.hold * conductance, edges.pull * conductance * v[0]

        functions = (f,) if g is None or isinstance(g, Smoothness) else (f, g)
        if isinstance(g, Smoothness):
            norms = g.norms(f.shape[1])
        else:
            norms = 1 if g is None else g.shape[1]
        total, sums = self._gather(weighted, (norms, f.shape[1]), terms, functions)
        moved = self._moved(f0, lam, total, sums)
        out[...] = moved if theta == 1 else np.where(self._keeps(lam, total), f0, f + self.real(theta) * (moved - f))

    def _euler_step(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array,
        g: Conductance,
        lam: float | Array,
        tau: float | Array,
        out: Array,
    ) -> None:
        lam = self._column(lam, len(f))
        pinned = np.isinf(lam)
        push = np.where(pinned, 0, lam) * (f0 - f) + self._flow(weighted, f, g)
        out[...] = np.where(pinned, f0, f + self._column(tau, len(f)) * push)


def make(device: Device, dtype: npt.DTypeLike) -> Backend:
    """Make the backend on this device."""
    return NumpyBackend(device, dtype)
