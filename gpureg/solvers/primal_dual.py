"""Alternate proximal steps on f and on the dual variable: for any p >= 1 and any lam, also 0.

The energy is the maximum over y on the directed edges of <df, y> - sum_u phi*(|y(u, .)|), plus the fidelity. Steps of
Chambolle and Pock (2011), with step lengths of their own at each vertex (Pock and Chambolle 2011):

    y+ = prox of sigma phi* at  y + sigma d(2 f - f_previous)
    f+ = prox of tau times the fidelity at  f - tau d*y+,  clipped to the box

sigma(u) belongs to the edges that start at u (edge norm: the smaller one of both ends). They converge if |d x|^2 with
the weights sigma is at most sum_u x(u)^2/tau(u), and

    |d x|^2 = sum over directed edges of sigma(u) (gamma_vu x(v) - gamma_uv x(u))^2
           <= sum_u x(u)^2 2 (sigma(u) sum_v gamma_uv^2 + sum_v gamma_uv^2 sigma(v))
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Recorded, in_turns
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .dual import duality_gap
from .loop import Course, Solver, changed

# tau times the sum of sigma is at most this: the rounding of the step lengths.
_BELOW = 1 - 1e-6
# tau/sigma in units of the frame, in which the data's spread is about 1. Of 0.003 to 1, the gap fell fastest with 0.03
# at p = 1, 0.1 to 0.3 at 1.2, 0.3 to 1 at 1.5, on a picture with a hole and on nearest neighbours with ten labels.
_RATIO, _DECADES, _MOST = 0.03, 2.6, 1.0


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array  # the next step overwrites it
    y: Array
    y_previous: Array
    turns: tuple[Recorded, Recorded]  # the next iteration, and the one after it
    ratio: float


@dataclass(frozen=True)
class PrimalDual(Solver[_State]):
    """The steps of Chambolle and Pock, with a step length per vertex."""

    ratio: float | None = None  # of tau to sigma; None: one that suits p

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: the start, both step lengths, and two functions on the edges."""
        return 2, 2

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Start at `initial`, (n, m), with y from its slopes."""
        backend, weighted, m = problem.backend, problem.weighted, problem.channels
        y, y_previous = (backend.empty_edges(weighted.graph, m) for _ in range(2))
        f, previous = backend.empty(weighted.graph, m), backend.empty(weighted.graph, m)
        backend.copy(weighted.graph, initial, out=f)
        backend.copy(weighted.graph, initial, out=previous)
        # at p = 2 these slopes solve the dual problem; a long step ends at the slopes of any p > 1
        length = (0.5 if problem.edge_norm else 1.0) if problem.p == 1 else 100.0
        backend.dual_step(weighted, y, y_previous, f, f, problem.model, beta=0.0, sigma=length)
        return self._begun(problem, f, previous, y_previous, y)

    def resume(self, problem: DeviceProblem, state: _State) -> _State:
        """Continue from the last f."""
        return self.start(problem, state.f)

    def _begun(self, problem: DeviceProblem, f: Array, previous: Array, y: Array, y_previous: Array) -> _State:
        """Return the state before the first step."""
        ratio = min(_RATIO * 10 ** (_DECADES * (problem.p - 1)), _MOST) if self.ratio is None else self.ratio
        sigma, tau = step_lengths(problem, ratio)

        def step(backend: Backend, here: tuple[Array, Array], there: tuple[Array, Array]) -> None:
            """Overwrite the second last y and f by the next ones."""
            backend.dual_step(
                problem.weighted, here[0], there[0], here[1], there[1], problem.model, beta=(1.0, 0.0), sigma=sigma
            )
            backend.proximal(
                problem.weighted, here[1], there[0], problem.f0, problem.lam, tau, box=problem.box, out=there[1]
            )

        turns = in_turns(problem.backend, step, (y, f), (y_previous, previous))
        return _State(f, previous, y, y_previous, turns, ratio)

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do a step on y and one on f, into the buffers of the second last iterates."""
        state.turns[0]()
        return changed(
            state,
            f=state.previous,
            previous=state.f,
            y=state.y_previous,
            y_previous=state.y,
            turns=state.turns[::-1],
        )

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the duality gap."""
        return state, duality_gap(problem, state.f, state.y, course.energies[-1])

    def next_check(self, state: _State, done: int) -> int:
        """Return a check after a tenth more iterations, so that checks cost at most a tenth."""
        return done + max(10, done // 10)

    def describe(self, state: _State) -> str:
        """Describe the process."""
        return f"Primal-dual proximal steps (Chambolle and Pock), a step length per vertex, ratio {state.ratio:g}"


def step_lengths(problem: DeviceProblem, ratio: float) -> tuple[float | Array, Array]:
    """Return sigma, a number or (n, 1), and tau, (n, 1), on the device; tau/sigma is about `ratio`."""
    backend, weighted = problem.backend, problem.weighted
    graph = weighted.graph
    degree = backend.get(graph, backend.degree(weighted)).astype(np.float64)
    if weighted.directed or not degree.any():
        # the sum over the opposite edges is known for one sigma only
        sigma: FloatArray = np.full_like(degree, 1 / np.sqrt(4 * ratio * max(degree.max(initial=0), 1e-30)))
        total = 2 * degree * sigma
    else:
        usual = np.median(degree[degree > 0])
        sigma = 1 / np.sqrt(4 * ratio * np.where(degree > 0, degree, usual))
        rounded = backend.put(graph, sigma)
        sigma = backend.get(graph, rounded).astype(np.float64)
        # 2 sum_v w (sigma(u) - sigma(v))
        out = backend.get(graph, backend.gradient(weighted, rounded, None, None, 0.0)).astype(np.float64)
        total = np.maximum(2 * degree * sigma - out / 2, degree * sigma)
    tau = np.where(total > 0, _BELOW / (2 * np.where(total > 0, total, 1)), 1.0)
    if weighted.directed:
        return float(sigma[0, 0]), backend.put(graph, tau)
    return backend.put(graph, sigma), backend.put(graph, tau)
