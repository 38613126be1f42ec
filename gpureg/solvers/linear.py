"""Solve p = 2, the linear system (lam + Laplacian) f = lam f0, by conjugate gradients on the device.

Eq. 20 counts every edge from both ends: with gamma = sqrt(w) the matrix is lam I + 2 L, with the edge norm lam I + L.
The gap is the sum of |lam (f - f0) + Laplacian f|^2 / (2 lam); ``dominance.py`` has one for lam = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..backends import Array, Backend, Recorded, in_turns
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .dominance import Dominance, rounding_of_residual
from .dual import duality_gap
from .loop import Course, Solver, changed
from .systems import Gradients, Multigrid, System

_BOUND = "From the residual and a function h with A h > 0, where A is the matrix of the linear system."


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    system: System
    work: Gradients
    dominance: Dominance | None  # where lam has zeros
    slopes: Array | None  # memory for a function on the edges, where lam has zeros and there is no h
    turns: tuple[Recorded, Recorded]  # the next step, and the one after it
    check: int = 0  # the iteration of the next check, if it can be predicted


@dataclass(frozen=True)
class Linear(Solver[_State]):
    """Conjugate gradients, preconditioned by cosine transforms on a uniform grid, by multigrid, or by the diagonal."""

    patience = 50

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: start, residual, direction, preconditioner with its output, and scratch memory.

        Cosine transforms on a GPU have a work space of two more. All levels of multigrid together have two functions
        and about twice the edges of the first one.
        """
        return 10 if isinstance(problem.graph, GridGraph) else 9, 2

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first step, from `initial`, (n, m)."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        f, previous = (backend.empty(graph, m) for _ in range(2))
        backend.copy(graph, initial, out=f)
        system, work = System.of(problem), Gradients.empty(problem, m)
        dominance, slopes = None if problem.box is None else Dominance.of(problem, system), None
        if problem.box is not None and dominance is None:
            slopes = backend.empty_edges(graph, m)

        def step(backend: Backend, here: tuple[Array, int], there: tuple[Array, int]) -> None:
            """Do a step from f and its number to the other ones."""
            work.step(backend, problem, system, system.preconditioner, here, there)

        turns = in_turns(backend, step, (f, 0), (previous, 1))
        return _begun(problem, _State(f, previous, system, work, dominance, slopes, turns))

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one step of conjugate gradients."""
        if not state.system.preconditioner.on_device:
            state.system.preconditioner.solve(problem.backend, state.work.residual)
        state.turns[0]()
        return changed(state, f=state.previous, previous=state.f, turns=state.turns[::-1])

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the gap from the true residual, or without a function h from the slopes of f and the box.

        Conjugate gradients restart if the true residual is larger than that of the recursion.
        """
        if state.slopes is not None:
            return self._within_box(problem, state, state.slopes, course)
        expected = _gap(problem, state, state.work.residual)
        state.system.residual(problem, state.f, state.work.scratch)
        gap = _gap(problem, state, state.work.scratch)
        state = replace(state, check=_next_check(course, gap))
        return (_begun(problem, state) if gap > 2 * expected else state), gap

    def _within_box(self, problem: DeviceProblem, state: _State, y: Array, course: Course) -> tuple[_State, float]:
        backend, graph = problem.backend, problem.weighted.graph
        residual, scratch = state.work.residual, state.work.scratch
        backend.combine(graph, 0.0, state.f, state.system.share, state.f, out=scratch)
        backend.difference(problem.weighted, scratch, out=y)
        gap = duality_gap(problem, state.f, y, course.energies[-1])
        expected = backend.dot(graph, residual, residual)
        state.system.residual(problem, state.f, scratch)
        # twice the residual is four times its square
        restarts = backend.dot(graph, scratch, scratch) > 4 * expected
        return (_begun(problem, state) if restarts else state), gap

    def error_bound(self, problem: DeviceProblem, state: _State, gap: float, energy: float) -> tuple[float | None, str]:
        """Bound the distance by the residual, or in general."""
        general, said = super().error_bound(problem, state, gap, energy)
        if state.dominance is None:
            return general, said
        assert state.system.matrix is not None
        residual = state.system.residual(problem, state.f, state.work.scratch)
        lost = rounding_of_residual(problem, state.system.matrix, state.f)
        bound = state.dominance.error(problem.backend.get(problem.weighted.graph, residual).astype(float), lost)
        if problem.scale is not None:
            bound /= float(problem.scale.min())
        return (bound, _BOUND) if general is None or bound < general else (general, said)

    def rounding(self, problem: DeviceProblem, state: _State, gap: float, energy: float) -> float:
        """Bound the roundings that are not in the gap: not those of products with the box, but of the residual."""
        if state.slopes is not None:
            return super().rounding(problem, state, gap, energy)
        found, matrix = super().rounding(replace(problem, box=None), state, gap, energy), state.system.matrix
        if state.dominance is None or matrix is None:
            return found
        lost = rounding_of_residual(problem, matrix, state.f)
        more = state.system.share * state.dominance.gap_of(lost, problem.channels)
        # the root of the gap is a norm of the residual
        return found + 2 * math.sqrt(gap * more) + more

    def next_check(self, state: _State, done: int) -> int:
        """Return a check after a tenth more iterations; a check costs about as much as a step without multigrid.

        With multigrid, the gap falls evenly enough to predict the check that ends the run.
        """
        if not isinstance(state.system.preconditioner, Multigrid):
            return done + max(1, done // 10)
        return max(done + 1, state.check if state.check > done else done + max(3, done // 10))

    def describe(self, state: _State) -> str:
        """Describe the method and its preconditioner."""
        by = state.system.preconditioner.name
        return f"The linear system of p = 2 by conjugate gradients, preconditioned by {by}"


def _next_check(course: Course, gap: float) -> int:
    """Predict from two gaps a check shortly before the tolerance is reached; 0 if nothing can be said."""
    if not course.gaps or len(course.checks) < 2 or not course.tol:
        return 0
    # the last gap of the course is that of the check before
    before, steps, target = course.gaps[-1], course.checks[-1] - course.checks[-2], course.tol * course.energies[-1]
    if before is None or not before > gap > target > 0 or not math.isfinite(before):
        return 0
    left = steps * math.log(gap / target) / math.log(before / gap)
    # the rate grows while conjugate gradients learn the spectrum
    return course.checks[-1] + min(max(1, int(0.75 * left)), 25)


def _gap(problem: DeviceProblem, state: _State, residual: Array) -> float:
    """Compute the gap from the residual, (n, m), in the units of the problem's energy."""
    over = state.system.lam if state.dominance is None else state.dominance.over
    return state.system.share * problem.backend.dot(problem.weighted.graph, residual, residual, over=over) / 2


def _begun(problem: DeviceProblem, state: _State) -> _State:
    """Restart the recursion from the true residual of f: the first direction is the preconditioned residual."""
    state.system.residual(problem, state.f, state.work.residual)
    state.work.begin(problem)
    return state
