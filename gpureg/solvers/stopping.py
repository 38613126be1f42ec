"""What the tolerance of the paper's processes can be of: a choice of tests, each with what it needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..backends import Array, Conductance
from ..checks import choice, number
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop
from .loop import Course, Solver

TESTS = ("change", "error", "gradient", "energy")

# Roundings of a value by which the same iterate can differ from itself.
_NOISE = 4

# What a method says of its result for p < 1.
LOCAL = ", towards a local minimum that depends on the start (p < 1)"


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
        now = math.sqrt(backend.dot(weighted.graph, found, found, over=self.units))
        gap = None
        if problem.p >= 1 and np.min(problem.problem.lam) > 0:
            gap = backend.dot(weighted.graph, found, found, over=problem.lam) / 2
        return replace(self, first=now if self.first is None else self.first, now=now), gap


@dataclass(frozen=True)
class Travel:
    """How far the values went between a check and the next."""

    buffer: Array  # f at the last check
    ways: tuple[float, ...] = ()

    @classmethod
    def of(cls, problem: DeviceProblem, initial: Array) -> Travel:
        """At the start."""
        buffer = problem.backend.empty(problem.weighted.graph, problem.channels)
        return cls(_copy(problem, initial, buffer))

    def at(self, problem: DeviceProblem, f: Array, g: Conductance) -> tuple[Travel, None]:
        """With the way to f."""
        way = problem.change(f, self.buffer)
        _copy(problem, f, self.buffer)
        return replace(self, ways=(*self.ways, way)), None


def _copy(problem: DeviceProblem, f: Array, out: Array) -> Array:
    return problem.backend.copy(problem.weighted.graph, f, out=out)


class Process(Solver):
    """A process of the paper, with a choice of what its tolerance is of; its state has ``g`` and ``watch`` too."""

    stop: str

    def check(self) -> None:
        """TypeError or ValueError unless the settings of the test are right."""
        if self.tol is not None:
            number("tol", self.tol, low=0)
        choice("stop", self.stop, TESTS)

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """What the test needs."""
        return int(self.stop in ("error", "gradient")), 0

    def watch(self, problem: DeviceProblem, initial: Array) -> Slope | Travel | None:
        """What the state needs for the test."""
        if self.stop == "error":
            return Travel.of(problem, initial)
        return Slope.of(problem) if self.stop == "gradient" else None

    def certify(self, problem: DeviceProblem, state: Any, course: Course) -> tuple[Any, float | None]:
        """What is tested, taken at this check."""
        if state.watch is None:
            return state, None
        watch, gap = state.watch.at(problem, state.f, state.g)
        return replace(state, watch=watch), gap

    def judge(self, problem: DeviceProblem, state: Any, course: Course) -> Stop | None:
        """The test that was chosen."""
        if course.tol is None:
            return None
        if self.stop == "change":
            return super().judge(problem, state, course)
        if self.stop == "gradient":
            return Stop.GRADIENT if state.watch.now <= course.tol * state.watch.first else None
        if self.stop == "energy":
            return Stop.ENERGY if energy_decrease(course) <= course.tol * abs(course.energies[-1]) else None
        rounding = float(np.finfo(problem.backend.dtype).eps) / 2 * largest_value(problem)
        ways, checks = state.watch.ways, course.checks[-len(state.watch.ways) :]
        if estimated_error(ways, checks, rounding) <= course.tol * course.span:
            return Stop.ERROR
        return Stop.ROUNDING if _is_noise(ways, checks, rounding) else None


def energy_decrease(course: Course) -> float:
    """What an iteration since the last check took off the energy, on average, or added; infinity at the first check."""
    if len(course.checks) < 2:
        return math.inf
    return abs(course.energies[-2] - course.energies[-1]) / (course.checks[-1] - course.checks[-2])


def estimated_error(ways: Sequence[float], checks: Sequence[int], rounding: float) -> float:
    """The way still to go, were it to shrink as it did; infinity where it does not, or is not known yet.

    `ways` are those up to each check, the first of which is the start. With R = r^n, r being the rate of an iteration
    and n those since the last check, a way d is followed by d R + d R^2 + ... = d R / (1 - R). r is observed over two
    checks, which brings even and odd iterations together; of the last three such rates the slowest counts, as one can
    be small by chance. No way is known better than to some roundings.
    """
    if len(ways) > 1 and not any(ways):  # nothing ever moved
        return 0.0
    known = [max(way, _NOISE * rounding) for way in ways]
    rates = [
        (known[k] / known[k - 2]) ** (1 / (checks[k] - checks[k - 2])) if known[k - 2] > 0 else 0.0
        for k in range(max(3, len(ways) - 3), len(ways))
    ]
    if not rates or max(rates) >= 1:
        return math.inf
    shrinks: float = max(rates) ** (checks[-1] - checks[-2])
    return known[-1] * shrinks / (1 - shrinks)


def _is_noise(ways: Sequence[float], checks: Sequence[int], rounding: float) -> bool:
    """Whether ways are of the size of roundings and shrink by less than a fifth while the iterations double."""
    early = [way for way, at in zip(ways[1:], checks[1:], strict=True) if 2 * at <= checks[-1]]
    if len(ways) > 1 and ways[-1] == 0:
        return True
    return bool(early) and ways[-1] <= 64 * rounding and ways[-1] >= 0.8 * min(early)


def largest_value(problem: DeviceProblem) -> float:
    """The size of the data, inside the mask of a grid."""
    graph, f0 = problem.problem.graph, problem.problem.f0
    if isinstance(graph, GridGraph) and graph.mask is not None:
        f0 = f0[graph.mask.ravel()]
    return max(float(f0.max(initial=0)), -float(f0.min(initial=0)))
