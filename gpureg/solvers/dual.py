"""Solve the dual problem by accelerated proximal gradient steps: for any p >= 1, without smoothing.

The minimiser is f = f0 - d*y / lam for the function y on the directed edges that maximises

    D(y) = - sum_u phi*(|y(u, .)|) - 1/2 sum_u |d*y(u)|^2 / lam(u) + sum_u d*y(u) f0(u)

with phi(t) = (t^2 + eps^2)^(p/2) / p (edge norm: the conjugate of phi/2 on every edge). The first part is separable and
the rest smooth: FISTA (Beck and Teboulle 2009), restarted whenever D falls (O'Donoghue and Candes 2015), which makes
the convergence linear where phi is smooth. Where lam or the degrees vary, each vertex has a step length of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Recorded, in_turns
from ..graphs.grid import AnyGraph, GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .loop import Course, Solver, changed

# A step length per vertex is used where the median is this many times the minimum: it costs a read per vertex or edge.
_VARIES = 1.25


@dataclass(frozen=True)
class _State:
    f: Array  # f0 - d*y / lam
    previous: Array  # the f of y_previous; the next step overwrites it
    y: Array
    y_previous: Array
    p: float  # y is a dual variable for this p
    sigma: float | Array  # a number or (n, 1)
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
        step = f"step {state.sigma / state.unit:.6g}" if isinstance(state.sigma, float) else "a step length per vertex"
        return f"Accelerated proximal gradient on the dual problem, {step}{again}"


def _begun(
    problem: DeviceProblem, f: Array, previous: Array, y: Array, y_previous: Array, sigma: float | Array
) -> _State:
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


def step_size(problem: DeviceProblem) -> float | Array:
    """Compute the step sigma: a number, or (n, 1) on the device where this is much larger at most vertices.

    With D(w) = sum_v gamma(w, v)^2, and with sigma(u) for the edges that start at u,

        sum over directed edges of sigma(u) (x(v) gamma_vu/sqrt(lam(v)) - x(u) gamma_uv/sqrt(lam(u)))^2
            <= sum_w x(w)^2 4 D(w)/lam(w) max of sigma over w and its neighbours

    This is at most |x|^2 if sigma(u) is the minimum of lam(w)/(4 D(w)) over u and its neighbours; with the edge norm
    an edge has the minimum of both its ends, which the primitive takes. The number is the minimum over all vertices.
    """
    graph, backend = problem.weighted.graph, problem.backend
    degree = backend.get(graph, backend.degree(problem.weighted)).astype(np.float64)
    lam = problem.lam if isinstance(problem.lam, float) else backend.get(graph, problem.lam).astype(np.float64)
    # lam is infinite at pinned vertices: they take no part, nor do vertices without edges
    bound = np.where(degree > 0, lam / (4 * (1 + 1e-6) * np.where(degree > 0, degree, 1)), np.inf)
    least = float(np.min(bound, initial=np.inf))
    if not math.isfinite(least):
        return 1.0
    own = bound if problem.edge_norm else smallest_around(graph, bound)
    # a pinned vertex takes any number; no step is more than 1e6 times another, so that digits are left
    own = np.minimum(own, 1e6 * least)
    return backend.put(graph, own) if float(np.median(own)) > _VARIES * least else least


def smallest_around(graph: AnyGraph, x: FloatArray) -> FloatArray:
    """Compute the minimum of x, (n, 1), over each vertex and its neighbours."""
    found = x.copy()
    if isinstance(graph, GridGraph):
        given, least = x.reshape(graph.shape), found.reshape(graph.shape)
        for step in graph.offsets:
            start, end = graph.ends(step)
            np.minimum(least[start], given[end], out=least[start])
        return found
    np.minimum.at(found[:, 0], graph.edge_rows(), x[graph.indices, 0])
    return found


def _from_slopes(
    problem: DeviceProblem, initial: Array, y: Array, other: Array, f: Array, sigma: float | Array
) -> tuple[Array, Array, Array]:
    """Return y from the slopes of `initial`, (n, m), or y = 0, whichever has the smaller gap; a buffer; and its f."""
    backend, weighted = problem.backend, problem.weighted
    without = problem.duality_gap(f, y)
    # a long proximal step ends at the slope; 100 step lengths are long enough and keep enough digits
    long = 100 * sigma if isinstance(sigma, float) else backend.combine(weighted.graph, 100.0, sigma, 0.0, sigma)
    backend.dual_step(weighted, y, other, initial, initial, problem.model, beta=0.0, sigma=long)
    y, other = other, y
    backend.primal(weighted, y, problem.f0, problem.lam, out=f)
    if problem.duality_gap(f, y) < without:
        return y, other, f
    backend.primal(weighted, other, problem.f0, problem.lam, out=f)
    return other, y, f
