"""degree(u) = sum_v gamma(u, v)^2, which is sum_v w(u, v) with gamma = sqrt(w)                      (section 2.1)

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights, on CSR also D indices; writes one number.
"""

import functools

import warp as wp

from . import gamma
from .reals import vector


@functools.cache
def make(access):
    """The kernel for one kind of graph."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    number, hold = vector(real, 1), gamma.make(real, access.directed, 1, 1).hold

    @wp.func
    def around(graph: Graph, u: Place) -> number:
        total = number()
        for i in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, i)
            if exists(graph, v):
                total += number(hold(edge(graph, u, i, v)))
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
