"""degree(u) = sum_v gamma(u, v)^2, which is sum_v w(u, v) with gamma = sqrt(w)                      (section 2.1)
with `largest`: max_v gamma(u, v)^2

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights (CSR: also D indices); writes one number.
"""

import functools

import warp as wp

from . import gamma
from .reals import vector, writing


@functools.cache
def make(access, largest):
    """Make the kernel for one kind of graph."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    number, hold = vector(real, 1), gamma.make(real, access.directed, 1, 1).hold
    put = writing(number)

    if largest:

        @wp.func
        def joined(total: real, w: real) -> real:
            return wp.max(total, w)

    else:

        @wp.func
        def joined(total: real, w: real) -> real:
            return total + w

    @wp.func
    def around(graph: Graph, u: Place) -> number:
        total = real(0.0)
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                total = joined(total, hold(edge(graph, u, i, v)))
            i += 1
        return number(total)

    @wp.kernel(module="unique", enable_backward=False)
    def degree(
        graph: Graph,
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=number),  # 1 channel
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        put(out, row, x, around(graph, place(graph, row, x)))

    return degree
