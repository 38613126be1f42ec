"""primal(u) = f0(u) - adjoint(y)(u) / lam(u)

The function f of a dual variable y; f0 where lam is infinite.

One work item: one vertex.
Traffic per vertex: as adjoint, plus M values of f0, and lam.
"""

import functools

import warp as wp

from . import reals
from .adjoint import outflow_around


@functools.cache
def make(access, M, lam_array):
    """Make the kernel for one kind of graph, and M channels; lam may be an array."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    function = reals.vector(real, M)
    at, put = reals.reading(function), reals.writing(function)
    around = outflow_around(access, M)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    @wp.kernel(module="unique", enable_backward=False)
    def primal(
        graph: Graph,
        y: wp.array3d(dtype=function),  # M channels per directed edge
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        # x/infinity is 0
        put(out, u[0], u[1], at(f0, u[0], u[1]) - around(graph, y, u) / lam_at(lam, u))

    return primal
