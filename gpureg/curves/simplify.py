"""Simplify polygonal curves, by p < 1: :func:`simplify_curve` (section 5.3, figure 7)."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Unpack, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..checks import choice, integer, number
from ..doors import door, part_of
from ..graphs.csr import Graph
from ..model.result import Result
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..solvers import Solver
from ..weights import Weights
from .curves import Curves, curves_of

CurveFilter = Literal["directions", "positions"]
CURVE_FILTERS: tuple[CurveFilter, ...] = get_args(CurveFilter)

# The type to compute in, unless asked otherwise: steps are many and small.
STEPS = np.float64

# Fidelities where none is given, in the scale of each: of Great Britain's coast they keep 28 and 31 percent.
_LAM: dict[CurveFilter, float] = {"directions": 3.0, "positions": 0.1}

# One run of the model on a function and a graph.
Process = Callable[..., Result]

# Differences below these are none: 3 degrees between directions, a twentieth of the mean segment between positions.
_JUMP = 0.05

# A number of vertices is looked for from the fidelity above to so many times that, halving the range so often, in the
# first round that leaves too few, or hardly fewer than it had.
_MOST, _HALVINGS, _STUCK = 1e4, 10, 0.95


@dataclass(frozen=True, eq=False)
class Simplified:
    """A curve of fewer vertices.

    Attributes
    ----------
    points : (k, d) float array
        The vertices kept.
    kept : (k,) int array
        Which these are of those that came.
    lam : float
        The fidelity used, in the scale of :func:`simplify_curve`.
    result : Result
        The run; of all curves together, where no number of vertices was asked for.
    """

    points: FloatArray
    kept: IntArray
    lam: float
    result: Result


@dataclass(frozen=True, eq=False)
class CurveSimplification:
    """What simplifying curves did.

    Attributes
    ----------
    curves : Curves
        Those that came in.
    filter : {"directions", "positions"}
        What was regularized.
    p : float
    parts : list of Simplified
        What became of each curve.
    """

    curves: Curves
    filter: CurveFilter
    p: float
    parts: list[Simplified]


def simplified(
    points: npt.ArrayLike | Sequence[npt.ArrayLike] | Curves,
    *,
    closed: bool | None = None,
    filter: CurveFilter = "directions",
    p: float = 0.5,
    lam: float | None = None,
    n_vertices: int | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    norm: Literal["vertex", "edge"] = "edge",
    eps: float = 1e-3,
    solver: str | Solver = "jacobi",
    max_iter: int = 2000,
    tol: float | None = 1e-6,
    **options: Unpack[Run],
) -> CurveSimplification:
    """Simplify curves, and say all that there is to say about it: the work of :func:`simplify_curve`.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`simplify_curve`.
    """
    curves = curves_of(points, closed)
    choice("filter", filter, CURVE_FILTERS)
    if lam is not None and n_vertices is not None:
        raise ValueError("give lam or n_vertices, not both: the number of vertices follows from lam")
    if lam is not None and not number("lam", lam, finite=False) > 0:
        raise ValueError(f"lam must be > 0, or nothing holds the vertices apart; got {lam}")
    least = 3 if any(curves.closed) else 2
    if n_vertices is not None and integer("n_vertices", n_vertices) < least:
        what = "a closed" if any(curves.closed) else "an open"
        raise ValueError(f"n_vertices must be at least {least} for {what} curve, got {n_vertices}")
    told: Run = {"dtype": STEPS, **options}
    process = functools.partial(
        regularize, p=p, weights=weights, norm=norm, eps=eps, solver=solver, max_iter=max_iter, tol=tol, **told
    )
    prepared = [_Prepared.of(x, shut) for x, shut in zip(curves.points, curves.closed, strict=True)]
    if n_vertices is None:
        parts = _simplified(prepared, filter, _LAM[filter] if lam is None else float(lam), None, process)
    else:
        parts = [_with_vertices(curve, filter, int(n_vertices), process) for curve in prepared]
    return CurveSimplification(curves, filter, float(p), parts)


@door(options=RUN | {"dtype": STEPS})
@part_of(simplified)
def simplify_curve(found: CurveSimplification) -> Any:
    """Keep the vertices of polygonal curves that tell their shape.

    Parameters
    ----------
    points : (n, d) array, or a list of such
        The vertices in order; all curves of a list go as one graph.
    closed : bool, optional
        Whether the last vertex is joined to the first. None: as :func:`denoise_curve` says. A first vertex repeated at
        the end is taken off, and put back. An open curve keeps its ends.
    filter : {"directions", "positions"}, default "directions"
        What is regularized until it is piecewise constant. "directions": the unit vectors along the segments; a vertex
        is kept where they still jump, so that corners stay and straight runs go. "positions": those of the vertices
        (figure 7); vertices that have met count as one, kept where the curve turns most, so that it is thinned evenly.
    p : float, default 0.5
        Degree of regularity, best below 1.
    lam : float, optional
        Fidelity > 0: larger keeps more vertices. It has no unit: it is taken times the length of a segment over the
        mean one for directions, times the mean segment to the power p - 2 for positions. None: 3 and 0.1.
    n_vertices : int, optional
        How many vertices to keep of each curve, instead of `lam`: the fidelity is looked for with which so many
        are left, and the largest jumps count.
    weights, norm, solver, max_iter, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`, on the graph of the segments, or of the vertices. Steps are many and small:
        float64 by default.
    eps : float, default 1e-3
        Smoothing of the gradient norm, for unit vectors, or in mean segments.

    Returns
    -------
    (k, d) array like `points`, or a list of such

    Raises
    ------
    TypeError, ValueError
        What is no curve, arguments out of their ranges.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises the energy of :func:`gpureg.regularize` for p < 1, which has many minima: the one found is near the curve
    itself, from where the process starts. Consecutive values count as the same where they differ by less than 0.05 (3
    degrees, or a twentieth of the mean segment).

    Examples
    --------
    A square of 80 vertices has four:

    >>> import numpy as np, gpureg as gr
    >>> side = np.linspace(0, 1, 20, endpoint=False)
    >>> zero, one = np.zeros(20), np.ones(20)
    >>> x, y = np.concatenate([side, one, 1 - side, zero]), np.concatenate([zero, side, one, 1 - side])
    >>> gr.simplify_curve(np.stack([x, y], axis=1), backend="numpy")
    array([[0., 0.],
           [1., 0.],
           [1., 1.],
           [0., 1.]])
    """
    return found.curves.as_came([part.points for part in found.parts])


@dataclass(frozen=True, eq=False)
class _Prepared:
    """A curve without consecutive vertices on the same point, and which of the given ones are left."""

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
        """Make the curve of some of the given vertices."""
        return _Prepared(self.given[kept], kept, self.closed, self.given)

    @property
    def too_small(self) -> bool:
        """Whether there is nothing to leave out."""
        return len(self.points) <= (3 if self.closed else 2)

    def segments(self) -> tuple[FloatArray, FloatArray]:
        """Compute unit vectors along the segments, (s, d), and their lengths, (s,)."""
        steps = np.roll(self.points, -1, axis=0) - self.points
        steps = steps if self.closed else steps[:-1]
        lengths = np.linalg.norm(steps, axis=1)
        return steps / lengths[:, None], lengths

    def values(self, filter: CurveFilter, lam: float) -> tuple[FloatArray, FloatArray]:
        """Compute what is regularized, in units in which 1 is large, and the fidelity of each value."""
        directions, lengths = self.segments()
        mean = float(lengths.mean())
        if filter == "directions":
            return directions, lam * lengths / mean
        f = (self.points - self.points.mean(axis=0)) / mean
        return f, np.full(len(f), lam)

    def kept(self, f: FloatArray, filter: CurveFilter, count: int | None) -> IntArray:
        """Choose the vertices to keep, `count` of them if asked for, by values f of the segments or the vertices."""
        n = len(self.points)
        jumps = np.linalg.norm(f - np.roll(f, 1, axis=0), axis=1)
        if not self.closed:
            # between the last and the first there is none; the ends stay
            jumps[0] = math.inf
            if filter == "directions":
                jumps = np.append(jumps, math.inf)
        most = min(n, count) if count is not None else max(int((jumps > _JUMP).sum()), 3 if self.closed else 2)
        if filter == "positions" and not self.closed and most < 2:
            most = 2
        cuts = np.sort(np.argsort(-jumps, kind="stable")[:most])
        if filter == "directions":
            return cuts
        # one vertex of each run from cut to cut: where the curve turns most; the ends of an open one
        turns = self._turns()
        label = (np.searchsorted(cuts, np.arange(n), side="right") - 1) % len(cuts)
        order = np.lexsort((-turns, label))
        found: IntArray = np.sort(order[np.unique(label[order], return_index=True)[1]])
        return found

    def _turns(self) -> FloatArray:
        """Compute by how much the direction changes at each vertex, infinitely at open ends, (n,)."""
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
    """Simplify a curve to so many vertices, with the least fidelity that leaves as many.

    One run leaves a third: from there the next begins, as long as more are left than asked for.
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
    """Make a graph of the values of several curves, each joined to the next of its own."""
    starts = np.cumsum([0, *sizes])
    edges = []
    for start, size, shut in zip(starts, sizes, closed, strict=False):
        u = np.arange(size if shut and size > 2 else size - 1)
        edges.append(np.stack([start + u, start + (u + 1) % size], axis=1))
    return Graph.from_edges(np.concatenate(edges), n_vertices=int(starts[-1]))
