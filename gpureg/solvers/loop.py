"""The one loop that runs every solver: checks, history, stop, callback, progress, interruption."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..backends import Array, Backend
from ..graph import FloatArray
from ..problem import DeviceProblem
from ..result import Stop


class Solver(ABC):
    """A solver: settings only; what changes lives in a state that has ``f`` and ``previous``, the last two iterates."""

    check_every: int

    @abstractmethod
    def start(self, problem: DeviceProblem, initial: Array) -> Any:
        """State before the first iteration, whose ``f`` is `initial`."""

    @abstractmethod
    def advance(self, problem: DeviceProblem, state: Any) -> Any:
        """State after one more iteration."""

    @abstractmethod
    def describe(self, state: Any) -> str:
        """What the iterations from this state do, as a sentence without its full stop."""


def check_settings(settings: dict[str, Any], *, integers: tuple[str, ...] = ("check_every",)) -> None:
    """TypeError or ValueError unless these settings of a solver are numbers; the integers at least 1."""
    for name, value in settings.items():
        kinds = (int, np.integer) if name in integers else (int, float, np.number)
        if value is not None and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise TypeError(f"{name} must be {'an integer' if name in integers else 'a number'}, got {value!r}")
        if name in integers and not (value is not None and value >= 1):
            raise ValueError(f"{name} must be >= 1, got {value}")


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
    value : callable
        ``check.value()`` reads the current iterate (n, m) back from the device; inside the callback only.
    """

    iteration: int
    energy: float
    change: float
    value: Callable[[], FloatArray]


Callback = Callable[[Check], Any]


@dataclass(frozen=True)
class Outcome:
    """What the loop leaves: the last whole iterate on the device, the problem it belongs to, and its history."""

    problem: DeviceProblem
    f: Array
    iterations: int
    stop: Stop
    energy: list[float]
    checks: list[int]
    method: str


def expect_finite(backend: Backend, done: int, *numbers: float) -> None:
    """FloatingPointError unless these numbers, met after `done` iterations, are finite."""
    if not all(map(math.isfinite, numbers)):
        raise FloatingPointError(
            f"values are not finite after {done} iterations: the data, lam or eps are out of the range of "
            f"{np.dtype(backend.dtype)}; rescale the data, or use float64"
        )


@contextmanager
def progress_bar(show: bool, total: int, unit: str = "iterations") -> Iterator[Callable[[int], None]]:
    """A bar on the terminal's error stream that leaves nothing behind; it pulses until the first report."""
    if not show:
        yield lambda done: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done: bar.update(task, total=total, completed=done)


def run(
    problem: DeviceProblem,
    solver: Solver,
    initial: Array,
    *,
    max_iter: int,
    threshold: float | None,
    callback: Callback | None,
    report: Callable[[int], None],
    update_weights: int | None = None,
) -> Outcome:
    """Iterate until a stop: `max_iter`, a largest change of at most `threshold`, the callback, or Ctrl-C.

    `report` is told the iterations done at each check. Every `update_weights` iterations the weights are computed anew
    from the current iterate, and the solver starts again from there.

    Raises
    ------
    FloatingPointError
        Values that are no longer finite.
    """
    backend = problem.backend
    energies, checks = [problem.energy(initial)], [0]
    state, done = solver.start(problem, initial), 0

    expect_finite(backend, done, energies[0])

    def outcome(stop: Stop) -> Outcome:
        method = solver.describe(state)
        if update_weights is not None:
            method += f", weights computed anew every {update_weights} iteration(s)"
        return Outcome(problem, state.f, done, stop, energies, checks, method + ".")

    def is_told_to_stop(change: float) -> bool:
        if callback is None:
            return False
        now, at, of = state.f, done, problem

        def value() -> FloatArray:
            if done != at:
                raise RuntimeError("check.value() reads the iterate of its own check: call it inside the callback")
            return of.get_function(now)

        check = Check(done, energies[-1], change, value)
        return callback(check) is True

    try:
        if is_told_to_stop(math.inf):
            return outcome(Stop.CALLBACK)
        while done < max_iter:
            if update_weights is not None and done and done % update_weights == 0:
                host = problem.get_function(state.f)
                anew = DeviceProblem.put(problem.problem, backend, host)
                problem, state = anew, solver.start(anew, anew.put_function(host))
            until = min(done - done % solver.check_every + solver.check_every, max_iter)
            if update_weights is not None:
                until = min(until, done - done % update_weights + update_weights)
            while done < until:
                # One assignment of a pair: an interrupt falls before or after a whole iteration.
                state, done = solver.advance(problem, state), done + 1
            if done % solver.check_every and done < max_iter:
                continue  # only the weights are due
            change = problem.change(state.f, state.previous)
            energy = problem.energy(state.f)
            expect_finite(backend, done, change, energy)
            energies.append(energy)
            checks.append(done)
            report(done)
            if is_told_to_stop(change):
                return outcome(Stop.CALLBACK)
            if threshold is not None and change <= threshold:
                return outcome(Stop.TOLERANCE)
    except KeyboardInterrupt:
        return outcome(Stop.INTERRUPTED)
    return outcome(Stop.MAX_ITER)
