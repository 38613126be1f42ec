"""Solve p = 2, the linear system (lam + Laplacian) f = lam f0, by conjugate gradients on the device.

Eq. 20 counts every edge from both ends: with gamma = sqrt(w) the matrix is lam I + 2 L, with the edge norm lam I + L.
The gap is the sum of |lam (f - f0) + Laplacian f|^2 / (2 lam).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..arrays import FloatArray
from ..backends import Array
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from .loop import Course, Solver


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    system: _System
    residual: Array
    direction: Array
    scratch: Array
    rz: float  # residual . preconditioned residual of the previous step; 0 before the first


@dataclass(frozen=True)
class _Diagonal:
    """The diagonal of the matrix as the preconditioner."""

    values: Array
    name: ClassVar[str] = "its diagonal"

    def solve(self, problem: DeviceProblem, r: Array) -> tuple[Array, float | Array]:
        """Return the numerator, (n, m), and the denominator of r / diagonal: the backends do the division."""
        return r, self.values


@dataclass(frozen=True)
class _Cosines:
    """The matrix of the grid reflected at its border as the preconditioner: its eigenvectors are cosines.

    It is the matrix of the grid if all neighbours lie along the axes; otherwise it has additional edges at the border.
    """

    eigenvalues: FloatArray
    name: ClassVar[str] = "cosine transforms"

    @classmethod
    def of(cls, graph: GridGraph, lam: float) -> _Cosines:
        """Compute the eigenvalues for w = 1: lam + 4 sum_d (1 - prod_a cos(pi i_a d_a / n_a)), d forward offsets."""
        total: FloatArray = np.full((*graph.shape, 1), lam)
        steps, counts = np.unique(np.abs(graph.forward_offsets), axis=0, return_counts=True)
        for step, count in zip(steps, counts, strict=True):
            waves = [np.cos(np.pi * int(d) / n * np.arange(n)) for d, n in zip(step, graph.shape, strict=True)]
            total += 4 * count * (1 - functools.reduce(np.multiply.outer, waves)[..., None])
        return cls(total)

    def solve(self, problem: DeviceProblem, r: Array) -> tuple[Array, float | Array]:
        """Solve by DCT-II on the host; return the solution, (n, m), and 1."""
        from scipy import fft

        backend, graph, shape = problem.backend, problem.weighted.graph, self.eigenvalues.shape
        axes = tuple(range(len(shape) - 1))
        waves = fft.dctn(backend.get(graph, r).astype(np.float64).reshape(*shape[:-1], -1), axes=axes)
        solved = fft.idctn(waves / self.eigenvalues, axes=axes)
        return backend.put(graph, solved.reshape(graph.n_vertices, -1)), 1.0


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
            return cls(lam, _Cosines.of(graph, lam), share)
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
        return self.share * problem.backend.dot(problem.weighted.graph, residual, residual, over=self.lam) / 2


@dataclass(frozen=True)
class Linear(Solver[_State]):
    """Conjugate gradients, preconditioned by cosine transforms on a uniform grid, otherwise by the diagonal."""

    patience = 50

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory needed: start, residual, direction, preconditioner, its output, and scratch memory."""
        return 6, 0

    def start(self, problem: DeviceProblem, initial: Array) -> _State:
        """Return the state before the first step, from `initial`, (n, m)."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        f, previous, residual, direction, scratch = (backend.empty(graph, m) for _ in range(5))
        backend.copy(problem.weighted.graph, initial, out=f)
        return _begun(problem, _State(f, previous, _System.of(problem), residual, direction, scratch, 0.0))

    def advance(self, problem: DeviceProblem, state: _State) -> _State:
        """Do one step of conjugate gradients."""
        backend, weighted, system = problem.backend, problem.weighted, state.system
        z, over = system.preconditioner.solve(problem, state.residual)
        rz = backend.dot(weighted.graph, state.residual, z, over=over)
        beta = rz / state.rz if state.rz > 0 else 0.0
        backend.combine(weighted.graph, beta, state.direction, 1.0, z, over=over, out=state.direction)
        backend.gradient(weighted, state.direction, None, None, system.lam, out=state.scratch)
        curvature = backend.dot(weighted.graph, state.direction, state.scratch)
        alpha = rz / curvature if curvature > 0 else 0.0
        backend.combine(weighted.graph, 1.0, state.f, alpha, state.direction, out=state.previous)
        backend.combine(weighted.graph, 1.0, state.residual, -alpha, state.scratch, out=state.residual)
        return replace(state, f=state.previous, previous=state.f, rz=rz)

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
    """Restart the recursion from the true residual of f."""
    state.system.residual(problem, state.f, state.residual)
    problem.backend.combine(problem.weighted.graph, 0.0, state.residual, 0.0, state.residual, out=state.direction)
    return replace(state, rz=0.0)


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
