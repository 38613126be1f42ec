"""Anderson's acceleration of a fixed-point process f <- J(f): the next iterate is a mix of the last images.

With r = J(f) - f and the differences of the last residuals and images as the columns of dR and dG, the candidate is
J(f) - dG c with the c that makes |r - dR c| least (Anderson 1965; Walker and Ni 2011, eq. 2.2). A mix every few sweeps
converges in as few sweeps as one in each, or in fewer, and costs less (Pratapa, Suryanarayana and Pask 2016).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..backends import Array
from ..graph import FloatArray
from ..problem import DeviceProblem

# Differences kept, and sweeps between two mixes. Measured on total variation of an image (eps 1e-3 of the range, to a
# distance of 1e-4): 111 sweeps, beside 184 with a mix in each, and 1460 without.
MEMORY = 10
PERIOD = 3

# Added to the diagonal of the normal equations, once their columns have length 1: what is below is rounding.
_RIDGE = 1e-12


@dataclass(frozen=True)
class History:
    """The last sweeps on the device: (residual, image), and differences of two that follow one another.

    Attributes
    ----------
    last : pair of arrays or None
        Residual and image of the last sweep.
    columns : tuple of pairs of arrays
        Differences, the newest last.
    gram : (k, k) float array
        Products of the residuals' differences.
    since : int
        Sweeps since the last mix.
    """

    last: tuple[Array, Array] | None = None
    columns: tuple[tuple[Array, Array], ...] = ()
    gram: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    since: int = 0

    @property
    def is_due(self) -> bool:
        """Whether the next iterate is to be a mix."""
        return self.since >= PERIOD and bool(self.columns)

    def after(self, problem: DeviceProblem, f: Array, image: Array) -> History:
        """With one more sweep, from f to its image; both are copied, and the oldest difference makes room."""
        backend, weighted, m = problem.backend, problem.weighted, problem.channels
        columns, gram = self.columns, self.gram
        free: tuple[Array, Array] | tuple[None, None] = None, None
        if len(columns) == MEMORY:
            free, columns, gram = columns[0], columns[1:], gram[1:, 1:]
        residual, copy = (backend.empty(weighted.graph, m) if x is None else x for x in free)
        backend.combine(weighted, 1.0, image, -1.0, f, out=residual)
        backend.combine(weighted, 1.0, image, 0.0, image, out=copy)
        if self.last is not None:
            for now, before in zip((residual, copy), self.last, strict=True):
                backend.combine(weighted, 1.0, now, -1.0, before, out=before)
            columns = (*columns, self.last)
            products = np.array([backend.dot(weighted, self.last[0], other) for other, _ in columns])
            gram = np.block([[gram, products[:-1, None]], [products[None]]])
        return History((residual, copy), columns, gram, self.since + 1)

    def younger(self) -> History:
        """Without the older half: what it says of J may no longer hold."""
        half = len(self.columns) // 2
        return replace(self, columns=self.columns[half:], gram=self.gram[half:, half:], since=0)

    def mix(self, problem: DeviceProblem, *, out: Array) -> None:
        """Write the candidate for the next iterate."""
        assert self.last is not None
        backend, weighted = problem.backend, problem.weighted
        residual, mixed = self.last
        products = np.array([backend.dot(weighted, column, residual) for column, _ in self.columns])
        for c, (_, column) in zip(coefficients(self.gram, products), self.columns, strict=True):
            mixed = backend.combine(weighted, 1.0, mixed, -float(c), column, out=out)


@dataclass(frozen=True)
class Anderson:
    """The acceleration of a process that does not raise the energy, by mixes that do not either."""

    history: History
    spare: Array  # for the mix
    lowest: float  # energy that was seen
    kept: int = 0
    rejected: int = 0

    @classmethod
    def of(cls, problem: DeviceProblem) -> Anderson:
        """Without a history."""
        return cls(History(), problem.backend.empty(problem.weighted.graph, problem.channels), math.inf)

    def after(self, problem: DeviceProblem, f: Array, image: Array) -> tuple[Anderson, float | None]:
        """With one more sweep, from f to its image; and the energy of the mix in ``spare``, if it is to be kept.

        A mix that would raise the energy is not, and the older half of the history goes.
        """
        history = self.history.after(problem, f, image)
        if not history.is_due:
            return replace(self, history=history), None
        history.mix(problem, out=self.spare)
        # below the lowest seen: the rounding that is allowed for does not add up
        lowest = min(self.lowest, problem.energy(f))
        energy = problem.energy(self.spare)
        if not energy <= highest_allowed(problem, lowest):
            return replace(self, history=history.younger(), lowest=lowest, rejected=self.rejected + 1), None
        return replace(self, history=replace(history, since=0), lowest=min(lowest, energy), kept=self.kept + 1), energy

    def describe(self) -> str:
        """How it went, as a clause."""
        return (
            f"one iterate in {PERIOD} mixed from the last {MEMORY + 1} sweeps (Anderson), "
            f"{self.rejected} of {self.kept + self.rejected} mixes rejected"
        )


def highest_allowed(problem: DeviceProblem, energy: float) -> float:
    """What may pass for an energy that is not higher: rounding is no rise."""
    return energy * (1 + 8 * float(np.finfo(problem.backend.dtype).eps))


def coefficients(gram: FloatArray, products: FloatArray) -> FloatArray:
    """The c that makes |r - dR c| least, from dR' dR and dR' r, (k,); 0 for a column that is 0."""
    length = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    scaled = gram * scale[:, None] * scale
    found: FloatArray = scale * np.linalg.solve(scaled + _RIDGE * len(gram) * np.eye(len(gram)), scale * products)
    return found
