"""length(r) = the t >= 0 with sigma t + share phi'(t) = r,   phi(t) = (t^2 + eps^2)^(p/2) / p

s = r - sigma length(r) is the norm of the proximal step of sigma (share phi)* from a point of norm r. With sigma = 0,
t = length(s) maximises s t - share phi(t), which gives the conjugate (share phi)*(s). The cases are:

  "newton"   any p >= 1, eps >= 0     "ball"   p = 1, eps = 0     "square"   p = 2     "power"   p > 1, eps = 0

The second and third have closed forms, the last has one for the conjugate. Newton's method converges from one side:
phi' is concave for p < 2, so it starts below the solution, and convex for p > 2, so it starts above.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from . import reals

# The maximum number of Newton steps. They are monotone: they stop at a step back, which is rounding.
_STEPS = wp.constant(60)


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

    @wp.func
    def length(r: real, sigma: real, p: real, eps: real) -> real:
        if not r > zero:
            return zero
        whole = r / share
        t = real(0.0)
        if p < two:
            # one of the two terms is at least r / 2, and phi'(t) <= min(t eps^(p - 2), t^(p - 1))
            least = whole
            if sigma > zero:
                least = whole / two
            if eps > zero:
                t = least * raise_(eps, two - p)
            if p > one:
                t = wp.max(t, raise_(least, one / (p - one)))
            if sigma > zero:
                t = wp.min(t, r / (two * sigma))
            if p == one:
                t = wp.max(t, (r - share) / sigma)
        else:
            # no term is larger than r, and phi'(t) >= max(t eps^(p - 2), t^(p - 1))
            t = raise_(whole, one / (p - one))
            if eps > zero:
                t = wp.min(t, whole * raise_(eps, two - p))
            if sigma > zero:
                t = wp.min(t, r / sigma)
        t = wp.min(wp.max(t, tiny), largest)
        for _ in range(_STEPS):
            square = t * t + eps * eps
            g = real(0.0)
            ratio = real(1.0)
            if square > zero and square <= largest:
                g = raise_(square, (p - two) / two)
                ratio = t * t / square
            rise = sigma + share * g * (one + (p - two) * ratio)
            step = real(0.0)
            if rise > zero:
                step = (sigma * t + share * g * t - r) / rise
            moved = wp.max(t - step, zero)
            ahead = t - moved
            if p < two:
                ahead = moved - t
            moving = ahead > two * rounding * t
            t = moved
            if not moving:
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
        def factor(square: real, sigma: real, p: real, eps: real) -> real:
            r = wp.sqrt(wp.min(square, largest))
            if not r > zero:
                return one
            # use the side of the equation that loses no digits
            t = length(r, sigma, p, eps)
            s = r - sigma * t
            square_t = wp.min(t * t + eps * eps, largest)
            if two * sigma * t > r and square_t > zero:
                s = share * t * raise_(square_t, (p - two) / two)
            if p == one:
                s = wp.min(s, ball)
            return s / r

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
