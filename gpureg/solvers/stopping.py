"""What the tolerance of the paper's processes can be of: a choice of tests, each with what it needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backends import Array, Conductance
from ..graph import GridGraph
from ..problem import DeviceProblem
from ..result import Stop
from .loop import Course, Solver, check_settings

TESTS = ("change", "error", "gradient", "energy")

# What a method says of its result for p < 1.
LOCAL = ", towards a local minimum that depends on the start (p < 1)"

# Checks over which the rate of convergence is observed.
_LAG = 3


@dataclass(frozen=True)
class Slope:
    """The norm of the energy's gradient at a start, and where it was taken last."""

    buffer: Array
    units: float | Array  # squares of the device's gradient over these are squares of the caller's
    first: float | None = None
    now: float = math.inf

    @classmethod
    def of(cls, problem: DeviceProblem) -> Slope:
        """Before the gradient was taken."""
        backend, graph, scale = problem.backend, problem.weighted.graph, problem.scale
        units: float | Array = 1.0 if scale is None else backend.put(graph, scale**-2.0)
        return cls(backend.empty(graph, problem.channels), units)

    def at(self, problem: DeviceProblem, f: Array, g: Conductance) -> tuple[Slope, float | None]:
        """The norm at f, and the duality gap where the energy is strongly convex; `g` is scratch.

        The energy at f + h is at least that at f + <gradient, h> + sum lam |h|^2 / 2, whose minimum over h is the
        energy minus sum |gradient|^2 / (2 lam).
        """
        backend, weighted = problem.backend, problem.weighted
        found = backend.gradient(weighted, f, problem.f0, problem.conductances(f, g), problem.lam, out=self.buffer)
        now = math.sqrt(backend.dot(weighted, found, found, over=self.units))
        gap = None
        if problem.p >= 1 and np.min(problem.problem.lam) > 0:
            gap = backend.dot(weighted, found, found, over=problem.lam) / 2
        return replace(self, first=now if self.first is None else self.first, now=now), gap


class Process(Solver):
    """A process of the paper, with a choice of what its tolerance is of; its state has ``g`` and ``slope`` too."""

    stop: str

    def check(self) -> None:
        """TypeError or ValueError unless the settings of the test are right."""
        check_settings({"tol": self.tol}, integers=())
        if self.tol is not None and not (math.isfinite(self.tol) and self.tol >= 0):
            raise ValueError(f"tol must be finite and >= 0, got {self.tol}")
        if self.stop not in TESTS:
            raise ValueError(f"stop must be one of {', '.join(TESTS)}, got {self.stop!r}")

    def slope(self, problem: DeviceProblem) -> Slope | None:
        """What the state needs for the test."""
        return Slope.of(problem) if self.stop == "gradient" else None

    def certify(self, problem: DeviceProblem, state: Any, energy: float) -> tuple[Any, float | None]:
        """The gradient of the energy, where that is what is tested."""
        if state.slope is None:
            return state, None
        slope, gap = state.slope.at(problem, state.f, state.g)
        return replace(state, slope=slope), gap

    def judge(self, problem: DeviceProblem, state: Any, course: Course) -> Stop | None:
        """The test that was chosen."""
        if course.tol is None:
            return None
        if self.stop == "change":
            return super().judge(problem, state, course)
        if self.stop == "gradient":
            return Stop.GRADIENT if state.slope.now <= course.tol * state.slope.first else None
        if self.stop == "energy":
            return Stop.ENERGY if energy_decrease(course) <= course.tol * abs(course.energies[-1]) else None
        rounding = float(np.finfo(problem.backend.dtype).eps) / 2 * _largest(problem)
        if estimated_error(course, rounding) <= course.tol * course.span:
            return Stop.ERROR
        return Stop.ROUNDING if course.changes[-1] <= rounding else None


def energy_decrease(course: Course) -> float:
    """What an iteration since the last check took off the energy, on average, or added; infinity at the first check."""
    if len(course.checks) < 2:
        return math.inf
    return abs(course.energies[-2] - course.energies[-1]) / (course.checks[-1] - course.checks[-2])


def estimated_error(course: Course, rounding: float) -> float:
    """The sum of the changes that are still to come, were they to fall as they did; infinity where they do not.

    A change is not known better than to `rounding`.
    """
    recent = slice(max(1, len(course.changes) - _LAG), None)  # the first check comes before any change
    changes = [max(change, rounding) for change in course.changes[1:]]
    if len(changes) <= _LAG:
        return math.inf
    done = course.checks[-1]
    rate = (changes[-1] / changes[-1 - _LAG]) ** (1 / (done - course.checks[-1 - _LAG])) if changes[-1] > 0 else 0.0
    if rate >= 1:
        return math.inf
    at = course.checks[recent]
    return max(c * rate ** (done - then) for c, then in zip(changes[-_LAG:], at, strict=True)) / (1 - rate)


def _largest(problem: DeviceProblem) -> float:
    """The size of the data, inside the mask of a grid."""
    graph, f0 = problem.problem.graph, problem.problem.f0
    if isinstance(graph, GridGraph) and graph.mask is not None:
        f0 = f0[graph.mask.ravel()]
    return max(float(f0.max(initial=0)), -float(f0.min(initial=0)))
