"""Find what must not decide for the rest of a curve: repeated vertices, outliers, gaps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from .noise import TELLING, is_rounded, noise_along, running_median, running_noise

# Vertices nearer to the one before than this, in mean segments, repeat it.
_SAME = 1e-6
# An outlier, or a run of up to _RUN: all its legs longer than _FAR medians, or the two outer ones as gaps; they
# are longer than _PAST times the way past it; each vertex more than _DEVIATIONS sigma off the middle of that way.
_FAR, _PAST, _DEVIATIONS, _RUN = 3.0, 1.5, 4.5, 3
# After the fit: a standardised residual above _DEVIATIONS, both legs longer than _LEG medians and than the way past.
_LEG = 2.0
_ROUNDS = 6
# A gap is longer than this many medians of the _NEAR segments before, and of those after.
_GAP, _NEAR = 8.0, 5


@dataclass(frozen=True, eq=False)
class Found:
    """What was found in a curve and kept from deciding for the rest.

    Attributes
    ----------
    outliers : (k,) int array
        Vertices of the input far off the curve: they had no say, and lie between their neighbours in the result.
    gaps : (g,) int array
        Vertices of the input after which the curve has a gap: it was not smoothed across.
    repeats : int
        Number of vertices that repeat the one before, to 1e-6 of the mean segment: they count once.
    opened : bool
        Whether the segment that closes the curve is such a gap: the curve was treated as open.
    few : bool
        Whether too few vertices are left to tell the noise: they stay as they are.
    """

    outliers: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    gaps: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    repeats: int = 0
    opened: bool = False
    few: bool = False


class Cleaned:
    """A curve without its repeats and outliers, cut at its gaps.

    Parameters
    ----------
    x : (n, d) float array
    closed : bool
    held : (n,) bool array
        Vertices that are no outliers, whatever they look like.
    sigma : float, optional
        The noise. None: estimated.
    robust : bool
        Whether to look for outliers and gaps, and to merge repeats.

    Attributes
    ----------
    of : (n,) int array
        The merged vertex of each vertex of the input.
    merged : (m, d) float array
        The vertices without repeats.
    alive : (k,) int array
        Those that are no outliers, in order.
    cuts : (c,) int array
        Indices of the vertices in `alive` after which there is a gap.
    sigma : (k,) float array
        The noise at each vertex in `alive`; 0 where there is none.
    """

    def __init__(
        self, x: FloatArray, closed: bool, held: npt.NDArray[np.bool_], sigma: float | None, robust: bool
    ) -> None:
        self.closed, self._given, self._robust = closed, sigma, robust
        merges = robust and not is_rounded(x, closed)
        self.of, first = _repeats(x, closed, merges)
        self.merged = x[first]
        self._held = np.zeros(len(first), bool)
        np.logical_or.at(self._held, self.of, held)
        self._look(np.arange(len(first)))

    @property
    def points(self) -> FloatArray:
        """The vertices in `alive`, (k, d)."""
        return self.merged[self.alive]

    @property
    def long(self) -> bool:
        """Whether there are enough vertices to tell noise from shape."""
        return len(self.alive) >= TELLING

    def _look(self, alive: IntArray) -> None:
        """Find outliers among these merged vertices, then gaps, then the noise."""
        for _ in range(_ROUNDS if self._robust else 0):
            out = self._outliers(alive)
            if not out.any():
                break
            alive = alive[~out]
        self.alive = alive
        self.cuts = _gaps(self.points, self.closed) if self._robust else np.empty(0, np.int64)
        order, sizes, rings = self.pieces()
        self.sigma = np.full(len(alive), 0.0 if self._given is None else self._given)
        if self._given is None:
            self._estimate(order, sizes, rings)

    def pieces(self) -> tuple[IntArray, IntArray, npt.NDArray[np.bool_]]:
        """Return the paths and rings between the gaps: vertices in `alive` in order, (k,), sizes and rings, (c,)."""
        k = len(self.alive)
        if self.closed and not len(self.cuts) and k > 2:
            return np.arange(k), np.array([k]), np.array([True])
        if self.closed and len(self.cuts):
            # begin after the first gap
            begin = int(self.cuts[0]) + 1
            bounds = np.append(self.cuts - self.cuts[0], k)
            return (np.arange(k) + begin) % k, np.diff(bounds), np.zeros(len(self.cuts), bool)
        bounds = np.concatenate([[0], self.cuts + 1, [k]])
        return np.arange(k), np.diff(bounds), np.zeros(len(self.cuts) + 1, bool)

    def _estimate(self, order: IntArray, sizes: IntArray, rings: npt.NDArray[np.bool_]) -> None:
        ends = np.cumsum(sizes)
        x = self.points[order]
        told = sizes >= TELLING
        for begin, end, ring in zip((ends - sizes)[told], ends[told], rings[told], strict=True):
            self.sigma[order[begin:end]] = noise_along(x[begin:end], bool(ring))
        if told.any() and not told.all():
            # short pieces tell nothing of their noise: they take that of the others
            known = np.repeat(told, sizes)
            self.sigma[order[~known]] = np.median(self.sigma[order[known]])

    def _legs(self, x: FloatArray) -> FloatArray:
        """Compute the length of the segment after each vertex; for open curves without the last vertex."""
        steps = np.diff(x, axis=0, append=x[:1]) if self.closed else np.diff(x, axis=0)
        lengths: FloatArray = np.linalg.norm(steps, axis=1)
        return lengths

    def _outliers(self, alive: IntArray) -> npt.NDArray[np.bool_]:
        """Find runs of vertices far off the way past them, before the fit."""
        x, m = self.merged[alive], len(alive)
        drop = np.zeros(m, bool)
        if m < TELLING:
            return drop
        legs = self._legs(x)
        median = running_median(legs, self.closed)
        far = legs > _FAR * median
        if not far.any():
            return drop
        gap = legs > _GAP * median
        noise = np.full(m, self._given) if self._given is not None else running_noise(x, self.closed)
        candidates: list[tuple[float, int, int]] = []
        for run in range(1, _RUN + 1):
            j = np.flatnonzero(far)
            if not self.closed:
                j = j[j + run < len(legs)]
            j = j[far[(j + run) % m]]
            # vertices may lie together if they are as far off as beyond a gap
            apart = gap[j] & gap[(j + run) % m]
            inner = np.ones(len(j), bool)
            for step in range(1, run):
                inner &= far[(j + step) % m]
            j = j[inner | apart]
            a, b = x[j], x[(j + run + 1) % m]
            past = np.linalg.norm(b - a, axis=1)
            leg = np.minimum(legs[j], legs[(j + run) % m])
            inside = (j[:, None] + np.arange(1, run + 1)) % m
            off = np.linalg.norm(x[inside] - (a + b)[:, None] / 2, axis=2).min(axis=1)
            sigma = noise[inside].max(axis=1)
            out = (leg > _PAST * past) & (off > _DEVIATIONS * math.sqrt(1.5) * sigma) & (sigma > 0)
            out &= ~self._held[alive[inside]].any(axis=1)
            candidates += [(p / q, int(k), run) for p, q, k in zip(past[out], leg[out], j[out], strict=True)]
        for _, j0, run in sorted(candidates):
            # with a vertex on each side that stays
            around = np.arange(j0, j0 + run + 2) % m
            if not drop[around].any():
                drop[around[1:-1]] = True
        # a curve is not made of outliers
        return drop if drop.sum() <= m // 3 else np.zeros(m, bool)

    def refit(self, u: FloatArray, h: FloatArray) -> bool:
        """Find further outliers by the fit u (k, d) with leverages h (k,); return whether there are any."""
        if not self._robust or not self.long:
            return False
        x, legs = self.points, self._legs(self.points)
        residual = np.linalg.norm(u - x, axis=1) / np.sqrt(np.maximum(1 - h, 0.05))
        out = (self.sigma > 0) & (residual > _DEVIATIONS * self.sigma) & ~self._held[self.alive]
        if not out.any():
            return False
        median = running_median(legs, self.closed)
        before, after = np.roll(x, 1, axis=0), np.roll(x, -1, axis=0)
        past = np.linalg.norm(after - before, axis=1)
        if not self.closed:
            legs, median, past[[0, -1]] = np.append(legs, 0), np.append(median, median[-1]), math.inf
        leg = np.minimum(legs, np.roll(legs, 1))
        out &= (leg > _LEG * median) & (leg > past)
        if not out.any():
            return False
        self._look(self.alive[~out])
        return True

    def filled(self, moved: FloatArray) -> FloatArray:
        """Extend new positions (k, d) of the vertices in `alive` to all merged ones, (m, d): linear between them."""
        m, k = len(self.merged), len(self.alive)
        if k == m:
            return moved
        at, values = self.alive, moved
        if self.closed:
            at = np.concatenate([at[-1:] - m, at, at[:1] + m])
            values = np.concatenate([moved[-1:], moved, moved[:1]])
        filled = np.stack([np.interp(np.arange(m), at, column) for column in values.T], axis=1)
        filled[self.alive] = moved
        return filled

    def found(self) -> Found:
        """Return what was found, in the numbers of the input."""
        last = np.zeros(len(self.merged), np.int64)
        np.maximum.at(last, self.of, np.arange(len(self.of)))
        gone = np.ones(len(self.merged), bool)
        gone[self.alive] = False
        opened = self.closed and len(self.alive) - 1 in self.cuts
        inner = self.cuts[self.cuts < len(self.alive) - 1]
        repeats, few = len(self.of) - len(self.merged), self._given is None and not self.long
        return Found(np.flatnonzero(gone[self.of]), last[self.alive[inner]], repeats, opened, few)


def _repeats(x: FloatArray, closed: bool, merges: bool) -> tuple[IntArray, IntArray]:
    """Return the number of the merged vertex of each vertex, (n,), and the first vertex of each, (m,)."""
    if not merges:
        return np.arange(len(x)), np.arange(len(x))
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    same = _SAME * float(steps.mean()) if len(steps) else 0.0
    new = np.concatenate([[True], steps > same])
    of, first = np.cumsum(new) - 1, np.flatnonzero(new)
    if closed and len(first) > 1 and np.linalg.norm(x[first[-1]] - x[0]) <= same:
        of[of == len(first) - 1] = 0
        first = first[:-1]
    return of, first


def _is_gap(lengths: FloatArray, closed: bool) -> npt.NDArray[np.bool_]:
    """Return which segments are longer than 8 medians of the 5 before, and of the 5 after, (s,)."""
    s = len(lengths)
    near = min(_NEAR, s - 1)
    if near < 1:
        return np.zeros(s, bool)
    if closed:
        around = np.concatenate([lengths[-near:], lengths, lengths[:near]])
    else:
        around = np.concatenate([np.full(near, np.nan), lengths, np.full(near, np.nan)])
    windows = np.lib.stride_tricks.sliding_window_view(around, near)
    before, after = windows[: len(lengths)], windows[near + 1 :]
    if closed:
        usual = np.maximum(np.median(before, axis=1), np.median(after, axis=1))
    else:
        inner = slice(near, s - near)
        usual = np.zeros(s)
        usual[inner] = np.maximum(np.median(before[inner], axis=1), np.median(after[inner], axis=1))
        for j in (*range(min(near, s)), *range(max(near, s - near), s)):
            sides = (lengths[max(0, j - near) : j], lengths[j + 1 : j + 1 + near])
            usual[j] = max(float(np.median(side)) for side in sides if len(side))
    far: npt.NDArray[np.bool_] = (usual > 0) & (lengths > _GAP * usual)
    return far


def _gaps(x: FloatArray, closed: bool) -> IntArray:
    if len(x) < TELLING:
        return np.empty(0, np.int64)
    steps = np.diff(x, axis=0, append=x[:1]) if closed else np.diff(x, axis=0)
    return np.flatnonzero(_is_gap(np.linalg.norm(steps, axis=1), closed))
