"""The minimiser in float64, as exact as rounding allows.

Derivatives at a point that is not the minimiser are wrong, by a factor for p near 1, and nothing shows it. Newton's
method starts from the value of the result. For p < 2 it is primal-dual (see ``solvers/newton.py``); where it does not
come to an end, it starts again with a large eps, which decreases to that of the problem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from .energy import HostEnergy, Point
from .solving import Singular, Solve, solver_of

# Sufficient decrease (Armijo), and the maximal number of halvings of a step.
_DECREASE, _HALVINGS = 1e-4, 40
# Steps of one try, and the factor of eps between two tries.
_STEPS, _FACTOR = 40, 0.2
# A change is rounding if it is at most this share of the largest value.
_STILL = 1e-14
# The residual of a step's system where it is solved by iterations, far from the minimiser and near it.
_ROUGH, _CLOSE = 0.01, 1e-6
# Once a step is at most this share of the largest value, the steps are those of the energy itself.
_NEAR = 1e-4
# What may be left of the way to the minimiser, as a share of the largest value; and of eps for p < 2, as the curvature
# changes over differences of eps. Both are errors of the derivatives.
_LEFT, _LEFT_OF_EPS = 1e-8, 1e-6


@dataclass(frozen=True, eq=False)
class Minimum:
    """A minimiser.

    Attributes
    ----------
    point : Point
    solve : callable
        The solution of a system with the Hessian there, for a right-hand side (n, m); 0 where f is not computed.
    left : float
        Newton's next step, the largest over all values, as a share of the largest value: about the error.
    error : Singular or None
        Why there is no such step, if `left` is infinite.
    """

    point: Point
    solve: Callable[[FloatArray], FloatArray]
    left: float
    error: Singular | None = None


def minimum(energy: HostEnergy, start: FloatArray) -> Minimum:
    """Find the minimiser from a function near it, (n, m).

    Raises
    ------
    ArithmeticError
        It was not found, or the Hessian there is singular.
    """
    start = np.where(energy.pinned[:, None], energy.f0, start)
    allowed = _LEFT if energy.p >= 2 else min(_LEFT, _LEFT_OF_EPS * energy.eps)
    found = _newton(energy, start)
    if found.left <= allowed:
        return found
    f, eps = start, max(1.0, energy.eps)
    while eps > energy.eps and eps > _STILL:
        f = _newton(energy.with_eps(eps), f).point.f
        eps *= _FACTOR
    again = _newton(energy, f)
    if again.left <= allowed:
        return again
    raise again.error or ArithmeticError(
        "the minimiser could not be found exactly enough for derivatives: Newton's steps still change values by "
        f"{min(found.left, again.left):.2g} of the largest. Use a larger eps or lam, or unrolled=K"
    )


def _newton(energy: HostEnergy, f: FloatArray) -> Minimum:
    """Do Newton steps until only rounding is left, or no step lowers the energy any more."""
    point, near = energy.at(f), energy.p >= 2
    y = point.flux
    best: Minimum | None = None
    for _ in range(_STEPS):
        size = max(float(np.abs(point.f).max(initial=0)), float(np.finfo(np.float64).tiny))
        flat = bool((np.abs(point.gradient) <= 4 * point.rounding).all())
        # close to the end the plain Hessian, which the derivatives need, gives the better steps
        exact = near or flat
        try:
            solve = solver_of(point, None if exact else _shortened(point, y))
            h = point.spread_out(solve(-point.gradient[energy.solved], _CLOSE if exact else _ROUGH))
        except Singular as error:
            return best or Minimum(point, point.spread_out, np.inf, error)
        left = float(np.abs(h).max(initial=0)) / size
        if exact:
            known = Minimum(point, _whole(point, solve), left)
            if best is None or left < best.left:
                best = known
            if flat or left <= _STILL:
                return best
        near = near or left <= _NEAR
        theta = _length(point, h)
        if theta == 0:
            if exact:
                break
            near = True
            continue
        if not exact:
            y = _turned(point, y, h)
        point = energy.at(point.f + theta * h)
    return best or Minimum(point, point.spread_out, np.inf)


def _whole(point: Point, solve: Solve) -> Callable[[FloatArray], FloatArray]:
    """Return a function that solves for (n, m) instead of the values that are computed."""
    return lambda b: point.spread_out(solve(b[point.energy.solved], None))


def _factors(point: Point) -> FloatArray:
    """Return (2 - p) g q^(-p/2) of each group: the factor of y in the linearised system."""
    p = point.energy.p
    return (2 - p) * point.power(-1.0)


def _shortened(point: Point, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the factor and y, (D, m), shortened so that the system is positive definite."""
    e = point.energy
    length = np.sqrt(e.grouped((y**2).sum(axis=1)))
    most = e.share * point.power((e.p - 1) / 2)
    short = np.where(length > most, most / np.where(length > 0, length, 1), 1)
    return _factors(point), y * short[e.group][:, None]


def _turned(point: Point, y: FloatArray, h: FloatArray) -> FloatArray:
    """Return the dual variable after a step h, (n, m)."""
    e = point.energy
    dh = e.matrix @ h
    slope = (_factors(point) * e.grouped((point.df * dh).sum(axis=1)))[e.group][:, None]
    found: FloatArray = e.share * point.c[e.group][:, None] * (point.df + dh) - slope * y
    return found


def _length(point: Point, h: FloatArray) -> float:
    """Return the largest of 1, 1/2, 1/4 ... for which the step h, (n, m), lowers the energy enough; 0 if none does."""
    e = point.energy
    before, slope = point.value, float((point.gradient * h).sum())
    # energies are sums: their rounding grows with the number of terms, as its root
    rounding = 4 * float(np.finfo(np.float64).eps) * abs(before) * max(1.0, len(h) ** 0.5)
    theta = 1.0
    for _ in range(_HALVINGS):
        if e.at(point.f + theta * h).value <= before + _DECREASE * theta * slope + rounding:
            return theta
        theta /= 2
    return 0.0
