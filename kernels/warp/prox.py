"""length(r) = the t >= 0 with sigma t + share phi'(t) = r,   phi(t) = (t^2 + eps^2)^(p/2) / p

s = r - sigma length(r) is the norm of the proximal step of sigma (share phi)* from a point of norm r. With sigma = 0,
t = length(s) maximises s t - share phi(t), which gives the conjugate (share phi)*(s). The cases are:

  "newton"   any p >= 1, eps >= 0     "ball"   p = 1, eps = 0     "square"   p = 2     "power"   p > 1, eps = 0

The second and third have closed forms, the last has one for the conjugate, and for p = 1.5 and 3. The others use
Halley's method on log V = log r for log t, V the left side: the slope lies between those of its two terms, and
the start is at most a factor of 2 off in V. Three or four steps reach rounding.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from . import reals

# The maximum number of steps. They stop below a move of a share `enough`: the error after a step is of the order of the
# cube of the error before, so that below a rounding is left.
_STEPS = wp.constant(30)


@dataclass(frozen=True, eq=False)
class Prox:
    """Functions of squared norms, for one number of a norm.

    factor(square, sigma, p, eps)
        the factor of z in a proximal step; for p = 1 the result is slightly inside the unit ball
    duality(square, dual, product, p, eps)
        share phi + (share phi)* - product, for |d|^2, |y|^2 and <d, y>
    """

    factor: Any
    duality: Any


@functools.cache
def make(real, case, edge_norm):
    """Make the functions for one case; with the edge norm the share is 1/2, as an edge has two ends."""
    raise_ = reals.raising(real)
    share = wp.constant(real(0.5 if edge_norm else 1.0))
    rounding = wp.constant(real(2.220446049250313e-16 if real == wp.float64 else 1.1920929e-7))
    tiny = wp.constant(real(2.2250738585072014e-308 if real == wp.float64 else 1.17549435e-38))
    largest = wp.constant(real(1.7976931348623157e308 if real == wp.float64 else 3.4028235e38))
    ball = wp.constant(real((0.5 if edge_norm else 1.0) * (1 - 32 * float(rounding))))
    one, two, zero = wp.constant(real(1.0)), wp.constant(real(2.0)), wp.constant(real(0.0))

    enough = wp.constant(real(3e-6 if real == wp.float64 else 2e-3))
    far = wp.constant(real(1.5))

    @wp.func
    def move(x: real, slope: real, curvature: real) -> real:
        """Compute the factor of t in a step, given x = r/V, and the slope of log V over log t and its derivative.

        log x and exp of the step are replaced by quotients that are as exact as the method; a step is at most a factor
        of 7.
        """
        steep = (one + x) * slope * slope
        below = wp.max(steep - (one - x) * curvature, steep / two)
        above = wp.clamp(two * (one - x) * slope, zero - below * far, below * far)
        return (two * below - above) / (two * below + above)

    @wp.func
    def solved(r: real, a: real, b: real, unit: real, k: real) -> real:
        """Solve a z + b (z/unit)^k = r for z, for k > 1, r > 0, a > 0, b > 0."""
        if k == two:
            # the root of a square that loses no digits, without a^2 or r b, which may overflow
            c = two * wp.sqrt(b) * wp.sqrt(r) / unit
            m = wp.max(a, c)
            ratio = wp.min(a, c) / m
            return two * r / (a + m * wp.sqrt(one + ratio * ratio))
        z = wp.min(r / a, unit * raise_(r / b, one / k))
        for _ in range(_STEPS):
            power = b * raise_(z / unit, k)
            value = a * z + power
            if not (value > zero and value < largest):
                break
            inverse = one / value
            part = power * inverse
            rest = one - part
            moved = move(r * inverse, rest + k * part, (k - one) * (k - one) * part * rest)
            z = z * moved
            if wp.abs(moved - one) <= enough:
                break
        return z

    @wp.func
    def length(r: real, sigma: real, p: real, eps: real) -> real:
        if not r > zero:
            return zero
        # the smaller one of the solutions with one term alone; phi'(t) is nearly min(t eps^(p - 2), t^(p - 1)) for
        # p < 2, max for p > 2, and for p = 1 it is t / sqrt(t^2 + eps^2)
        whole = r / share
        t = largest
        if p == one:
            if whole < one:
                t = eps * whole / wp.sqrt(one - whole * whole)
            t = wp.min(t, wp.max((r - share) / sigma, eps))
        else:
            t = raise_(whole, one / (p - one))
            if eps > zero:
                linear = whole * raise_(eps, two - p)
                if p < two:
                    t = wp.max(t, linear)
                else:
                    t = wp.min(t, linear)
        if sigma > zero:
            t = wp.min(t, r / sigma)
        t = wp.min(wp.max(t, tiny), largest)
        for _ in range(_STEPS):
            square = t * t + eps * eps
            # no step where squares underflow or overflow: the start is right there
            if not (square > zero and square <= largest):
                break
            term = share * raise_(square, (p - two) / two) * t
            inverse = one / (sigma * t + term)
            part = term * inverse
            ratio = t * t / square
            less = (two - p) * ratio
            curvature = part * ((one - part) * less * less - two * less * (one - ratio))
            moved = move(r * inverse, one - part * less, curvature)
            t = t * moved
            if wp.abs(moved - one) <= enough:
                break
        return t

    if case == "ball":

        @wp.func
        def factor(square: real, sigma: real, p: real, eps: real) -> real:
            if square > ball * ball:
                return ball / wp.sqrt(square)
            return one

        @wp.func
        def conjugate(square: real, p: real, eps: real) -> real:
            return zero

    elif case == "square":

        @wp.func
        def factor(square: real, sigma: real, p: real, eps: real) -> real:
            return share / (sigma + share)

        @wp.func
        def conjugate(square: real, p: real, eps: real) -> real:
            return square / (two * share) - share * eps * eps / two

    else:

        @wp.func
        def outside(r: real, sigma: real, p: real, eps: real) -> real:
            """Compute s, by the side of the equation that loses no digits."""
            t = length(r, sigma, p, eps)
            s = r - sigma * t
            square_t = wp.min(t * t + eps * eps, largest)
            if two * sigma * t > r and square_t > zero:
                s = share * t * raise_(square_t, (p - two) / two)
            if p == one:
                s = wp.min(s, ball)
            return s

        @wp.func
        def power_outside(r: real, sigma: real, p: real, eps: real) -> real:
            """Compute s for eps = 0."""
            if p < two:
                return solved(r, one, sigma, share, one / (p - one))
            t = solved(r, sigma, share, one, p - one)
            if two * sigma * t > r:
                return share * raise_(t, p - one)
            return r - sigma * t

        step_norm = power_outside if case == "power" else outside

        @wp.func
        def factor(square: real, sigma: real, p: real, eps: real) -> real:
            r = wp.sqrt(wp.min(square, largest))
            if not r > zero:
                return one
            return step_norm(r, sigma, p, eps) / r

        if case == "power":

            @wp.func
            def maximiser(square: real, p: real, eps: real) -> real:
                return raise_(square / (share * share), one / (two * (p - one)))

        else:

            @wp.func
            def maximiser(square: real, p: real, eps: real) -> real:
                return length(wp.sqrt(square), zero, p, eps)

        @wp.func
        def conjugate(square: real, p: real, eps: real) -> real:
            if p == one:
                return zero - share * eps * wp.sqrt(wp.max(one - square / (share * share), zero))
            # t maximises s t - share phi(t), so a rounded exponent has only an effect of second order
            t = maximiser(square, p, eps)
            found = wp.sqrt(square) * t - share * raise_(t * t + eps * eps, p / two) / p
            # the conjugate is >= -share eps^p / p: -infinity or NaN comes from an overflow
            if not found >= zero - largest:
                return real(wp.inf)
            return found

    @wp.func
    def duality(square: real, dual: real, product: real, p: real, eps: real) -> real:
        return share * raise_(square + eps * eps, p / two) / p + conjugate(dual, p, eps) - product

    return Prox(factor, duality)
