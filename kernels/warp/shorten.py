"""y(u, .) = y(u, .) min(1, most(u)/|y(u, .)|),   in place

The dual variable of a primal-dual step is made no longer than a slope can be, most = share q^((p - 1)/2). Edge norm:
the same for each edge, with q = |df|^2 + eps^2 computed from f.

One work item: the edges of one vertex; no other work item reads or writes them.
Traffic per vertex with D neighbours: reads D M edge values twice and most (edge norm: once, D weights and (D + 1) M
values of f), writes D M.
"""

import functools

import warp as wp

from . import curvature, gamma, reals


@functools.cache
def make(access, M, edge_norm):
    """Make the kernel for one kind of graph, M channels and one norm."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at = access.edge_at
    function, number = reals.vector(real, M), reals.vector(real, 1)
    at, number_at = reals.reading(function), reals.reading(number)
    edge_value, put = reals.reading(function, 3), reals.writing(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived = of.difference, of.derived
    tiny, raise_ = curvature.make(real, True).tiny, reals.raising(real)

    @wp.func
    def shortened(length: real, longest: real) -> real:
        if length > longest:
            return longest / length
        return real(1)

    @wp.func
    def longest_at(most: wp.array2d(dtype=number), u: Place) -> real:
        return number_at(most, u[0], u[1])[0]

    @wp.func
    def step(
        graph: Graph,
        f: wp.array2d(dtype=function),
        most: wp.array2d(dtype=number),
        p: real,
        eps: real,
        y: wp.array3d(dtype=function),
        u: Place,
    ):
        square = real(0)
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                k = edge_at(u, i)
                y_e = edge_value(y, k[0], k[1], k[2])
                if wp.static(edge_norm):
                    e = edge(graph, u, i, v)
                    slope = derived(e, difference(e, at(f, u[0], u[1]), at(f, v[0], v[1])))
                    q = wp.max(wp.dot(slope, slope) + eps * eps, tiny)
                    longest = real(0.5) * raise_(q, (p - real(1)) / real(2))
                    put(y, k[0], k[1], k[2], shortened(wp.sqrt(wp.dot(y_e, y_e)), longest) * y_e)
                else:
                    square += wp.dot(y_e, y_e)
            i += 1
        if wp.static(not edge_norm):
            by = shortened(wp.sqrt(square), longest_at(most, u))
            i = begin(graph, u)
            while i < last:
                k = edge_at(u, i)
                put(y, k[0], k[1], k[2], by * edge_value(y, k[0], k[1], k[2]))
                i += 1

    @wp.kernel(module="unique", enable_backward=False)
    def shorten(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels; read with the edge norm
        most: wp.array2d(dtype=number),  # 1 channel; not read with the edge norm
        p: real,  # read with the edge norm, as the next
        eps: real,
        first: wp.vec2i,  # row and x of the launch's first work item
        # input and output
        y: wp.array3d(dtype=function),  # M channels per directed edge
    ):
        i, j = wp.tid()
        step(graph, f, most, p, eps, y, place(graph, first[0] + i, first[1] + j))

    return shorten
