"""Find where curves in the plane cross themselves or each other: :func:`crossings_of`; and undo moves that cross."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..arrays import BLOCK_ENTRIES, FloatArray, IntArray

# A move is halved until nothing crosses; a smaller share of it than this is none.
_LEAST = 0.05
_ROUNDS = 200
# Pairs of segments that are compared, and 100 for each segment more.
_MOST_PAIRS = 5_000_000


def segments_of(sizes: Sequence[int], closed: Sequence[bool]) -> IntArray:
    """List the segments of curves, (s, 2), as vertices of one curve after another."""
    found = []
    start = 0
    for n, shut in zip(sizes, closed, strict=True):
        u = np.arange(n if shut and n > 2 else n - 1)
        found.append(np.stack([start + u, start + (u + 1) % n], axis=1))
        start += n
    return np.concatenate(found)


class Crossings(NamedTuple):
    """Pairs of segments that meet although they have no end in common.

    Attributes
    ----------
    before, after : int
        Their number in the input and in the result.
    new : int
        The increase within curves, plus those between curves that did not cross before.
    between : bool
        Whether crossings between curves are among them; not if very many curves lie together.
    """

    before: int
    after: int
    new: int
    between: bool = True


def crossings_of(before: Sequence[FloatArray], after: Sequence[FloatArray], closed: Sequence[bool]) -> Crossings | None:
    """Count the crossings of curves before and after; None if not in the plane, or if too many lie together."""
    if before[0].shape[1] != 2:
        return None
    for between in (True, False) if len(before) > 1 else (True,):
        first = _curves_that_meet(before, closed, between)
        last = None if first is None else _curves_that_meet(after, closed, between)
        if first is not None and last is not None:
            own = [int((pairs[:, 0] == pairs[:, 1]).sum()) for pairs in (first, last)]
            known = set(map(tuple, first.tolist()))
            other = sum(i != j and (i, j) not in known for i, j in last.tolist())
            return Crossings(len(first), len(last), max(0, own[1] - own[0]) + other, between)
    return None


def _curves_that_meet(curves: Sequence[FloatArray], closed: Sequence[bool], between: bool) -> IntArray | None:
    """Return the numbers of the curves of each pair of segments that meet, (k, 2), the smaller first."""
    segments = segments_of([len(x) for x in curves], closed)
    of = np.repeat(np.arange(len(curves)), [len(x) for x in curves])[segments[:, 0]]
    pairs = meeting(np.concatenate(curves), segments, None if between else of)
    if pairs is None:
        return None
    found: IntArray = np.sort(of[pairs], axis=1)
    return found


def crossed(counts: Crossings | None, cure: str = "valid=True") -> list[str]:
    """Say in a sentence, or none, that there are new crossings, and what prevents them."""
    if counts is None or not counts.new:
        return []
    places = "1 place" if counts.after == 1 else f"{counts.after} places"
    return [f"the result crosses itself at {places}, the input at {counts.before}: {cure} prevents that"]


def expect_plane(curves: Sequence[FloatArray]) -> None:
    """Raise ValueError if curves (n, d) are not in the plane, where crossings can be prevented."""
    if curves[0].shape[1] != 2:
        raise ValueError(f"valid=True is for curves in the plane, (n, 2), got {curves[0].shape[1]} coordinates")


def meeting(x: FloatArray, segments: IntArray, within: IntArray | None = None) -> IntArray | None:
    """Find pairs of segments that meet without a common end.

    Parameters
    ----------
    x : (n, 2) float array
    segments : (s, 2) int array
        The two vertices of each.
    within : (s,) int array, optional
        Only segments with the same number are compared.

    Returns
    -------
    (k, 2) int array or None
        Pairs of numbers of segments, sorted; None if so many lie together that comparing them would take minutes.

    Notes
    -----
    Segments are cut into pieces of at most half the mean length; pairs with pieces in the same square of that size are
    compared.
    """
    start, end = x[segments[:, 0]], x[segments[:, 1]]
    length = np.linalg.norm(end - start, axis=1)
    # a point of a curve is part of its neighbours
    proper = np.flatnonzero(length > 0)
    if len(proper) < 2:
        return np.empty((0, 2), np.int64)
    size = float(length[proper].mean()) / 2
    parts = np.ceil(1.01 * length[proper] / size).astype(np.int64)
    of = np.repeat(proper, parts)
    place = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    along = (end - start)[of] / np.repeat(parts, parts)[:, None]
    first = (start[of] - x.mean(axis=0)) + along * place[:, None]
    both = np.stack([first, first + along]) / size
    # a little more, so that segments that only touch are in the same square
    one = np.floor(both.min(axis=0) - 1e-6).astype(np.int64)
    two = np.floor(both.max(axis=0) + 1e-6).astype(np.int64)
    # a piece is in at most four squares
    squares = np.concatenate([np.stack([a[:, 0], b[:, 1]], axis=1) for a in (one, two) for b in (one, two)])
    squares -= squares.min(axis=0)
    which = np.tile(of, 4)
    key = squares[:, 0] * (int(squares[:, 1].max()) + 1) + squares[:, 1]
    if within is not None:
        # the squares of one group after those of another; numbered first if their product is no integer any more
        if int(key.max() + 1) * int(within.max() + 1) > np.iinfo(np.int64).max:
            key = np.unique(key, return_inverse=True)[1].reshape(-1)
        key = key + (key.max() + 1) * within[which]
    order = np.lexsort((which, key))
    key, which = key[order], which[order]
    new = np.concatenate([[True], (np.diff(key) != 0) | (np.diff(which) != 0)])
    key, which = key[new], which[new]
    together = np.diff(np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1], [True]])))
    if (together * (together - 1) // 2).sum() > _MOST_PAIRS + 100 * len(segments):
        return None
    low, high = np.minimum(start, end), np.maximum(start, end)
    found = [np.empty((0, 2), np.int64)]
    at = np.arange(len(key) - 1)
    step = 1
    while True:
        at = at[at + step < len(key)]
        at = at[key[at] == key[at + step]]
        if not len(at):
            break
        i, j = which[at], which[at + step]
        near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
        i, j = i[near], j[near]
        met = _meet(start[i], end[i], start[j], end[j])
        found.append(np.stack([i[met], j[met]], axis=1))
        step += 1
    return np.unique(np.concatenate(found), axis=0)


def _meet(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether the segments ab and cd, (k, 2) each, meet and have no end in common; their boxes must overlap."""
    common = np.zeros(len(a), bool)
    for u in (a, b):
        for v in (c, d):
            common |= (u == v).all(axis=1)
    sides = [np.sign(_turn(a, b, c)) * np.sign(_turn(a, b, d)), np.sign(_turn(c, d, a)) * np.sign(_turn(c, d, b))]
    met: npt.NDArray[np.bool_] = ~common & (sides[0] <= 0) & (sides[1] <= 0)
    return met


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Compute twice the area of triangles, > 0 if counterclockwise."""
    area: FloatArray = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    return area


def shared_vertices(x: FloatArray) -> IntArray:
    """Number the places of vertices (n, d): equal vertices have the same number, (n,)."""
    return np.unique(x, axis=0, return_inverse=True)[1].reshape(-1)


def _nested(x: FloatArray, place: IntArray, sizes: Sequence[int], closed: Sequence[bool]) -> set[tuple[int, int]]:
    """Return the pairs of a curve, by its first vertex, inside a closed one that has no place in common with it."""
    bounds = np.cumsum([0, *sizes])
    parts = [x[a:b] for a, b in itertools.pairwise(bounds)]
    places = [set(place[a:b].tolist()) for a, b in itertools.pairwise(bounds)]
    low, high = np.array([part.min(axis=0) for part in parts]), np.array([part.max(axis=0) for part in parts])
    first = x[bounds[:-1]]
    found = set()
    for j in np.flatnonzero(closed).tolist():
        near = np.flatnonzero(((low[j] <= first) & (first <= high[j])).all(axis=1))
        others = [i for i in near.tolist() if i != j and places[i].isdisjoint(places[j])]
        if others:
            inside = is_inside(first[others], parts[j])
            found |= {(i, j) for i, own in zip(others, inside, strict=True) if own}
    return found


def _expected(pairs: IntArray | None) -> IntArray:
    if pairs is None:
        raise ValueError(
            "valid=True needs curves that are apart: too many of these lie at the same place to compare them"
        )
    return pairs


def is_inside(points: FloatArray, polygon: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether points (k, 2) are inside a polygon (n, 2) by the even-odd rule, (k,)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    odd = np.zeros(len(points), bool)
    step = max(1, BLOCK_ENTRIES // len(polygon))
    for begin in range(0, len(points), step):
        x, y = points[begin : begin + step].T[:, :, None]
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = b[:, 1] - a[:, 1]
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / np.where(rise == 0, 1, rise)
        odd[begin : begin + step] = (spans & (x < at)).sum(axis=1) % 2 == 1
    return odd


def without_crossings(
    x: FloatArray, moves: FloatArray, sizes: Sequence[int], closed: Sequence[bool]
) -> tuple[FloatArray, int]:
    """Shorten moves of vertices until no segments meet that did not before, and curves lie in each other as before.

    Parameters
    ----------
    x : (n, 2) float array
        The vertices of one curve after another.
    moves : (n, 2) float array
        Their displacements; vertices at the same place get the mean of theirs, and none if one of them has none.
    sizes, closed : sequences
        Number of vertices of each curve, and whether it is closed.

    Returns
    -------
    moves : (n, 2) float array
    shortened : int
        Number of vertices whose move is shorter.
    """
    place = shared_vertices(x)
    count = np.bincount(place)
    mean = np.stack([np.bincount(place, weights=column) / count for column in moves.T], axis=1)
    mean[place[(moves == 0).all(axis=1)]] = 0
    segments = segments_of(sizes, closed)
    of = np.repeat(np.arange(len(sizes)), sizes)
    side = of[segments[:, 0]]
    # curves that cross each other may do so elsewhere
    pairs = _expected(meeting(x, segments))
    before = set(map(tuple, pairs.tolist()))
    crossing = set(map(tuple, side[pairs].tolist())) - {(k, k) for k in range(len(sizes))}
    nested = _nested(x, place, sizes, closed)
    share = np.ones(len(mean))
    for _ in range(_ROUNDS):
        moved = x + (share[:, None] * mean)[place]
        pairs = _expected(meeting(moved, segments))
        new = [
            pair
            for pair, curves in zip(pairs.tolist(), side[pairs].tolist(), strict=True)
            if tuple(pair) not in before and tuple(curves) not in crossing
        ]
        ends = np.unique(place[segments[np.unique(new)]]) if new else np.empty(0, np.int64)
        if not new:
            # a curve can have jumped over another as a whole
            other = {
                pair for pair in nested ^ _nested(moved, place, sizes, closed) if tuple(sorted(pair)) not in crossing
            }
            ends = np.unique(place[np.isin(of, list({k for pair in other for k in pair}))])
        if not len(ends):
            break
        share[ends] = np.where(share[ends] / 2 < _LEAST, 0, share[ends] / 2)
    else:
        share[:] = 0
    return (share[:, None] * mean)[place], int((share[place] < 1).sum())
