"""Derivatives of a number of plain Jacobi sweeps (eq. 25), from the last sweep to the first.

With the gradient r of the energy and the diagonal a of lam + d* c d a sweep is f+ = f - theta r/a, and f0 where f is
pinned or a is 0. If b is the derivative of L with respect to f+, that with respect to anything else is the derivative
of <rho, r> + <sigma, a> for fixed rho = - theta b/a, sigma = theta b r/a^2, and b passes on to f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from .energy import HostEnergy, Point
from .partials import Partials, diagonal
from .parts import Part

# A sweep that still raises the energy after this number of halvings is skipped, as the solver does.
_HALVINGS = 30


@dataclass(frozen=True)
class Damping:
    """The damping theta of the sweeps, as :class:`gpureg.Jacobi` chooses it.

    Attributes
    ----------
    theta : float
    by_p : float
        Its derivative with respect to p, as a share of it.
    guarded : bool
        Whether theta is halved in a sweep that would raise the energy.
    """

    theta: float
    by_p: float = 0.0
    guarded: bool = False

    @classmethod
    def of(cls, energy: HostEnergy, given: float | None) -> Damping:
        """Choose the damping for a problem; `given` is that of the solver."""
        if given is not None:
            return cls(given)
        if energy.p > 2:
            return cls(1 / (energy.p - 1), -1 / (energy.p - 1), True)
        return cls(0.5 if energy.on.swings() else 1.0)


@dataclass(frozen=True, eq=False)
class Swept:
    """The iterates of a number of sweeps.

    Attributes
    ----------
    energy : HostEnergy
    damping : Damping
    from_f0 : bool
        Whether the first iterate is the data.
    before : list of (n, m) float arrays
        The iterate before each sweep.
    thetas : list of float
        Its damping.
    f : (n, m) float array
        The last iterate.
    """

    energy: HostEnergy
    damping: Damping
    from_f0: bool
    before: list[FloatArray]
    thetas: list[float]
    f: FloatArray

    @classmethod
    def of(cls, energy: HostEnergy, start: FloatArray | None, sweeps: int, damping: Damping) -> Swept:
        """Do the sweeps from a start, (n, m); None means the data."""
        f = energy.f0 if start is None else start
        before, thetas = [], []
        for _ in range(sweeps):
            point, theta = energy.at(f), damping.theta
            f = _after(point, theta)
            if damping.guarded:
                allowed = point.value * (1 + 8 * float(np.finfo(np.float64).eps))
                halved = 0
                while not energy.at(f).value <= allowed and halved < _HALVINGS:
                    halved += 1
                    theta = damping.theta / 2**halved if halved < _HALVINGS else 0.0
                    f = _after(point, theta)
            before.append(point.f)
            thetas.append(theta)
        return cls(energy, damping, start is None, before, thetas, f)

    def derivatives(self, g: FloatArray) -> Part:
        """Compute the derivatives of a number with the gradient g at f, (n, m), in the units of the data."""
        b, found = g, Part.none(self.energy)
        for f, theta in zip(reversed(self.before), reversed(self.thetas), strict=True):
            point = self.energy.at(f)
            moved, a, r = _parts(point)
            step = np.where(moved, theta * b / a, 0)
            partials = Partials.of(point, -step, (step * r / a).sum(axis=1))
            part = Part.of(partials, sign=1.0, f0=partials.f0 + np.where(moved, 0, b))
            # f+ - f = - theta r/a grows with theta
            by_theta = -float((step * r).sum())
            found = found.plus(replace(part, p=part.p + by_theta * self.damping.by_p))
            b = np.where(moved, b, 0) + partials.f
        return replace(found, f0=found.f0 + b) if self.from_f0 else found


def _parts(point: Point) -> tuple[npt.NDArray[np.bool_], FloatArray, FloatArray]:
    """Return where a sweep moves f, (n, 1), its diagonal a, (n, 1), 1 elsewhere, and the gradient r, (n, m)."""
    e = point.energy
    a = e.lam + diagonal(point)[:, None]
    moved = ~e.pinned[:, None] & (a > 0)
    r = e.lam * (point.f - e.f0) + e.adjoint @ point.flux
    return moved, np.where(moved, a, 1), r


def _after(point: Point, theta: float) -> FloatArray:
    moved, a, r = _parts(point)
    return np.where(moved, point.f - theta * r / a, point.energy.f0)
