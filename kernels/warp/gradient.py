"""gradient(u) = lam (f(u) - f0(u)) + p_laplacian(f)(u)

The gradient of the energy (eq. 19), given the conductances (conductance.py); 0 where lam is infinite. Without `data`,
f0 counts as 0: the result is the matrix of eq. 25 applied to f.

One work item: one vertex.
Traffic per vertex: as p_laplacian, plus M values of f0, and lam.
"""

import functools

import warp as wp

from . import reals
from .p_laplacian import flow_around


@functools.cache
def make(access, M, G, kind, lam_array, data):
    """Make the kernel for one kind of graph, M channels, G conductances of a kind; lam may be an array, f0 absent."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    channels = reals.make(real, M, G)
    function, norm = channels.function, channels.norm
    at, put = reals.reading(function), reals.writing(function)
    around = flow_around(access, M, G, kind)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    if data:

        @wp.func
        def off(f: wp.array2d(dtype=function), f0: wp.array2d(dtype=function), u: Place) -> function:
            return at(f, u[0], u[1]) - at(f0, u[0], u[1])

    else:

        @wp.func
        def off(f: wp.array2d(dtype=function), f0: wp.array2d(dtype=function), u: Place) -> function:
            return at(f, u[0], u[1])

    @wp.kernel(module="unique", enable_backward=False)
    def gradient(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels; read with `data`
        g: wp.array2d(dtype=norm),  # G channels: the conductances; read with kind "vertex"
        power: real,  # (p - 2)/2; read with the edge norm
        eps2: real,  # eps^2; read with the edge norm
        lam: lam_type,  # a number or 1 channel
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        u = place(graph, first[0] + i, first[1] + j)
        lam_u = lam_at(lam, u)
        result = function()
        if not wp.isinf(lam_u):
            result = lam_u * off(f, f0, u) - around(graph, f, g, power, eps2, u)
        put(out, u[0], u[1], result)

    return gradient
