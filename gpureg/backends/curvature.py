"""The protocol of Newton's method: the second derivatives of the energy.

With df = d_w(f), a group of edges (those that start at a vertex; with the edge norm one edge), q = |df|^2 + eps^2 over
the group, share = 1 (edge norm: 1/2), and one norm for all channels, the Hessian applied to h is

    lam h + d*[ share q^((p-2)/2) dh - share (2 - p) q^((p-4)/2) df <df, dh> ]

and the matrix of a primal-dual step, with a dual variable y at the place of the slope share q^((p-2)/2) df (Chan, Golub
and Mulet 1999 for p = 1),

    lam h + d*[ share q^((p-2)/2) dh - 1/2 (2 - p)/q (y <df, dh> + df <y, dh>) ].

With the vertex norm, numbers per vertex are given: g = share q^((p-2)/2), and the inner products times a factor.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .duality import Duality
from .types import Array, Smoothness, Weighted


@dataclass(frozen=True, eq=False)
class Bend:
    """What the Hessian is made of, apart from the graph and lam.

    Attributes
    ----------
    f : device function, (n, m)
    model : Smoothness
        With one norm for all channels.
    y : device function on the edges, m channels, or None
        The dual variable of a primal-dual step.
    g : device function, (n, 1), or None
        share q^((p-2)/2); None with the edge norm.
    products : device function, (n, 1), with y (n, 2), or None
        share (2 - p) q^((p-4)/2) <df, dh>; with y (2 - p)/q <df, dh> and (2 - p)/q <y, dh>. None with the edge norm.
    floor : float
        With the edge norm: the least q^((p-2)/2) that counts.
    """

    f: Array
    model: Smoothness
    y: Array | None = None
    g: Array | None = None
    products: Array | None = None
    floor: float = 0.0


def least_square(dtype: npt.DTypeLike) -> float:
    """Return the least q that counts in a type, so that no quotient overflows."""
    return 1e-290 if np.dtype(dtype) == np.float64 else 1e-30


class Curvature(Duality):
    """The primitives of Newton's method."""

    def gradient_product(
        self, weighted: Weighted, f: Array, h: Array, by: Array, *, y: Array | None = None, out: Array | None = None
    ) -> Array:
        """Compute by <df, dh> around each vertex, 1 channel; with y on the edges by <y, dh> as the second one."""
        out = self._out(weighted.graph, 1 if y is None else 2, out)
        self._gradient_product(weighted, f, h, by, y, out)
        return out

    @abstractmethod
    def _gradient_product(
        self, weighted: Weighted, f: Array, h: Array, by: Array, y: Array | None, out: Array
    ) -> None: ...

    def hessian(
        self, weighted: Weighted, h: Array, bend: Bend, lam: float | Array, *, out: Array | None = None
    ) -> Array:
        """Apply the Hessian, or the matrix of a primal-dual step, to h, (n, m); 0 where lam is infinite."""
        out = self._out(weighted.graph, self.channels(h), out)
        self._hessian(weighted, h, bend, lam, out)
        return out

    @abstractmethod
    def _hessian(self, weighted: Weighted, h: Array, bend: Bend, lam: float | Array, out: Array) -> None: ...

    @abstractmethod
    def shorten(self, weighted: Weighted, y: Array, f: Array, model: Smoothness, most: Array | None) -> Array:
        """Shorten y on the edges, in place, to |y| <= share q^((p-1)/2), and return it.

        `most` are these numbers, (n, 1); None with the edge norm.
        """

    @abstractmethod
    def dual_newton(self, weighted: Weighted, h: Array, bend: Bend) -> Array:
        """Do Newton's step h of the dual variable, in place, and return it: y = g (df + dh) - (2 - p)/q <df, dh> y."""
