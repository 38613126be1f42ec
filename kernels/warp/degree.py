"""degree(u) = sum_v w(u, v)                                                                     (section 2.1)

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights, on CSR also D indices; writes one number.
"""

import functools

import warp as wp

from .reals import vector


@functools.cache
def make(access):
    """The kernel for one kind of graph."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, weight = access.begin, access.end, access.neighbour, access.exists, access.weight
    number = vector(real, 1)

    @wp.func
    def around(graph: Graph, u: Place) -> number:
        total = number()
        for e in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, e)
            if exists(graph, v):
                total += number(weight(graph, u, e, v))
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def degree(
        graph: Graph,
        # output
        out: wp.array2d(dtype=number),  # 1 channel
    ):
        row, x = wp.tid()
        out[row, x] = around(graph, place(graph, row, x))

    return degree
