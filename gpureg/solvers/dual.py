"""The dual problem by accelerated proximal gradient steps: any p >= 1, no smoothing needed.

With y on the directed edges the minimiser is f = f0 - d*y / lam at the y that maximises

    D(y) = - sum_u phi*(|y(u, .)|) - 1/2 sum_u |d*y(u)|^2 / lam(u) + sum_u d*y(u) f0(u)

with phi(t) = (t^2 + eps^2)^(p/2) / p (the edge norm: the conjugate of phi/2 on every edge). The second part is smooth,
the first separable: Beck and Teboulle's FISTA (2009), begun anew whenever D falls (O'Donoghue and Candes 2015), which
makes it linear where phi is smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..backends import Array
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .loop import Course, Solver


@dataclass(frozen=True)
class _State:
    f: Array  # f0 - d*y / lam
    previous: Array  # of y_previous, to be overwritten by the next
    y: Array
    y_previous: Array
    p: float  # for which y is a dual variable
    sigma: float
    t: float = 1.0  # of the momentum
    dual: float = -math.inf  # D at the last check
    restarts: int = 0


@dataclass(frozen=True)
class Dual(Solver[_State]):
    """FISTA on the dual problem."""

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """The start, and two functions on the edges."""
        return 1, 2

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """From y = 0, or from the slopes of `initial` where these are better."""
        backend, weighted, m = problem.backend, problem.weighted, problem.channels
        y, y_previous = (backend.empty_edges(weighted.graph, m) for _ in range(2))
        f, previous = backend.empty(weighted.graph, m), backend.empty(weighted.graph, m)
        sigma = step_size(problem)
        backend.primal(weighted, y, problem.f0, problem.lam, out=f)
        if backend.max_change(weighted.graph, initial, problem.f0) > 0:
            y, y_previous, f = _from_slopes(problem, initial, y, y_previous, f, sigma)
        backend.copy(weighted.graph, f, out=previous)
        return _State(f, previous, y, y_previous, problem.p, sigma)

    def resume(self, problem: DeviceProblem, state: _State) -> _State:
        """From the dual variable that there is; for p = 1, which wants it in the unit ball, it must be one of p = 1."""
        if problem.p == 1 != state.p:
            return self.start(problem, state.f)
        backend, weighted = problem.backend, problem.weighted
        backend.primal(weighted, state.y, problem.f0, problem.lam, out=state.f)
        backend.copy(weighted.graph, state.f, out=state.previous)
        # with beta = 0 in the first step, y_previous does not count
        return _State(state.f, state.previous, state.y, state.y_previous, problem.p, step_size(problem))

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """A proximal step on y and the f that belongs to it, into the buffers of the iterates before the last."""
        backend, weighted = problem.backend, problem.weighted
        t = (1 + math.sqrt(1 + 4 * state.t**2)) / 2
        backend.dual_step(
            weighted,
            state.y,
            state.y_previous,
            state.f,
            state.previous,
            problem.model,
            beta=(state.t - 1) / t,
            sigma=state.sigma,
        )
        backend.primal(weighted, state.y_previous, problem.f0, problem.lam, out=state.previous)
        return replace(state, f=state.previous, previous=state.f, y=state.y_previous, y_previous=state.y, t=t)

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """The duality gap; a D that has fallen since the last check ends the momentum."""
        energy = course.energies[-1]
        gap = duality_gap(problem, state.f, state.y, energy)
        dual = energy - gap
        fallen = dual < state.dual
        return replace(state, dual=dual, t=1.0 if fallen else state.t, restarts=state.restarts + fallen), gap

    def next_check(self, state: _State, done: int) -> int:
        """A tenth further, so that looking costs a tenth at most."""
        return done + max(10, done // 10)

    def describe(self, state: _State) -> str:
        """The process, and how often it began anew."""
        again = f", begun anew {state.restarts} time(s)" if state.restarts else ""
        return f"Accelerated proximal gradient on the dual problem, step {state.sigma:.6g}{again}"


def hidden(problem: DeviceProblem, energy: float) -> float:
    """What rounding may hide of a gap: p machine epsilons of the energy.

    The largest terms of the gap, <y, df>, sum up to p times the smoothness of f. Measured in float32, for p = 1 to 8 on
    every device: 0.13 machine epsilons.
    """
    return problem.p * float(np.finfo(problem.backend.dtype).eps) * energy


def duality_gap(problem: DeviceProblem, f: Array, y: Array, energy: float) -> float:
    """The gap between f, whose energy is given, and y, with what rounding may hide of it.

    Raises
    ------
    FloatingPointError
        A gap further below 0 than that: powers under- or overflow in the type.
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
    """1/(4 max_u sum_v gamma(u, v)^2 / lam(u)) over the vertices that move: at most 1/|d lam^(-1/2)|^2.

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
    """The dual variable that a function's own slopes give, or y = 0, whichever has the smaller gap; with its f."""
    backend, weighted = problem.backend, problem.weighted
    without = problem.duality_gap(f, y)
    # Far out a proximal step lands on the slope itself; 100 steps are far, and leave digits.
    backend.dual_step(weighted, y, other, initial, initial, problem.model, beta=0.0, sigma=100 * sigma)
    y, other = other, y
    backend.primal(weighted, y, problem.f0, problem.lam, out=f)
    if problem.duality_gap(f, y) < without:
        return y, other, f
    backend.primal(weighted, other, problem.f0, problem.lam, out=f)
    return other, y, f
