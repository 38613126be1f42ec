"""The one loop that runs every solver: checks, history, stop, callback, progress, interruption."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop

if TYPE_CHECKING:
    # mypy knows this module without it being installed; Python has TypeVar(default=...) from 3.13 on
    from typing_extensions import TypeVar
else:
    from typing import TypeVar


class Iterates(Protocol):
    """What the loop reads of a solver's state: the last two iterates, functions (n, m) on the device."""

    @property
    def f(self) -> Array:
        """The last whole iterate."""

    @property
    def previous(self) -> Array:
        """The one before it."""


if TYPE_CHECKING:
    # `Solver` alone is a solver whose state nobody asks for.
    S = TypeVar("S", bound=Iterates, default=Any)
else:
    S = TypeVar("S", bound=Iterates)


@dataclass
class Course:
    """How a run has gone so far: one entry per check in each list.

    Attributes
    ----------
    checks : list of int
        Iterations done.
    energies : list of float
        The eps-smoothed energy.
    changes : list of float
        Largest change of a value in the last iteration; infinity before the first.
    gaps : list of float or None
        Duality gap, where the solver finds one.
    tol : float or None
        What the caller asked for; the solver says of what.
    span : float
        The data's range, or 1 where it has none.
    """

    tol: float | None
    span: float
    checks: list[int] = field(default_factory=list)
    energies: list[float] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    gaps: list[float | None] = field(default_factory=list)

    @property
    def stands_still(self) -> bool:
        """Whether the last change is at most tol times the data's range."""
        return self.tol is not None and self.changes[-1] <= self.tol * self.span

    def drop_unfinished(self) -> None:
        """Drop a check that an interruption cut short, so that no gap stands beside another energy."""
        for column in (self.checks, self.energies, self.changes):
            del column[len(self.gaps) :]


class Solver(ABC, Generic[S]):
    """A solver: settings only. What changes lives in a state of its own type, with the last two iterates.

    Attributes
    ----------
    check_every : int
        Iterations between two checks.
    tol : float or None
        The tolerance where the caller names none.
    most : int
        The default of `max_iter`.
    smooths : bool
        Whether p < 2 needs eps > 0.
    renews : bool
        Whether weights may change under way.
    patience : int
        Iterations before which a gap that stands still is not held against the floating-point type.
    """

    check_every: int = 1
    tol: float | None = None

    most: ClassVar[int] = 100
    smooths: ClassVar[bool] = True
    renews: ClassVar[bool] = True
    patience: ClassVar[int] = 100

    def accept(self, problem: Problem) -> None:
        """ValueError unless this solver can take the problem."""

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Functions on the vertices, and on the directed edges, in its state besides the data and two iterates."""
        return 0, 0

    @abstractmethod
    def start(self, problem: DeviceProblem, initial: Array) -> S:
        """State before the first iteration, whose ``f`` is `initial`, (n, m)."""

    def resume(self, problem: DeviceProblem, state: S) -> S:
        """State before the first iteration, from the end of a run with another p or lam."""
        return self.start(problem, state.f)

    @abstractmethod
    def advance(self, problem: DeviceProblem, state: S) -> S:
        """State after one more iteration."""

    def next_check(self, state: S, done: int) -> int:
        """The number of iterations after which energy and change are looked at next."""
        return done - done % self.check_every + self.check_every

    def certify(self, problem: DeviceProblem, state: S, course: Course) -> tuple[S, float | None]:
        """The state to go on from, and how far the last energy of the course is above the minimum at most, or None."""
        return state, None

    def judge(self, problem: DeviceProblem, state: S, course: Course) -> Stop | None:
        """Why to stop at this check, or None: by default a largest change of at most tol times the data's range."""
        return Stop.TOLERANCE if course.stands_still else None

    @abstractmethod
    def describe(self, state: S) -> str:
        """What the iterations to this state did, as a sentence without its full stop."""


@dataclass(frozen=True)
class Check:
    """What a callback sees at a check.

    Attributes
    ----------
    iteration : int
        Iterations done.
    energy : float
        The eps-smoothed energy now.
    change : float
        Largest change of a value in the last iteration, in the data's units; infinity before the first.
    gap : float or None
        How far the energy is above its minimum at most; None unless the solver certifies it.
    value : callable
        ``check.value()`` reads the current iterate (n, m) back from the device; inside the callback only.
    """

    iteration: int
    energy: float
    change: float
    gap: float | None
    value: Callable[[], FloatArray]


Callback = Callable[[Check], Any]


@dataclass(frozen=True)
class Outcome(Generic[S]):
    """What the loop leaves.

    Attributes
    ----------
    problem : DeviceProblem
        The problem, with the last weights.
    f : device function, (n, m)
        The last whole iterate.
    iterations : int
        Whole iterations done.
    stop : Stop
    course : Course
    method : str
        What the iterations did, as a sentence.
    state : S
        The solver's last state.
    """

    problem: DeviceProblem
    f: Array
    iterations: int
    stop: Stop
    course: Course
    method: str
    state: S


def expect_finite(backend: Backend, done: int, *numbers: float) -> None:
    """FloatingPointError unless these numbers, met after `done` iterations, are finite."""
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
    """Iterate until a stop: `max_iter`, what the solver makes of `tol`, the callback, or Ctrl-C.

    `report` is told the iterations done at each check. Every `update_weights` iterations the weights are computed anew
    from the current iterate, and the solver starts again from there; until that has happened once, no tolerance stops
    the run. `resume`, the state of an earlier run, is used instead of `initial`.

    Raises
    ------
    FloatingPointError
        Values that are no longer finite.
    """
    backend = problem.backend
    course = Course(tol, problem.problem.data_range or 1.0)
    state, done = solver.start(problem, initial) if resume is None else solver.resume(problem, resume), 0

    def look() -> Stop | None:
        """Write down how it goes; whether to stop."""
        nonlocal state
        change = problem.change(state.f, state.previous) if done else math.inf
        energy = problem.energy(state.f)
        expect_finite(backend, done, energy, *([change] if done else []))
        course.checks.append(done)
        course.energies.append(energy)
        course.changes.append(change)
        state, gap = solver.certify(problem, state, course)
        # infinity is a gap that says nothing, as of a dual variable too large
        expect_finite(backend, done, *([gap] if gap is not None and math.isnan(gap) else []))
        course.gaps.append(gap)
        if is_told_to_stop():
            return Stop.CALLBACK
        stop = solver.judge(problem, state, course)
        # near the fixed point of the first weights nothing is said of that of the next
        return None if update_weights is not None and done <= update_weights else stop

    def outcome(stop: Stop) -> Outcome[S]:
        method = solver.describe(state)
        if update_weights is not None:
            method += f", weights computed anew every {update_weights} iteration(s)"
        course.drop_unfinished()
        return Outcome(problem, state.f, done, stop, course, method + ".", state)

    def is_told_to_stop() -> bool:
        if callback is None:
            return False
        now, at, of = state.f, done, problem

        def value() -> FloatArray:
            if done != at:
                raise RuntimeError("check.value() reads the iterate of its own check: call it inside the callback")
            return of.get_function(now)

        check = Check(done, course.energies[-1], course.changes[-1], course.gaps[-1], value)
        answer = callback(check)
        # True alone, numpy's too: a callback that returns something by the way does not stop the run
        return isinstance(answer, bool | np.bool_) and bool(answer)

    try:
        stop = look()
        if stop is not None:
            return outcome(stop)
        while done < max_iter:
            if update_weights is not None and done and done % update_weights == 0:
                host = problem.get_function(state.f)
                anew = DeviceProblem.put(problem.problem, backend, host)
                problem, state = anew, solver.start(anew, anew.put_function(host))
            check = min(solver.next_check(state, done), max_iter)
            until = check
            if update_weights is not None:
                until = min(until, done - done % update_weights + update_weights)
            while done < until:
                # One assignment of a pair: an interrupt falls before or after a whole iteration.
                state, done = solver.advance(problem, state), done + 1
            if done < check:
                continue  # only the weights are due
            stop = look()
            report(done)
            if stop is not None:
                return outcome(stop)
    except KeyboardInterrupt:
        return outcome(Stop.INTERRUPTED)
    return outcome(Stop.MAX_ITER)
