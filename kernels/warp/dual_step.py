"""prox of sigma phi* at z(u, .) = y + beta_y (y - y_previous) + sigma d_w(f + beta (f - f_previous))

x = z s/r with r = |z(u, .)|, s = r - sigma length(r) (prox.py). Edge norm: r = |z(u, v)|. sigma may be sigma(u), for
the edges that start at u, with the edge norm the smaller one of both ends.

One work item: the edges of one vertex; no other work item reads or writes them. A norm over all edges needs z twice: z
is stored in `out` first.
Traffic per vertex with D neighbours: reads D weights, 2 D M edge values and 2 (D + 1) M vertex values (grid: all but 2
M of the latter from the cache; CSR: also D indices); writes D M numbers.
"""

import functools

import warp as wp

from . import gamma, prox, reals


@functools.cache
def make(access, M, G, case, edge_norm, sigma_array):
    """Make the kernel for one kind of graph, M channels, G norms and a case of prox.py; sigma may be an array."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at = access.edge_at
    channels = reals.make(real, M, G)
    function, norm, squared, scaled = channels.function, channels.norm, channels.squared, channels.scaled
    at = reals.reading(function)
    edge_value, put = reals.reading(function, 3), reals.writing(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived = of.difference, of.derived
    sigma_type, sigma_at = reals.per_vertex(real, Place, sigma_array)
    factor = prox.make(real, case, edge_norm).factor

    @wp.func
    def factors(square: norm, sigma: real, p: real, eps: real) -> norm:
        result = norm()
        for c in range(G):
            result[c] = factor(square[c], sigma, p, eps)
        return result

    @wp.func
    def ahead(f: wp.array2d(dtype=function), f_previous: wp.array2d(dtype=function), beta: real, u: Place) -> function:
        here = at(f, u[0], u[1])
        return here + beta * (here - at(f_previous, u[0], u[1]))

    @wp.func
    def step(
        graph: Graph,
        y: wp.array3d(dtype=function),
        f: wp.array2d(dtype=function),
        f_previous: wp.array2d(dtype=function),
        beta: real,
        beta_y: real,
        sigma: sigma_type,
        p: real,
        eps: real,
        out: wp.array3d(dtype=function),
        u: Place,
    ):
        here = ahead(f, f_previous, beta, u)
        own = sigma_at(sigma, u)
        square = norm()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            k = edge_at(u, i)
            z = function()
            size = own
            if exists(graph, v):
                if wp.static(edge_norm and sigma_array):
                    size = wp.min(own, sigma_at(sigma, v))
                e = edge(graph, u, i, v)
                y_e = edge_value(y, k[0], k[1], k[2])
                d = derived(e, difference(e, here, ahead(f, f_previous, beta, v)))
                z = y_e + beta_y * (y_e - edge_value(out, k[0], k[1], k[2])) + size * d
            if wp.static(edge_norm):
                z = scaled(factors(squared(z), size, p, eps), z)
            else:
                square += squared(z)
            put(out, k[0], k[1], k[2], z)
            i += 1
        if wp.static(not edge_norm):
            share = factors(square, own, p, eps)
            i = begin(graph, u)
            while i < last:
                k = edge_at(u, i)
                put(out, k[0], k[1], k[2], scaled(share, edge_value(out, k[0], k[1], k[2])))
                i += 1

    @wp.kernel(module="unique", enable_backward=False)
    def dual_step(
        graph: Graph,
        y: wp.array3d(dtype=function),  # M channels per directed edge
        f: wp.array2d(dtype=function),  # M channels
        f_previous: wp.array2d(dtype=function),  # M channels
        beta: real,
        beta_y: real,
        sigma: sigma_type,  # a number or 1 channel
        p: real,
        eps: real,
        first: wp.vec2i,  # row and x of the launch's first work item
        # the previous y, and output
        out: wp.array3d(dtype=function),  # M channels per directed edge
    ):
        i, j = wp.tid()
        step(graph, y, f, f_previous, beta, beta_y, sigma, p, eps, out, place(graph, first[0] + i, first[1] + j))

    return dual_step
