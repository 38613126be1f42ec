"""Remove the vertices of curves that stand least above the line between their neighbours: :func:`kept_by_height`."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray
from .crossings import shared_vertices

# Lower heights, in diagonals of a curve, are rounding.
_FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class Kept:
    """The vertices that are kept.

    Attributes
    ----------
    kept : list of (k,) int arrays
        The indices of the vertices of each curve.
    refused : int
        Number of vertices that are kept only because curves would cross without them.
    """

    kept: list[IntArray]
    refused: int


def kept_by_height(
    curves: Sequence[FloatArray],
    closed: Sequence[bool],
    *,
    tolerance: float,
    n_vertices: int | None = None,
    valid: bool = False,
) -> Kept:
    """Remove vertices in the order of their heights, each time the lowest of the curves as they are then.

    Parameters
    ----------
    curves : sequence of (n, d) arrays
    closed : sequence of bool
    tolerance : float
        The height up to which vertices are removed, relative to the diagonal of the curve's bounding box.
    n_vertices : int, optional
        Number of vertices to keep of each curve, instead of `tolerance`.
    valid : bool, default False
        Keep a vertex if another one lies in the triangle of it and its neighbours: then no curves cross that did not
        before. Vertices at the same place are removed together, or not at all.
    """
    if valid:
        # equal vertices in sequence are one
        proper = [_proper(x, shut) for x, shut in zip(curves, closed, strict=True)]
        parts = [x[own] for x, own in zip(curves, proper, strict=True)]
        found = _Heights(parts, closed, shared_vertices(np.concatenate(parts)), valid).run(tolerance, n_vertices)
        return Kept([own[kept] for own, kept in zip(proper, found.kept, strict=True)], found.refused)
    each = [
        _Heights([x], [shut], np.arange(len(x)), valid).run(tolerance, n_vertices).kept[0]
        for x, shut in zip(curves, closed, strict=True)
    ]
    return Kept(each, 0)


def _proper(x: FloatArray, closed: bool) -> IntArray:
    """Return the vertices that differ from the one before; all if too few do."""
    new = (x != np.roll(x, 1, axis=0)).any(axis=1)
    new[0] |= not closed
    if new.sum() < (3 if closed else 2):
        return np.arange(len(x))
    if not closed:
        # an open curve keeps its last vertex
        last = np.flatnonzero(new)[-1]
        new[last], new[-1] = new[last] and last == 0, True
    return np.flatnonzero(new)


class _Heights:
    """Curves from which vertices are removed; a place is what the vertices at the same point have in common.

    Parameters
    ----------
    curves, closed : sequences
    place : (n,) int array
        The place of each vertex, of one curve after another.
    valid : bool
    """

    def __init__(self, curves: Sequence[FloatArray], closed: Sequence[bool], place: IntArray, valid: bool) -> None:
        sizes = [len(x) for x in curves]
        x = np.concatenate(curves)
        starts = np.cumsum([0, *sizes])
        self.place: list[int] = place.tolist()
        n_places = max(self.place) + 1
        first = np.zeros(n_places, np.int64)
        first[place[::-1]] = np.arange(len(x))[::-1]
        self.points = x[first]
        self.at = [tuple(row) for row in self.points.tolist()]
        self.vertices: list[list[int]] = [[] for _ in range(n_places)]
        for i, p in enumerate(self.place):
            self.vertices[p].append(i)
        self.curve: list[int] = np.repeat(np.arange(len(sizes)), sizes).tolist()
        self.sizes, self.starts = sizes, starts
        self.left = list(sizes)
        self.least = [3 if shut else 2 for shut in closed]
        after, before = np.arange(len(x)) + 1, np.arange(len(x)) - 1
        for begin, end, shut in zip(starts[:-1], starts[1:], closed, strict=True):
            after[end - 1], before[begin] = (begin, end - 1) if shut else (-1, -1)
        self.after: list[int] = after.tolist()
        self.before: list[int] = before.tolist()
        diagonal = [float(np.linalg.norm(np.ptp(c, axis=0))) for c in curves]
        self.scale = [min(diagonal[self.curve[i]] for i in around) for around in self.vertices]
        self.alive = [True] * n_places
        self.valid = valid
        # vertices that wait until the place that blocks them is removed
        self.waiting: dict[int, list[int]] = {}

    def neighbours(self, p: int) -> tuple[int, int] | None:
        """Return the places on both sides; None if the place must stay: an end, or a junction of borders."""
        found: tuple[int, int] | None = None
        for i in self.vertices[p]:
            if self.before[i] < 0 or self.after[i] < 0:
                return None
            a, b = self.place[self.before[i]], self.place[self.after[i]]
            pair = (a, b) if a < b else (b, a)
            if found is not None and pair != found:
                return None
            found = pair
        if found is None or p in found or (found[0] == found[1] and self.valid):
            return None
        return found

    def height(self, p: int, pair: tuple[int, int]) -> float:
        """Return the distance of a place from the segment between its neighbours, relative to the diagonal."""
        v, a, b = self.at[p], self.at[pair[0]], self.at[pair[1]]
        scale = self.scale[p] or 1.0
        if len(v) == 2:
            # the common case, without lists
            x, y, dx, dy = v[0] - a[0], v[1] - a[1], b[0] - a[0], b[1] - a[1]
            square = dx * dx + dy * dy
            share = 0.0 if square == 0 else min(1.0, max(0.0, (x * dx + y * dy) / square))
            return math.sqrt((x - share * dx) ** 2 + (y - share * dy) ** 2) / scale
        base = [t - s for s, t in zip(a, b, strict=True)]
        up = [t - s for s, t in zip(a, v, strict=True)]
        square = sum(s * s for s in base)
        share = 0.0 if square == 0 else min(1.0, max(0.0, sum(s * t for s, t in zip(up, base, strict=True)) / square))
        return math.sqrt(sum((t - share * s) ** 2 for s, t in zip(base, up, strict=True))) / scale

    def run(self, tolerance: float, count: int | None) -> Kept:
        """Remove vertices up to the tolerance, or down to the number of each curve."""
        version = [0] * len(self.at)
        beside = [self.neighbours(p) for p in range(len(self.at))]
        heap = [(self.height(p, pair), p, 0) for p, pair in enumerate(beside) if pair is not None]
        heapq.heapify(heap)
        limit = max(tolerance, _FLAT) if count is None else math.inf
        blocked = _Blocked(self) if self.valid else None
        refused: set[int] = set()
        while heap:
            height, p, number = heapq.heappop(heap)
            if height > limit:
                break
            if number != version[p] or not self.alive[p]:
                continue
            pair = beside[p]
            mine = [self.curve[i] for i in self.vertices[p]]
            if pair is None or any(
                self.left[c] - mine.count(c) < (self.least[c] if count is None else max(count, self.least[c]))
                for c in mine
            ):
                continue
            if blocked is not None and height > _FLAT:
                by = blocked.by(p, pair)
                if by is not None:
                    self.waiting.setdefault(by, []).append(p)
                    refused.add(p)
                    continue
            self._remove(p, mine)
            around = [*pair, *(q for q in self.waiting.pop(p, ()) if self.alive[q])]
            for q in dict.fromkeys(around):
                version[q] += 1
                beside[q] = new = self.neighbours(q)
                if new is not None:
                    heapq.heappush(heap, (self.height(q, new), q, version[q]))
        kept = np.array(self.alive)[np.array(self.place)]
        parts = np.split(kept, self.starts[1:-1])
        stay = sum(self.alive[p] for p in refused)
        return Kept([np.flatnonzero(part) for part in parts], stay)

    def _remove(self, p: int, curves: list[int]) -> None:
        self.alive[p] = False
        for i, c in zip(self.vertices[p], curves, strict=True):
            before, after = self.before[i], self.after[i]
            self.after[before], self.before[after] = after, before
            self.left[c] -= 1


class _Blocked:
    """Search for vertices in triangles."""

    def __init__(self, heights: _Heights) -> None:
        self.heights = heights
        self._plant()

    def _plant(self) -> None:
        from scipy.spatial import cKDTree

        self.alive = np.flatnonzero(self.heights.alive)
        self.tree = cKDTree(self.heights.points[self.alive])
        self.since = 0

    def by(self, p: int, pair: tuple[int, int]) -> int | None:
        """Return a place in the closed triangle of p and its neighbours; None if there is none."""
        heights = self.heights
        self.since += 1
        if self.since > len(self.alive):
            # most of the tree has been removed
            self._plant()
        (vx, vy), (ax, ay), (bx, by) = heights.at[p], heights.at[pair[0]], heights.at[pair[1]]
        low_x, high_x, low_y, high_y = min(vx, ax, bx), max(vx, ax, bx), min(vy, ay, by), max(vy, ay, by)
        radius = math.hypot(high_x - low_x, high_y - low_y) / 2 * (1 + 1e-9)
        near = self.tree.query_ball_point(((low_x + high_x) / 2, (low_y + high_y) / 2), radius)
        for q in self.alive[near].tolist():
            if not heights.alive[q] or q == p or q in pair:
                continue
            x, y = heights.at[q]
            if not (low_x <= x <= high_x and low_y <= y <= high_y):
                continue
            one = (vx - ax) * (y - ay) - (vy - ay) * (x - ax)
            two = (bx - vx) * (y - vy) - (by - vy) * (x - vx)
            three = (ax - bx) * (y - by) - (ay - by) * (x - bx)
            if (one >= 0 and two >= 0 and three >= 0) or (one <= 0 and two <= 0 and three <= 0):
                return int(q)
        return None
