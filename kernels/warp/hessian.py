"""hessian(u) = lam h + d*[ g dh - s df ],           s = share (2 - p) q^((p - 4)/2) <df, dh>
with `dual`: lam h + d*[ g dh - 1/2 (s y + t df) ],  s = (2 - p)/q <df, dh>,  t = (2 - p)/q <y, dh>

The second derivatives of the energy, or the matrix of a primal-dual step with the dual variable y, applied to h;
g = share q^((p - 2)/2), q = |df|^2 + eps^2 over the edges of a vertex. The numbers g, s, t of each vertex are given.
Edge norm: q is that of an edge, all is computed from f, and y(v, u) = -y(u, v). 0 where lam is infinite.

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values and 2 or 3 (D + 1) numbers (grid: all but
those of u from the cache; CSR: also D indices), with `dual` 2 D M edge values (edge norm: D M), and lam; writes M
values.
"""

import functools

import warp as wp

from . import curvature, gamma, reals


@functools.cache
def make(access, M, edge_norm, dual, lam_array):
    """Make the kernel for one kind of graph, M channels and one norm; with or without y; lam may be an array."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at, opposite_at = access.edge_at, access.opposite_at
    function, number, parts = (reals.vector(real, size) for size in (M, 1, 2 if dual else 1))
    at, put, number_at, parts_at = (
        reals.reading(function),
        reals.writing(function),
        reals.reading(number),
        reals.reading(parts),
    )
    edge_value = reals.reading(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived, flow, own = of.difference, of.derived, of.flow, of.own
    numbers = curvature.make(real, dual)
    g_of, factor_of, tiny = numbers.g, numbers.factor, numbers.tiny
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    @wp.func
    def of_edges(
        graph: Graph,
        h: wp.array2d(dtype=function),
        f: wp.array2d(dtype=function),
        y: wp.array3d(dtype=function),
        g: wp.array2d(dtype=number),
        products: wp.array2d(dtype=parts),
        p: real,
        eps: real,
        floor: real,
        u: Place,
    ) -> function:
        f_u = at(f, u[0], u[1])
        h_u = at(h, u[0], u[1])
        total = function()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                df = difference(e, f_u, at(f, v[0], v[1]))
                dh = difference(e, h_u, at(h, v[0], v[1]))
                slope = derived(e, df)
                q = wp.max(wp.dot(slope, slope) + eps * eps, tiny)
                along = factor_of(q, p) * wp.dot(slope, derived(e, dh))
                total += real(2) * g_of(q, p, floor) * flow(e, dh)
                if wp.static(dual):
                    k = edge_at(u, i)
                    y_e = edge_value(y, k[0], k[1], k[2])
                    across = factor_of(q, p) * wp.dot(y_e, derived(e, dh))
                    total -= along * own(e) * y_e + across * flow(e, df)
                else:
                    total -= real(2) * along * flow(e, df)
            i += 1
        return total

    @wp.func
    def of_vertices(
        graph: Graph,
        h: wp.array2d(dtype=function),
        f: wp.array2d(dtype=function),
        y: wp.array3d(dtype=function),
        g: wp.array2d(dtype=number),
        products: wp.array2d(dtype=parts),
        p: real,
        eps: real,
        floor: real,
        u: Place,
    ) -> function:
        f_u = at(f, u[0], u[1])
        h_u = at(h, u[0], u[1])
        g_u = number_at(g, u[0], u[1])[0]
        here = parts_at(products, u[0], u[1])
        total = function()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                df = difference(e, f_u, at(f, v[0], v[1]))
                dh = difference(e, h_u, at(h, v[0], v[1]))
                there = parts_at(products, v[0], v[1])
                total += (g_u + number_at(g, v[0], v[1])[0]) * flow(e, dh)
                if wp.static(dual):
                    k = edge_at(u, i)
                    o = opposite_at(graph, v, i)
                    bent = there[0] * edge_value(y, o[0], o[1], o[2]) - here[0] * edge_value(y, k[0], k[1], k[2])
                    total -= real(0.5) * ((here[1] + there[1]) * flow(e, df) - own(e) * bent)
                else:
                    total -= (here[0] + there[0]) * flow(e, df)
            i += 1
        return total

    around = of_edges if edge_norm else of_vertices

    @wp.kernel(module="unique", enable_backward=False)
    def hessian(
        graph: Graph,
        h: wp.array2d(dtype=function),  # M channels
        f: wp.array2d(dtype=function),  # M channels
        y: wp.array3d(dtype=function),  # M channels per directed edge; read with `dual`
        g: wp.array2d(dtype=number),  # 1 channel; not read with the edge norm
        products: wp.array2d(dtype=parts),  # 1 channel: s; with `dual` 2: s and t; not read with the edge norm
        lam: lam_type,  # a number or 1 channel
        p: real,  # read with the edge norm, as the next two
        eps: real,
        floor: real,
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        lam_u = lam_at(lam, u)
        result = function()
        if not wp.isinf(lam_u):
            result = lam_u * at(h, u[0], u[1]) - around(graph, h, f, y, g, products, p, eps, floor, u)
        put(out, u[0], u[1], result)

    return hessian
