"""x(u) += e(a) for all vertices u of the aggregate a

From a function e of a level of multigrid, a stored graph, to one of the level before it; x of a vertex in no list does
not change.

One work item: one aggregate.
Traffic per vertex of the finer level: reads its place and M values, writes M; per aggregate: reads a start and M
values.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(real, M):
    """Make the kernel for M channels."""
    function = reals.vector(real, M)
    at, put, index_at = reals.reading(function), reals.writing(function), reals.reading(wp.int32, 1)

    @wp.kernel(module="unique", enable_backward=False)
    def prolong(
        starts: wp.array(dtype=wp.int32),  # (n + 1,): where the list of each aggregate begins
        places: wp.array(dtype=wp.int32),  # (members,): vertices
        e: wp.array2d(dtype=function),  # M channels, on the coarser level
        first: wp.vec2i,  # row and x of the launch's first work item
        # input and output
        x: wp.array2d(dtype=function),  # M channels, on the finer level
    ):
        _, j = wp.tid()
        a = first[1] + j
        add = at(e, 0, a)
        k = index_at(starts, a)
        end = index_at(starts, a + 1)
        while k < end:
            u = index_at(places, k)
            row = u / x.shape[1]
            at_x = u - row * x.shape[1]
            put(x, row, at_x, at(x, row, at_x) + add)
            k += 1

    return prolong
