"""One step of the explicit Euler process                                                          (eq. 24)

  out(u) = f(u) + tau (lam (f0(u) - f(u)) - p_laplacian(f)(u))

tau is a number, or one value per vertex (a factor of gamma per vertex is a change of variable, which also changes the
step); lam likewise. Where lam is infinite, out = f0. The p-Laplacian is eq. 12 with the conductances of conductance.py.

One work item: one vertex.
Traffic per vertex with D neighbours: reads D weights, and (D + 2) M values, (D + 1) G conductances (none with the edge
norm), lam and tau (grid: all but 2 M + G + 2 from the cache; CSR: also D indices); writes M numbers.
"""

import functools

import warp as wp

from . import p_laplacian, reals


@functools.cache
def make(access, M, G, kind, lam_array, tau_array):
    """Make the kernel for one kind of graph, M channels, and G conductances of a kind; lam and tau may be arrays."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    channels = reals.make(real, M, G)
    function, norm = channels.function, channels.norm
    at, put = reals.reading(function), reals.writing(function)
    around = p_laplacian.flow_around(access, M, G, kind)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)
    tau_type, tau_at = reals.per_vertex(real, Place, tau_array)

    @wp.func
    def move(old: function, data: function, flow: function, lam: real, tau: real) -> function:
        if wp.isinf(lam):
            return data
        return old + tau * (lam * (data - old) + flow)

    @wp.kernel(module="unique", enable_backward=False)
    def euler_step(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=norm),  # G channels: the conductances; read with kind "vertex"
        power: real,  # (p - 2)/2; read with the edge norm
        eps2: real,  # eps^2; read with the edge norm
        lam: lam_type,  # a number or 1 channel
        tau: tau_type,  # a number or 1 channel
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        u = place(graph, row, x)
        flow = around(graph, f, g, power, eps2, u)
        put(out, row, x, move(at(f, row, x), at(f0, row, x), flow, lam_at(lam, u), tau_at(tau, u)))

    return euler_step
