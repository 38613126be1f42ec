"""The implicit neighbourhood graph of a regular grid (:class:`GridGraph`)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import BLOCK_ENTRIES, FloatArray, IntArray, frozen
from ..checks import choice, number
from .csr import Graph
from .edges import METRICS, Metric, check_weights, checked_spacing


@dataclass(frozen=True, eq=False)
class GridGraph:
    """The implicit k-neighbourhood graph of a regular grid; nothing is stored per edge.

    Vertices are the cells of an array of the given shape, in row-major order. Two of them are joined when their
    distance is at most `radius` (the neighbourhood N_k of section 5.2). Vertices exist only inside the grid: at the
    border a window is clipped.

    Parameters
    ----------
    shape : int or sequence of int
        Size of each axis, any number of axes.
    radius : float, default 1
        Reach of the neighbourhood, in the units of `spacing`. Infinity gives the complete graph, for small grids.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        "chebyshev" gives square windows, "euclidean" disks, "cityblock" diamonds; ``radius=1`` with "cityblock" is
        the paper's 4-adjacency graph G_0, with "chebyshev" its 8-adjacency graph G_1.
    spacing : sequence of float, optional
        Distance between cells along each axis; None means 1.
    mask : bool array of the grid's shape, optional
        True where a vertex takes part. The others stay vertices, without an edge.

    Raises
    ------
    TypeError, ValueError
        An empty shape, a radius that reaches no neighbour, an unknown metric, spacing or mask that do not match.

    Examples
    --------
    >>> grid = GridGraph((4, 5), radius=1, metric="cityblock")
    >>> grid.offsets.tolist()
    [[-1, 0], [0, -1], [0, 1], [1, 0]]
    >>> grid.n_vertices, grid.n_edges, grid.to_graph().n_edges
    (20, 62, 62)
    """

    shape: tuple[int, ...]
    radius: float = 1
    metric: Metric = "chebyshev"
    spacing: tuple[float, ...] | None = None
    mask: npt.NDArray[np.bool_] | None = None

    def __init__(
        self,
        shape: int | Sequence[int],
        radius: float = 1,
        metric: Metric = "chebyshev",
        *,
        spacing: Sequence[float] | None = None,
        mask: npt.ArrayLike | None = None,
    ) -> None:
        sizes = tuple(np.atleast_1d(np.asarray(shape)).tolist())
        if not sizes or any(type(s) is not int or s < 1 for s in sizes):
            raise ValueError(f"shape must hold one or more integers >= 1, got {shape}")
        choice("metric", metric, METRICS)
        steps = checked_spacing(spacing, len(sizes))
        if number("radius", radius, above=0, finite=False) < min(steps or (1.0,)):
            raise ValueError(f"radius must reach the nearest neighbour, got {radius}")
        inside: npt.NDArray[np.bool_] | None = None
        if mask is not None:
            inside = np.array(mask)
            if inside.dtype != np.bool_ or inside.shape != sizes:
                raise ValueError(f"mask must be boolean of shape {sizes}, got {inside.dtype} of shape {inside.shape}")
            frozen(inside)
        for name, value in (("shape", sizes), ("radius", radius), ("metric", metric), ("spacing", steps)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "mask", inside)
        object.__setattr__(self, "_offsets", frozen(self._window()))

    def _window(self) -> IntArray:
        steps = np.array(self.spacing or (1.0,) * len(self.shape))
        # An axis of s cells has no neighbour further than s - 1.
        reach = [int(min(self.radius / d + 1e-9, s - 1)) for d, s in zip(steps, self.shape, strict=True)]
        axes = [np.arange(-r, r + 1) for r in reach]
        offsets = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        distance = np.abs(offsets) * steps
        if self.metric == "chebyshev":
            length = distance.max(axis=1)
        elif self.metric == "euclidean":
            length = np.sqrt((distance**2).sum(axis=1))
        else:
            length = distance.sum(axis=1)
        kept = (length <= self.radius * (1 + 1e-9)) & (np.abs(offsets).sum(axis=1) > 0)
        window: IntArray = offsets[kept].astype(np.int64)
        return window

    def __repr__(self) -> str:
        masked = "" if self.mask is None else f", {int(self.mask.sum())} cells in the mask"
        return f"GridGraph(shape={self.shape}, radius={self.radius:g}, metric={self.metric!r}{masked})"

    @property
    def offsets(self) -> IntArray:
        """Steps from a vertex to its neighbours, (K, ndim), in lexicographic order.

        The opposite of offset k is offset K - 1 - k; the last K/2 lead forward in row-major order.
        """
        offsets: IntArray = self._offsets  # type: ignore[attr-defined]
        return offsets

    @property
    def half_window(self) -> int:
        """Number of forward offsets, K/2: weights are stored for these alone."""
        return len(self.offsets) // 2

    @property
    def forward_offsets(self) -> IntArray:
        """The forward half of the offsets, (K/2, ndim)."""
        return self.offsets[self.half_window :]

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def n_vertices(self) -> int:
        """Number of vertices, masked ones included."""
        return math.prod(self.shape)

    @property
    def n_edges(self) -> int:
        """Number of directed edges, twice the number of undirected ones."""
        if self.mask is not None:
            return 2 * sum(int(self._inside_mask(step).sum()) for step in self.forward_offsets)
        return sum(math.prod(s - abs(int(o)) for s, o in zip(self.shape, step, strict=True)) for step in self.offsets)

    def ends(self, step: IntArray) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Slices of an array on the grid that select the start and the end of every edge along `step`."""
        pairs = [(int(o), s) for o, s in zip(step, self.shape, strict=True)]
        start = tuple(slice(max(0, -o), s - max(0, o)) for o, s in pairs)
        end = tuple(slice(max(0, o), s - max(0, -o)) for o, s in pairs)
        return start, end

    def _inside_mask(self, step: IntArray) -> npt.NDArray[np.bool_]:
        start, end = self.ends(step)
        assert self.mask is not None
        both: npt.NDArray[np.bool_] = self.mask[start] & self.mask[end]
        return both

    def unit_half_weights(self) -> FloatArray:
        """Weight 1 on every edge as stored once per pair, (K/2, *shape): 0 where an edge leaves grid or mask."""
        half = np.zeros((self.half_window, *self.shape), np.float32)
        for plane, step in zip(half, self.forward_offsets, strict=True):
            start, _ = self.ends(step)
            plane[start] = 1 if self.mask is None else self._inside_mask(step)
        return half

    def _edge_blocks(self) -> Iterator[tuple[IntArray, IntArray, npt.NDArray[np.bool_]]]:
        """Blocks of vertices u (B,), their neighbours v (B, K), and which of these exist (B, K)."""
        offsets, K = self.offsets, max(1, len(self.offsets))
        strides = np.array([math.prod(self.shape[d + 1 :]) for d in range(self.ndim)], np.int64)
        jumps = offsets @ strides
        block = max(1, BLOCK_ENTRIES // (K * self.ndim))
        inside = None if self.mask is None else self.mask.ravel()
        for begin in range(0, self.n_vertices, block):
            u = np.arange(begin, min(begin + block, self.n_vertices))
            there = np.stack(np.unravel_index(u, self.shape), axis=-1)[:, None, :] + offsets[None]
            exists: npt.NDArray[np.bool_] = np.asarray(((there >= 0) & (there < np.array(self.shape))).all(axis=-1))
            v = u[:, None] + jumps[None]
            if inside is not None:
                exists = exists & inside[u][:, None] & inside[np.where(exists, v, 0)]
            yield u, v, exists

    def to_graph(self, half_weights: FloatArray | None = None) -> Graph:
        """The same graph as CSR with row-major vertices, carrying positions (in units of spacing) and the grid.

        Parameters
        ----------
        half_weights : (K/2, *shape) float array, optional
            Weights stored once per pair, as the ``half_weights`` methods give them; None means 1.
        """
        counts, columns = [], []
        for _, v, exists in self._edge_blocks():
            counts.append(exists.sum(axis=1))
            columns.append(v[exists])
        indptr = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
        indices = np.concatenate(columns)
        weights = None if half_weights is None else self.half_to_edges(half_weights)
        steps = np.array(self.spacing or (1.0,) * self.ndim)
        positions = np.stack(np.unravel_index(np.arange(self.n_vertices), self.shape), axis=-1) * steps
        return Graph(indptr, indices, weights, positions, self)

    def half_to_edges(self, half: npt.ArrayLike) -> FloatArray:
        """Weights stored once per pair, (K/2, *shape), as one per directed edge in the order of :meth:`to_graph`."""
        H, n = self.half_window, self.n_vertices
        planes: FloatArray = np.asarray(half)
        if planes.shape != (H, *self.shape):
            raise ValueError(f"half weights must have shape {(H, *self.shape)}, got {planes.shape}")
        flat = planes.reshape(H, n)
        values = []
        for u, v, exists in self._edge_blocks():
            table = np.empty(v.shape, planes.dtype)
            for k in range(2 * H):
                plane = k - H if k >= H else H - 1 - k
                table[:, k] = flat[plane, u if k >= H else np.where(exists[:, k], v[:, k], 0)]
            values.append(table[exists])
        return np.concatenate(values)

    def flat_edges(self, values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
        """One value per directed edge, given as (n_edges,) or (*shape, K), in the order of :meth:`to_graph`.

        Raises
        ------
        ValueError
            Another shape.
        """
        K, array = len(self.offsets), np.asarray(values)
        if array.shape == (self.n_edges,):
            return array
        if array.shape != (*self.shape, K):
            raise ValueError(
                f"{name} must have shape ({self.n_edges},), one per directed edge in the order of to_graph(), "
                f"or {(*self.shape, K)}, one per offset; got {array.shape}"
            )
        exists = np.concatenate([exists.ravel() for _, _, exists in self._edge_blocks()])
        kept: npt.NDArray[Any] = array.reshape(-1)[exists]
        return kept

    def window_to_edges(self, planes: FloatArray) -> FloatArray:
        """A function on the edges as one plane per offset, (K, *shape, m), in the order of :meth:`to_graph`."""
        K, n = len(self.offsets), self.n_vertices
        flat = planes.reshape(K, n, planes.shape[-1])
        values = [flat[:, u].transpose(1, 0, 2)[exists] for u, _, exists in self._edge_blocks()]
        return np.concatenate(values)

    def edges_to_window(self, values: FloatArray) -> FloatArray:
        """A function on the edges, (n_edges, m), as one plane per offset with 0 where an edge leaves grid or mask."""
        K, n, m = len(self.offsets), self.n_vertices, values.shape[1]
        planes = np.zeros((K, n, m), values.dtype)
        begin = 0
        for u, _, exists in self._edge_blocks():
            table = np.zeros((*exists.shape, m), values.dtype)
            count = int(exists.sum())
            table[exists] = values[begin : begin + count]
            planes[:, u] = table.transpose(1, 0, 2)
            begin += count
        return planes.reshape(K, *self.shape, m)

    def edges_to_half(self, values: npt.ArrayLike) -> FloatArray:
        """One weight per directed edge, as (n_edges,) or (*shape, K), checked and stored once per pair.

        Raises
        ------
        ValueError
            Another shape, a negative or non-finite weight, or two directions that differ.
        """
        H, n = self.half_window, self.n_vertices
        array = self.flat_edges(values, "weights")
        array = check_weights(array, (self.n_edges,), "one per directed edge in the order of to_graph()")
        half = np.zeros((H, n), array.dtype)
        begin = 0
        for u, _, exists in self._edge_blocks():
            table = np.zeros(exists.shape, array.dtype)
            count = int(exists.sum())
            table[exists] = array[begin : begin + count]
            half[:, u] = table[:, H:].T
            begin += count
        if not np.array_equal(self.half_to_edges(half.reshape(H, *self.shape)), array):
            raise ValueError("weights must be the same in both directions of an edge; symmetrise them first")
        return half.reshape(H, *self.shape)


AnyGraph = Graph | GridGraph


def check_stored(name: str, graph: Any) -> None:
    """TypeError unless this is a :class:`Graph`, whose edges are stored."""
    if isinstance(graph, GridGraph):
        raise TypeError(f"{name} takes a Graph, got a GridGraph: give grid.to_graph()")
    if not isinstance(graph, Graph):
        raise TypeError(f"{name} takes a Graph, got {type(graph).__name__}")
