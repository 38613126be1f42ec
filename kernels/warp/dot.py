"""dot = sum_u a(u) b(u) / over(u)

The term is 0 where over is infinite.

One work item: a segment of a row, as in energy.py; it writes its sum in float64, and total.py adds the sums.
Traffic per vertex: reads 2 M values and over. The weights are not read.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(real, M, over):
    """Make the kernel for M channels; `over` has 1 channel or M, or is a number (0)."""
    function = reals.vector(real, M)
    at = reals.reading(function)
    over_type, quotient = reals.divided(real, M, over)

    @wp.func
    def segment_sum(
        a: wp.array2d(dtype=function),
        b: wp.array2d(dtype=function),
        over: over_type,
        row: int,
        begin: int,
        stride: int,
        count: int,
    ) -> wp.float64:
        total = wp.float64(0.0)
        x = int(begin)
        last = wp.min(a.shape[1], begin + count * stride)
        while x < last:
            total += wp.float64(wp.dot(at(a, row, x), quotient(at(b, row, x), over, row, x)))
            x += stride
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def dot(
        a: wp.array2d(dtype=function),  # M channels
        b: wp.array2d(dtype=function),  # M channels
        over: over_type,  # a number, 1 channel or M
        reach: int,  # step from a segment's first vertex to that of the next segment
        stride: int,  # step between the vertices of a segment
        count: int,  # vertices in a segment
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=wp.float64),  # (rows, segments)
    ):
        i, j = wp.tid()
        row, s = first[0] + i, first[1] + j
        out[row, s] = segment_sum(a, b, over, row, s * reach, stride, count)

    return dot
