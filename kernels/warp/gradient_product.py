"""gradient_product(u) = by(u) <df, dh>(u, .),   given y also by(u) <y, dh>(u, .)

Inner products over the edges of a vertex and the channels, d the difference d_w (eq. 4).

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values (grid: all but 2 M from the cache; CSR: also D
indices), by, and with `dual` D M edge values; writes 1 or 2 numbers.
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def make(access, M, dual):
    """Make the kernel for one kind of graph and M channels, with or without a dual variable."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at = access.edge_at
    function, number, result = (reals.vector(real, size) for size in (M, 1, 2 if dual else 1))
    at, number_at, put = reals.reading(function), reals.reading(number), reals.writing(result)
    edge_value = reals.reading(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived = of.difference, of.derived

    @wp.func
    def around(
        graph: Graph,
        f: wp.array2d(dtype=function),
        h: wp.array2d(dtype=function),
        y: wp.array3d(dtype=function),
        u: Place,
    ) -> result:
        f_u = at(f, u[0], u[1])
        h_u = at(h, u[0], u[1])
        total = result()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                dh = derived(e, difference(e, h_u, at(h, v[0], v[1])))
                total[0] += wp.dot(derived(e, difference(e, f_u, at(f, v[0], v[1]))), dh)
                if wp.static(dual):
                    k = edge_at(u, i)
                    total[1] += wp.dot(edge_value(y, k[0], k[1], k[2]), dh)
            i += 1
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def gradient_product(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        h: wp.array2d(dtype=function),  # M channels
        by: wp.array2d(dtype=number),  # 1 channel
        y: wp.array3d(dtype=function),  # M channels per directed edge; read with `dual`
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=result),  # 1 channel, with `dual` 2
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        put(out, u[0], u[1], number_at(by, u[0], u[1])[0] * around(graph, f, h, y, u))

    return gradient_product
