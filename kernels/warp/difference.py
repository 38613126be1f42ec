"""difference(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u)                          (eq. 4; the edge derivative of eq. 5)

One work item: the edges of one vertex.
Traffic per vertex of D neighbours: reads D weights and (D + 1) M values, of which a grid finds all but M in the cache;
writes D M numbers, on a grid 0 where an edge leaves it.
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def make(access, M):
    """The kernel for one kind of graph and M channels."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at, function = access.edge_at, reals.vector(real, M)
    of = gamma.make(real, access.directed, M, 1)
    difference_of, derived = of.difference, of.derived

    @wp.func
    def write_all(graph: Graph, f: wp.array2d(dtype=function), out: wp.array3d(dtype=function), u: Place):
        here = f[u[0], u[1]]
        for i in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, i)
            d = function()
            if exists(graph, v):
                e = edge(graph, u, i, v)
                d = derived(e, difference_of(e, here, f[v[0], v[1]]))
            at = edge_at(u, i)
            out[at[0], at[1], at[2]] = d

    @wp.kernel(module="unique", enable_backward=False)
    def difference(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        # output
        out: wp.array3d(dtype=function),  # M channels per directed edge
    ):
        row, x = wp.tid()
        write_all(graph, f, out, place(graph, row, x))

    return difference
