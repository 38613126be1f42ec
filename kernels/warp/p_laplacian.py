"""p_laplacian(u) = sum_v gamma(u, v) c(u, v) (gamma(u, v) f(u) - gamma(v, u) f(v))                      (eq. 12)

c is the conductance of the edge (conductance.py): g(u) + g(v) with g = |grad_w f|^(p - 2), 2 for p = 2 (eq. 16), or,
with the edge norm, |d_w(f)(u, v)|^(p - 2) (the derivative of eq. 30).

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights, and (D + 1) M values and (D + 1) G conductances (none with the
edge norm; grid: all but M + G from the cache; CSR: also D indices); writes M numbers.
"""

import functools

import warp as wp

from . import conductance, gamma, reals


@functools.cache
def flow_around(access, M, G, kind):
    """Make a function that computes minus the sum at a vertex; also used by the Euler step."""
    real, Graph, Place = access.real, access.Graph, access.Place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    channels = reals.make(real, M, G)
    function, norm, scaled = channels.function, channels.norm, channels.scaled
    at = reals.reading(function)
    of = gamma.make(real, access.directed, M, G)
    difference, flow = of.difference, of.flow
    conductance_of = conductance.make(access, M, G, kind)

    @wp.func
    def around(
        graph: Graph,
        f: wp.array2d(dtype=function),
        g: wp.array2d(dtype=norm),
        power: real,
        eps2: real,
        u: Place,
    ) -> function:
        here = at(f, u[0], u[1])
        total = function()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                d = difference(e, here, at(f, v[0], v[1]))
                total += scaled(conductance_of(e, d, g, u, v, power, eps2), flow(e, d))
            i += 1
        return total

    return around


@functools.cache
def make(access, M, G, kind):
    """Make the kernel for one kind of graph, M channels, and G conductances of a kind."""
    real, Graph, place = access.real, access.Graph, access.place
    channels = reals.make(real, M, G)
    function, norm = channels.function, channels.norm
    around = flow_around(access, M, G, kind)
    put = reals.writing(function)

    @wp.kernel(module="unique", enable_backward=False)
    def p_laplacian(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=norm),  # G channels: the conductances; read with kind "vertex"
        power: real,  # (p - 2)/2; read with the edge norm
        eps2: real,  # eps^2; read with the edge norm
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        put(out, row, x, function() - around(graph, f, g, power, eps2, place(graph, row, x)))

    return p_laplacian
