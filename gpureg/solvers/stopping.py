"""Stop tests of the paper's processes: four tests, each an object with its data."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeVar

import numpy as np

from ..backends import Array, Conductance, Recorded
from ..checks import choice, number
from ..graphs.grid import GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop
from .loop import Course, Solver

# Number of roundings of a value by which equal iterates can differ.
_NOISE = 4

# The end of a method's description for p < 1.
LOCAL = ", towards a local minimum that depends on the start (p < 1)"


class StopTest(ABC):
    """A stop test during a run: at each check it is updated, then it judges.

    Attributes
    ----------
    holds : int
        Number of functions on the vertices, (n, m), that it stores on the device.
    """

    holds: ClassVar[int] = 0

    @classmethod
    def of(cls, problem: DeviceProblem, initial: Array) -> Self:
        """Make the test before the first check; the run starts at `initial`, (n, m)."""
        return cls()

    def at(self, problem: DeviceProblem, f: Array, g: Conductance) -> tuple[Self, float | None]:
        """Update the test at f, (n, m); also return the duality gap if it is known; `g` is scratch memory."""
        return self, None

    @abstractmethod
    def judge(self, problem: DeviceProblem, course: Course, tol: float) -> Stop | None:
        """Return why to stop at this check, or None."""


@dataclass(frozen=True)
class Change(StopTest):
    """The largest change of a value in the last iteration, as a share of the data's spread."""

    def judge(self, problem: DeviceProblem, course: Course, tol: float) -> Stop | None:
        """Stop if the iterate hardly changes."""
        return Stop.TOLERANCE if course.stands_still else None


@dataclass(frozen=True)
class Error(StopTest):
    """The estimated distance from the limit, as a share of the data's spread.

    Attributes
    ----------
    last : device function, (n, m)
        f at the last check.
    ways : tuple of float
        Largest change of a value from the previous check to each check; the first check is the start.
    """

    holds: ClassVar[int] = 1

    last: Array
    ways: tuple[float, ...] = ()

    @classmethod
    def of(cls, problem: DeviceProblem, initial: Array) -> Self:
        """Make the test at the start."""
        buffer = problem.backend.empty(problem.weighted.graph, problem.channels)
        return cls(_copy(problem, initial, buffer))

    def at(self, problem: DeviceProblem, f: Array, g: Conductance) -> tuple[Self, float | None]:
        """Add the largest change since the last check."""
        way = problem.change(f, self.last)
        _copy(problem, f, self.last)
        return replace(self, ways=(*self.ways, way)), None

    def judge(self, problem: DeviceProblem, course: Course, tol: float) -> Stop | None:
        """Stop if the estimated distance is small, or if changes are only rounding."""
        rounding = float(np.finfo(problem.backend.dtype).eps) / 2 * largest_value(problem)
        ways, checks = self.ways, course.checks[-len(self.ways) :]
        if estimated_error(ways, checks, rounding) <= tol * course.span:
            return Stop.ERROR
        return Stop.ROUNDING if _is_noise(ways, checks, rounding) else None


@dataclass(frozen=True)
class Gradient(StopTest):
    """The norm of the energy's gradient, as a share of that at the start.

    Attributes
    ----------
    buffer : device function, (n, m)
        Scratch memory for the gradient.
    units : float or device function, (n, 1)
        The squared gradient on the device divided by this is that of the caller's variable.
    first, now : float
        The norm at the first check (None before it) and at the last one.
    """

    holds: ClassVar[int] = 1

    buffer: Array
    units: float | Array
    first: float | None = None
    now: float = math.inf

    @classmethod
    def of(cls, problem: DeviceProblem, initial: Array) -> Self:
        """Make the test before the first check."""
        backend, graph, scale = problem.backend, problem.weighted.graph, problem.scale
        units: float | Array = 1.0 if scale is None else backend.put(graph, scale**-2.0)
        return cls(backend.empty(graph, problem.channels), units)

    def at(self, problem: DeviceProblem, f: Array, g: Conductance) -> tuple[Self, float | None]:
        """Compute the norm at f, and the duality gap if the energy is strongly convex.

        The energy at f + h is at least that at f plus <gradient, h> + sum lam |h|^2 / 2. The minimum over h is the
        energy at f minus sum |gradient|^2 / (2 lam).
        """
        backend, weighted = problem.backend, problem.weighted
        found = backend.gradient(weighted, f, problem.f0, problem.conductances(f, g), problem.lam, out=self.buffer)
        now = math.sqrt(backend.dot(weighted.graph, found, found, over=self.units))
        gap = None
        if problem.p >= 1 and np.min(problem.problem.lam) > 0:
            gap = backend.dot(weighted.graph, found, found, over=problem.lam) / 2
        return replace(self, first=now if self.first is None else self.first, now=now), gap

    def judge(self, problem: DeviceProblem, course: Course, tol: float) -> Stop | None:
        """Stop if the norm has fallen enough."""
        assert self.first is not None
        return Stop.GRADIENT if self.now <= tol * self.first else None


@dataclass(frozen=True)
class Energy(StopTest):
    """The change of the energy per iteration since the last check, as a share of the energy."""

    def judge(self, problem: DeviceProblem, course: Course, tol: float) -> Stop | None:
        """Stop if the energy hardly changes."""
        return Stop.ENERGY if energy_decrease(course) <= tol * abs(course.energies[-1]) else None


TESTS: dict[str, type[StopTest]] = {"change": Change, "error": Error, "gradient": Gradient, "energy": Energy}


def _copy(problem: DeviceProblem, f: Array, out: Array) -> Array:
    return problem.backend.copy(problem.weighted.graph, f, out=out)


@dataclass(frozen=True)
class ProcessState:
    """The common part of the states of processes.

    Attributes
    ----------
    f, previous : device functions, (n, m)
        The last complete iterate, and the one before it, which the next iterate overwrites.
    g : device function, (n, 1) or (n, m), or None
        Scratch memory for the conductances.
    test : StopTest
    local : bool
        Whether there can be several minima.
    turns : pair of Recorded
        The next iteration, and the one after it, which has the two iterates swapped.
    """

    f: Array
    previous: Array
    g: Array | None
    test: StopTest
    local: bool
    turns: tuple[Recorded, Recorded]


P = TypeVar("P", bound=ProcessState)


class Process(Solver[P]):
    """A process of the paper, with a choice of stop tests."""

    stop: str

    def check(self) -> None:
        """Raise TypeError or ValueError unless the settings of the test are valid."""
        if self.tol is not None:
            number("tol", self.tol, low=0)
        choice("stop", self.stop, TESTS)

    def keeps(self, problem: Problem) -> tuple[int, int]:
        """Return the memory that the test needs."""
        return TESTS[self.stop].holds, 0

    def test(self, problem: DeviceProblem, initial: Array) -> StopTest:
        """Make the chosen test, at the start `initial`, (n, m)."""
        return TESTS[self.stop].of(problem, initial)

    def certify(self, problem: DeviceProblem, state: P, course: Course) -> tuple[P, float | None]:
        """Update the test at this check."""
        test, gap = state.test.at(problem, state.f, state.g)
        return replace(state, test=test), gap

    def judge(self, problem: DeviceProblem, state: P, course: Course) -> Stop | None:
        """Judge by the chosen test."""
        return None if course.tol is None else state.test.judge(problem, course, course.tol)


def energy_decrease(course: Course) -> float:
    """Compute the mean absolute change of the energy per iteration since the last check; infinity at the first."""
    if len(course.checks) < 2:
        return math.inf
    return abs(course.energies[-2] - course.energies[-1]) / (course.checks[-1] - course.checks[-2])


def estimated_error(ways: Sequence[float], checks: Sequence[int], rounding: float) -> float:
    """Estimate the remaining distance from the rate at which changes decrease; infinity if they do not, or not yet.

    `ways` are the largest changes up to each check; the first check is the start. With R = r^n, where r is the rate of
    an iteration and n the iterations since the last check, a change d is followed by d R + d R^2 + ... = d R / (1 - R).
    r is measured over two checks, to average even and odd iterations; the slowest of the last three rates is used, as
    one can be small by chance. Changes are accurate only up to a few roundings.
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
    """Return whether the changes are as small as rounding and fall by less than a fifth as iterations double."""
    early = [way for way, at in zip(ways[1:], checks[1:], strict=True) if 2 * at <= checks[-1]]
    if len(ways) > 1 and ways[-1] == 0:
        return True
    return bool(early) and ways[-1] <= 64 * rounding and ways[-1] >= 0.8 * min(early)


def largest_value(problem: DeviceProblem) -> float:
    """Return the largest absolute value of the data, inside the mask of a grid."""
    graph, f0 = problem.problem.graph, problem.problem.f0
    if isinstance(graph, GridGraph) and graph.mask is not None:
        f0 = f0[graph.mask.ravel()]
    return max(float(f0.max(initial=0)), -float(f0.min(initial=0)))
