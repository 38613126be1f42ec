"""relax(u) = x(u) + step(u) (r(u) - (A x)(u))

One Jacobi sweep for A x = r, step = omega/diagonal, with the matrix of eq. 25 at p = 2:

    (A x)(u) = lam(u) x(u) + 2 sum_v gamma(u, v) (gamma(u, v) x(u) - gamma(v, u) x(v))

Where step is 0, as at pinned vertices, the result is x.

One work item: one vertex.
Traffic per vertex: as gradient with lam, plus M values of r, and step.
"""

import functools

import warp as wp

from . import reals
from .p_laplacian import flow_around


@functools.cache
def make(access, M, lam_array):
    """Make the kernel for one kind of graph and M channels; lam may be an array."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    channels = reals.make(real, M, 1)
    function, norm = channels.function, channels.norm
    at, put, number_at = reals.reading(function), reals.writing(function), reals.reading(norm)
    around = flow_around(access, M, 1, "none")
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    @wp.kernel(module="unique", enable_backward=False)
    def relax(
        graph: Graph,
        x: wp.array2d(dtype=function),  # M channels
        r: wp.array2d(dtype=function),  # M channels
        unread: wp.array2d(dtype=norm),  # conductances, of which there are none at p = 2
        lam: lam_type,  # a number or 1 channel
        step: wp.array2d(dtype=norm),  # 1 channel
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; not x
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        here = at(x, u[0], u[1])
        by = number_at(step, u[0], u[1])[0]
        # lam is infinite at pinned vertices
        if by != real(0):
            flow = around(graph, x, unread, real(0), real(0), u)
            here += by * (at(r, u[0], u[1]) + flow - lam_at(lam, u) * here)
        put(out, u[0], u[1], here)

    return relax
