"""Derivatives of the minimiser, by one system with the Hessian H.

The minimiser f has the gradient 0 for all data and parameters. Differentiating this equation with respect to a
parameter t, with H v = g for the gradient g of L,

    dL/dt = - d/dt <v, gradient of the energy at a fixed f>,          v = 0 where f is pinned.

Where f is pinned, it is the data, and dL/df0 = g - H v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .energy import HostEnergy
from .minimiser import Minimum, minimum
from .partials import Partials
from .parts import Part


@dataclass(frozen=True, eq=False)
class Minimised:
    """The minimiser of an energy.

    Attributes
    ----------
    energy : HostEnergy
    found : Minimum
    """

    energy: HostEnergy
    found: Minimum

    @classmethod
    def of(cls, energy: HostEnergy, start: FloatArray) -> Minimised:
        """Find the minimiser, from a start near it, (n, m)."""
        return cls(energy, minimum(energy, start))

    @property
    def f(self) -> FloatArray:
        """The minimiser, (n, m)."""
        return self.found.point.f

    def derivatives(self, g: FloatArray) -> Part:
        """Compute the derivatives of a number with the gradient g at f, (n, m), in the units of the data."""
        energy = self.energy
        partials = Partials.of(self.found.point, self.found.solve(g))
        f0 = np.where(energy.pinned[:, None], g - partials.f, -partials.f0)
        return Part.of(partials, sign=-1.0, f0=f0)
