"""combine(u) = a x(u) + b y(u) / over(u)

Where over is infinite: a x(u).

One work item: one vertex; it reads only its own numbers, so that out may be x or y.
Traffic per vertex: reads 2 M values and over, writes M. The weights are not read.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(real, M, over):
    """Make the kernel for M channels; `over` has 1 channel or M, or is a number (0)."""
    function = reals.vector(real, M)
    at, put = reals.reading(function), reals.writing(function)
    over_type, quotient = reals.divided(real, M, over)

    @wp.kernel(module="unique", enable_backward=False)
    def combine(
        a: real,
        x: wp.array2d(dtype=function),  # M channels
        b: real,
        y: wp.array2d(dtype=function),  # M channels
        over: over_type,  # a number, 1 channel or M
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        row, k = first[0] + i, first[1] + j
        put(out, row, k, a * at(x, row, k) + b * quotient(at(y, row, k), over, row, k))

    return combine
