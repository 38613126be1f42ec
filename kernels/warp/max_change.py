"""max_change = max over vertices and channels of |a - b|; infinity if any difference is not a number.

One work item: a segment of a row, the `count` vertices at s * reach + i * stride; it writes its maximum, and total.py
finds the largest one. Traffic per vertex: reads 2 M values. The graph is not read.
"""

import functools

import warp as wp

from .reals import reading, vector


@functools.cache
def make(real, M):
    """Make the kernel for M channels."""
    function = vector(real, M)
    at = reading(function)

    @wp.func
    def segment_max(
        a: wp.array2d(dtype=function), b: wp.array2d(dtype=function), row: int, begin: int, stride: int, count: int
    ) -> real:
        largest = real(0.0)
        x = int(begin)
        last = wp.min(a.shape[1], begin + count * stride)
        while x < last:
            d = at(a, row, x) - at(b, row, x)
            for c in range(M):
                change = wp.abs(d[c])
                # wp.max may drop a NaN: use infinity instead
                if wp.isnan(change):
                    change = real(wp.inf)
                largest = wp.max(largest, change)
            x += stride
        return largest

    @wp.kernel(module="unique", enable_backward=False)
    def max_change(
        a: wp.array2d(dtype=function),  # M channels
        b: wp.array2d(dtype=function),  # M channels
        reach: int,  # step from a segment's first vertex to that of the next segment
        stride: int,  # step between the vertices of a segment
        count: int,  # vertices in a segment
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=real),  # (rows, segments)
    ):
        i, j = wp.tid()
        row, s = first[0] + i, first[1] + j
        out[row, s] = segment_max(a, b, row, s * reach, stride, count)

    return max_change
