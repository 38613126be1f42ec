"""Graphs in numpy: sums over the neighbours of a vertex, and the terms of an edge.

A grid is a loop over the forward offsets, with slices for the two ends of their edges; a stored graph is a loop over
blocks of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import FloatArray, IntArray
from ...graphs.edges import opposite_edges
from ...graphs.grid import AnyGraph, GridGraph
from ..advice import warn_if_slow
from ..protocol import Backend
from ..types import Array, Conductance, Smoothness, Weighted, host_weights

# Edges of a stored graph in one block.
_BLOCK = 1 << 18


def raised(x: FloatArray, power: float) -> FloatArray:
    """Compute x^power, without pow for the exponents of p = 1 and p = 2, as the kernels do."""
    if power == 1:
        return x
    if power == 0.5:
        return np.sqrt(x)
    if power == -0.5:
        return 1 / np.sqrt(x)
    return np.power(x, power)


@dataclass(frozen=True)
class Edges:
    """Some directed edges (u, v): their weight w, or gamma(u, v) as `own` and gamma(v, u) as `other`."""

    w: Any
    own: Any = None
    other: Any = None

    def difference(self, f_u: FloatArray, f_v: FloatArray) -> FloatArray:
        """Compute d_w(f)(u, v), without the factor sqrt(w): the `d` of the other methods."""
        d: FloatArray = f_v - f_u if self.own is None else self.other * f_v - self.own * f_u
        return d

    def squared(self, d: FloatArray) -> FloatArray:
        """Compute d_w(f)(u, v)^2."""
        square: FloatArray = self.w * d**2 if self.own is None else d**2
        return square

    def derived(self, d: FloatArray) -> FloatArray:
        """Compute d_w(f)(u, v)."""
        derivative: FloatArray = np.sqrt(self.w) * d if self.own is None else d
        return derivative

    def flow(self, d: FloatArray) -> FloatArray:
        """Compute gamma(u, v) d_w(f)(u, v)."""
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
        """Whether there is an edge."""
        return self.w > 0 if self.own is None else (self.own > 0) | (self.other > 0)


Terms = Callable[[Any, Any, Edges], tuple[FloatArray, ...]]


def conductance_of(g: Conductance, u: Any, v: Any, edges: Edges) -> Any:
    """Compute the conductance of edges; `u` and `v` are [f], or [f, g], at their ends."""
    if isinstance(g, Smoothness):
        square = edges.squared(edges.difference(u[0], v[0]))
        if g.coupled:
            square = square.sum(axis=-1, keepdims=True)
        return raised(square + square.dtype.type(g.eps) ** 2, g.power)
    return 2 * np.ones_like(u[0][..., :1]) if g is None else u[1] + v[1]


class NumpyGraph(Backend):
    """Graphs and functions in numpy arrays, and sums over the neighbours."""

    name = "numpy"

    def channels(self, x: Array) -> int:
        return int(x.shape[-1])

    def put(self, graph: AnyGraph, f: npt.NDArray[Any]) -> Array:
        warn_if_slow(graph.n_vertices)
        return np.array(f, self.dtype)

    def overwrite(self, graph: GridGraph, f: npt.NDArray[Any], *, out: Array) -> None:
        out[...] = f

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

    def sweep_bytes(self, graph: AnyGraph, channels: int, norms: int) -> int:
        # sums, terms and their factors, on the vertices or on a block of edges
        rows = graph.n_vertices if isinstance(graph, GridGraph) else graph.n_vertices + 2 * _BLOCK
        return (6 * channels + 8) * rows * self.dtype.itemsize

    def _along(self, weighted: Weighted, h: int) -> tuple[Edges, Edges]:
        """Return the edges of a grid along forward offset h, in both directions."""
        graph, weights = weighted.graph, weighted.weights
        assert isinstance(graph, GridGraph)
        start, end = graph.ends(graph.forward_offsets[h])
        if not weighted.directed:
            edges = Edges(self.real(1) if weights is None else weights[h][start][..., None])
            return edges, edges
        H = graph.half_window
        own, other = weights[H + h][start], weights[H - 1 - h][end]
        return Edges(None, own, other), Edges(None, other, own)

    def _of_rows(self, weighted: Weighted, edges: slice, opposite: IntArray | None) -> Edges:
        """Return the edges of a stored graph in this range."""
        weights = weighted.weights
        if weighted.directed:
            assert opposite is not None
            return Edges(None, weights[edges], weights[opposite[edges]])
        return Edges(self.real(1) if weights is None else weights[edges][:, None])

    def _gather(
        self, weighted: Weighted, channels: tuple[int, ...], terms: Terms, functions: tuple[FloatArray, ...]
    ) -> tuple[FloatArray, ...]:
        """Sum terms over the neighbours; return one array (n, c) per number c in `channels`.

        ``terms(at_u, at_v, edges)`` computes the terms at u per edge (u, v), from the functions at both ends, with the
        channels on the last axis.
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
        """Yield blocks of rows with about _BLOCK edges, and the range of these edges."""
        n, begin = len(indptr) - 1, 0
        while begin < n:
            end = int(np.searchsorted(indptr, indptr[begin] + _BLOCK, side="right")) - 1
            end = min(n, max(begin + 1, end))
            yield slice(begin, end), slice(int(indptr[begin]), int(indptr[end]))
            begin = end

    def _column(self, number: float | Array, n: int) -> FloatArray:
        """Broadcast a number or a function to one value per vertex, (n, 1)."""
        return np.broadcast_to(np.asarray(number, self.dtype).reshape(-1, 1), (n, 1))

    def _keeps(self, lam: float | Array, total: FloatArray) -> npt.NDArray[np.bool_]:
        """Return where a step keeps the data: lam is infinite, or it and the sums of the weights are about 0."""
        column = self._column(lam, len(total))
        return np.isinf(column) | ~(column + total > (1e-290 if self.dtype == np.float64 else 1e-30))

    def _moved(self, f0: Array, lam: float | Array, total: FloatArray, sums: FloatArray) -> FloatArray:
        """Return the whole step of eq. 25 from the sums of alpha and of beta f around each vertex."""
        keeps, lam = self._keeps(lam, total), self._column(lam, len(total))
        finite = np.where(np.isinf(lam), 0, lam)
        moved: FloatArray = np.where(keeps, f0, (finite * f0 + sums) / np.where(keeps, 1, finite + total))
        return moved

    def _squared_gradient(
        self, weighted: Weighted, f: FloatArray, coupled: bool, eps2: Any, edge_power: float | None = None
    ) -> FloatArray:
        """Compute |grad f|^2 + eps^2, or the sum of (d^2 + eps^2)^edge_power over the present edges."""

        def terms(u: Any, v: Any, edges: Edges) -> tuple[FloatArray]:
            square = edges.squared(edges.difference(u[0], v[0]))
            if coupled:
                square = square.sum(axis=-1, keepdims=True)
            if edge_power is None:
                return (square,)
            return (np.where(edges.present, raised(square + eps2, edge_power), 0),)

        total = self._gather(weighted, (1 if coupled else f.shape[1],), terms, (f,))[0]
        return total + eps2 if edge_power is None else total

    def _flow(self, weighted: Weighted, f: Array, g: Conductance) -> FloatArray:
        """Compute the negative p-Laplacian."""

        def terms(u: Any, v: Any, edges: Edges) -> tuple[FloatArray]:
            return (conductance_of(g, u, v, edges) * edges.flow(edges.difference(u[0], v[0])),)

        functions = (f,) if g is None or isinstance(g, Smoothness) else (f, g)
        return self._gather(weighted, (f.shape[1],), terms, functions)[0]
