"""The loop that runs all solvers: checks, history, stop, callback, progress, interruption."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend
from ..doors import calling_back
from ..exchange import as_came
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop
from ..model.rounding import Rounding
from .error_bounds import error_bound

if TYPE_CHECKING:
    # known to mypy without being installed; Python has TypeVar(default=...) from 3.13 on
    from typing_extensions import TypeVar
else:
    from typing import TypeVar


class Iterates(Protocol):
    """The part of a solver's state that the loop reads: the last two iterates, functions (n, m) on the device."""

    @property
    def f(self) -> Array:
        """The last complete iterate."""

    @property
    def previous(self) -> Array:
        """The iterate before it."""


if TYPE_CHECKING:
    # `Solver` without a parameter is a solver with any state
    S = TypeVar("S", bound=Iterates, default=Any)
else:
    S = TypeVar("S", bound=Iterates)


def changed(state: S, **changes: Any) -> S:
    """Return a copy of a state with other values of some attributes.

    It does the same as ``dataclasses.replace``, which would take half the time of an iteration on a small graph.
    """
    made: S = object.__new__(type(state))
    made.__dict__.update(state.__dict__, **changes)
    return made


@dataclass
class Course:
    """The history of a run: each list has one entry per check.

    Attributes
    ----------
    checks : list of int
        Iterations done.
    energies : list of float
        The eps-smoothed energy.
    changes : list of float
        Largest change of a value in the last iteration; infinity before the first.
    gaps : list of float or None
        Duality gap, if the solver computes one.
    tol : float or None
        The tolerance; its meaning depends on the solver.
    span : float
        The data's spread, or 1 for constant data; 0 without a tolerance.
    """

    tol: float | None
    span: float
    checks: list[int] = field(default_factory=list)
    energies: list[float] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    gaps: list[float | None] = field(default_factory=list)

    @property
    def stands_still(self) -> bool:
        """Whether the last change is at most tol times the data's spread."""
        return self.tol is not None and self.changes[-1] <= self.tol * self.span

    def drop_unfinished(self) -> None:
        """Drop a check that was interrupted, so that the gaps match the energies."""
        for column in (self.checks, self.energies, self.changes):
            del column[len(self.gaps) :]


class Solver(ABC, Generic[S]):
    """A solver: its settings only. A separate state has the last two iterates and everything else that changes.

    Attributes
    ----------
    check_every : int
        Iterations between two checks.
    tol : float or None
        The default tolerance.
    most : int
        The default of `max_iter`.
    smooths : bool
        Whether p < 2 needs eps > 0.
    renews : bool
        Whether weights may change during a run.
    patience : int
        Iterations after which a gap that does not fall can end the run.
    """

    check_every: int = 1
    tol: float | None = None

    most: ClassVar[int] = 100
    smooths: ClassVar[bool] = True
    renews: ClassVar[bool] = True
    patience: ClassVar[int] = 100

    def accept(self, problem: Problem) -> None:
        """Raise ValueError unless this solver supports the problem."""

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return how many functions on the vertices and on the edges its state has, without data and two iterates."""
        return 0, 0

    def prepare(self, problem: DeviceProblem) -> DeviceProblem:
        """Return the problem that is solved: an equivalent one, with what the solver needs to know of it."""
        return problem

    @abstractmethod
    def start(self, problem: DeviceProblem, initial: Array) -> S:
        """Return the state before the first iteration, with ``f`` equal to `initial`, (n, m)."""

    def resume(self, problem: DeviceProblem, state: S) -> S:
        """Return the state before the first iteration, from the last state of a run with another p or lam."""
        return self.start(problem, state.f)

    @abstractmethod
    def advance(self, problem: DeviceProblem, state: S) -> S:
        """Do one iteration and return the new state."""

    def settle(self, problem: DeviceProblem, state: S) -> S:
        """Return the state with what was left to the next check, before anything else at it: here reads are allowed."""
        return state

    def next_check(self, state: S, done: int) -> int:
        """Return the number of iterations at the next check."""
        return done - done % self.check_every + self.check_every

    def certify(self, problem: DeviceProblem, state: S, course: Course) -> tuple[S, float | None]:
        """Return the state to continue from, and a bound on the last energy minus the minimum, or None."""
        return state, None

    def judge(self, problem: DeviceProblem, state: S, course: Course) -> Stop | None:
        """Return why to stop at this check, or None; by default stop if a change is at most tol times the spread."""
        return Stop.TOLERANCE if course.stands_still else None

    def error_bound(self, problem: DeviceProblem, state: S, gap: float, energy: float) -> tuple[float | None, str]:
        """Bound the Euclidean distance of f from the minimiser, in units of the frame; None if unknown; and say how.

        `energy` is that of f, and `gap` a bound on its difference from the minimum.
        """
        return error_bound(problem, gap, energy)

    def rounding(self, problem: DeviceProblem, state: S, gap: float, energy: float) -> float:
        """Bound the roundings of an energy with this gap, and of the data, that are not in the gap yet."""
        return Rounding.of(problem, state.f)(energy, gap)

    @abstractmethod
    def describe(self, state: S) -> str:
        """Describe the iterations, as a sentence without its full stop."""


@dataclass(frozen=True)
class Check:
    """The argument of a callback, at a check.

    Attributes
    ----------
    iteration : int
        Iterations done.
    energy : float
        The eps-smoothed energy now.
    change : float
        Largest change of a value in the last iteration, in the data's units; infinity before the first.
    gap : float or None
        Bound on the energy minus its minimum; None unless the solver computes one.
    value : callable
        ``check.value()`` reads the current iterate, (n, m), from the device; only inside the callback. It is
        an array of the data's library.
    """

    iteration: int
    energy: float
    change: float
    gap: float | None
    value: Callable[[], FloatArray]


Callback = Callable[[Check], Any]


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """The result of the loop.

    Attributes
    ----------
    problem : DeviceProblem
        The problem, with the last weights.
    f : device function, (n, m)
        The last complete iterate.
    iterations : int
        Complete iterations done.
    stop : Stop
    course : Course
    method : str
        Description of the iterations, as a sentence.
    state : S
        The solver's last state.
    solver : Solver
    """

    problem: DeviceProblem
    f: Array
    iterations: int
    stop: Stop
    course: Course
    method: str
    state: S
    solver: Solver[S]


def expect_finite(backend: Backend, done: int, *numbers: float) -> None:
    """Raise FloatingPointError unless these numbers, computed after `done` iterations, are finite."""
    if not all(map(math.isfinite, numbers)):
        raise FloatingPointError(
            f"values are not finite after {done} iterations: the data, lam or eps are out of the range of "
            f"{np.dtype(backend.dtype)}; rescale the data, or use float64"
        )


def run(
    problem: DeviceProblem,
    solver: Solver[S],
    initial: Array,
    *,
    max_iter: int,
    tol: float | None,
    callback: Callback | None,
    report: Callable[[int], None],
    update_weights: int | None = None,
    resume: S | None = None,
) -> Outcome[S]:
    """Iterate from `initial`, (n, m), until `max_iter`, a tolerance, the callback or Ctrl-C stops the run.

    `report` is called with the iterations done at each check. Every `update_weights` iterations the weights are
    computed from the current iterate, and the solver restarts there; no tolerance stops the run before the first
    update. `resume`, the state of an earlier run, is used instead of `initial`.

    Raises
    ------
    FloatingPointError
        Values that are no longer finite.
    """
    backend, problem = problem.backend, solver.prepare(problem)
    course = Course(tol, 0.0 if tol is None else problem.problem.spread)
    state, done = solver.start(problem, initial) if resume is None else solver.resume(problem, resume), 0

    def look() -> Stop | None:
        """Add a check to the course; return why to stop, or None."""
        nonlocal state
        state = solver.settle(problem, state)
        change = problem.change(state.f, state.previous) if done else math.inf
        energy = problem.energy(state.f)
        expect_finite(backend, done, energy, *([change] if done else []))
        course.checks.append(done)
        course.energies.append(energy)
        course.changes.append(change)
        state, gap = solver.certify(problem, state, course)
        # an infinite gap is allowed: the dual variable is too large for a bound
        expect_finite(backend, done, *([gap] if gap is not None and math.isnan(gap) else []))
        course.gaps.append(gap)
        if is_told_to_stop():
            return Stop.CALLBACK
        stop = solver.judge(problem, state, course)
        # a fixed point for the first weights says nothing about the next weights
        return None if update_weights is not None and done <= update_weights else stop

    def outcome(stop: Stop) -> Outcome[S]:
        method = solver.describe(state)
        if update_weights is not None:
            method += f", weights computed anew every {update_weights} iteration(s)"
        course.drop_unfinished()
        return Outcome(problem, state.f, done, stop, course, method + ".", state, solver)

    def is_told_to_stop() -> bool:
        if callback is None:
            return False
        now, at, of = state.f, done, problem

        def value() -> FloatArray:
            if done != at:
                raise RuntimeError("check.value() reads the iterate of its own check: call it inside the callback")
            found: FloatArray = as_came(of.problem.back(of.get_function(now)))
            return found

        frame, gap = problem.problem.frame, course.gaps[-1]
        energy, change = frame.energy(course.energies[-1], problem.p), course.changes[-1] * frame.scale
        if gap is not None:
            gap += solver.rounding(problem, state, gap, course.energies[-1])
            gap = frame.energy(gap, problem.p)
        check = Check(done, energy, change, gap, value)
        with calling_back():
            answer = callback(check)
        # only True (also numpy's) stops the run, and no other return value
        return isinstance(answer, bool | np.bool_) and bool(answer)

    try:
        stop = look()
        if stop is not None:
            return outcome(stop)
        while done < max_iter:
            if update_weights is not None and done and done % update_weights == 0:
                host = problem.get_function(solver.settle(problem, state).f)
                anew = solver.prepare(DeviceProblem.put(problem.problem, backend, host))
                problem, state = anew, solver.start(anew, anew.put_function(host))
            check = min(solver.next_check(state, done), max_iter)
            until = check
            if update_weights is not None:
                until = min(until, done - done % update_weights + update_weights)
            while done < until:
                # one assignment of both: an interrupt comes before or after a complete iteration
                state, done = solver.advance(problem, state), done + 1
            if done < check:
                continue  # no check yet: only the weights are updated
            stop = look()
            report(done)
            if stop is not None:
                return outcome(stop)
    except KeyboardInterrupt:
        state = solver.settle(problem, state)
        return outcome(Stop.INTERRUPTED)
    return outcome(Stop.MAX_ITER)
