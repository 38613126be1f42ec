"""Functions on a part of a grid."""

from __future__ import annotations

from ..arrays import FloatArray
from .grid import GridGraph


def rows_of(grid: GridGraph, f: FloatArray, box: tuple[slice, ...]) -> FloatArray:
    """Return the rows of a function (n, m) that belong to a box of the grid; a view if possible."""
    return f.reshape(*grid.shape, f.shape[1])[box].reshape(-1, f.shape[1])
