"""Where the rows of a function on a grid lie that belong to a part of it."""

from __future__ import annotations

from ..arrays import FloatArray
from .grid import GridGraph


def rows_of(grid: GridGraph, f: FloatArray, box: tuple[slice, ...]) -> FloatArray:
    """The rows of a function (n, m) that belong to a box of the grid; a view where it can be."""
    return f.reshape(*grid.shape, f.shape[1])[box].reshape(-1, f.shape[1])
