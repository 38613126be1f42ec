"""Fewer vertices for polygonal curves, by p < 1: :func:`simplify_curve` (section 5.3, figure 7)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..model.result import Result
from ..regularization.regularize import regularize
from ..solvers import Solver
from ..solvers.loop import Callback
from ..weights import Weights
from .denoise import Curves, curves_of

Function = Literal["directions", "positions"]
FUNCTIONS: tuple[Function, ...] = get_args(Function)

# Fidelities where none is given, in the scale of each function: of Great Britain's coast they keep 28 and 31 percent.
_LAM: dict[Function, float] = {"directions": 3.0, "positions": 0.1}

# Differences below these are none: 3 degrees between directions, a twentieth of the mean segment between positions.
_JUMP = 0.05

# A number of vertices is looked for from the fidelity above to so many times that, halving the range so often, in the
# first round that leaves too few, or hardly fewer than it had.
_MOST, _HALVINGS, _STUCK = 1e4, 10, 0.95


@dataclass(frozen=True, eq=False)
class CurveSimplification:
    """What :func:`simplified_curves` made of a curve.

    Attributes
    ----------
    points : (k, d) float array
        The vertices kept.
    kept : (k,) int array
        Which these are of those that came.
    lam : float
        The fidelity used, in the scale of :func:`simplify_curve`.
    result : Result
        The run, of all curves together.
    """

    points: FloatArray
    kept: IntArray
    lam: float
    result: Result


def simplify_curve(
    points: npt.ArrayLike | Sequence[npt.ArrayLike],
    *,
    closed: bool = True,
    function: Function = "directions",
    p: float = 0.5,
    lam: float | None = None,
    n_vertices: int | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    norm: Literal["vertex", "edge"] = "edge",
    eps: float = 1e-3,
    solver: str | Solver = "jacobi",
    max_iter: int = 2000,
    tol: float | None = 1e-6,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = np.float64,
    callback: Callback | None = None,
    progress: bool = False,
) -> Any:
    """Keep the vertices of polygonal curves that tell their shape.

    Parameters
    ----------
    points : (n, d) array, or a list of such
        The vertices in order; all curves of a list go as one graph.
    closed : bool, default True
        Whether the last vertex is joined to the first. A first vertex repeated at the end is taken off, and put back.
        An open curve keeps its ends.
    function : {"directions", "positions"}, default "directions"
        What is regularized until it is piecewise constant. "directions": the unit vectors along the segments; a vertex
        is kept where they still jump, so that corners stay and straight runs go. "positions": those of the vertices
        (figure 7); vertices that have met count as one, kept where the curve turns most, so that it is thinned evenly.
    p : float, default 0.5
        Degree of regularity, best below 1.
    lam : float, optional
        Fidelity > 0: larger keeps more vertices. It has no unit: it is taken times the length of a segment over the
        mean one for directions, times the mean segment to the power p - 2 for positions. None: 3 and 0.1.
    n_vertices : int, optional
        How many vertices to keep of each curve, in the place of `lam`: the fidelity is looked for with which so many
        are left, and the largest jumps count.
    weights, norm, solver, max_iter, tol, backend, dtype, callback, progress
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
    curves = curves_of(points, closed)
    found = simplified_curves(
        curves, function=function, p=p, lam=lam, n_vertices=n_vertices, weights=weights, norm=norm, eps=eps,
        solver=solver, max_iter=max_iter, tol=tol, backend=backend, dtype=dtype, callback=callback, progress=progress,
    )  # fmt: skip
    return curves.as_came([one.points for one in found])


def simplified_curves(
    curves: Curves,
    *,
    function: Function = "directions",
    lam: float | None = None,
    n_vertices: int | None = None,
    **model: Any,
) -> list[CurveSimplification]:
    """:func:`simplify_curve`, with all that there is to say about it.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`simplify_curve`.
    """
    if function not in FUNCTIONS:
        raise ValueError(f"function must be one of {', '.join(FUNCTIONS)}, got {function!r}")
    if lam is not None and n_vertices is not None:
        raise ValueError("give lam or n_vertices, not both: the number of vertices follows from lam")
    if lam is not None and (isinstance(lam, bool) or not isinstance(lam, int | float | np.number)):
        raise TypeError(f"lam must be a number, got {lam!r}")
    if lam is not None and not lam > 0:
        raise ValueError(f"lam must be > 0, or nothing holds the vertices apart; got {lam}")
    least = 3 if curves.closed else 2
    if n_vertices is not None and (isinstance(n_vertices, bool) or not isinstance(n_vertices, int | np.integer)):
        raise TypeError(f"n_vertices must be an integer, got {n_vertices!r}")
    if n_vertices is not None and n_vertices < least:
        what = "a closed" if curves.closed else "an open"
        raise ValueError(f"n_vertices must be at least {least} for {what} curve, got {n_vertices}")
    prepared = [_Prepared.of(x, curves.closed) for x in curves.points]
    if n_vertices is None:
        chosen = _LAM[function] if lam is None else float(lam)
        return _simplified(prepared, function, chosen, None, model)
    return [_with_vertices(curve, function, int(n_vertices), model) for curve in prepared]


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
        """The curve of some of the given vertices."""
        return _Prepared(self.given[kept], kept, self.closed, self.given)

    @property
    def too_small(self) -> bool:
        """Whether there is nothing to leave out."""
        return len(self.points) <= (3 if self.closed else 2)

    def segments(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors along the segments, and their lengths."""
        steps = np.roll(self.points, -1, axis=0) - self.points
        steps = steps if self.closed else steps[:-1]
        lengths = np.linalg.norm(steps, axis=1)
        return steps / lengths[:, None], lengths

    def function(self, function: Function, lam: float, p: float) -> tuple[FloatArray, FloatArray]:
        """What is regularized, in units in which 1 is large, and the fidelity of each value."""
        directions, lengths = self.segments()
        mean = float(lengths.mean())
        if function == "directions":
            return directions, lam * lengths / mean
        f = (self.points - self.points.mean(axis=0)) / mean
        return f, np.full(len(f), lam)

    def kept(self, f: FloatArray, function: Function, count: int | None) -> IntArray:
        """Vertices kept, where values (of the segments, or at the vertices) are f; `count` of them, if asked for."""
        n = len(self.points)
        jumps = np.linalg.norm(f - np.roll(f, 1, axis=0), axis=1)
        if not self.closed:
            # between the last and the first there is none; the ends stay
            jumps[0] = math.inf
            if function == "directions":
                jumps = np.append(jumps, math.inf)
        most = min(n, count) if count is not None else max(int((jumps > _JUMP).sum()), 3 if self.closed else 2)
        if function == "positions" and not self.closed and most < 2:
            most = 2
        cuts = np.sort(np.argsort(-jumps, kind="stable")[:most])
        if function == "directions":
            return cuts
        # one vertex of each run from cut to cut: where the curve turns most; the ends of an open one
        turns = self._turns()
        label = (np.searchsorted(cuts, np.arange(n), side="right") - 1) % len(cuts)
        order = np.lexsort((-turns, label))
        found: IntArray = np.sort(order[np.unique(label[order], return_index=True)[1]])
        return found

    def _turns(self) -> FloatArray:
        """By how much the direction changes at each vertex, infinitely at open ends."""
        directions, _ = self.segments()
        turns: FloatArray = np.linalg.norm(directions - np.roll(directions, 1, axis=0), axis=1)
        return turns if self.closed else np.concatenate([[math.inf], turns[1:], [math.inf]])


def _simplified(
    curves: list[_Prepared], function: Function, lam: float, count: int | None, model: dict[str, Any]
) -> list[CurveSimplification]:
    """All curves in one run."""
    parts = [curve.function(function, lam, model["p"]) for curve in curves]
    graph = _chain([len(f) for f, _ in parts], curves[0].closed)
    result = regularize(
        np.concatenate([f for f, _ in parts]), graph, lam=np.concatenate([held for _, held in parts]), **model
    )
    values = np.split(result.value, np.cumsum([len(f) for f, _ in parts[:-1]]))
    found = []
    for curve, f in zip(curves, values, strict=True):
        kept = np.arange(len(curve.points)) if curve.too_small else curve.kept(f, function, count)
        kept = curve.number[kept]
        found.append(CurveSimplification(curve.given[kept], kept, lam, result))
    return found


def _with_vertices(curve: _Prepared, function: Function, count: int, model: dict[str, Any]) -> CurveSimplification:
    """The simplification with so many vertices, with the least fidelity that leaves as many.

    One run leaves a third: from there the next begins, as long as more are left than asked for.
    """
    low = _LAM[function]
    while not curve.too_small:
        [found] = _simplified([curve], function, low, None, model)
        if len(found.kept) == count:
            return found
        if len(found.kept) < count or len(found.kept) > _STUCK * len(curve.points):
            break
        curve = curve.only(found.kept)
    high = low * _MOST
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        [found] = _simplified([curve], function, middle, None, model)
        if len(found.kept) == count:
            return found
        low, high = (middle, high) if len(found.kept) < count else (low, middle)
    return _simplified([curve], function, high, count, model)[0]


def _chain(sizes: list[int], closed: bool) -> Graph:
    """Values of several curves, each joined to the next of its own."""
    starts = np.cumsum([0, *sizes])
    edges = []
    for start, size in zip(starts, sizes, strict=False):
        u = np.arange(size if closed and size > 2 else size - 1)
        edges.append(np.stack([start + u, start + (u + 1) % size], axis=1))
    return Graph.from_edges(np.concatenate(edges), n_vertices=int(starts[-1]))
