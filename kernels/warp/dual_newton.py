"""y(u, v) = g(u) (df + dh)(u, v) - s(u) y(u, v),   in place

Newton's step h of the dual variable: g = share q^((p - 2)/2), s = (2 - p)/q <df, dh>, q = |df|^2 + eps^2 over the edges
of a vertex. The numbers g and s of each vertex are given. Edge norm: those of each edge, computed from f.

One work item: the edges of one vertex; no other work item reads or writes them.
Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values (grid: all but 2 M from the cache; CSR: also D
indices), g, the products and D M edge values; writes D M.
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
    function, number, pair = (reals.vector(real, size) for size in (M, 1, 2))
    at, number_at, pair_at = reals.reading(function), reals.reading(number), reals.reading(pair)
    edge_value, put = reals.reading(function, 3), reals.writing(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived = of.difference, of.derived
    numbers = curvature.make(real, True)
    g_of, factor_of, tiny = numbers.g, numbers.factor, numbers.tiny

    @wp.func
    def vertex_numbers(g: wp.array2d(dtype=number), products: wp.array2d(dtype=pair), u: Place):
        return number_at(g, u[0], u[1])[0], pair_at(products, u[0], u[1])[0]

    @wp.func
    def step(
        graph: Graph,
        f: wp.array2d(dtype=function),
        h: wp.array2d(dtype=function),
        g: wp.array2d(dtype=number),
        products: wp.array2d(dtype=pair),
        p: real,
        eps: real,
        floor: real,
        y: wp.array3d(dtype=function),
        u: Place,
    ):
        by = real(0)
        along = real(0)
        if wp.static(not edge_norm):
            by, along = vertex_numbers(g, products, u)
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                df = derived(e, difference(e, at(f, u[0], u[1]), at(f, v[0], v[1])))
                dh = derived(e, difference(e, at(h, u[0], u[1]), at(h, v[0], v[1])))
                if wp.static(edge_norm):
                    q = wp.max(wp.dot(df, df) + eps * eps, tiny)
                    by = g_of(q, p, floor)
                    along = factor_of(q, p) * wp.dot(df, dh)
                k = edge_at(u, i)
                put(y, k[0], k[1], k[2], by * (df + dh) - along * edge_value(y, k[0], k[1], k[2]))
            i += 1

    @wp.kernel(module="unique", enable_backward=False)
    def dual_newton(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        h: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=number),  # 1 channel; not read with the edge norm
        products: wp.array2d(dtype=pair),  # 2 channels, of which the first is s; not read with the edge norm
        p: real,  # read with the edge norm, as the next two
        eps: real,
        floor: real,
        first: wp.vec2i,  # row and x of the launch's first work item
        # input and output
        y: wp.array3d(dtype=function),  # M channels per directed edge
    ):
        i, j = wp.tid()
        step(graph, f, h, g, products, p, eps, floor, y, place(graph, first[0] + i, first[1] + j))

    return dual_newton
