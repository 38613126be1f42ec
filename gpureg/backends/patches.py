"""Patches around the vertices of a grid: the form of weights that compare them, and the positions of their cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.grid import AnyGraph, GridGraph, row_major


@dataclass(frozen=True, eq=False)
class PatchForm:
    """The parameters of weights that compare patches (section 5.2); rho is the distance of two patches.

        s(u, v) exp(-max(rho(u, v) - shift, 0) scale)
        s(u, v) exp(-max(rho(u, v) - shift - a(u) - a(v), 0) scale q(u) q(v))          with maps

    Attributes
    ----------
    profile : (2 r + 1,) float array
        The patch's weights along one axis; their outer product is g. All ones: the flat patch.
    shift : float
        Subtracted from the distance.
    scale : float or None
        1/h^2; None gives the distance itself.
    spatial : float array or None
        s per forward offset of a grid, (K/2,), or per directed edge, (n_edges,).
    maps : (n, 2) float array or None
        a >= 0 and q > 0 per vertex.
    cut : float
        Exponentials below it count as 0.
    average : int
        Only for :meth:`Backend.similarity_step` of a backend with ``averages``: a weight is the sum of those of all
        pairs (u - j, v - j) on the grid, with j in a square patch of this radius.
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
    """Pad `f`, (n, m), by `radius`; return it as (m, *padded shape), and the index of each vertex in a channel, (n,).

    Outside the grid it is reflected, without repeating the edge cell.
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
    """Pad `f`, (n, m), by reflection without repeating the edge cell; return (m, *padded shape)."""
    cells = np.moveaxis(f.reshape(*grid.shape, f.shape[1]), -1, 0)
    padded: FloatArray = np.pad(cells, [(0, 0)] + [(radius, radius)] * grid.ndim, mode="reflect")
    return padded


def padded_shape(graph: AnyGraph, radius: int) -> tuple[int, ...]:
    """Return the shape of a channel from :func:`padded_for_patches`."""
    grid = graph if isinstance(graph, GridGraph) else graph.grid
    return (graph.n_vertices,) if grid is None else tuple(s + 2 * radius for s in grid.shape)


def patch_jumps(patch: tuple[int, ...], strides: IntArray) -> npt.NDArray[np.int64]:
    """Return the index steps from a patch's centre to its cells, (cells,); `strides` is (ndim,)."""
    places = np.indices(patch).reshape(len(patch), math.prod(patch))
    jumps: npt.NDArray[np.int64] = strides @ (places - np.array(patch, np.int64)[:, None] // 2)
    return jumps


def over_patches(x: FloatArray, radius: int) -> FloatArray:
    """Sum an array over the square patch around each cell; cells outside count as 0."""
    for axis, size in enumerate(x.shape):
        around = np.pad(x, [(radius, radius) if a == axis else (0, 0) for a in range(x.ndim)])
        total = np.zeros_like(x)
        for j in range(2 * radius + 1):
            total += around.take(range(j, j + size), axis)
        x = total
    return x


def patch_lines(grid: GridGraph, radius: int) -> npt.NDArray[np.int32]:
    """Return the rows of a square patch, (n_lines, ndim): steps along the leading axes, then the step in rows."""
    ndim, side = grid.ndim - 1, 2 * radius + 1
    steps = np.array(list(np.ndindex((side,) * ndim)), np.int64).reshape(side**ndim, ndim) - radius
    lines: npt.NDArray[np.int32] = np.column_stack([steps, steps @ row_major(grid.shape[:-1])]).astype(np.int32)
    return lines
