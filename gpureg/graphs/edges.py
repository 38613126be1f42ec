"""Checks of weights and spacing, and joining of directed and repeated edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import choice

Metric = Literal["chebyshev", "euclidean", "cityblock"]
METRICS: tuple[Metric, ...] = ("chebyshev", "euclidean", "cityblock")
Symmetrize = Literal["max", "mean", "mutual"]
SYMMETRIZE: tuple[Symmetrize, ...] = ("max", "mean", "mutual")
# The end of each error message about a directed graph or a repeated edge.
SYMMETRIZE_MENDS = (
    'symmetrize="max", "mean" or "mutual" of Graph.from_edges, Graph.from_scipy, from_networkx and read_graph '
    "joins these edges"
)


def check_weights(weights: npt.ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """Check shape, finiteness and sign of `weights`, and return a float copy."""
    array = np.array(weights, dtype=np.result_type(np.asarray(weights).dtype, np.float32))
    if array.dtype.kind != "f":
        raise TypeError(f"weights must be real numbers, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"weights must have shape {shape} ({what}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"weights must be finite, got {array[~np.isfinite(array)][0]}")
    if array.size and array.min() < 0:
        raise ValueError(f"weights must be >= 0, got {array.min()}")
    return array


def checked_spacing(spacing: Sequence[float] | None, ndim: int) -> tuple[float, ...] | None:
    """Check `spacing`, and return it as a tuple of `ndim` finite numbers > 0, or None."""
    if spacing is None:
        return None
    if np.ndim(spacing) != 1:
        raise ValueError(f"spacing must hold {ndim} numbers, one per axis, got {spacing!r}")
    if np.asarray(spacing).dtype.kind not in "iuf":
        raise TypeError(f"spacing must hold numbers, got {spacing!r}")
    steps = tuple(float(s) for s in spacing)
    if len(steps) != ndim or not all(math.isfinite(s) and s > 0 for s in steps):
        raise ValueError(f"spacing must hold {ndim} finite numbers > 0, got {spacing}")
    return steps


def check_symmetrize(symmetrize: str | None) -> None:
    """Check the value of `symmetrize`."""
    if symmetrize is not None:
        choice("symmetrize", symmetrize, SYMMETRIZE)


def refuse_loops(rows: IntArray, columns: IntArray) -> None:
    """Raise a ValueError if an edge joins a vertex with itself."""
    loops = rows == columns
    if loops.any():
        raise ValueError(
            f"self-loops are not allowed, vertex {rows[loops][0]} has one: leave it out "
            f"(of a scipy matrix: A.setdiag(0), then A.eliminate_zeros())"
        )


def symmetrized(pairs: IntArray, weights: FloatArray | None, how: Symmetrize) -> tuple[IntArray, FloatArray | None]:
    """Convert directed edges (E, 2), also repeated ones, and their weights (E,) or None to distinct undirected ones."""
    refuse_loops(pairs[:, 0], pairs[:, 1])
    low, high, forward = pairs.min(axis=1), pairs.max(axis=1), pairs[:, 0] < pairs[:, 1]
    # Sort edges between the same two vertices next to each other, forward ones last.
    order = np.lexsort((forward, high, low))
    low, high, forward = low[order], high[order], forward[order]
    new = np.ones(len(order), bool)
    new[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    starts = np.flatnonzero(new)
    once = np.stack([low[starts], high[starts]], axis=1)
    values = (np.ones(len(order)) if weights is None else weights)[order]
    if how == "max":
        joined = np.maximum.reduceat(values, starts)
    elif how == "mean":
        joined = np.add.reduceat(values, starts) / 2
    else:
        ends = np.append(starts[1:], len(order)) - 1
        mutual = ~forward[starts] & forward[ends]
        once, joined = once[mutual], np.minimum.reduceat(values, starts)[mutual]
    return once, None if weights is None and (joined == 1).all() else joined


def opposite_edges(indptr: IntArray, indices: IntArray) -> IntArray:
    """Return the index of edge (v, u) for each stored edge (u, v) of a symmetric graph with sorted rows, (n_edges,)."""
    from scipy import sparse

    n = len(indptr) - 1
    numbered = sparse.csr_array((np.arange(len(indices)), indices, indptr), shape=(n, n))
    opposite: IntArray = numbered.T.tocsr().data
    return opposite
