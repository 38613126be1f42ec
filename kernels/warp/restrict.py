"""restrict(a) = sum of x(u) - y(u) over the vertices u of the aggregate a

From the functions x, y of a level of multigrid to one of the next level, a stored graph.

One work item: one aggregate. The sum has a fixed order, that of the list.
Traffic per vertex of the finer level: reads its place and 2 M values; per aggregate: reads a start, writes M values.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(real, M):
    """Make the kernel for M channels."""
    function = reals.vector(real, M)
    at, put, index_at = reals.reading(function), reals.writing(function), reals.reading(wp.int32, 1)

    @wp.func
    def summed(
        x: wp.array2d(dtype=function),
        y: wp.array2d(dtype=function),
        places: wp.array(dtype=wp.int32),
        begin: int,
        end: int,
    ) -> function:
        total = function()
        i = wp.int32(begin)
        while i < end:
            u = index_at(places, i)
            row = u / x.shape[1]
            k = u - row * x.shape[1]
            total += at(x, row, k) - at(y, row, k)
            i += 1
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def restrict(
        starts: wp.array(dtype=wp.int32),  # (n + 1,): where the list of each aggregate begins
        places: wp.array(dtype=wp.int32),  # (members,): vertices
        x: wp.array2d(dtype=function),  # M channels, on the finer level
        y: wp.array2d(dtype=function),  # M channels, on the finer level
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels, on the next level
    ):
        _, j = wp.tid()
        a = first[1] + j
        put(out, 0, a, summed(x, y, places, index_at(starts, a), index_at(starts, a + 1)))

    return restrict
