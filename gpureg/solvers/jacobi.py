"""The Gauss-Jacobi process of the paper, eq. 25 and 31."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backends import Array, Backend, Numbers, in_turns, scalars
from ..checks import flag, integer, number
from ..doors import door
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .anderson import MEMORY, Anderson
from .loop import changed
from .stopping import LOCAL, Process, ProcessState

# A sweep that still raises the energy after this number of halvings is skipped: the rest is rounding.
_HALVINGS = 30


@dataclass(frozen=True)
class _State(ProcessState):
    theta: float
    why: str  # the reason for theta, "" if it is 1
    numbers: Numbers | None  # scalars on the device, if there is a guard or an acceleration
    anderson: Anderson | None
    guard: Guard | None
    at: int = 0  # the place of f among the two iterates
    pending: int = 0  # sweeps since the last check, with a guard or an acceleration
    halved: int = 0  # how often a sweep was shortened
    mixes: tuple[int, int] = (0, 0)  # rejected, and in all, at the last check


@dataclass(frozen=True)
class Guard:
    """What sweeps need that must not raise the energy.

    The device compares energies, and the host looks at the result at checks only. If a sweep has raised the energy, the
    sweeps since the last check are done again, and the next ones too, now with a look after each, until all sweeps
    between two checks lower it.

    Attributes
    ----------
    anchor : device function, (n, m)
        f at the last check.
    careful : bool
        Whether the host looks after each sweep.
    energy : float
        The energy of f; known if careful.
    halved : int
        How many sweeps had been shortened at the last check.
    """

    anchor: Array
    careful: bool = False
    energy: float = math.nan
    halved: int = 0


@door
@dataclass(frozen=True)
class Jacobi(Process[_State]):
    """Gauss-Jacobi sweeps: each vertex takes the weighted mean of its data and its neighbours (eq. 25, 31).

    Parameters
    ----------
    damping : float, optional
        theta in (0, 1]: f + theta (J(f) - f) instead of J(f). None: 1, the paper's process, except in two cases. For
        p > 2, where the plain sweep can diverge, 1/(p - 1), halved in a sweep that would raise the energy. With lam = 0
        on a bipartite part of the graph (such as the 4-adjacency graph), where the plain sweep can oscillate between
        two states for ever, 1/2. ``Result.method`` says which; ``damping=1`` is the plain sweep in all cases.
    check_every : int, default 10
        Sweeps between two checks of energy and change, which read from the device.
    accelerate : bool, default False
        Anderson acceleration: every fourth iterate is a mix of 11 sweeps of the last 44, accepted only if its energy is
        not above that of the previous iterate; otherwise it is the sweep, and older sweeps are dropped. It needs far
        fewer iterations if the plain process is slow (small lam or eps), otherwise a half to a third; an iteration
        takes several times as long as a sweep over few neighbours, and 23 more functions are stored on the device.
    stop : {"change", "error", "gradient", "energy"}, default "change"
        The stop test. "change": the largest change of a value in an iteration, as a share of the data's spread; the
        distance from the limit can be far larger (800 times at lam = 0.01 on 4-adjacency). "error": the estimated
        distance from the limit, as a share of the spread, if changes go on to decrease at the rate of the last checks;
        it needs three checks, and does not work with `accelerate`, which has no such rate. "gradient": the norm of the
        energy's gradient, as a share of that at the start; for p >= 1 and lam > 0 everywhere ``Result.gap`` then bounds
        how far the energy is above its minimum. "energy": the change of the energy per iteration since the last check,
        as a share of the energy.
    tol : float, optional
        The tolerance if :func:`gpureg.regularize` is called without `tol`. None: no test.

    Raises
    ------
    TypeError, ValueError
        A damping outside (0, 1]; a check_every that is not an integer >= 1; an accelerate that is not a bool; an
        unknown stop; "error" with `accelerate`; a tol that is not >= 0.

    Notes
    -----
    For 0 < p <= 2 and eps > 0 a sweep with damping 1 never raises the eps-smoothed energy. For p > 2 the damping
    1/(p - 1) is enough near the minimiser but not everywhere: by default the energy is computed after every sweep, at
    the cost of one more pass over the edges. With `accelerate` no iteration raises the energy by more than its
    rounding, for any p and damping.

    For p >= 1, lam > 0 and eps > 0 the default converges to the only minimiser from any start. For p < 1 the energy is
    not convex: the result is a local minimum, which depends on the start (`initial`, by default the data) and on
    `accelerate`.

    The gap of "gradient" is sum_u |gradient(u)|^2/(2 lam(u)), as the energy is lam-strongly convex. "error" ends with
    ``Stop.ROUNDING`` if the limit is not reached because of rounding.

    Examples
    --------
    >>> Jacobi(check_every=5)
    Jacobi(damping=None, check_every=5, accelerate=False, stop='change', tol=None)

    The same limit, until the gradient has fallen to 1e-8 of its first norm:

    >>> import numpy as np, gpureg as gr
    >>> f0 = np.array([0, 0, 0.3, 0, 1, 1, 0.8, 1])
    >>> model = {"p": 1, "lam": 0.5, "eps": 0.01, "max_iter": 5000, "backend": "numpy", "dtype": float}
    >>> plain, fast = (
    ...     gr.regularize(f0, gr.GridGraph(8), solver=gr.Jacobi(accelerate=a, stop="gradient", tol=1e-8), **model)
    ...     for a in (False, True)
    ... )
    >>> bool(abs(plain.value - fast.value).max() < 1e-4), fast.iterations < plain.iterations / 3
    (True, True)
    """

    damping: float | None = None
    check_every: int = 10
    accelerate: bool = False
    stop: str = "change"
    tol: float | None = None

    def __post_init__(self) -> None:
        if self.damping is not None:
            number("damping", self.damping, above=0, high=1)
        integer("check_every", self.check_every, low=1)
        flag("accelerate", self.accelerate)
        self.check()
        if self.accelerate and self.stop == "error":
            raise ValueError(
                "stop='error' observes the rate of a process, and accelerated sweeps have none: use stop='gradient', "
                "or accelerate=False"
            )

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: that of the test and the guard, stored sweeps, and a buffer for the mix."""
        functions, edges = super().keeps(problem)
        functions += 1 if self._guards(problem.p) else 0
        return functions + (2 * (MEMORY + 1) + 1 if self.accelerate else 0), edges

    def _guards(self, p: float) -> bool:
        """Return whether sweeps that would raise the energy are shortened."""
        return p > 2 and (self.damping is None or self.accelerate)

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first sweep, from `initial`, (n, m)."""
        theta, why = self.damping, "as asked for"
        if theta is None and problem.p > 2:
            theta, why = 1 / (problem.p - 1), "1/(p - 1): beyond p = 2 the plain sweep can diverge"
        elif theta is None and problem.swings():
            theta, why = 0.5, "lazy: with lam = 0 on a bipartite part the plain sweep can swing between two states"
        elif theta is None:
            theta = 1.0
        empty = problem.backend.empty(problem.weighted.graph, problem.channels)
        backend, guard, anderson, numbers = problem.backend, None, None, None
        if self._guards(problem.p) or self.accelerate:
            numbers = backend.scalars()
        if numbers is not None and self._guards(problem.p):
            anchor = backend.empty(problem.weighted.graph, problem.channels)
            guard = Guard(backend.copy(problem.weighted.graph, initial, out=anchor))
            _measure(problem, numbers, 0, initial)
        if numbers is not None and self.accelerate:
            anderson = Anderson.of(problem, numbers)
        why = "" if theta == 1 else why
        test, local, g = self.test(problem, initial), problem.p < 1, problem.scratch()

        def sweep(backend: Backend, here: tuple[Array, int], there: tuple[Array, int]) -> None:
            f, out = here[0], there[0]
            backend.sweep(problem.weighted, f, problem.f0, problem.lam, problem.model, theta=theta, g=g, out=out)
            if guard is not None and numbers is not None:
                _measure(problem, numbers, there[1], out, backend)
                backend.watch(numbers, scalars.ENERGIES + there[1], scalars.ENERGIES + here[1])

        turns = in_turns(backend, sweep, (initial, 0), (empty, 1))
        return _State(initial, empty, g, test, local, turns, theta, why, numbers, anderson, guard)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one sweep, into the buffer of the second last iterate, and every fourth time mix the last sweeps."""
        if state.guard is not None and state.guard.careful:
            return self._careful(problem, state)
        state.turns[0]()
        if state.numbers is None:
            return changed(state, f=state.previous, previous=state.f, turns=state.turns[::-1])
        anderson = state.anderson
        if anderson is not None:
            anderson = anderson.after(problem, state.f, state.previous, state.at)
            if state.guard is not None and anderson.since == 0:
                _measure(problem, state.numbers, 1 - state.at, state.previous)
        return self._turned(state, anderson=anderson)

    @staticmethod
    def _turned(state: _State, **changes: Any) -> _State:
        """Return the state after a sweep, with the iterates swapped."""
        return changed(
            state,
            f=state.previous,
            previous=state.f,
            turns=state.turns[::-1],
            at=1 - state.at,
            pending=state.pending + 1,
            **changes,
        )

    def _careful(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one sweep, shortened until it does not raise the energy."""
        assert state.guard is not None
        self._sweep(problem, state, state.theta)
        # J(f) - f is a descent direction: a short enough step lowers the energy, up to rounding
        allowed, halved = state.guard.energy * _may_rise(problem), 0
        energy = problem.energy(state.previous)
        while not energy <= allowed and halved < _HALVINGS:
            halved += 1
            self._sweep(problem, state, state.theta / 2**halved if halved < _HALVINGS else 0.0)
            energy = problem.energy(state.previous)
        return self._turned(state, guard=replace(state.guard, energy=energy), halved=state.halved + (halved > 0))

    def settle(self, problem: DeviceProblem, state: _State) -> _State:
        """Do the sweeps since the last check again, with a look at each, if one of them has raised the energy."""
        numbers = state.numbers
        if numbers is None or not state.pending:
            return state
        backend, graph, guard = problem.backend, problem.weighted.graph, state.guard
        values = backend.read(numbers)
        rejected = int(values[scalars.REJECTED])
        state = replace(state, mixes=(rejected, rejected + int(values[scalars.ACCEPTED])))
        if guard is None:
            return replace(state, pending=0)
        if guard.careful:
            if state.halved == guard.halved:
                _measure(problem, numbers, state.at, state.f)
                guard = replace(guard, careful=False)
            else:
                guard = replace(guard, halved=state.halved)
        elif not values[scalars.WORST] <= _may_rise(problem):
            backend.copy(graph, guard.anchor, out=state.f)
            anderson = None if state.anderson is None else state.anderson.begun_anew()
            guard = replace(guard, careful=True, energy=problem.energy(state.f))
            again = replace(state, guard=guard, anderson=anderson, pending=0)
            for _ in range(state.pending):
                again = self._careful(problem, again)
            state = again
            assert state.guard is not None
            guard = replace(state.guard, halved=state.halved)
            backend.begin_scalars(numbers)
        backend.copy(graph, state.f, out=guard.anchor)
        return replace(state, guard=guard, pending=0)

    @staticmethod
    def _sweep(problem: DeviceProblem, state: _State, theta: float) -> None:
        problem.backend.sweep(
            problem.weighted,
            state.f,
            problem.f0,
            problem.lam,
            problem.model,
            theta=theta,
            g=state.g,
            out=state.previous,
        )

    def describe(self, state: _State) -> str:
        """Describe the process, its damping, its mixes, and for p < 1 the kind of result."""
        damped = f", damped by theta = {state.theta:.6g} ({state.why})" if state.why else ""
        shortened = f", {state.halved} sweep(s) shortened so as not to raise the energy" if state.halved else ""
        mixed = f", {state.anderson.describe(*state.mixes)}" if state.anderson is not None else ""
        return f"Gauss-Jacobi (eq. 25){damped}{shortened}{mixed}{LOCAL if state.local else ''}"


def _may_rise(problem: DeviceProblem) -> float:
    """Return the quotient of two energies up to which a rise is rounding."""
    return 1 + 8 * float(np.finfo(problem.backend.dtype).eps)


def _measure(problem: DeviceProblem, numbers: Numbers, at: int, f: Array, backend: Backend | None = None) -> None:
    """Compute the energy of an iterate, (n, m), at its place on the device."""
    to = numbers[scalars.ENERGIES + at]
    (backend or problem.backend).energy_into(to, problem.weighted, f, problem.f0, problem.lam, problem.model)
