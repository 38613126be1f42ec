"""Solve p = 2, the linear system (lam + Laplacian) f = lam f0, by conjugate gradients on the device.

Eq. 20 counts every edge from both ends: with gamma = sqrt(w) the matrix is lam I + 2 L, with the edge norm lam I + L.
The gap is the sum of |lam (f - f0) + Laplacian f|^2 / (2 lam).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import FloatArray
from ..backends import Array, Backend, Cosines, Numbers, Ratio, Recorded, in_turns
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .loop import Course, Solver, changed


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    system: _System
    residual: Array
    direction: Array
    scratch: Array
    numbers: Numbers  # residual . preconditioned residual of two steps, and the curvature along the direction
    turns: tuple[Recorded, Recorded]  # the next step, and the one after it


@dataclass(frozen=True)
class _Diagonal:
    """The diagonal of the matrix as the preconditioner."""

    values: Array
    name: ClassVar[str] = "its diagonal"
    on_device: ClassVar[bool] = True

    def solve(self, backend: Backend, r: Array) -> None:
        """Do nothing: the backends divide by the diagonal where they need the solution for the residual."""

    def of_residual(self, r: Array) -> tuple[Array, float | Array]:
        """Return the numerator, (n, m), and the denominator of r / diagonal."""
        return r, self.values


@dataclass(frozen=True)
class _Cosines:
    """The matrix of the grid reflected at its border as the preconditioner: its eigenvectors are cosines.

    It is the matrix of the grid if all neighbours lie along the axes; otherwise it has additional edges at the border.
    """

    matrix: Cosines
    solved: Array
    name: ClassVar[str] = "cosine transforms"

    @property
    def on_device(self) -> bool:
        """Whether the device does the transforms, and reads nothing back."""
        return self.matrix.place is not None

    def solve(self, backend: Backend, r: Array) -> None:
        """Write the solution for the residual r, (n, m), to ``solved``."""
        backend.cosine_solve(self.matrix, r, out=self.solved)

    @classmethod
    def of(cls, problem: DeviceProblem, graph: GridGraph, lam: float) -> _Cosines:
        """Compute the eigenvalues for w = 1: lam + 4 sum_d (1 - prod_a cos(pi i_a d_a / n_a)), d forward offsets."""
        total: FloatArray = np.full((*graph.shape, 1), lam)
        steps, counts = np.unique(np.abs(graph.forward_offsets), axis=0, return_counts=True)
        for step, count in zip(steps, counts, strict=True):
            waves = [np.cos(np.pi * int(d) / n * np.arange(n)) for d, n in zip(step, graph.shape, strict=True)]
            total += 4 * count * (1 - functools.reduce(np.multiply.outer, waves)[..., None])
        backend, m = problem.backend, problem.channels
        return cls(backend.cosines(graph, total, m), backend.empty(graph, m))

    def of_residual(self, r: Array) -> tuple[Array, float | Array]:
        """Return where the solution for the residual is, (n, m), and 1."""
        return self.solved, 1.0


@dataclass(frozen=True)
class _System:
    """A f = lam f0 with the matrix of the vertex norm; for the edge norm half of it, with twice the fidelity."""

    lam: float | Array
    preconditioner: _Diagonal | _Cosines
    share: float

    @classmethod
    def of(cls, problem: DeviceProblem) -> _System:
        backend, graph = problem.backend, problem.weighted.graph
        share = 0.5 if problem.edge_norm else 1.0
        lam = problem.lam
        if problem.edge_norm:
            lam = 2 * lam if isinstance(lam, float) else backend.put(graph, 2 * backend.get(graph, lam))
        if _repeats(problem):
            assert isinstance(graph, GridGraph) and isinstance(lam, float)
            return cls(lam, _Cosines.of(problem, graph, lam), share)
        degree = backend.get(graph, backend.degree(problem.weighted)).astype(np.float64)
        fidelity = lam if isinstance(lam, float) else backend.get(graph, lam).astype(np.float64)
        return cls(lam, _Diagonal(backend.put(graph, fidelity + 2 * degree)), share)

    def residual(self, problem: DeviceProblem, f: Array, out: Array) -> Array:
        """Compute lam f0 - A f, (n, m)."""
        backend, weighted = problem.backend, problem.weighted
        backend.gradient(weighted, f, problem.f0, None, self.lam, out=out)
        return backend.combine(weighted.graph, -1.0, out, 0.0, out, out=out)

    def gap(self, problem: DeviceProblem, residual: Array) -> float:
        """Compute the gap from the residual, (n, m), in the units of the problem's energy."""
        if np.min(problem.problem.lam) == 0:
            return math.inf
        return self.share * problem.backend.dot(problem.weighted.graph, residual, residual, over=self.lam) / 2


@dataclass(frozen=True)
class Linear(Solver[_State]):
    """Conjugate gradients, preconditioned by cosine transforms on a uniform grid, otherwise by the diagonal."""

    patience = 50

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: start, residual, direction, preconditioner with its output, and scratch memory.

        Cosine transforms on a GPU have a work space of two more.
        """
        return (8 if isinstance(problem.graph, GridGraph) else 6), 0

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first step, from `initial`, (n, m)."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        f, previous, residual, direction, scratch = (backend.empty(graph, m) for _ in range(5))
        backend.copy(graph, initial, out=f)
        system, numbers = _System.of(problem), backend.numbers(3)

        def step(backend: Backend, here: tuple[Array, int], there: tuple[Array, int]) -> None:
            """Do a step from f and its number to the other ones."""
            new, old, curvature = there[1], here[1], 2
            if system.preconditioner.on_device:
                system.preconditioner.solve(backend, residual)
            z, over = system.preconditioner.of_residual(residual)
            backend.dot_into(numbers[new], graph, residual, z, over=over)
            backend.combine(graph, Ratio(numbers, new, old), direction, 1.0, z, over=over, out=direction)
            backend.gradient(problem.weighted, direction, None, None, system.lam, out=scratch)
            backend.dot_into(numbers[curvature], graph, direction, scratch)
            backend.combine(graph, Ratio(numbers, new, curvature), direction, 1.0, here[0], out=there[0])
            backend.combine(graph, Ratio(numbers, new, curvature, -1.0), scratch, 1.0, residual, out=residual)

        turns = in_turns(backend, step, (f, 0), (previous, 1))
        return _begun(problem, _State(f, previous, system, residual, direction, scratch, numbers, turns))

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one step of conjugate gradients."""
        if not state.system.preconditioner.on_device:
            state.system.preconditioner.solve(problem.backend, state.residual)
        state.turns[0]()
        return changed(state, f=state.previous, previous=state.f, turns=state.turns[::-1])

    def certify(self, problem: DeviceProblem, state: _State, course: Course) -> tuple[_State, float]:
        """Compute the gap from the true residual; restart if it differs from that of the recursion."""
        expected = state.system.gap(problem, state.residual)
        state.system.residual(problem, state.f, state.scratch)
        gap = state.system.gap(problem, state.scratch)
        return (_begun(problem, state) if gap > 2 * expected else state), gap

    def next_check(self, state: _State, done: int) -> int:
        """Return a check after a tenth more iterations; a check costs at most as much as a step."""
        return done + max(1, done // 10)

    def describe(self, state: _State) -> str:
        """Describe the method and its preconditioner."""
        by = state.system.preconditioner.name
        return f"The linear system of p = 2 by conjugate gradients, preconditioned by {by}"


def _begun(problem: DeviceProblem, state: _State) -> _State:
    """Restart the recursion from the true residual of f: the first direction is the preconditioned residual."""
    backend, graph, direction = problem.backend, problem.weighted.graph, state.direction
    state.system.residual(problem, state.f, state.residual)
    backend.combine(graph, 0.0, state.residual, 0.0, state.residual, out=direction)
    for at in (0, 1):
        backend.dot_into(state.numbers[at], graph, direction, direction)
    return state


def _repeats(problem: DeviceProblem) -> bool:
    """Return whether the matrix is uniform inside the border: a grid without mask, w = 1, lam a number."""
    graph = problem.weighted.graph
    return (
        isinstance(graph, GridGraph)
        and graph.mask is None
        and problem.weighted.weights is None
        and isinstance(problem.lam, float)
        and math.isfinite(problem.lam)
        and problem.scale is None
    )
