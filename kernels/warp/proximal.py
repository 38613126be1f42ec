"""proximal(u) = (f - tau s + tau lam f0) / (1 + tau lam), clipped to [low, high],   s = adjoint(y)

f0 where lam is infinite. It is clipped only with a box. The share of f0 is w / (1 + w) with w = tau lam, so that
neither a small w nor an infinite one loses digits.

One work item: one vertex. `out` may be f.
Traffic per vertex: as adjoint, plus 2 M values of f and f0, lam, tau (with a box: and 2 M values).
"""

import functools

import warp as wp

from . import reals
from .adjoint import outflow_around


@functools.cache
def make(access, M, lam_array, tau_array, box):
    """Make the kernel for one kind of graph, and M channels; lam and tau may be arrays; with or without a box."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    function = reals.vector(real, M)
    at, put = reals.reading(function), reals.writing(function)
    around = outflow_around(access, M)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)
    tau_type, tau_at = reals.per_vertex(real, Place, tau_array)

    @wp.func
    def move(here: function, outflow: function, data: function, lam: real, tau: real) -> function:
        w = tau * lam
        share = w / (real(1.0) + w)
        if w > real(1.0):
            share = real(1.0) / (real(1.0) + real(1.0) / w)
        moved = here - tau * outflow
        return moved + share * (data - moved)

    @wp.kernel(module="unique", enable_backward=False)
    def proximal(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        y: wp.array3d(dtype=function),  # M channels per directed edge
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        tau: tau_type,  # a number or 1 channel
        low: wp.array2d(dtype=function),  # M channels; read with a box
        high: wp.array2d(dtype=function),  # M channels; read with a box
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; may be f
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        data, lam_u = at(f0, u[0], u[1]), lam_at(lam, u)
        moved = data
        if not wp.isinf(lam_u):
            moved = move(at(f, u[0], u[1]), around(graph, y, u), data, lam_u, tau_at(tau, u))
            if wp.static(box):
                moved = wp.min(wp.max(moved, at(low, u[0], u[1])), at(high, u[0], u[1]))
        put(out, u[0], u[1], moved)

    return proximal
