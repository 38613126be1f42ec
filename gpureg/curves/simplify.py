"""Simplify polygonal curves: :func:`simplify_curve` (section 5.3, figure 7)."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Unpack, get_args

import numpy as np
import numpy.typing as npt

from ..backends import get
from ..checks import choice, flag, integer, number
from ..doors import door, outside, part_of
from ..regularization.denoised import check_numbers
from ..regularization.options import RUN, Run
from ..regularization.regularize import regularize
from ..solvers import Solver
from ..weights import Weights
from .crossings import Crossings, crossed, crossings_of, expect_plane
from .curves import Curves, curves_of
from .heights import kept_by_height
from .process import CURVE_FILTERS, CurveFilter, Simplified, simplified_by_process

CurveMethod = Literal["heights", "process"]
CURVE_METHODS: tuple[CurveMethod, ...] = get_args(CurveMethod)

# The default height: at this one the coasts of Iceland and Great Britain keep 30 and 20 percent of their vertices, and
# lie nearer to the input, in area and in distance, than by the process, which keeps 26 and 24 percent.
TOLERANCE = 0.0015
# The default type of the process: there are many small steps.
STEPS = np.float64
_PROCESS: dict[str, Any] = {
    "p": 0.5, "norm": "edge", "eps": 1e-3, "solver": "jacobi", "max_iter": 2000, "tol": 1e-6, "dtype": STEPS,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class CurveSimplification:
    """The result of simplifying curves.

    Attributes
    ----------
    curves : Curves
        The input curves.
    method : {"heights", "process"}
    parts : list of Simplified
        The simplified curves.
    tolerance : float or None
        The height of "heights" without `n_vertices`.
    filter : {"directions", "positions"} or None
        What the process regularized.
    p : float or None
        Degree of regularity of the process.
    crossings : Crossings or None
        Pairs of segments that meet without a common end, before and after; None for curves that are not in the plane.
    refused : int
        Number of vertices that were kept only because curves would cross without them.
    n_vertices : int or None
        The number asked for.
    """

    curves: Curves
    method: CurveMethod
    parts: list[Simplified]
    tolerance: float | None = None
    filter: CurveFilter | None = None
    p: float | None = None
    crossings: Crossings | None = None
    refused: int = 0
    n_vertices: int | None = None


def simplified(
    points: npt.ArrayLike | Sequence[npt.ArrayLike] | Curves,
    *,
    closed: bool | None = None,
    method: CurveMethod | None = None,
    tolerance: float | None = None,
    n_vertices: int | None = None,
    valid: bool = False,
    filter: CurveFilter | None = None,
    p: float | None = None,
    lam: float | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    norm: Literal["vertex", "edge"] | None = None,
    eps: float | None = None,
    solver: str | Solver | None = None,
    max_iter: int | None = None,
    tol: float | None = None,
    **options: Unpack[Run],
) -> CurveSimplification:
    """Simplify curves and return a full report; the parameters and errors are those of :func:`simplify_curve`."""
    model: dict[str, Any] = {"p": p, "weights": weights, "norm": norm, "eps": eps, "solver": solver}
    model |= {"max_iter": max_iter, "tol": tol}
    told = [name for name, value in ({"filter": filter, "lam": lam} | model).items() if value is not None]
    method = _method(method, told, tolerance, n_vertices)
    curves = curves_of(points, closed)
    check_numbers({"eps": eps, "tol": tol}, p=p, max_iter=max_iter)
    if lam is not None and n_vertices is not None:
        raise ValueError("give lam or n_vertices, not both: the number of vertices follows from lam")
    if lam is not None and not number("lam", lam, finite=False) > 0:
        raise ValueError(f"lam must be > 0: with 0 all vertices meet; got {lam}")
    _expect_shapes(curves, n_vertices)
    if flag("valid", valid):
        expect_plane(curves.points)
    refused = 0
    if method == "heights":
        if (backend := options.get("backend", "auto")) != "auto":
            # none is needed, but a wrong name is an error
            get(backend)
        height = TOLERANCE if tolerance is None else float(tolerance)
        found = kept_by_height(curves.points, curves.closed, tolerance=height, n_vertices=n_vertices, valid=valid)
        parts = [Simplified(x[kept], kept) for x, kept in zip(curves.points, found.kept, strict=True)]
        tolerance, refused = (height if n_vertices is None else None), found.refused
    elif valid:
        raise ValueError("valid=True is for method='heights': the process does not know which curves cross")
    else:
        filter = choice("filter", filter or "directions", CURVE_FILTERS)
        p = float(_PROCESS["p"] if p is None else p)
        given = {name: value for name, value in model.items() if value is not None}
        settings: dict[str, Any] = {**_PROCESS, **given, **options}
        process = functools.partial(regularize, **settings)
        parts = simplified_by_process(curves, filter, lam, n_vertices, process)
    crossings = crossings_of(curves.points, [part.points for part in parts], curves.closed)
    return CurveSimplification(curves, method, parts, tolerance, filter, p, crossings, refused, n_vertices)


def _method(
    method: CurveMethod | None, told: list[str], tolerance: float | None, n_vertices: int | None
) -> CurveMethod:
    """Choose the method: settings of the process, `told`, ask for the process."""
    if method is not None:
        choice("method", method, CURVE_METHODS)
    if tolerance is not None:
        number("tolerance", tolerance, low=0)
    if told and (method == "heights" or tolerance is not None):
        other = "tolerance" if tolerance is not None else "method='heights'"
        raise ValueError(f"{told[0]} is for method='process', without heights: leave it out, or {other}")
    found: CurveMethod = method or ("process" if told else "heights")
    if tolerance is not None and found == "process":
        raise ValueError("tolerance is for method='heights': the process has lam instead")
    if tolerance is not None and n_vertices is not None:
        raise ValueError("give tolerance or n_vertices, not both: the number of vertices follows from the tolerance")
    return found


def _expect_shapes(curves: Curves, n_vertices: int | None) -> None:
    least = 3 if any(curves.closed) else 2
    if n_vertices is not None and integer("n_vertices", n_vertices) < least:
        what = "a closed" if any(curves.closed) else "an open"
        raise ValueError(f"n_vertices must be at least {least} for {what} curve, got {n_vertices}")
    for k, x in enumerate(curves.points):
        if (x == x[0]).all():
            what = f"curve {k}" if curves.several else "the curve"
            raise ValueError(f"{what} has no shape to simplify: its vertices coincide")


def warnings_of(found: CurveSimplification) -> list[str]:
    """List in sentences what a user must know of the result."""
    told = list(found.curves.left)
    told += crossed(found.crossings, "valid=True" if found.method == "heights" else "method='heights' with valid=True")
    most = max(len(part.kept) for part in found.parts)
    if found.n_vertices is not None and most > found.n_vertices:
        told.append(
            f"a curve keeps {most} vertices instead of {found.n_vertices}: with fewer, curves would cross or part from "
            "a common border"
        )
    return told


@door(options=RUN | {"dtype": STEPS})
@part_of(simplified)
def simplify_curve(found: CurveSimplification) -> Any:
    """Simplify polygonal curves: keep the vertices that describe their shape.

    Parameters
    ----------
    points : (n, d) array, or a list of (n, d) arrays
        The vertices in order, in any dimension; or a line or polygon of shapely, also several. A list is treated as
        one set: `valid` concerns all of its curves.
    closed : bool, optional
        Whether the last vertex is joined to the first. None: as in :func:`denoise_curve`. A first vertex repeated at
        the end is removed, and added again to the result. An open curve keeps its ends.
    method : {"heights", "process"}, optional
        "heights" removes one vertex after another, each time the one that stands least above the segment between its
        neighbours. The result does not depend on how densely the same shape is sampled, and simplifying it again
        changes nothing. "process" is the paper's (figure 7). None: "heights", but "process" if a parameter of the
        process is given.
    tolerance : float, default 0.0015
        The height up to which vertices are removed, relative to the diagonal of the curve's bounding box. The curve can
        move by somewhat more (measured: up to 1.9 times).
    n_vertices : int, optional
        Number of vertices to keep of each curve, instead of `tolerance` or `lam`. For "process" the fidelity is
        searched that keeps this number.
    valid : bool, default False
        For "heights" in the plane: keep a vertex if the curves would cross without it. If the input does not cross, the
        result does not either: holes stay in their polygons. Vertices at the same place, such as those of a common
        border, are removed from all curves or from none.
    filter : {"directions", "positions"}, default "directions"
        For "process": what is made piecewise constant. "directions": the unit vectors along the segments; a vertex is
        kept where they jump. "positions": the vertices (figure 7); one vertex of each group that comes together is
        kept, where the curve turns most, which thins the curve evenly.
    p : float, default 0.5
        For "process": degree of regularity, best below 1.
    lam : float, optional
        For "process": fidelity > 0; larger values keep more vertices. It has no unit: it is multiplied by the length of
        a segment over the mean one for directions, by the mean segment to the power p - 2 for positions. None: 3 and
        0.1.
    weights, norm, eps, solver, max_iter, tol
        For "process": as in :func:`gpureg.regularize`, on the graph of the segments or of the vertices. The defaults
        are 1, "edge", 1e-3 (of unit vectors, or in mean segments), "jacobi", 2000 and 1e-6.
    backend, dtype, memory, callback, progress
        For "process": as in :func:`gpureg.regularize`. The default `dtype` is float64, because there are many small
        steps.

    Returns
    -------
    (k, d) array like `points`, or a list of (k, d) arrays, or objects of shapely

    Raises
    ------
    TypeError, ValueError
        Not a curve; a curve whose vertices coincide; arguments out of range, or of the other method.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        The result crosses itself at more places than the input; a curve has more vertices than `n_vertices` because it
        would cross with fewer.

    Notes
    -----
    "heights" is the rule of Visvalingam and Whyatt (The Cartographic Journal 30(1), 1993) with the height of a triangle
    instead of its area. "process" minimises the energy of :func:`gpureg.regularize` for p < 1, which has many minima:
    it starts at the curve and finds one near it. Consecutive values that differ by at most 0.05 (3 degrees, or a
    twentieth of the mean segment) count as equal; the result depends on how densely the curve is sampled.

    Examples
    --------
    A square of 80 vertices has four:

    >>> import numpy as np, gpureg as gr
    >>> side = np.linspace(0, 1, 20, endpoint=False)
    >>> zero, one = np.zeros(20), np.ones(20)
    >>> x, y = np.concatenate([side, one, 1 - side, zero]), np.concatenate([zero, side, one, 1 - side])
    >>> gr.simplify_curve(np.stack([x, y], axis=1))
    array([[0., 0.],
           [1., 0.],
           [1., 1.],
           [0., 1.]])
    """
    for sentence in warnings_of(found):
        warnings.warn(sentence, UserWarning, stacklevel=outside())
    return found.curves.as_came([part.points for part in found.parts], [part.kept for part in found.parts])
