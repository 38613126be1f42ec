"""gradient_norm(u) = (|grad_w f(u)|^2 + eps^2)^power,   |grad_w f(u)|^2 = sum_v w(u, v) |f(v) - f(u)|^2
                                                                                  (eq. 9, 15, section 5.1)
One gradient norm for all M channels (G = 1), or one each (G = M). power 1/2 gives the local variation, (p - 2)/2 the
conductances of the p-Laplacian, p/2 the density of the energy. The power is taken of the sum, never of a root.

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights and (D + 1) M values, of which a grid finds all but M in the cache,
on CSR also D indices; writes G numbers.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def squared_gradient(access, M, G):
    """A function that gives |grad_w f(u)|^2 as a norm; the energy uses it too."""
    Graph, Place = access.Graph, access.Place
    begin, end, neighbour, exists, weight = access.begin, access.end, access.neighbour, access.exists, access.weight
    channels = reals.make(access.real, M, G)
    function, norm, squared = channels.function, channels.norm, channels.squared

    @wp.func
    def around(graph: Graph, f: wp.array2d(dtype=function), u: Place) -> norm:
        here = f[u[0], u[1]]
        total = norm()
        for e in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, e)
            if exists(graph, v):
                total += weight(graph, u, e, v) * squared(f[v[0], v[1]] - here)
        return total

    return around


@functools.cache
def make(access, M, G):
    """The kernel for one kind of graph, M channels and G gradient norms."""
    real, Graph, place = access.real, access.Graph, access.place
    channels = reals.make(real, M, G)
    function, norm, raised = channels.function, channels.norm, channels.raised
    around = squared_gradient(access, M, G)

    @wp.kernel(module="unique", enable_backward=False)
    def gradient_norm(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        eps2: real,  # eps^2
        power: real,
        # output
        out: wp.array2d(dtype=norm),  # G channels
    ):
        row, x = wp.tid()
        out[row, x] = raised(around(graph, f, place(graph, row, x)), eps2, power)

    return gradient_norm
