"""p_laplacian(u) = sum_v w(u, v) (g(u) + g(v)) (f(u) - f(v)),   g = |grad_w f|^(p - 2)          (eq. 12)

Without conductances g is 1: p = 2, the Laplacian of eq. 16.

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights, (D + 1) M values and (D + 1) G conductances, of which a grid finds
all but M + G in the cache, on CSR also D indices; writes M numbers.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(access, M, G, conductances):
    """The kernel for one kind of graph, M channels and G conductances or none."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, weight = access.begin, access.end, access.neighbour, access.exists, access.weight
    channels = reals.make(real, M, G)
    function, norm, scaled = channels.function, channels.norm, channels.scaled
    pair = reals.conductance(real, Place, G, conductances)

    @wp.func
    def around(graph: Graph, f: wp.array2d(dtype=function), g: wp.array2d(dtype=norm), u: Place) -> function:
        here = f[u[0], u[1]]
        total = function()
        for e in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, e)
            if exists(graph, v):
                total += scaled(weight(graph, u, e, v) * pair(g, u, v), here - f[v[0], v[1]])
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def p_laplacian(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=norm),  # G channels: the conductances; not read without them
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        row, x = wp.tid()
        out[row, x] = around(graph, f, g, place(graph, row, x))

    return p_laplacian
