"""The implicit neighbourhood graph of a regular grid (:class:`GridGraph`)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, frozen
from ..checks import choice, number
from ..doors import door
from .csr import Graph
from .edges import METRICS, Metric, checked_spacing
from .grid_edges import EdgeLists


def row_major(shape: tuple[int, ...]) -> IntArray:
    """Return the differences of cell numbers along each axis of a row-major array of this shape, (ndim,)."""
    return np.array([math.prod(shape[d + 1 :]) for d in range(len(shape))], np.int64)


@functools.lru_cache(maxsize=16)
def _window(reach: tuple[int, ...], radius: float, metric: Metric, spacing: tuple[float, ...] | None) -> IntArray:
    """Return the offsets of a neighbourhood with at most `reach` cells along each axis, (K, ndim), read-only.

    They are cached, because the tiles of a job have many sizes and the same offsets.
    """
    offsets = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1)
    offsets = offsets.reshape(-1, len(reach))
    distance = np.abs(offsets) * np.array(spacing or (1.0,) * len(reach))
    if metric == "chebyshev":
        length = distance.max(axis=1)
    elif metric == "euclidean":
        length = np.sqrt((distance**2).sum(axis=1))
    else:
        length = distance.sum(axis=1)
    inside = (length <= radius * (1 + 1e-9)) & (np.abs(offsets).sum(axis=1) > 0)
    return frozen(offsets[inside].astype(np.int64))


@dataclass(frozen=True, eq=False)
class GridGraph:
    """The implicit k-neighbourhood graph of a regular grid; nothing is stored per edge.

    Vertices are the cells of an array of the given shape, in row-major order. Two vertices are joined if their distance
    is at most `radius` (the neighbourhood N_k of section 5.2). Windows are clipped at the border of the grid.

    Parameters
    ----------
    shape : int or sequence of int
        Size of each axis, any number of axes.
    radius : float, default 1
        Radius of the neighbourhood, in the units of `spacing`. Infinity gives the complete graph, for small grids.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        "chebyshev" gives square windows, "euclidean" disks, "cityblock" diamonds; ``radius=1`` with "cityblock" is
        the paper's 4-adjacency graph G_0, with "chebyshev" its 8-adjacency graph G_1.
    spacing : sequence of float, optional
        Distance between cells along each axis; None means 1.
    mask : bool array of the grid's shape, optional
        True where a vertex takes part. The other vertices have no edges.

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

    @door(name="GridGraph")
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
        # An axis of s cells has no neighbour further than s - 1.
        reach = tuple(int(min(radius / d + 1e-9, s - 1)) for d, s in zip(self.cell.tolist(), sizes, strict=True))
        object.__setattr__(self, "_offsets", _window(reach, radius, metric, steps))

    def __repr__(self) -> str:
        masked = "" if self.mask is None else f", {int(self.mask.sum())} cells in the mask"
        return f"GridGraph(shape={self.shape}, radius={self.radius:g}, metric={self.metric!r}{masked})"

    @property
    def offsets(self) -> IntArray:
        """Steps from a vertex to its neighbours, (K, ndim), in lexicographic order.

        The opposite of offset k is offset K - 1 - k; the last K/2 are forward in row-major order.
        """
        offsets: IntArray = self._offsets  # type: ignore[attr-defined]
        return offsets

    @property
    def half_window(self) -> int:
        """Number of forward offsets, K/2; weights are stored only for these."""
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
            both = (self.mask[start] & self.mask[end] for start, end in map(self.ends, self.forward_offsets))
            return 2 * sum(int(inside.sum()) for inside in both)
        return sum(math.prod(s - abs(int(o)) for s, o in zip(self.shape, step, strict=True)) for step in self.offsets)

    @property
    def strides(self) -> IntArray:
        """Differences of vertex numbers along each axis, (ndim,); vertices are numbered in row-major order."""
        return row_major(self.shape)

    @property
    def steps(self) -> IntArray:
        """Differences of vertex numbers along each forward offset, (K/2,)."""
        steps: IntArray = self.forward_offsets @ self.strides
        return steps

    @property
    def cell(self) -> FloatArray:
        """Distance between cells along each axis, (ndim,): the spacing, or 1."""
        return np.array(self.spacing or (1.0,) * self.ndim)

    def positions(self) -> FloatArray:
        """Return the coordinates of the vertices in the units of `spacing`, (n, ndim)."""
        positions: FloatArray = np.stack(np.unravel_index(np.arange(self.n_vertices), self.shape), axis=-1) * self.cell
        return positions

    @property
    def edges(self) -> EdgeLists:
        """The directed edges as a list, and conversions of functions on them."""
        return EdgeLists(self)

    def ends(self, step: IntArray) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Return slices of an array on the grid for the starts and the ends of all edges along `step`, (ndim,)."""
        pairs = [(int(o), s) for o, s in zip(step, self.shape, strict=True)]
        start = tuple(slice(max(0, -o), s - max(0, o)) for o, s in pairs)
        end = tuple(slice(max(0, o), s - max(0, -o)) for o, s in pairs)
        return start, end

    def to_graph(self, half_weights: FloatArray | None = None) -> Graph:
        """Convert to CSR with row-major vertices, with positions (in the units of `spacing`) and the grid.

        Parameters
        ----------
        half_weights : (K/2, *shape) float array, optional
            Weights stored once per pair, as returned by ``edges.scatter_half``; None means 1.
        """
        indptr, indices = self.edges.rows()
        weights = None if half_weights is None else self.edges.gather_half(half_weights)
        return Graph(indptr, indices, weights, self.positions(), self)

    def part(self, box: tuple[slice, ...]) -> GridGraph:
        """Return the grid graph of the cells in a box, with its part of the mask.

        Parameters
        ----------
        box : tuple of slice
            One per axis, with `start` and `stop` inside the grid, of step 1.
        """
        shape = tuple(s.stop - s.start for s in box)
        mask = None if self.mask is None else self.mask[box]
        return GridGraph(shape, self.radius, self.metric, spacing=self.spacing, mask=mask)


AnyGraph = Graph | GridGraph


def refuse_grid(name: str, graph: object) -> None:
    """Raise a TypeError for a GridGraph, which does not store its edges."""
    if isinstance(graph, GridGraph):
        raise TypeError(f"{name} must be a Graph, got a GridGraph: give grid.to_graph()")
