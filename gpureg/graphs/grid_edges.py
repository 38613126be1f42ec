"""Functions on the edges of a grid graph, as planes and as lists (:class:`EdgeLists`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import BLOCK_ENTRIES, FloatArray, IntArray
from .edges import check_weights

if TYPE_CHECKING:
    from .grid import GridGraph


@dataclass(frozen=True, eq=False)
class EdgeLists:
    """The directed edges of a grid graph as a list, and conversions between three forms of a function on them.

    - A list has one row per directed edge, (n_edges, ...), in the order of :meth:`GridGraph.to_graph`.
    - Planes have one value per vertex and offset, (K, *shape, m), 0 where the edge leaves the grid or its mask.
    - Half planes have one weight per vertex and forward offset, (K/2, *shape): once per pair.

    Gathering converts planes to a list, scattering a list to planes.

    Parameters
    ----------
    grid : GridGraph
        The grid, with K offsets.
    """

    grid: GridGraph

    def blocks(self) -> Iterator[tuple[IntArray, IntArray, npt.NDArray[np.bool_]]]:
        """Yield blocks of B vertices u (B,), their neighbours v (B, K), and whether these exist (B, K)."""
        grid = self.grid
        offsets, K = grid.offsets, max(1, len(grid.offsets))
        jumps = offsets @ grid.strides
        block = max(1, BLOCK_ENTRIES // (K * grid.ndim))
        inside = None if grid.mask is None else grid.mask.ravel()
        for begin in range(0, grid.n_vertices, block):
            u = np.arange(begin, min(begin + block, grid.n_vertices))
            there = np.stack(np.unravel_index(u, grid.shape), axis=-1)[:, None, :] + offsets[None]
            exists: npt.NDArray[np.bool_] = np.asarray(((there >= 0) & (there < np.array(grid.shape))).all(axis=-1))
            v = u[:, None] + jumps[None]
            if inside is not None:
                exists = exists & inside[u][:, None] & inside[np.where(exists, v, 0)]
            yield u, v, exists

    def rows(self) -> tuple[IntArray, IntArray]:
        """Return the edges as CSR: row pointers (n + 1,), and neighbours (n_edges,)."""
        counts, columns = [], []
        for _, v, exists in self.blocks():
            counts.append(exists.sum(axis=1))
            columns.append(v[exists])
        return np.concatenate([[0], np.cumsum(np.concatenate(counts))]), np.concatenate(columns)

    def gather(self, planes: FloatArray) -> FloatArray:
        """Convert planes, (K, *shape, m), to a list, (n_edges, m)."""
        K, n = len(self.grid.offsets), self.grid.n_vertices
        flat = planes.reshape(K, n, planes.shape[-1])
        return np.concatenate([flat[:, u].transpose(1, 0, 2)[exists] for u, _, exists in self.blocks()])

    def scatter(self, values: FloatArray) -> FloatArray:
        """Convert a list, (n_edges, m), to planes, (K, *shape, m)."""
        K, n, m = len(self.grid.offsets), self.grid.n_vertices, values.shape[1]
        planes = np.zeros((K, n, m), values.dtype)
        for u, table in self._tables(values):
            planes[:, u] = table.transpose(1, 0, 2)
        return planes.reshape(K, *self.grid.shape, m)

    def gather_half(self, half: npt.ArrayLike) -> FloatArray:
        """Convert weights stored once per pair, (K/2, *shape), to a list, (n_edges,).

        Raises
        ------
        ValueError
            Another shape.
        """
        H, n = self.grid.half_window, self.grid.n_vertices
        planes: FloatArray = np.asarray(half)
        if planes.shape != (H, *self.grid.shape):
            raise ValueError(f"half weights must have shape {(H, *self.grid.shape)}, got {planes.shape}")
        flat = planes.reshape(H, n)
        values = []
        for u, v, exists in self.blocks():
            table = np.empty(v.shape, planes.dtype)
            for k in range(2 * H):
                plane = k - H if k >= H else H - 1 - k
                table[:, k] = flat[plane, u if k >= H else np.where(exists[:, k], v[:, k], 0)]
            values.append(table[exists])
        return np.concatenate(values)

    def scatter_half(self, values: npt.ArrayLike) -> FloatArray:
        """Check weights, (n_edges,) or (*shape, K), and convert them to one per pair, (K/2, *shape).

        Raises
        ------
        ValueError
            Another shape, a negative or non-finite weight, or two directions that differ.
        """
        H, n = self.grid.half_window, self.grid.n_vertices
        array = self.listed(values, "weights")
        array = check_weights(array, (self.grid.n_edges,), "one per directed edge in the order of to_graph()")
        half = np.zeros((H, n), array.dtype)
        for u, table in self._tables(array):
            half[:, u] = table[:, H:].T
        stored = half.reshape(H, *self.grid.shape)
        if not np.array_equal(self.gather_half(stored), array):
            raise ValueError("weights must be the same in both directions of an edge; symmetrise them first")
        return stored

    def unit_half(self) -> FloatArray:
        """Return weights 1, stored once per pair, (K/2, *shape); 0 where an edge leaves the grid or its mask."""
        grid = self.grid
        half = np.zeros((grid.half_window, *grid.shape), np.float32)
        for plane, step in zip(half, grid.forward_offsets, strict=True):
            start, end = grid.ends(step)
            plane[start] = 1 if grid.mask is None else grid.mask[start] & grid.mask[end]
        return half

    def listed(self, values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
        """Convert one value per directed edge, (n_edges,) or (*shape, K), to a list, (n_edges,).

        Raises
        ------
        ValueError
            Another shape.
        """
        grid, array = self.grid, np.asarray(values)
        K = len(grid.offsets)
        if array.shape == (grid.n_edges,):
            return array
        if array.shape != (*grid.shape, K):
            raise ValueError(
                f"{name} must have shape ({grid.n_edges},), one per directed edge in the order of to_graph(), "
                f"or {(*grid.shape, K)}, one per offset; got {array.shape}"
            )
        exists = np.concatenate([exists.ravel() for _, _, exists in self.blocks()])
        listed: npt.NDArray[Any] = array.reshape(-1)[exists]
        return listed

    def _tables(self, values: npt.NDArray[Any]) -> Iterator[tuple[IntArray, npt.NDArray[Any]]]:
        """Yield blocks of B vertices (B,), and the values of a list on their edges, (B, K, ...), 0 without an edge."""
        begin = 0
        for u, _, exists in self.blocks():
            table = np.zeros((*exists.shape, *values.shape[1:]), values.dtype)
            count = int(exists.sum())
            table[exists] = values[begin : begin + count]
            yield u, table
            begin += count
