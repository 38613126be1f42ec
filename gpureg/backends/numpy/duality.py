"""The primitives of the certified solvers, in numpy."""

from __future__ import annotations

import numpy as np

from ...arrays import FloatArray
from ...graphs.grid import AnyGraph, GridGraph
from ..duality import BALL_ROUNDINGS, momenta
from ..sums import Ratio
from ..types import Array, Box, Conductance, Smoothness, Weighted
from .edges import NumpyGraph, raised

# The maximum number of Newton steps; they stop once nothing moves.
_STEPS = 60


def length(r: FloatArray, sigma: float | FloatArray, share: float, p: float, eps: float) -> FloatArray:
    """Solve sigma t + share phi'(t) = r for t >= 0; r >= 0, and sigma > 0 or p > 1 or eps > 0.

    Newton's method converges from one side: phi' is concave for p < 2, so it starts below the solution, and convex for
    p > 2, so it starts above.
    """
    if p == 2:
        return r / (sigma + share)
    if p == 1 and eps == 0:
        excess: FloatArray = np.maximum(r - share, 0) / sigma
        return excess
    positive = bool(np.all(np.asarray(sigma) > 0))
    if p == 1 and not positive:
        s = np.minimum(r / share, 1)
        below = np.sqrt(np.maximum(1 - s**2, np.finfo(r.dtype).tiny))
        tangent: FloatArray = r.dtype.type(eps) * s / below
        return tangent
    whole = r / share
    with np.errstate(over="ignore", divide="ignore", invalid="ignore", under="ignore"):
        if p < 2:
            # one of the two terms is at least r / 2, and phi'(t) <= min(t eps^(p - 2), t^(p - 1))
            least = whole / 2 if positive else whole
            t: FloatArray = least * r.dtype.type(eps) ** (2 - p)
            if p > 1:
                t = np.maximum(t, least ** (1 / (p - 1)))
            if positive:
                t = np.minimum(t, r / (2 * sigma))
            if p == 1:
                t = np.maximum(t, (r - share) / sigma)
        else:
            # no term is larger than r, and phi'(t) >= max(t eps^(p - 2), t^(p - 1))
            t = whole ** (1 / (p - 1))
            if eps > 0:
                t = np.minimum(t, whole * r.dtype.type(eps) ** (2 - p))
            if positive:
                t = np.minimum(t, r / sigma)
        t = np.where(r > 0, np.maximum(t, np.finfo(r.dtype).tiny), 0)
        for _ in range(_STEPS):
            square = t**2 + r.dtype.type(eps) ** 2
            g = np.where(square > 0, raised(np.where(square > 0, square, 1), (p - 2) / 2), 0)
            ratio = np.where(square > 0, t**2 / np.where(square > 0, square, 1), 1)
            value = sigma * t + share * g * t - r
            rise = sigma + share * g * (1 + (p - 2) * ratio)
            step = np.where(rise > 0, value / np.where(rise > 0, rise, 1), 0)
            moved = np.maximum(t - step, 0)
            if not (np.abs(moved - t) > 2 * np.finfo(r.dtype).eps * np.abs(t)).any():
                break
            t = moved
    found: FloatArray = t
    return found


def step_length(r: FloatArray, sigma: float | FloatArray, share: float, p: float, eps: float) -> FloatArray:
    """Compute s = share phi'(t) = r - sigma t for t of :func:`length`, in the form that loses no digits."""
    if p == 1 and eps == 0:
        least: FloatArray = np.minimum(r, share)
        return least
    t = length(r, sigma, share, p, eps)
    square = np.minimum(t**2 + r.dtype.type(eps) ** 2, np.finfo(r.dtype).max)
    far = (2 * sigma * t > r) & (square > 0)
    slope = share * t * raised(np.where(far, square, 1), (p - 2) / 2)
    found: FloatArray = np.where(far, slope, r - sigma * t)
    return found


def conjugate(s: FloatArray, share: float, p: float, eps: float) -> FloatArray:
    """Compute (share phi)*(s) for s >= 0; for p = 1 a value s > share counts as share."""
    found: FloatArray
    if p == 1:
        inside = np.minimum(s / share, 1)
        found = -share * s.dtype.type(eps) * np.sqrt(np.maximum(1 - inside**2, 0))
    elif p == 2:
        found = s**2 / (2 * share) - share * s.dtype.type(eps) ** 2 / 2
    else:
        with np.errstate(over="ignore", invalid="ignore"):
            # t maximises s t - share phi(t), so a rounded exponent has only an effect of second order
            t = length(s, 0.0, share, p, eps) if eps > 0 else raised(s / share, 1 / (p - 1))
            found = s * t - share * raised(t**2 + s.dtype.type(eps) ** 2, p / 2) / p
        # the conjugate is >= -share eps^p / p: -inf or NaN comes from an overflow
        found = np.where(np.isfinite(found), found, np.inf)
    return found


class NumpyDuality(NumpyGraph):
    """The primitives of the certified solvers."""

    def _combine(
        self,
        graph: AnyGraph,
        a: float | Ratio,
        x: Array,
        b: float | Ratio,
        y: Array,
        over: float | Array,
        out: Array,
    ) -> None:
        out[...] = self._term(a, x, 1.0) + self._term(b, y, over)

    def _term(self, coefficient: float | Ratio, x: Array, over: float | Array) -> FloatArray:
        """Compute a term of `combine`."""
        if isinstance(coefficient, Ratio):
            above, below = (coefficient.numbers.values[at] for at in (coefficient.above, coefficient.below))
            value = self.real(coefficient.sign * (above / below) if below > 0 else 0)
            if value == 0:
                return np.zeros_like(x)
        else:
            value = self.real(coefficient)
        term: FloatArray = value * (x / np.asarray(over, self.dtype))
        return term

    def _gradient(
        self, weighted: Weighted, f: Array, f0: Array | None, g: Conductance, lam: float | Array, out: Array
    ) -> None:
        lam = self._column(lam, len(f))
        pinned = np.isinf(lam)
        pull = np.where(pinned, 0, lam) * (f if f0 is None else f - f0)
        out[...] = np.where(pinned, 0, pull - self._flow(weighted, f, g))

    def _around(self, graph: AnyGraph, H: FloatArray) -> FloatArray:
        """Sum a function on the edges over the edges that start at each vertex, (n, channels)."""
        if isinstance(graph, GridGraph):
            total: FloatArray = H.sum(axis=0).reshape(graph.n_vertices, -1)
            return total
        sums = np.zeros((graph.n_vertices, H.shape[1]), H.dtype)
        np.add.at(sums, graph.edge_rows(), H)
        return sums

    def _at_edges(self, graph: AnyGraph, x: FloatArray) -> FloatArray:
        """Expand a function on the vertices to the edges that start there."""
        return x.reshape(*graph.shape, -1) if isinstance(graph, GridGraph) else x[graph.edge_rows()]

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
        graph = weighted.graph
        p, eps, edge_norm = model.p, model.eps, model.edge
        ahead, back = (self.real(x) for x in momenta(beta))
        moved = f + ahead * (f - f_previous)
        length, of_edges = self._steps(graph, sigma, edge_norm)
        z = y + back * (y - previous) + of_edges * self.difference(weighted, moved)
        square = (z**2).sum(axis=-1, keepdims=True) if model.coupled else z**2
        r = np.sqrt(square if edge_norm else self._around(graph, square))
        share = 0.5 if edge_norm else 1.0
        s = step_length(r, length, share, p, eps)
        if p == 1:
            # the certificate needs y inside the unit ball, in spite of the roundings of a norm
            s = np.minimum(s, share * (1 - BALL_ROUNDINGS * np.finfo(self.dtype).eps))
        factor = np.where(r > 0, s / np.where(r > 0, r, 1), 0).astype(self.dtype)
        previous[...] = z * (factor if edge_norm else self._at_edges(graph, factor))
        return previous

    def _steps(self, graph: AnyGraph, sigma: float | Array, edge_norm: bool) -> tuple[FloatArray, FloatArray]:
        """Return a step length for each norm, and for each directed edge, or one number for all."""
        if isinstance(sigma, float | int):
            return self.real(sigma), self.real(sigma)
        own = self._at_edges(graph, sigma)
        if not edge_norm:
            return sigma, own
        if isinstance(graph, GridGraph):
            planes = np.broadcast_to(own, (len(graph.offsets), *graph.shape, 1)).copy()
            for plane, step in enumerate(graph.offsets):
                start, end = graph.ends(step)
                planes[plane][start] = np.minimum(own[start], own[end])
            return planes, planes
        smaller = np.minimum(own, sigma[graph.indices])
        return smaller, smaller

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
    ) -> None:
        lam = self._column(lam, len(f))
        pinned = np.isinf(lam)
        tau = self._column(tau, len(f))
        pull = tau * np.where(pinned, 0, lam)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            share = np.where(pull > 1, 1 / (1 + 1 / pull), pull / (1 + pull))
        moved = f - tau * self.adjoint(weighted, y)
        moved += share * (f0 - moved)
        if box is not None:
            moved = np.clip(moved, box.low, box.high)
        out[...] = np.where(pinned, f0, moved)

    def _primal(self, weighted: Weighted, y: Array, f0: Array, lam: float | Array, out: Array) -> None:
        out[...] = f0 - self.adjoint(weighted, y) / self._column(lam, len(f0))
