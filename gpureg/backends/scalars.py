"""Computations with a few numbers on a device, so that a solver need not read them back.

They are the guard of sweeps that must not raise the energy, and the least squares of Anderson acceleration. The
equations are in ``kernels/README.md``, the places of the numbers below.
"""

from __future__ import annotations

from abc import abstractmethod

from .sums import Numbers, Sums

# Differences that Anderson acceleration keeps, and the places that hold them: one more holds the last sweep.
MEMORY = 10
PLACES = MEMORY + 1

# Places of numbers: 1; the shares of a mix and of its last image in the next iterate, 1 and 0 or 0 and 1; differences
# in use; mixes accepted and rejected; energies of the mix and of the iterate before.
ONE, TAKEN, LEFT, COUNT, ACCEPTED, REJECTED, MIXED, BEFORE = range(8)
# The largest quotient of two energies one after the other, and the last two energies.
WORST, ENERGIES = 8, 9
# Inner products of the newest difference of residuals: with the last residual, and with all differences by place.
PRODUCT, ROW = 11, 12
# Inner products of the differences with the last residual, coefficients of the mix, and the Gram matrix.
PRODUCTS, COEFFICIENTS, GRAM = ROW + PLACES, ROW + 2 * PLACES, ROW + 3 * PLACES
SIZE = GRAM + PLACES**2


class Scalars(Sums):
    """Computations with numbers that have the places above."""

    def scalars(self) -> Numbers:
        """Allocate the numbers."""
        made = self.numbers(SIZE)
        self.begin_scalars(made)
        return made

    @property
    def ridge(self) -> float:
        """What the least squares add to the diagonal of the matrix with columns of length 1: less is rounding."""
        return 1e-12 if self.device.float64 else 1e-6

    @abstractmethod
    def begin_scalars(self, numbers: Numbers) -> None:
        """Forget all differences, and the largest quotient of energies."""

    @abstractmethod
    def watch(self, numbers: Numbers, new: int, old: int) -> None:
        """Update the largest quotient of energies, by those at two places; at most 1 if the energy has not risen."""

    @abstractmethod
    def mix_coefficients(self, numbers: Numbers, newest: int) -> None:
        """Add the difference at the place `newest`, and compute the coefficients of the differences in use."""

    @abstractmethod
    def judge_mix(self, numbers: Numbers) -> None:
        """Accept the mix if its energy is at most that before; otherwise drop the older half of the differences."""
