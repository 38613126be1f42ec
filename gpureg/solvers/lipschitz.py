"""Extend pinned values to the absolutely minimal Lipschitz extension: :func:`extend`.

It is the limit of the p-harmonic functions of the edge norm as p goes to infinity. At each free vertex u

    max_v gamma_uv (f(v) - f(u)) = max_v gamma_uv (f(u) - f(v))

and it is the value of a game: one player chooses a neighbour `up` of each free vertex, the other a neighbour `down`,

    f(u) = (gamma_up f(up) + gamma_down f(down)) / (gamma_up + gamma_down)

a linear system. The choices `up` stay while `down` is improved until it is the best answer; only then `up` is improved.
The values then grow from round to round, and the iteration ends. To change both at once can go round in circles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, IntArray, all_finite
from .slopes import EPS, Distances, Slopes, Steepest

# A choice changes if the slope grows by more than so many roundings of its values.
_ROUNDINGS = 64
# Sweeps before the first system, on graphs where a system costs more than a few of them. On 20,000 vertices, with a
# range of 4 answers, 200 sweeps save two thirds of the systems.
_SWEEPS, _SMALL = 300, 1000
# Answers that are computed before `up` is improved, in the first rounds: one more each round of `_PATIENCE`. The best
# answer to a choice that does not stay is not worth its time.
_ANSWERS, _PATIENCE = 4, 8
# A share of the identity for systems that are singular up to rounding.
_SHIFT = 1e-14


@dataclass(frozen=True, eq=False)
class Extension:
    """An extension of pinned values.

    Attributes
    ----------
    f : (n,) float array
    residual : float
        The largest difference of the steepest slopes up and down at a free vertex; 0 for the absolutely minimal one.
    systems : int
        Linear systems solved.
    settled : bool
        Whether no choice can be improved, up to rounding, or the residual is within the tolerance.
    """

    f: FloatArray
    residual: float
    systems: int
    settled: bool


def extend(
    slopes: Slopes,
    f: FloatArray,
    steepest: Steepest,
    *,
    start: FloatArray | None = None,
    most: int,
    tol: float = 0.0,
) -> Extension:
    """Find the absolutely minimal extension.

    Parameters
    ----------
    slopes : Slopes
    f : (n,) float array
        The pinned values; the others do not matter.
    steepest : Steepest
        Their least Lipschitz constant.
    start : (n,) float array, optional
        A first guess. None: the middle between the least and the largest extension with the least constant.
    most : int
        Maximal number of linear systems.
    tol : float
        A residual, as a share of the least constant, at which to stop.
    """
    distances = Distances.of(slopes)
    values = f[distances.pinned]
    if slopes.pinned.all():
        return Extension(f, 0.0, 0, True)
    low, before = distances.from_values(values, steepest.slope)
    if not steepest.slope > 0:
        # a constant in each component
        return Extension(np.where(slopes.pinned, f, low), 0.0, 0, True)
    high = -distances.from_values(-values, steepest.slope)[0]
    middle = (low + high) / 2 if start is None else np.clip(start, np.minimum(low, high), high)
    game = Game.of(slopes, before, float(np.ptp(values)))
    f = game.swept(np.where(slopes.pinned, f, middle), _SWEEPS if len(game.free) > _SMALL else 0)
    ends = float(values.min()), float(values.max())
    d = game.slopes(f)
    up, down = game.steepest(d)[1], game.steepest(-d)[1]
    systems, rounds, settled = 0, 0, False
    while not settled and systems < most:
        lower = 1
        for _ in range(_ANSWERS + rounds // _PATIENCE):
            up, down = game.connected(up, down)
            f = np.clip(game.solve(f, up, down), *ends)
            systems += 1
            d = game.slopes(f)
            down, lower = game.improved(down, -d)
            if not lower or systems >= most:
                break
        up, higher = game.improved(up, d)
        rounds += 1
        settled = (not lower and not higher) or game.residual(d) <= tol * steepest.slope
    return Extension(f, game.residual(d), systems, settled)


@dataclass(frozen=True, eq=False)
class Game:
    """The directed edges of the free vertices, and what choices of one of them per vertex give.

    Attributes
    ----------
    free : (k,) int array
        The vertices that are not pinned.
    place : (n,) int array
        The number of each free vertex, -1 for pinned ones.
    row, end : (D,) int arrays
        The number of the free vertex at which each edge starts, sorted, and the vertex at which it ends.
    begin : (k,) int array
        The first edge of each free vertex.
    gamma : (D,) float array
    towards : (k,) int array
        The first edge of a path to a pinned vertex.
    rounding : float
        A bound on the rounding of a slope, divided by gamma.
    """

    free: IntArray
    place: IntArray
    row: IntArray
    end: IntArray
    begin: IntArray
    gamma: FloatArray
    towards: IntArray
    rounding: float

    @classmethod
    def of(cls, slopes: Slopes, before: IntArray, span: float) -> Game:
        """Make it from the vertex before each on a path from a pinned one, (n,), and the range of the values."""
        free = np.flatnonzero(~slopes.pinned)
        place = np.full(len(slopes.pinned), -1)
        place[free] = np.arange(len(free))
        own = ~slopes.pinned[slopes.start]
        counts = np.diff(slopes.indptr)[free]
        row, end = np.repeat(np.arange(len(free)), counts), slopes.end[own]
        hit = np.flatnonzero(end == before[free][row])
        towards = np.empty(len(free), np.int64)
        towards[row[hit]] = hit
        begin = np.cumsum(counts) - counts
        return cls(free, place, row, end, begin, slopes.gamma[own], towards, _ROUNDINGS * EPS * span)

    def slopes(self, f: FloatArray) -> FloatArray:
        """Compute the slopes of a function, (n,), along the edges, (D,)."""
        along: FloatArray = self.gamma * (f[self.end] - f[self.free][self.row])
        return along

    def steepest(self, slopes: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the largest slope at each free vertex, and the first edge that has it."""
        most = np.maximum.reduceat(slopes, self.begin)
        hit = np.flatnonzero(slopes == most[self.row])[::-1]
        edge = np.empty(len(most), np.int64)
        edge[self.row[hit]] = hit
        return most, edge

    def residual(self, slopes: FloatArray) -> float:
        """Return the largest difference of the steepest slopes up and down."""
        up, down = np.maximum.reduceat(slopes, self.begin), np.minimum.reduceat(slopes, self.begin)
        return float(np.abs(up + down).max(initial=0.0))

    def improved(self, chosen: IntArray, slopes: FloatArray) -> tuple[IntArray, int]:
        """Return the choices, changed where the slope grows by more than rounding, and how many changed."""
        most, edge = self.steepest(slopes)
        better = most - slopes[chosen] > self.rounding * (self.gamma[edge] + self.gamma[chosen])
        return np.where(better, edge, chosen), int(better.sum())

    def connected(self, up: IntArray, down: IntArray) -> tuple[IntArray, IntArray]:
        """Return the choices, on a path to a pinned vertex instead where they lead to none."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import breadth_first_order

        k = len(self.free)
        ends = self.place[self.end[np.concatenate([up, down])]]
        backwards = np.where(ends < 0, k, ends), np.tile(np.arange(k), 2)
        A = csr_array((np.ones(2 * k, np.int8), backwards), shape=(k + 1, k + 1))
        lost = np.ones(k + 1, bool)
        lost[breadth_first_order(A, k, return_predecessors=False)] = False
        return np.where(lost[:k], self.towards, up), np.where(lost[:k], self.towards, down)

    def swept(self, f: FloatArray, sweeps: int) -> FloatArray:
        """Return a function, (n,), after sweeps that balance the steepest slopes of all free vertices at once."""
        f = f.copy()
        for _ in range(sweeps):
            d = self.slopes(f)
            up, down = self.steepest(d)[1], self.steepest(-d)[1]
            # by how much f grows: the slopes are then equal
            f[self.free] += (d[up] + d[down]) / (self.gamma[up] + self.gamma[down])
        return f

    def solve(self, f: FloatArray, up: IntArray, down: IntArray) -> FloatArray:
        """Return f with the values at the free vertices that choices give."""
        from scipy.sparse import coo_array, eye_array
        from scipy.sparse.linalg import splu

        k, chosen = len(self.free), np.concatenate([up, down])
        rows, ends = np.tile(np.arange(k), 2), self.end[chosen]
        share = self.gamma[chosen] / np.tile(self.gamma[up] + self.gamma[down], 2)
        columns = self.place[ends]
        inner = columns >= 0
        b = np.bincount(rows[~inner], share[~inner] * f[ends[~inner]], minlength=k)
        across = coo_array((share[inner], (rows[inner], columns[inner])), shape=(k, k))
        A, found = (eye_array(k) - across).tocsc(), f.copy()
        try:
            found[self.free] = splu(A).solve(b)
        except RuntimeError:  # a vertex that is joined to the others by a share below rounding
            A, b = A + _SHIFT * eye_array(k, format="csc"), b + _SHIFT * f[self.free]
            found[self.free] = splu(A.tocsc()).solve(b)
        return found if all_finite(found) else f
