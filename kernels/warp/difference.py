"""difference(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u)                          (eq. 4; the edge derivative of eq. 5)

One work item: the edges of one vertex.
Traffic per vertex with D neighbours: reads D weights and (D + 1) M values (grid: all but M from the cache; CSR: also D
indices); writes D M numbers, 0 where an edge leaves the grid.
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def make(access, M):
    """Make the kernel for one kind of graph and M channels."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at, function = access.edge_at, reals.vector(real, M)
    at, put = reals.reading(function), reals.writing(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference_of, derived = of.difference, of.derived

    @wp.func
    def write_all(graph: Graph, f: wp.array2d(dtype=function), out: wp.array3d(dtype=function), u: Place):
        here = at(f, u[0], u[1])
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            d = function()
            if exists(graph, v):
                e = edge(graph, u, i, v)
                d = derived(e, difference_of(e, here, at(f, v[0], v[1])))
            to = edge_at(u, i)
            put(out, to[0], to[1], to[2], d)
            i += 1

    @wp.kernel(module="unique", enable_backward=False)
    def difference(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array3d(dtype=function),  # M channels per directed edge
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        write_all(graph, f, out, place(graph, row, x))

    return difference
