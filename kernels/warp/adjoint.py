"""adjoint(u) = sum_v gamma(u, v) (H(v, u) - H(u, v))                                     (eq. 7, Proposition 1)

The divergence is -adjoint.

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights and 2 D M edge values (grid: half of them from the cache; CSR:
also D indices of opposite edges); writes M numbers.
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def outflow_around(access, M):
    """Make a function that computes the sum at a vertex; also used by the primal function and the duality gap."""
    real, Graph, Place = access.real, access.Graph, access.Place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at, opposite_at, function = access.edge_at, access.opposite_at, reals.vector(real, M)
    value_at = reals.reading(function, 3)
    own = gamma.make(real, access.directed, M, 1).own

    @wp.func
    def around(graph: Graph, H: wp.array3d(dtype=function), u: Place) -> function:
        total = function()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                here, there = edge_at(u, i), opposite_at(graph, v, i)
                outward = value_at(H, there[0], there[1], there[2]) - value_at(H, here[0], here[1], here[2])
                total += own(edge(graph, u, i, v)) * outward
            i += 1
        return total

    return around


@functools.cache
def make(access, M):
    """Make the kernel for one kind of graph and M channels."""
    Graph, place, function = access.Graph, access.place, reals.vector(access.real, M)
    put, around = reals.writing(function), outflow_around(access, M)

    @wp.kernel(module="unique", enable_backward=False)
    def adjoint(
        graph: Graph,
        H: wp.array3d(dtype=function),  # M channels per directed edge
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        put(out, row, x, around(graph, H, place(graph, row, x)))

    return adjoint
