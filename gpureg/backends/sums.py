"""The protocol of long sums over a graph, whose results can stay on the device.

Each sum has two methods. ``dot`` waits for the device and returns a float. ``dot_into`` writes the result to one of a
few numbers on the device and does not wait; the next kernel can use it there. The equations are in
``kernels/README.md``.
"""

from __future__ import annotations

import threading
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph
from .data import Data
from .types import Array, Box, Device, Smoothness, Weighted


@dataclass(frozen=True, eq=False)
class Numbers:
    """A few numbers on a device, such as the scalars of conjugate gradients.

    The sums of one ``Numbers`` share memory for their parts, so only one thread may use it at a time.

    Attributes
    ----------
    values : object
        The device array, in the form of its backend.
    count : int
        How many numbers.
    parts : dict
        Memory for the parts of a sum, made by the backend at first use.
    """

    values: Any
    count: int
    parts: dict[Any, Any] = field(default_factory=dict)

    def __getitem__(self, at: int) -> Number:
        """Return one of the numbers, as the output of a sum."""
        if not 0 <= at < self.count:
            raise IndexError(f"number {at} of {self.count}")
        return Number(self, at)


@dataclass(frozen=True, eq=False)
class Number:
    """One number on a device: the number `at` of `numbers`."""

    numbers: Numbers
    at: int


@dataclass(frozen=True, eq=False)
class Ratio:
    """A coefficient that the device computes: the quotient of two numbers on it, or 0 if the divisor is not > 0.

    Attributes
    ----------
    numbers : Numbers
    above, below : int
        The places of the numbers.
    sign : float
        A factor.
    """

    numbers: Numbers
    above: int
    below: int
    sign: float = 1.0


def ratios(*coefficients: float | Ratio) -> tuple[Numbers | None, list[float], list[int]]:
    """Split coefficients into their numbers (None if all are numbers of the host), factors and pairs of places."""
    numbers, factors, places = None, [], []
    for x in coefficients:
        if isinstance(x, Ratio):
            assert numbers is None or numbers is x.numbers
            numbers = x.numbers
            factors.append(x.sign)
            places += [x.above, x.below]
        else:
            factors.append(x)
            places += [-1, -1]
    return numbers, factors, places


class Sums(Data):
    """The long sums, and the largest difference."""

    def __init__(self, device: Device, dtype: npt.DTypeLike) -> None:
        super().__init__(device, dtype)
        # A number for each thread that waits for a sum.
        self._waiting = threading.local()

    @abstractmethod
    def numbers(self, count: int) -> Numbers:
        """Allocate numbers on the device, 0 at first: float64, or pairs of float32 on a device without it."""

    @abstractmethod
    def read(self, numbers: Numbers) -> FloatArray:
        """Wait for the device and copy the numbers to the host, (count,) in float64."""

    @abstractmethod
    def max_change_into(self, out: Number, graph: AnyGraph, a: Array, b: Array) -> None:
        """Write :meth:`max_change` to a number on the device."""

    @abstractmethod
    def dot_into(self, out: Number, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> None:
        """Write :meth:`dot` to a number on the device."""

    @abstractmethod
    def energy_into(
        self, out: Number, weighted: Weighted, f: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> None:
        """Write :meth:`energy` to a number on the device."""

    @abstractmethod
    def duality_gap_into(
        self,
        out: Number,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        box: Box | None = None,
    ) -> None:
        """Write :meth:`duality_gap` to a number on the device."""

    def max_change(self, graph: AnyGraph, a: Array, b: Array) -> float:
        """Compute the largest absolute difference; infinity if there is a NaN."""
        out = self._own_number()
        self.max_change_into(out, graph, a, b)
        return self._value(out)

    def dot(self, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> float:
        """Sum a b / over, over vertices and channels.

        A term is 0 where `over` is infinite: a number, or a function with 1 channel or the channels of a and b. The
        sum is in float64, or compensated.
        """
        out = self._own_number()
        self.dot_into(out, graph, a, b, over=over)
        return self._value(out)

    def energy(self, weighted: Weighted, f: Array, f0: Array, lam: float | Array, model: Smoothness) -> float:
        """Compute the energy, smoothed by eps: eq. 20, or eq. 30 with the edge norm."""
        out = self._own_number()
        self.energy_into(out, weighted, f, f0, lam, model)
        return self._value(out)

    def duality_gap(
        self,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        model: Smoothness,
        *,
        box: Box | None = None,
    ) -> float:
        """Compute the energy of f minus the dual energy of y, p >= 1, as a sum of terms >= 0.

        Without a box lam > 0. With one lam may be 0, and f must lie in the box.
        """
        out = self._own_number()
        self.duality_gap_into(out, weighted, f, y, f0, lam, model, box=box)
        return self._value(out)

    def _own_number(self) -> Number:
        """Return a number of this thread, which it reads before it asks for the next one."""
        numbers: Numbers | None = getattr(self._waiting, "numbers", None)
        if numbers is None:
            numbers = self._waiting.numbers = self.numbers(1)
        return numbers[0]

    def _value(self, number: Number) -> float:
        """Wait for the device and return the value of a number."""
        return float(self.read(number.numbers)[number.at])
