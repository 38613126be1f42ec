"""gradient_norm(u) = (|grad_w f(u)|^2 + eps^2)^power,   |grad_w f(u)|^2 = sum_v d_w(f)(u, v)^2
                                                                                  (eq. 9, 15, section 5.1)
With gamma = sqrt(w), d_w(f)(u, v)^2 = w(u, v) |f(v) - f(u)|^2. One gradient norm for all M channels (G = 1), or one
each (G = M). power 1/2 gives the local variation, (p - 2)/2 the conductances of the p-Laplacian, p/2 the density of
the energy. The power is taken of the sum, never of a root.

Edge norm: (sum_v (d_w(f)(u, v)^2 + eps^2)^edge_power)^power instead, over the edges whose gamma is not 0; p/2 and 1/p
give the L^p norm of eq. 10.

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights and (D + 1) M values, of which a grid finds all but M in the cache,
on CSR also D indices; writes G numbers.
"""

import functools

import warp as wp

from . import reals, squared_gradient


@functools.cache
def make(access, M, G, edge_norm):
    """The kernel for one kind of graph, M channels and G gradient norms, of vertices or of edges."""
    real, Graph, place = access.real, access.Graph, access.place
    channels = reals.make(real, M, G)
    function, norm, raised = channels.function, channels.norm, channels.raised
    around = squared_gradient.make(access, M, G, edge_norm)

    @wp.kernel(module="unique", enable_backward=False)
    def gradient_norm(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        eps2: real,  # eps^2
        power: real,
        edge_power: real,  # read with the edge norm
        # output
        out: wp.array2d(dtype=norm),  # G channels
    ):
        row, x = wp.tid()
        out[row, x] = raised(around(graph, f, place(graph, row, x), eps2, edge_power), real(0.0), power)

    return gradient_norm
