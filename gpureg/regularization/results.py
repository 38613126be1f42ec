"""Check the settings of a run, and make its result."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, computed_type
from ..checks import flag, integer, number
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from ..model.problem import Problem
from ..model.result import Interrupted, Result, Stop
from ..solvers import Solver
from ..solvers.loop import Callback, Outcome


def as_run(
    method: Solver,
    max_iter: int | None,
    tol: float | None,
    dtype: npt.DTypeLike | None,
    callback: Callback | None,
    progress: bool,
) -> tuple[int, float | None, np.dtype[Any]]:
    """Check the settings of a run; return max_iter, tol (the solver's defaults if None) and the type."""
    if callback is not None and not callable(callback):
        raise TypeError(f"callback must be callable, got {callback!r}")
    flag("progress", progress)
    most = method.most if max_iter is None else max_iter
    tol = method.tol if tol is None else tol
    most = integer("max_iter", most, low=0)
    tol = None if tol is None else number("tol", tol, low=0)
    return most, tol, computed_type(dtype)


def value_of(outcome: Outcome, f0: npt.ArrayLike, graph: Graph | GridGraph) -> npt.NDArray[Any]:
    """Return the value of a run on the host, in the shape of the data."""
    on = outcome.problem
    return as_given(on.problem.back(on.get_function(outcome.f)), f0, graph)


def result_of(outcome: Outcome, value: Any, begin: float, asked: Problem | None = None) -> Result:
    """Make the result of a run that began at the time `begin`; raise Interrupted if it was interrupted.

    `asked` is the problem as it was given, which a solver may change.
    """
    on, course = outcome.problem, outcome.course
    problem, frame = on.problem, on.problem.frame
    # an interruption may come after the last check
    gap = course.gaps[-1] if course.checks[-1:] == [outcome.iterations] else None
    bound, note = None, ""
    if gap is not None:
        gap += outcome.solver.rounding(on, outcome.state, gap, course.energies[-1])
        bound, note = outcome.solver.error_bound(on, outcome.state, gap, course.energies[-1])
    result = Result(
        value=value,
        iterations=outcome.iterations,
        stop=outcome.stop,
        energy=np.array([frame.energy(energy, problem.p) for energy in course.energies]),
        checks=np.array(course.checks),
        gap=None if gap is None else frame.energy(gap, problem.p),
        error_bound=None if bound is None else frame.scale * bound,
        eps=problem.eps * frame.scale,
        method=outcome.method,
        backend=repr(on.backend),
        seconds=time.perf_counter() - begin,
        error_bound_note=note,
        problem=asked,
    )
    if outcome.stop is Stop.INTERRUPTED:
        raise Interrupted(result)
    return result


def as_given(value: FloatArray, f0: npt.ArrayLike, graph: Graph | GridGraph) -> npt.NDArray[Any]:
    """Return a regularized function (n, m) in the shape of the data."""
    if isinstance(graph, GridGraph) and graph.mask is not None:
        # vertices outside the mask are returned unchanged, including NaN
        outside = ~graph.mask.ravel()
        value[outside] = np.asarray(f0).reshape(value.shape)[outside]
    return value.reshape(np.shape(f0))
