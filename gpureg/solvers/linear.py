"""p = 2: the linear system (lam + Laplacian) f = lam f0, by conjugate gradients on the device, or by cosines.

eq. 20 counts every edge from both ends, so that with gamma = sqrt(w) the matrix is lam I + 2 L; with the edge norm
lam I + L. The gap is |lam (f - f0) + Laplacian f|^2 / (2 lam), summed up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backends import Array
from ..graph import FloatArray, GridGraph
from ..problem import DeviceProblem
from .loop import Method


@dataclass(frozen=True)
class _State:
    f: Array
    previous: Array
    system: _System
    residual: Array
    direction: Array
    scratch: Array
    rz: float  # residual . residual / diagonal
    steps: int = 0


@dataclass(frozen=True)
class _System:
    """A f = lam f0 with the matrix of the vertex norm: the edge norm's is half of it with twice the fidelity."""

    lam: float | Array
    diagonal: Array
    share: float

    @classmethod
    def of(cls, problem: DeviceProblem) -> _System:
        backend, graph = problem.backend, problem.weighted.graph
        share = 0.5 if problem.edge_norm else 1.0
        lam = problem.lam
        if problem.edge_norm:
            lam = 2 * lam if isinstance(lam, float) else backend.put(graph, 2 * backend.get(graph, lam))
        degree = backend.get(graph, backend.degree(problem.weighted)).astype(np.float64)
        fidelity = lam if isinstance(lam, float) else backend.get(graph, lam).astype(np.float64)
        return cls(lam, backend.put(graph, fidelity + 2 * degree), share)

    def residual(self, problem: DeviceProblem, f: Array, out: Array) -> Array:
        """The right-hand side lam f0 minus A f."""
        backend, weighted = problem.backend, problem.weighted
        backend.gradient(weighted, f, problem.f0, None, self.lam, out=out)
        return backend.combine(weighted, -1.0, out, 0.0, out, out=out)

    def gap(self, problem: DeviceProblem, residual: Array) -> float:
        """What the residual says of the energy, in the problem's own units."""
        return self.share * problem.backend.dot(problem.weighted, residual, residual, over=self.lam) / 2


@dataclass(frozen=True)
class Linear(Method):
    """Conjugate gradients, preconditioned by the diagonal; one step of cosines where they are the eigenvectors."""

    patience = 50
    keeps = (5, 0)

    def start(self, problem: DeviceProblem, initial: Array) -> Any:
        """State before the first step."""
        backend, graph, m = problem.backend, problem.weighted.graph, problem.channels
        if _has_cosines(problem):
            return _Cosines(initial, backend.empty(graph, m))
        system = _System.of(problem)
        f, previous, residual, direction, scratch = (backend.empty(graph, m) for _ in range(5))
        backend.combine(problem.weighted, 1.0, initial, 0.0, initial, out=f)
        state = _State(f, previous, system, residual, direction, scratch, 0.0)
        return _begun(problem, state)

    def advance(self, problem: DeviceProblem, state: Any) -> Any:
        """One step of conjugate gradients."""
        if isinstance(state, _Cosines):
            problem.backend.combine(problem.weighted, 1.0, solved_by_cosines(problem), 0.0, state.f, out=state.previous)
            return replace(state, f=state.previous, previous=state.f)
        backend, weighted, system = problem.backend, problem.weighted, state.system
        backend.gradient(weighted, state.direction, None, None, system.lam, out=state.scratch)
        curvature = backend.dot(weighted, state.direction, state.scratch)
        alpha = state.rz / curvature if curvature > 0 else 0.0
        backend.combine(weighted, 1.0, state.f, alpha, state.direction, out=state.previous)
        backend.combine(weighted, 1.0, state.residual, -alpha, state.scratch, out=state.residual)
        rz = backend.dot(weighted, state.residual, state.residual, over=system.diagonal)
        beta = rz / state.rz if state.rz > 0 else 0.0
        backend.combine(weighted, beta, state.direction, 1.0, state.residual, over=system.diagonal, out=state.direction)
        return replace(state, f=state.previous, previous=state.f, rz=rz, steps=state.steps + 1)

    def certify(self, problem: DeviceProblem, state: Any, energy: float) -> tuple[Any, float]:
        """The gap of the true residual; one that has drifted off the recursion's begins the recursion anew."""
        if isinstance(state, _Cosines):
            system = _System.of(problem)
            return state, system.gap(
                problem,
                system.residual(problem, state.f, problem.backend.empty(problem.weighted.graph, problem.channels)),
            )
        expected = state.system.gap(problem, state.residual)
        state.system.residual(problem, state.f, state.scratch)
        gap = state.system.gap(problem, state.scratch)
        return (_begun(problem, state) if gap > 2 * expected else state), gap

    def next_check(self, done: int) -> int:
        """A look costs what a step costs."""
        return done + max(1 if done == 0 else 5, done // 10)

    def describe(self, state: Any) -> str:
        """Which of the two ways it was."""
        if isinstance(state, _Cosines):
            return "The linear system of p = 2 solved by cosine transforms"
        return "The linear system of p = 2 by conjugate gradients, preconditioned by its diagonal"


@dataclass(frozen=True)
class _Cosines:
    f: Array
    previous: Array


def _begun(problem: DeviceProblem, state: _State) -> _State:
    """The recursion from the true residual of f."""
    backend, weighted, system = problem.backend, problem.weighted, state.system
    system.residual(problem, state.f, state.residual)
    backend.combine(weighted, 0.0, state.residual, 1.0, state.residual, over=system.diagonal, out=state.direction)
    return replace(state, rz=backend.dot(weighted, state.residual, state.residual, over=system.diagonal))


def _has_cosines(problem: DeviceProblem) -> bool:
    """Whether the matrix has the grid's cosines for eigenvectors: neighbours along the axes alone, all w = 1."""
    graph = problem.weighted.graph
    return (
        isinstance(graph, GridGraph)
        and graph.mask is None
        and problem.weighted.weights is None
        and isinstance(problem.lam, float)
        and math.isfinite(problem.lam)
        and problem.scale is None
        and all(np.abs(step).sum() == 1 for step in graph.forward_offsets)
    )


def solved_by_cosines(problem: DeviceProblem) -> Array:
    """The solution by DCT-II, whose eigenvalues are lam + c sum_d (2 - 2 cos(pi i / n_d)), c = 2, or 1 (edge norm)."""
    from scipy import fft

    graph, backend = problem.weighted.graph, problem.backend
    assert isinstance(graph, GridGraph) and isinstance(problem.lam, float)
    axes = tuple(range(graph.ndim))
    values = backend.get(graph, problem.f0).astype(np.float64).reshape(*graph.shape, -1)
    eigenvalues: FloatArray = np.full((*graph.shape, 1), problem.lam)
    for step in graph.forward_offsets:
        axis = int(np.flatnonzero(step)[0])
        waves = 2 - 2 * np.cos(np.pi * np.arange(graph.shape[axis]) / graph.shape[axis])
        shape = [1] * (graph.ndim + 1)
        shape[axis] = -1
        eigenvalues = eigenvalues + (1.0 if problem.edge_norm else 2.0) * waves.reshape(shape)
    solved = fft.idctn(fft.dctn(values, axes=axes) * (problem.lam / eigenvalues), axes=axes)
    return backend.put(graph, solved.reshape(graph.n_vertices, -1))
