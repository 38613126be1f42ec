"""energy = sum_u [ 1/p (|grad_w f(u)|^2 + eps^2)^(p/2) + lam(u)/2 |f(u) - f0(u)|^2 ]        (eq. 19, 20 with 15)

Edge norm: the first term is 1/(2 p) sum_v (d_w(f)(u, v)^2 + eps^2)^(p/2), over the edges whose gamma is not 0 (eq. 30).
With one gradient norm per channel (G = M) the first term is summed over channels. The second term is 0 where lam is
infinite, as f = f0 there.

One work item: a segment of a row, the `count` vertices at s * reach + i * stride; it writes their sum in float64, and
total.py adds the sums. The segments depend only on graph and device, so every run gives the same bits.
Traffic per vertex with D neighbours: reads D weights, (D + 2) M values and lam (CSR: also D indices).
"""

import functools

import warp as wp

from . import reals, squared_gradient


@functools.cache
def make(access, M, G, edge_norm, lam_array):
    """Make the kernel for one kind of graph, M channels and G gradient norms; lam may be an array."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    channels = reals.make(real, M, G)
    function, raise_ = channels.function, reals.raising(real)
    at = reals.reading(function)
    around = squared_gradient.make(access, M, G, edge_norm)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    if edge_norm:
        # each edge is raised already, and counted twice
        @wp.func
        def term(x: real, p: real) -> real:
            return x / (real(2.0) * p)

    else:

        @wp.func
        def term(x: real, p: real) -> real:
            return raise_(x, p / real(2.0)) / p

    @wp.func
    def density(
        graph: Graph,
        f: wp.array2d(dtype=function),
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        p: real,
        eps2: real,
        u: Place,
    ) -> real:
        smoothness = around(graph, f, u, eps2, p / real(2.0))
        total = real(0.0)
        lam_u = lam_at(lam, u)
        if not wp.isinf(lam_u):
            d = at(f, u[0], u[1]) - at(f0, u[0], u[1])
            total = lam_u * wp.dot(d, d) / real(2.0)
        for c in range(G):
            total += term(smoothness[c], p)
        return total

    @wp.func
    def segment_sum(
        graph: Graph,
        f: wp.array2d(dtype=function),
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        p: real,
        eps2: real,
        row: int,
        begin: int,
        stride: int,
        count: int,
    ) -> wp.float64:
        total = wp.float64(0.0)
        x = int(begin)
        last = wp.min(f.shape[1], begin + count * stride)
        while x < last:
            total += wp.float64(density(graph, f, f0, lam, p, eps2, place(graph, row, x)))
            x += stride
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def energy(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        p: real,
        eps2: real,  # eps^2
        reach: int,  # step from a segment's first vertex to that of the next segment
        stride: int,  # step between the vertices of a segment
        count: int,  # vertices in a segment
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=wp.float64),  # (rows, segments)
    ):
        i, j = wp.tid()
        row, s = first[0] + i, first[1] + j
        out[row, s] = segment_sum(graph, f, f0, lam, p, eps2, row, s * reach, stride, count)

    return energy
