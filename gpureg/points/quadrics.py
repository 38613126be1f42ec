"""Fit quadrics to the neighbourhoods of points, many at a time."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..arrays import FloatArray

# Entries of the tables of a piece: they stay in the cache of a core.
_ENTRIES = 1 << 18


def in_pieces(work: Callable[[slice], FloatArray], n: int, entries: int) -> FloatArray:
    """Compute an array (n, ...) piece by piece, on all cores; `entries` is the size of the tables of a row."""
    step = max(64, _ENTRIES // max(entries, 1))
    parts = [slice(begin, min(begin + step, n)) for begin in range(0, n, step)]
    if len(parts) < 2:
        return work(slice(0, n))
    first = work(parts[0])
    found = np.empty((n, *first.shape[1:]), first.dtype)
    found[parts[0]] = first

    def put(part: slice) -> None:
        found[part] = work(part)

    with ThreadPoolExecutor(_cores()) as threads:
        # a list, so that errors come out
        list(threads.map(put, parts[1:]))
    return found


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def frames(local: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute the means (q, d) and principal axes (q, d, d), the normal first, of points (q, k, d) with weights."""
    total = w.sum(axis=1)[:, None]
    middle = (w[:, None] @ local)[:, 0] / total
    centred = local - middle[:, None]
    moments = (centred * w[..., None]).transpose(0, 2, 1) @ centred / total[..., None]
    return middle, np.linalg.eigh(moments).eigenvectors


def terms(places: FloatArray, heights: FloatArray) -> FloatArray:
    """Return 1, the places, their products, and the heights as rows (q, terms + 1, k).

    `places` is (q, k, d - 1), with at most two coordinates in the plane of a point, and `heights` (q, k).
    """
    flat = places.shape[2]
    A = np.empty((len(places), 2 + flat + flat * (flat + 1) // 2, places.shape[1]), heights.dtype)
    A[:, 0] = 1
    for i in range(flat):
        A[:, 1 + i] = places[..., i]
    row = 1 + flat
    for i in range(flat):
        for j in range(i, flat):
            np.multiply(places[..., i], places[..., j], out=A[:, row])
            row += 1
    A[:, -1] = heights
    return A


def solved(A: FloatArray, w: FloatArray, ridge: FloatArray) -> FloatArray:
    """Fit the heights, the last row of A (q, terms + 1, k), to the other rows with weights w, (q, terms).

    The ridge (terms,), times the sum of the weights, is added to the diagonal.
    """
    G = (A * w[:, None]) @ A.transpose(0, 2, 1)
    M = G[:, :-1, :-1] + w.sum(axis=1)[:, None, None] * np.diag(ridge)
    fit: FloatArray = np.linalg.solve(M, G[:, :-1, -1:])[..., 0]
    return fit
