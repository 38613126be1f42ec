"""Solve the dual problem by accelerated proximal gradient steps: for any p >= 1, without smoothing.

The minimiser is f = f0 - d*y / lam for the function y on the directed edges that maximises

    D(y) = - sum_u phi*(|y(u, .)|) - 1/2 sum_u |d*y(u)|^2 / lam(u) + sum_u d*y(u) f0(u)

with phi(t) = (t^2 + eps^2)^(p/2) / p (edge norm: the conjugate of phi/2 on every edge). The first part is separable and
the rest smooth: FISTA (Beck and Teboulle 2009), restarted whenever D falls (O'Donoghue and Candes 2015), which makes
the convergence linear where phi is smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..backends import Array, Backend, Recorded, in_turns
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .loop import Course, Solver, changed


@dataclass(frozen=True)
class _State:
    f: Array  # f0 - d*y / lam
    previous: Array  # the f of y_previous; the next step overwrites it
    y: Array
    y_previous: Array
    p: float  # y is a dual variable for this p
    sigma: float
    unit: float  # of lam and sigma
    turns: tuple[Recorded, Recorded]  # the next iteration, and the one after it
    t: float = 1.0  # momentum
    dual: float = -math.inf  # D at the last check
    restarts: int = 0


@dataclass(frozen=True)
class Dual(Solver[_State]):
    """FISTA on the dual problem."""

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: the start, and two functions on the edges."""
        return 1, 2

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Start from y = 0, or from the slopes of `initial`, (n, m), if these are better."""
        backend, weighted, m = problem.backend, problem.weighted, problem.channels
        y, y_previous = (backend.empty_edges(weighted.graph, m) for _ in range(2))
        f, previous = backend.empty(weighted.graph, m), backend.empty(weighted.graph, m)
        sigma = step_size(problem)
        backend.primal(weighted, y, problem.f0, problem.lam, out=f)
        if backend.max_change(weighted.graph, initial, problem.f0) > 0:
            y, y_previous, f = _from_slopes(problem, initial, y, y_previous, f, sigma)
        backend.copy(weighted.graph, f, out=previous)
        return _begun(problem, f, previous, y, y_previous, sigma)

    def resume(self, problem: DeviceProblem, state: _State) -> _State:
        """Continue from the last y; for p = 1, which needs y in the unit ball, only if it was computed for p = 1."""
        if problem.p == 1 != state.p:
            return self.start(problem, state.f)
        backend, weighted = problem.backend, problem.weighted
        backend.primal(weighted, state.y, problem.f0, problem.lam, out=state.f)
        backend.copy(weighted.graph, state.f, out=state.previous)
        # the first step has beta = 0 and does not use y_previous
        return _begun(problem, state.f, state.previous, state.y, state.y_previous, step_size(problem))

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do a proximal step on y and compute its f, into the buffers of the second last iterates."""
        t = (1 + math.sqrt(1 + 4 * state.t**2)) / 2
        state.turns[0]((state.t - 1) / t)
        return changed(
            state,
            f=state.previous,
            previous=state.f,
            y=state.y_previous,
            y_previous=state.y,
            t=t,
            turns=state.turns[::-1],
        )

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the duality gap; reset the momentum if D has fallen since the last check."""
        energy = course.energies[-1]
        gap = duality_gap(problem, state.f, state.y, energy)
        dual = energy - gap
        fallen = dual < state.dual
        return replace(state, dual=dual, t=1.0 if fallen else state.t, restarts=state.restarts + fallen), gap

    def next_check(self, state: _State, done: int) -> int:
        """Return a check after a tenth more iterations, so that checks cost at most a tenth."""
        return done + max(10, done // 10)

    def describe(self, state: _State) -> str:
        """Describe the process, and its number of restarts."""
        again = f", begun anew {state.restarts} time(s)" if state.restarts else ""
        return f"Accelerated proximal gradient on the dual problem, step {state.sigma / state.unit:.6g}{again}"


def _begun(problem: DeviceProblem, f: Array, previous: Array, y: Array, y_previous: Array, sigma: float) -> _State:
    """Return the state before the first step."""

    def step(backend: Backend, here: tuple[Array, Array], there: tuple[Array, Array], beta: float) -> None:
        """Overwrite the second last y and f by the next ones."""
        backend.dual_step(problem.weighted, here[0], there[0], here[1], there[1], problem.model, beta=beta, sigma=sigma)
        backend.primal(problem.weighted, there[0], problem.f0, problem.lam, out=there[1])

    turns = in_turns(problem.backend, step, (y, f), (y_previous, previous))
    return _State(f, previous, y, y_previous, problem.p, sigma, _unit(problem), turns)


def _unit(problem: DeviceProblem) -> float:
    """Return lam in units of the frame, for a lam of 1."""
    return float(problem.problem.frame.lam(np.ones(()), problem.p))


def hidden(problem: DeviceProblem, energy: float) -> float:
    """Return a bound on the rounding error of a gap: p machine epsilons of the energy.

    The largest terms of the gap, <y, df>, sum to p times the smoothness of f. Measured in float32 for p = 1 to 8 on
    every device: 0.13 machine epsilons.
    """
    return problem.p * float(np.finfo(problem.backend.dtype).eps) * energy


def duality_gap(problem: DeviceProblem, f: Array, y: Array, energy: float) -> float:
    """Compute the gap of f, (n, m), with this energy, and y on the edges, plus a bound on its rounding error.

    Raises
    ------
    FloatingPointError
        A negative gap beyond rounding: powers underflow or overflow in the type.
    """
    gap = problem.duality_gap(f, y)
    rounding = hidden(problem, energy)
    if gap < -16 * rounding:
        raise FloatingPointError(
            f"the duality gap comes out below 0: the data, lam or eps are out of the range of "
            f"{np.dtype(problem.backend.dtype)} for p = {problem.p:g}; rescale the data, or use float64"
        )
    return max(gap + rounding, 0.0)


def step_size(problem: DeviceProblem) -> float:
    """Compute the step 1/(4 max_u sum_v gamma(u, v)^2 / lam(u)), which is at most 1/|d lam^(-1/2)|^2.

    |d x|^2 = sum over the directed edges of (gamma_vu x(v) - gamma_uv x(u))^2 <= 4 sum_u x(u)^2 sum_v gamma_uv^2.
    """
    graph, backend = problem.weighted.graph, problem.backend
    degree = backend.get(graph, backend.degree(problem.weighted))[:, 0].astype(np.float64)
    lam = problem.lam if isinstance(problem.lam, float) else backend.get(graph, problem.lam)[:, 0].astype(np.float64)
    largest = float(np.max(degree / lam, initial=0))
    return 1 / (4 * largest * (1 + 1e-6)) if largest > 0 else 1.0


def _from_slopes(
    problem: DeviceProblem, initial: Array, y: Array, other: Array, f: Array, sigma: float
) -> tuple[Array, Array, Array]:
    """Return y from the slopes of `initial`, (n, m), or y = 0, whichever has the smaller gap; a buffer; and its f."""
    backend, weighted = problem.backend, problem.weighted
    without = problem.duality_gap(f, y)
    # a long proximal step ends at the slope; 100 step lengths are long enough and keep enough digits
    backend.dual_step(weighted, y, other, initial, initial, problem.model, beta=0.0, sigma=100 * sigma)
    y, other = other, y
    backend.primal(weighted, y, problem.f0, problem.lam, out=f)
    if problem.duality_gap(f, y) < without:
        return y, other, f
    backend.primal(weighted, other, problem.f0, problem.lam, out=f)
    return other, y, f
