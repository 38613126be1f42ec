"""Patches around the vertices of a grid: the form of weights that compare them, and where their cells are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.grid import AnyGraph, GridGraph, row_major


@dataclass(frozen=True, eq=False)
class PatchForm:
    """Weights of the form s(u, v) exp(-max(rho(u, v) - shift, 0) scale), rho the distance of two patches (section 5.2).

    With maps every vertex has a shift a and a strength q of its own: s exp(-max(rho - shift - a(u) - a(v), 0) scale
    q(u) q(v)), symmetric in u and v.

    Attributes
    ----------
    profile : (2 r + 1,) float array
        The patch's weights along one axis; their outer product is g. Ones give the flat patch.
    shift : float
        Taken off the distance.
    scale : float or None
        1/h^2; None leaves the distance itself.
    spatial : float array or None
        s: one per forward offset of a grid, (K/2,), or one per directed edge, (n_edges,).
    maps : (n, 2) float array or None
        a >= 0 and q > 0 of each vertex.
    cut : float
        Exponentials below it count as 0.
    average : int
        In :meth:`Backend.similarity_step` alone, where the backend ``averages``: weights are sums of those of all pairs
        (u - j, v - j) on the grid, j in a square patch of this radius.
    """

    profile: FloatArray
    shift: float = 0.0
    scale: float | None = None
    spatial: FloatArray | None = None
    maps: FloatArray | None = None
    cut: float = 0.0
    average: int = 0

    @property
    def radius(self) -> int:
        """The patch's radius r, in cells."""
        return len(self.profile) // 2

    def window(self, ndim: int) -> FloatArray:
        """The patch's weights g, (2 r + 1,) * ndim."""
        g = np.ones(())
        for _ in range(ndim):
            g = np.multiply.outer(g, self.profile)
        return g


def padded_for_patches(graph: AnyGraph, f: FloatArray, radius: int) -> tuple[FloatArray, IntArray]:
    """`f`, (n, m), padded by a patch's radius as (m, *padded shape), and where each vertex sits in a padded channel.

    Patches that reach over the border of the grid are filled by reflection without the edge cell.
    """
    grid = graph if isinstance(graph, GridGraph) else graph.grid
    if grid is None:
        if radius:
            raise ValueError("patches of radius > 0 need vertices on a grid; this graph has none")
        return np.ascontiguousarray(f.T), np.arange(len(f))
    padded = reflected(grid, f, radius)
    inner = tuple(slice(radius, radius + s) for s in grid.shape)
    sites = np.arange(padded[0].size).reshape(padded[0].shape)[inner].ravel()
    return padded, sites


def reflected(grid: GridGraph, f: FloatArray, radius: int) -> FloatArray:
    """`f`, (n, m), padded by reflection without the edge cell, as (m, *padded shape)."""
    cells = np.moveaxis(f.reshape(*grid.shape, f.shape[1]), -1, 0)
    padded: FloatArray = np.pad(cells, [(0, 0)] + [(radius, radius)] * grid.ndim, mode="reflect")
    return padded


def padded_shape(graph: AnyGraph, radius: int) -> tuple[int, ...]:
    """The shape that :func:`padded_for_patches` gives a channel."""
    grid = graph if isinstance(graph, GridGraph) else graph.grid
    return (graph.n_vertices,) if grid is None else tuple(s + 2 * radius for s in grid.shape)


def patch_jumps(patch: tuple[int, ...], strides: IntArray) -> npt.NDArray[np.int64]:
    """Steps in numbers from a patch's centre to its cells, (cells,), from those along each axis, (ndim,)."""
    places = np.indices(patch).reshape(len(patch), math.prod(patch))
    jumps: npt.NDArray[np.int64] = strides @ (places - np.array(patch, np.int64)[:, None] // 2)
    return jumps


def over_patches(x: FloatArray, radius: int) -> FloatArray:
    """Sums of an array over the square patches around its cells, as far as these lie inside."""
    for axis, size in enumerate(x.shape):
        around = np.pad(x, [(radius, radius) if a == axis else (0, 0) for a in range(x.ndim)])
        total = np.zeros_like(x)
        for j in range(2 * radius + 1):
            total += around.take(range(j, j + size), axis)
        x = total
    return x


def patch_lines(grid: GridGraph, radius: int) -> npt.NDArray[np.int32]:
    """The rows of a square patch as steps along the grid's leading axes, and in rows, (n_lines, ndim)."""
    ndim, side = grid.ndim - 1, 2 * radius + 1
    steps = np.array(list(np.ndindex((side,) * ndim)), np.int64).reshape(side**ndim, ndim) - radius
    lines: npt.NDArray[np.int32] = np.column_stack([steps, steps @ row_major(grid.shape[:-1])]).astype(np.int32)
    return lines
