"""The protocol of the certified solvers: duality, vectors, residuals.

y, the dual variable, is a function on the directed edges: minimising the energy over f is maximising over y

    - sum_u phi*(|y(u, .)|) - 1/2 sum_u |d*y(u)|^2 / lam(u) + sum_u d*y(u) f0(u),    phi(t) = (t^2 + eps^2)^(p/2) / p

with d* the adjoint of the difference and phi* the conjugate of phi; with the edge norm the first sum is that of
(phi/2)*(|y(u, v)|) over the edges. The minimiser is f = f0 - d*y / lam at the best y. The equations are in
``kernels/README.md``.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

from ..graphs.grid import AnyGraph
from .data import Data
from .types import Array, Conductance, Smoothness, Weighted

# An edge function of p = 1 stays inside the unit ball by so many roundings: what a norm may be off by on a device.
BALL_ROUNDINGS = 32

ProxCase = Literal["ball", "square", "power", "newton"]


def prox_case(p: float, eps: float) -> ProxCase:
    """Which form the proximal step has: p = 1 and p = 2 are closed, eps = 0 has a closed conjugate, else Newton's."""
    if p == 1 and eps == 0:
        return "ball"
    if p == 2:
        return "square"
    return "power" if eps == 0 else "newton"


class Duality(Data):
    """What a certified or accelerated solver asks of a device besides the paper's primitives."""

    # Vectors: they need no weights

    @abstractmethod
    def max_change(self, graph: AnyGraph, a: Array, b: Array) -> float:
        """Find the largest absolute difference; infinity if there is a NaN."""

    @abstractmethod
    def dot(self, graph: AnyGraph, a: Array, b: Array, *, over: float | Array = 1.0) -> float:
        """Sum a b / over over vertices and channels; where `over`, a number or a function, is infinite, 0.

        `over` has 1 channel or those of a and b. The sum is taken in float64, or compensated.
        """

    def combine(
        self,
        graph: AnyGraph,
        a: float,
        x: Array,
        b: float,
        y: Array,
        *,
        over: float | Array = 1.0,
        out: Array | None = None,
    ) -> Array:
        """Compute a x + b y / over, without the second term where `over` is infinite; `out` may be x or y."""
        out = self._out(graph, self.channels(x), out)
        self._combine(graph, a, x, b, y, over, out)
        return out

    @abstractmethod
    def _combine(
        self, graph: AnyGraph, a: float, x: Array, b: float, y: Array, over: float | Array, out: Array
    ) -> None: ...

    def copy(self, graph: AnyGraph, x: Array, *, out: Array) -> Array:
        """Copy x to `out`."""
        return self.combine(graph, 1.0, x, 0.0, x, out=out)

    # Steps on a graph with weights

    def gradient(
        self,
        weighted: Weighted,
        f: Array,
        f0: Array | None,
        g: Conductance,
        lam: float | Array,
        *,
        out: Array | None = None,
    ) -> Array:
        """Compute the energy's gradient, given the conductances; 0 where lam is infinite.

            lam (f - f0) + p-Laplacian of f

        Without f0 that is 0: then this is the matrix of eq. 25, applied to f.
        """
        out = self._out(weighted.graph, self.channels(f), out)
        self._gradient(weighted, f, f0, g, lam, out)
        return out

    @abstractmethod
    def _gradient(
        self, weighted: Weighted, f: Array, f0: Array | None, g: Conductance, lam: float | Array, out: Array
    ) -> None: ...

    @abstractmethod
    def dual_step(
        self,
        weighted: Weighted,
        y: Array,
        previous: Array,
        f: Array,
        f_previous: Array,
        model: Smoothness,
        *,
        beta: float,
        sigma: float,
    ) -> Array:
        """Do a proximal step of the dual variable from y + beta (y - previous), which overwrites `previous`.

        With f* = f + beta (f - f_previous) and z = y + beta (y - previous) + sigma d_w f*: what minimises
        |x - z|^2 / 2 + sigma sum phi*(|x(u, .)|) over x.
        """

    def primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, *, out: Array | None = None) -> Array:
        """Compute the function that belongs to a dual variable; f0 where lam is infinite.

        f0 - d*y / lam
        """
        out = self._out(weighted.graph, self.channels(f0), out)
        self._primal(weighted, y, f0, lam, out)
        return out

    @abstractmethod
    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None: ...

    @abstractmethod
    def duality_gap(
        self, weighted: Weighted, f: Array, y: Array, f0: Array, lam: float | Array, model: Smoothness
    ) -> float:
        """Compute the energy of f minus the dual energy of y, p >= 1, as a sum of terms that are none below 0."""
