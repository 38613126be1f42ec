"""Primal-dual Newton steps on the device.

The minimiser and its dual variable satisfy lam (f - f0) + d*y = 0 and y = phi'(|df|) df/|df|. For p < 2 Newton's method
on y (|df|^2 + eps^2)^((2 - p)/2) = df (Chan, Golub and Mulet 1999, for p = 1) hardly depends on eps, but Newton's
method on f alone is slow for a small eps. Eliminating the change of y gives for the change h of f

    lam h + d* [ g dh - k/2 (y <df, dh> + df <y, dh>) ] = - gradient,   g = q^((p-2)/2),  k = (2 - p) g q^(-p/2)

with q = |df|^2 + eps^2. The system is made symmetric, and y is shortened so that it is positive definite. For p > 2,
y = g df is Newton's method. Conjugate gradients solve the systems, preconditioned by a V-cycle of multigrid for the
matrix of eq. 25 (k = 0). All this is in float64 where the device has it, and only the levels are made on the host.

For eps = 0 and p < 2 there are no second derivatives: the steps use an eps > 0 that decreases with the gap. y and the
gap still belong to the problem with eps = 0.

For a large p Newton's method is slow far from the minimiser: it starts with steps for p = 3, 6, 12, ...
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..backends import Array, Smoothness
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .bent import Bent, Memory, in_float64
from .conductances import Conductances
from .cycle import Cycle
from .dual import duality_gap
from .loop import Course, Solver

# Sufficient decrease (Armijo), and the maximal number of halvings of a step.
_DECREASE, _HALVINGS = 1e-4, 30
# The relative residual of a step, in the norm of its V-cycle.
_FORCING = 0.01
# If the problem has no smoothing: what that of the steps may add to the energy, as a share of the gap.
_PART = 0.1
# Up to this p a start needs no steps for another p. Of these, at most so many each, until one promises to lower the
# energy by less than this share.
_EASY, _WARM, _FALLS = 3.0, 10, 0.01


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    work: DeviceProblem  # in float64 if the device has it
    matrix: Conductances
    memory: Memory
    here: Array  # f in `work`
    y: Array
    eps: float  # of the next step
    cycle: Cycle | None = None  # if it is the same for all steps
    inner: int = 0
    halved: int = 0
    warm: int = 0  # steps for a smaller p
    fall: float = np.inf  # the decrease of the energy that the last step promised


@dataclass(frozen=True)
class Newton(Solver[_State]):
    """Newton's method, primal-dual for p < 2."""

    patience = 20

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed, if it is twice that of the type: functions, with a V-cycle's, and y at a check."""
        return 2 * 12, 2 * 2

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first step, from `initial`, (n, m)."""
        work = in_float64(problem)
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        wide = work.backend
        here = wide.put(graph, backend.get(graph, initial))
        if not isinstance(work.lam, float):
            # f0 at pinned vertices
            host, lam = wide.get(graph, here), wide.get(graph, work.lam)
            here = wide.put(graph, np.where(np.isinf(lam), wide.get(graph, work.f0), host))
        elif np.isinf(work.lam):
            here = wide.copy(graph, work.f0, out=here)
        eps = problem.eps if problem.eps or problem.p >= 2 else 0.1 * problem.problem.spread
        f, previous, y = backend.empty(graph, m), backend.empty(graph, m), wide.empty_edges(graph, m)
        state = _State(f, previous, work, Conductances.of(work), Memory.empty(work), here, y, eps)
        state = self._warm(problem, state)
        return replace(state, f=backend.put(graph, wide.get(graph, state.here)))

    def _warm(self, problem: DeviceProblem, state: _State) -> _State:
        """Do steps for p = 3, 6, 12, ... below the problem's, each from the last one."""
        p = _EASY
        while p < problem.p:
            model, f = replace(_model(problem), p=p), state.here
            for _ in range(_WARM):
                state = replace(self._step(state, model), warm=state.warm + 1)
                energy = _energy(state.work, state.here, model)
                if state.fall <= _FALLS * energy:
                    break
            if _energy(state.work, state.here, _model(problem)) > _energy(state.work, f, _model(problem)):
                state = replace(state, here=f)  # the start was better
            p *= 2
        return state

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one Newton step, shortened until the energy falls enough."""
        after = self._step(state, replace(_model(problem), eps=state.eps))
        backend, graph = problem.backend, problem.weighted.graph
        f = backend.put(graph, after.work.backend.get(graph, after.here))
        return replace(after, f=f, previous=state.f)

    def _step(self, state: _State, model: Smoothness) -> _State:
        work, memory, y = state.work, state.memory, state.y
        backend, weighted, graph = work.backend, work.weighted, work.weighted.graph
        conductances = backend.conductances(weighted, state.here, model)
        backend.gradient(weighted, state.here, work.f0, conductances, work.lam, out=memory.gradient)
        bent = Bent.at(state.matrix, state.here, y, model)
        if backend.dot(graph, memory.gradient, memory.gradient) == 0:
            backend.combine(graph, 0.0, memory.gradient, 0.0, memory.gradient, out=memory.h)
            bent.move(memory.h)
            return replace(state, fall=0.0)
        cycle = state.cycle or state.matrix.cycle(bent.conductances)
        steps = bent.solve(cycle, memory, 1e-3 if model.p == 2 else _FORCING)
        energy, slope = _energy(work, state.here, model), backend.dot(graph, memory.gradient, memory.h)
        moved, theta, halved = backend.empty(graph, work.channels), 1.0, 0

        def tried() -> float:
            backend.combine(graph, 1.0, state.here, theta, memory.h, out=moved)
            return _energy(work, moved, model)

        while not tried() <= energy + _DECREASE * theta * slope and halved < _HALVINGS:
            theta, halved = theta / 2, halved + 1
        if halved == _HALVINGS:  # only rounding is left
            backend.copy(graph, state.here, out=moved)
        if np.isfinite(slope):
            bent.move(memory.h)
        if work.box is not None:
            backend.proximal(weighted, moved, y, work.f0, work.lam, 0.0, box=work.box, out=moved)
        return replace(
            state,
            here=moved,
            cycle=cycle if model.p == 2 else None,
            inner=state.inner + steps,
            halved=state.halved + (halved > 0),
            fall=-slope,
        )

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the gap of f on the device and y, for p = 1 moved into the unit ball, and choose the next eps."""
        backend, weighted, p = problem.backend, problem.weighted, problem.p
        graph, y = weighted.graph, state.y
        if state.work.backend is not backend:
            y = backend.put_edges(graph, state.work.backend.get_edges(graph, y))
        if p == 1:
            ball, other = replace(_model(problem), eps=0.0), backend.empty_edges(graph, problem.channels)
            y = backend.dual_step(weighted, y, other, state.f, state.f, ball, beta=0.0, sigma=0.0)
        gap = duality_gap(problem, state.f, y, course.energies[-1])
        if problem.eps or p >= 2:
            return state, gap
        # eps adds at most eps^p / p to the energy of a vertex: choose it as a share of the gap
        return replace(state, eps=min(state.eps, (_PART * p * gap / graph.n_vertices) ** (1 / p))), gap

    def next_check(self, state: _State, done: int) -> int:
        """Check after every step."""
        return done + 1

    def describe(self, state: _State) -> str:
        """Describe the method and its steps."""
        name = "Primal-dual Newton" if state.work.p < 2 else "Newton"
        warm = f" after {state.warm} step(s) for smaller p" if state.warm else ""
        halved = f", {state.halved} step(s) shortened" if state.halved else ""
        return f"{name}{warm}, {state.inner} step(s) of conjugate gradients preconditioned by multigrid in all{halved}"


def _model(problem: DeviceProblem) -> Smoothness:
    """Return the smoothness with one norm: several channels have a norm each only at p = 2, where it is not used."""
    return replace(problem.model, coupled=True)


def _energy(problem: DeviceProblem, f: Array, model: Smoothness) -> float:
    return problem.backend.energy(problem.weighted, f, problem.f0, problem.lam, model)
