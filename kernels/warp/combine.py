"""combine(u) = a x(u) + b y(u) / over(u)

Where over is infinite: a x(u). With `ratios` a and b are multiplied by quotients of numbers on the device (0 if the
divisor is not > 0), and a term whose coefficient is 0 is left out, whatever its function is.

One work item: one vertex; it reads only its own numbers, so that out may be x or y.
Traffic per vertex: reads 2 M values and over, writes M. The weights are not read.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(real, M, over, ratios=False):
    """Make the kernel for M channels; `over` has 1 channel or M, or is a number (0)."""
    function = reals.vector(real, M)
    at, put = reals.reading(function), reals.writing(function)
    over_type, quotient = reals.divided(real, M, over)

    @wp.func
    def coefficient(factor: real, numbers: wp.array(dtype=wp.float64), above: int, below: int) -> real:
        """Return the factor times the quotient of two numbers; the factor if a place is < 0."""
        if below < 0:
            return factor
        divisor = numbers[below]
        if divisor > wp.float64(0):
            return real(wp.float64(factor) * (numbers[above] / divisor))
        return real(0)

    @wp.kernel(module="unique", enable_backward=False)
    def combine(
        a: real,
        x: wp.array2d(dtype=function),  # M channels
        b: real,
        y: wp.array2d(dtype=function),  # M channels
        over: over_type,  # a number, 1 channel or M
        numbers: wp.array(dtype=wp.float64),  # read with `ratios`
        places: wp.vec4i,  # of the quotients that a and b are multiplied by; -1: none
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        row, k = first[0] + i, first[1] + j
        if wp.static(ratios):
            first_factor = coefficient(a, numbers, places[0], places[1])
            second_factor = coefficient(b, numbers, places[2], places[3])
            result = function()
            if first_factor != real(0):
                result = first_factor * at(x, row, k)
            if second_factor != real(0):
                result += second_factor * quotient(at(y, row, k), over, row, k)
            put(out, row, k, result)
        else:
            put(out, row, k, a * at(x, row, k) + b * quotient(at(y, row, k), over, row, k))

    return combine
