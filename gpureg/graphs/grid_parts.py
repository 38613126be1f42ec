"""Parts of a grid graph: a box of its cells, and where their rows lie in the whole."""

from __future__ import annotations

from ..arrays import FloatArray
from .grid import GridGraph


def part_of(grid: GridGraph, box: tuple[slice, ...]) -> GridGraph:
    """The part of a grid in a box."""
    shape = tuple(s.stop - s.start for s in box)
    mask = None if grid.mask is None else grid.mask[box]
    return GridGraph(shape, grid.radius, grid.metric, spacing=grid.spacing, mask=mask)


def rows_of(grid: GridGraph, f: FloatArray, box: tuple[slice, ...]) -> FloatArray:
    """The rows of a function (n, m) that belong to a box of the grid; a view where it can be."""
    return f.reshape(*grid.shape, f.shape[1])[box].reshape(-1, f.shape[1])
