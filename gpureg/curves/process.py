"""Simplify polygonal curves by the process of the paper, p < 1 (section 5.3, figure 7)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..model.result import Result
from .curves import Curves

CurveFilter = Literal["directions", "positions"]
CURVE_FILTERS: tuple[CurveFilter, ...] = get_args(CurveFilter)

# Default fidelities: they keep 28 and 31 percent of the vertices of Great Britain's coast.
_LAM: dict[CurveFilter, float] = {"directions": 3.0, "positions": 0.1}

# One run of the model on a function and a graph.
Process = Callable[..., Result]

# Smaller differences count as 0: 3 degrees between directions, a twentieth of the mean segment between positions.
_JUMP = 0.05

# With `n_vertices`: the fidelity is searched between the default and this multiple of it, with this number of
# bisections, after the first round that leaves too few vertices, or more than the last share of those it had.
_MOST, _HALVINGS, _STUCK = 1e4, 10, 0.95


@dataclass(frozen=True, eq=False)
class Simplified:
    """A simplified curve.

    Attributes
    ----------
    points : (k, d) float array
        The vertices kept.
    kept : (k,) int array
        Their indices in the input.
    lam : float or None
        The fidelity of the process, in the scale of :func:`gpureg.simplify_curve`.
    result : Result or None
        The run of the process; without `n_vertices` one run for all curves.
    """

    points: FloatArray
    kept: IntArray
    lam: float | None = None
    result: Result | None = None


def simplified_by_process(
    curves: Curves,
    filter: CurveFilter,
    lam: float | None,
    n_vertices: int | None,
    process: Process,
) -> list[Simplified]:
    """Simplify curves by p < 1.

    Parameters
    ----------
    curves : Curves
    filter : {"directions", "positions"}
        What is made piecewise constant.
    lam : float, optional
        The fidelity, in the scale of :func:`gpureg.simplify_curve`.
    n_vertices : int, optional
        Number of vertices to keep of each curve, instead of `lam`.
    process : callable
        :func:`gpureg.regularize` with the settings of the run.
    """
    prepared = [_Prepared.of(x, shut) for x, shut in zip(curves.points, curves.closed, strict=True)]
    if n_vertices is None:
        return _simplified(prepared, filter, _LAM[filter] if lam is None else float(lam), None, process)
    return [_with_vertices(curve, filter, int(n_vertices), process) for curve in prepared]


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A curve without consecutive equal vertices: (k, d), their (k,) indices in the input, and the input, (n, d)."""

    points: FloatArray
    number: IntArray
    closed: bool
    given: FloatArray

    @classmethod
    def of(cls, x: FloatArray, closed: bool) -> _Prepared:
        new = (x != np.roll(x, 1, axis=0)).any(axis=1)
        if not closed:
            new[0] = True
        number = np.flatnonzero(new)
        return cls(x[number], number, closed, x)

    def only(self, kept: IntArray) -> _Prepared:
        """Make the curve of the input vertices `kept`, (k,)."""
        return _Prepared(self.given[kept], kept, self.closed, self.given)

    @property
    def too_small(self) -> bool:
        """Whether no vertex can be removed."""
        return len(self.points) <= (3 if self.closed else 2)

    def segments(self) -> tuple[FloatArray, FloatArray]:
        """Compute unit vectors along the segments, (s, d), and their lengths, (s,)."""
        steps = np.roll(self.points, -1, axis=0) - self.points
        steps = steps if self.closed else steps[:-1]
        lengths = np.linalg.norm(steps, axis=1)
        return steps / lengths[:, None], lengths

    def values(self, filter: CurveFilter, lam: float) -> tuple[FloatArray, FloatArray]:
        """Compute the function to regularize, scaled so that 1 is large, (k, d), and its fidelity, (k,)."""
        directions, lengths = self.segments()
        mean = float(lengths.mean())
        if filter == "directions":
            return directions, lam * lengths / mean
        f = (self.points - self.points.mean(axis=0)) / mean
        return f, np.full(len(f), lam)

    def kept(self, f: FloatArray, filter: CurveFilter, count: int | None) -> IntArray:
        """Choose the vertices to keep (`count` or by default all with a jump) from regularized values f, (k, d)."""
        n = len(self.points)
        jumps = np.linalg.norm(f - np.roll(f, 1, axis=0), axis=1)
        if not self.closed:
            # an open curve has no jump from last to first, and keeps its ends
            jumps[0] = math.inf
            if filter == "directions":
                jumps = np.append(jumps, math.inf)
        most = min(n, count) if count is not None else max(int((jumps > _JUMP).sum()), 3 if self.closed else 2)
        if filter == "positions" and not self.closed and most < 2:
            most = 2
        cuts = np.sort(np.argsort(-jumps, kind="stable")[:most])
        if filter == "directions":
            return cuts
        # one vertex of each run between two cuts, where the curve turns most; and the ends of an open curve
        turns = self._turns()
        label = (np.searchsorted(cuts, np.arange(n), side="right") - 1) % len(cuts)
        order = np.lexsort((-turns, label))
        found: IntArray = np.sort(order[np.unique(label[order], return_index=True)[1]])
        return found

    def _turns(self) -> FloatArray:
        """Compute the change of direction at each vertex, (k,); infinity at open ends."""
        directions, _ = self.segments()
        turns: FloatArray = np.linalg.norm(directions - np.roll(directions, 1, axis=0), axis=1)
        return turns if self.closed else np.concatenate([[math.inf], turns[1:], [math.inf]])


def _simplified(
    curves: list[_Prepared], filter: CurveFilter, lam: float, count: int | None, process: Process
) -> list[Simplified]:
    """Simplify all curves in one run."""
    parts = [curve.values(filter, lam) for curve in curves]
    graph = _chain([len(f) for f, _ in parts], [curve.closed for curve in curves])
    result = process(np.concatenate([f for f, _ in parts]), graph, lam=np.concatenate([held for _, held in parts]))
    values = np.split(result.value, np.cumsum([len(f) for f, _ in parts[:-1]]))
    found = []
    for curve, f in zip(curves, values, strict=True):
        kept = np.arange(len(curve.points)) if curve.too_small else curve.kept(f, filter, count)
        kept = curve.number[kept]
        found.append(Simplified(curve.given[kept], kept, lam, result))
    return found


def _with_vertices(curve: _Prepared, filter: CurveFilter, count: int, process: Process) -> Simplified:
    """Simplify a curve to `count` vertices, with the least fidelity that leaves as many.

    One run leaves about a third; the next run starts there, while there are more than `count`.
    """
    low = _LAM[filter]
    while not curve.too_small:
        [found] = _simplified([curve], filter, low, None, process)
        if len(found.kept) == count:
            return found
        if len(found.kept) < count or len(found.kept) > _STUCK * len(curve.points):
            break
        curve = curve.only(found.kept)
    high = low * _MOST
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        [found] = _simplified([curve], filter, middle, None, process)
        if len(found.kept) == count:
            return found
        low, high = (middle, high) if len(found.kept) < count else (low, middle)
    return _simplified([curve], filter, high, count, process)[0]


def _chain(sizes: list[int], closed: list[bool]) -> Graph:
    """Make one graph for the values of several curves, each value joined to the next one of its curve."""
    starts = np.cumsum([0, *sizes])
    edges = []
    for start, size, shut in zip(starts, sizes, closed, strict=False):
        u = np.arange(size if shut and size > 2 else size - 1)
        edges.append(np.stack([start + u, start + (u + 1) % size], axis=1))
    return Graph.from_edges(np.concatenate(edges), n_vertices=int(starts[-1]))
