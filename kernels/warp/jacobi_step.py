"""One sweep of the Gauss-Jacobi process                                                       (eq. 25, 31)

  J(u)   = (lam f0(u) + sum_v a(u, v) f(v)) / (lam + sum_v a(u, v)),   a(u, v) = w(u, v) (g(u) + g(v))
  out(u) = f(u) + theta (J(u) - f(u))

g = |grad_w f|^(p - 2), or 1 without conductances (p = 2). lam is a number, or one value per vertex. Where lam is
infinite, or the denominator is not above `smallest` (lam and all weights are 0, or nearly), out = f0. theta = 1 is the
paper's process.

One work item: one vertex.
Traffic per vertex of D neighbours: reads D weights, (D + 2) M values, (D + 1) G conductances and lam, of which a grid
finds all but 2 M + G + 1 in the cache, on CSR also D indices; writes M numbers.
"""

import functools

import warp as wp

from . import reals


@functools.cache
def make(access, M, G, conductances, lam_array):
    """The kernel for one kind of graph, M channels, G conductances or none, and lam as an array or a number."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, weight = access.begin, access.end, access.neighbour, access.exists, access.weight
    channels = reals.make(real, M, G)
    function, norm, scaled = channels.function, channels.norm, channels.scaled
    pair = reals.conductance(real, Place, G, conductances)
    lam_type, lam_at = reals.fidelity(real, Place, lam_array)
    last = G - 1
    smallest = reals.smallest(real)

    # The two sums: of a(u, v) f(v), and of a(u, v).
    @wp.func
    def around(graph: Graph, f: wp.array2d(dtype=function), g: wp.array2d(dtype=norm), u: Place):
        pull = function()
        total = norm()
        for e in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, e)
            if exists(graph, v):
                a = weight(graph, u, e, v) * pair(g, u, v)
                total += a
                pull += scaled(a, f[v[0], v[1]])
        return pull, total

    @wp.func
    def move(old: real, data: real, pull: real, total: real, lam: real, theta: real) -> real:
        denominator = lam + total
        if wp.isinf(lam) or not (denominator > smallest):
            return data
        moved = (lam * data + pull) / denominator
        if theta == real(1.0):
            return moved
        return old + theta * (moved - old)

    @wp.func
    def move_all(old: function, data: function, pull: function, total: norm, lam: real, theta: real) -> function:
        result = function()
        for c in range(M):
            result[c] = move(old[c], data[c], pull[c], total[wp.min(c, last)], lam, theta)
        return result

    @wp.kernel(module="unique", enable_backward=False)
    def jacobi_step(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=norm),  # G channels: the conductances; not read without them
        lam: lam_type,  # a number or 1 channel
        theta: real,
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        row, x = wp.tid()
        u = place(graph, row, x)
        pull, total = around(graph, f, g, u)
        out[row, x] = move_all(f[row, x], f0[row, x], pull, total, lam_at(lam, u), theta)

    return jacobi_step
