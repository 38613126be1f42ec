"""The protocol of the certified solvers: duality, vectors, residuals.

The dual variable y is a function on the directed edges. Instead of minimising the energy over f, maximise over y

    - sum_u phi*(|y(u, .)|) - 1/2 sum_u |d*y(u)|^2 / lam(u) + sum_u d*y(u) f0(u),    phi(t) = (t^2 + eps^2)^(p/2) / p

where d* is the adjoint of the difference and phi* the conjugate of phi. With the edge norm the first sum is that of
(phi/2)*(|y(u, v)|) over the edges. At the maximum, f = f0 - d*y / lam minimises the energy. The equations are in
``kernels/README.md``.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

from ..graphs.grid import AnyGraph
from .data import Data
from .sums import Ratio
from .types import Array, Box, Conductance, Smoothness, Weighted

# At p = 1, y stays inside the unit ball by this many roundings, the error of a norm on a device.
BALL_ROUNDINGS = 32

ProxCase = Literal["ball", "square", "power", "newton"]


def prox_case(p: float, eps: float) -> ProxCase:
    """Choose the proximal step: closed form at p = 1 and p = 2, closed conjugate at eps = 0, Newton otherwise."""
    if p == 1 and eps == 0:
        return "ball"
    if p == 2:
        return "square"
    return "power" if eps == 0 else "newton"


def momenta(beta: float | tuple[float, float]) -> tuple[float, float]:
    """Return the momentum of f and that of y in a dual step."""
    return beta if isinstance(beta, tuple) else (beta, beta)


class Duality(Data):
    """The primitives of the certified and accelerated solvers, which are not in the paper."""

    # Vectors, without weights

    def combine(
        self,
        graph: AnyGraph,
        a: float | Ratio,
        x: Array,
        b: float | Ratio,
        y: Array,
        *,
        over: float | Array = 1.0,
        out: Array | None = None,
    ) -> Array:
        """Compute a x + b y / over; the second term is 0 where `over` is infinite. `out` may be x or y.

        A term is left out if its coefficient is a :class:`Ratio` that is 0, whatever its function is.
        """
        out = self._out(graph, self.channels(x), out)
        self._combine(graph, a, x, b, y, over, out)
        return out

    @abstractmethod
    def _combine(
        self,
        graph: AnyGraph,
        a: float | Ratio,
        x: Array,
        b: float | Ratio,
        y: Array,
        over: float | Array,
        out: Array,
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
        """Compute the gradient of the energy, given the conductances; 0 where lam is infinite.

            lam (f - f0) + p-Laplacian of f

        If f0 is None it counts as 0: the result is the matrix of eq. 25, applied to f.
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
        beta: float | tuple[float, float],
        sigma: float | Array,
    ) -> Array:
        """Do a proximal step of the dual variable; the result overwrites `previous`.

        It is the x that minimises |x - z|^2 / 2 + sigma sum phi*(|x(u, .)|), with

            z = y + beta_y (y - previous) + sigma d_w(f + beta_f (f - f_previous))

        `beta` is one number for both, or a pair (beta_f, beta_y).
        `sigma` is a number or (n, 1): sigma(u) for the edges that start at u, with the edge norm the smaller one of
        both ends.
        """

    def proximal(
        self,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        tau: float | Array,
        *,
        box: Box | None = None,
        out: Array | None = None,
    ) -> Array:
        """Do a proximal step of the fidelity from f - tau d*y, and clip it to the box; `out` may be f.

            (f - tau d*y + tau lam f0) / (1 + tau lam)

        It is f0 where lam is infinite. `tau` is a number or (n, 1).
        """
        out = self._out(weighted.graph, self.channels(f), out)
        self._proximal(weighted, f, y, f0, lam, tau, box, out)
        return out

    @abstractmethod
    def _proximal(
        self,
        weighted: Weighted,
        f: Array,
        y: Array,
        f0: Array,
        lam: float | Array,
        tau: float | Array,
        box: Box | None,
        out: Array,
    ) -> None: ...

    def primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, *, out: Array | None = None) -> Array:
        """Compute the function f0 - d*y / lam of a dual variable y; f0 where lam is infinite."""
        out = self._out(weighted.graph, self.channels(f0), out)
        self._primal(weighted, y, f0, lam, out)
        return out

    @abstractmethod
    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None: ...
