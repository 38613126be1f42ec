"""Checks of a graph in compressed sparse row form when it is made."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, integers
from .edges import SYMMETRIZE_MENDS, check_weights, refuse_loops


def checked_rows(
    indptr: npt.ArrayLike, indices: npt.ArrayLike, weights: npt.ArrayLike | None
) -> tuple[IntArray, IntArray, FloatArray | None]:
    """Check a symmetric graph, and sort its rows.

    Parameters
    ----------
    indptr : (n + 1,) int array
        Row pointers.
    indices : (n_edges,) int array
        Neighbours, in any order within a row.
    weights : (n_edges,) float array or None
        One weight per stored directed edge; None means 1.

    Returns
    -------
    indptr, indices : (n + 1,) and (n_edges,) int64 arrays
        The neighbours of each vertex in rising order.
    weights : (n_edges,) float array or None
        Weights in the same order.

    Raises
    ------
    TypeError, ValueError
        As :class:`gpureg.Graph`.
    """
    starts = integers("indptr", indptr, 1).astype(np.int64)
    ends = integers("indices", indices, 1).astype(np.int64)
    n, nnz = len(starts) - 1, len(ends)
    if n < 1:
        raise ValueError("a graph needs at least one vertex: indptr must have n + 1 >= 2 entries")
    if starts[0] != 0 or starts[-1] != nnz or (np.diff(starts) < 0).any():
        raise ValueError(f"indptr must rise from 0 to len(indices) = {nnz} without falling")
    if nnz and (ends.min() < 0 or ends.max() >= n):
        bad = ends[(ends < 0) | (ends >= n)][0]
        raise ValueError(f"indices must lie in 0..{n - 1}, got {bad}")
    values = None if weights is None else check_weights(weights, (nnz,), "one per stored directed edge")
    rows = np.repeat(np.arange(n), np.diff(starts))
    if ((ends[1:] <= ends[:-1]) & (rows[1:] == rows[:-1])).any():
        order = np.lexsort((ends, rows))
        ends = ends[order]
        values = None if values is None else values[order]
    refuse_loops(rows, ends)
    repeated = (rows[1:] == rows[:-1]) & (ends[1:] == ends[:-1])
    if repeated.any():
        u, v = rows[1:][repeated][0], ends[1:][repeated][0]
        raise ValueError(f"each edge may be stored once per direction, ({u}, {v}) is repeated: {SYMMETRIZE_MENDS}")
    _expect_symmetric(starts, rows, ends, values)
    return starts, ends, values


def _expect_symmetric(indptr: IntArray, rows: IntArray, indices: IntArray, weights: FloatArray | None) -> None:
    """Check that every edge is stored in both directions with the same weight."""
    from scipy import sparse

    n, nnz = len(indptr) - 1, len(indices)
    forward = sparse.csr_array((np.arange(1, nnz + 1), indices, indptr), shape=(n, n))
    backward = forward.T.tocsr()
    backward.sort_indices()
    if not (np.array_equal(backward.indptr, indptr) and np.array_equal(backward.indices, indices)):
        k = int(np.flatnonzero(~np.isin(rows * n + indices, indices * n + rows))[0])
        u, v = rows[k], indices[k]
        raise ValueError(
            f"the graph must be symmetric, every edge stored in both directions: ({u}, {v}) is stored but "
            f"({v}, {u}) is not: {SYMMETRIZE_MENDS}"
        )
    if weights is None:
        return
    mirrored = weights[backward.data - 1]
    if not np.array_equal(weights, mirrored):
        k = int(np.flatnonzero(weights != mirrored)[0])
        raise ValueError(
            f"weights must be the same in both directions, edge ({rows[k]}, {indices[k]}) has "
            f"{weights[k]} one way and {mirrored[k]} the other: {SYMMETRIZE_MENDS}"
        )


def checked_positions(positions: Any, n: int) -> FloatArray | None:
    """Check the coordinates of n vertices, and return them as a float64 array (n, d); None for None."""
    if positions is None:
        return None
    if np.asarray(positions).dtype.kind not in "biuf":
        raise TypeError(f"positions must hold real numbers, got {np.asarray(positions).dtype}")
    array = np.array(positions, dtype=np.float64)
    if array.ndim != 2 or len(array) != n or not np.isfinite(array).all():
        raise ValueError(f"positions must be finite and of shape ({n}, d), got shape {array.shape}")
    return array
