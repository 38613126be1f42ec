"""The conductance of an edge (u, v), for the p-Laplacian, both processes and the gradient:

  vertex norm    g(u) + g(v), g = |grad_w f|^(p - 2) from an array, or 2: p = 2                   (eq. 12, 25)
  edge norm      (d_w(f)(u, v)^2 + eps^2)^((p - 2)/2), from f itself                              (from eq. 30)

`kind` is "none" (p = 2), "vertex" or "edge". The function from `make` takes the edge, `difference` of f along it
(gamma.py), g, the vertices u and v, the power (p - 2)/2 and eps^2; each kind reads some of these.
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def make(access, M, G, kind):
    """Make a function that computes the conductance of an edge as a norm."""
    real, Place, Edge = access.real, access.Place, access.Edge
    channels = reals.make(real, M, G)
    function, norm, raised = channels.function, channels.norm, channels.raised
    g_at = reals.reading(norm)
    squared = gamma.make(real, access.directed, M, G).squared

    if kind == "edge":

        @wp.func
        def conductance(
            e: Edge, d: function, g: wp.array2d(dtype=norm), u: Place, v: Place, power: real, eps2: real
        ) -> norm:
            return raised(squared(e, d), eps2, power)

    elif kind == "vertex":

        @wp.func
        def conductance(
            e: Edge, d: function, g: wp.array2d(dtype=norm), u: Place, v: Place, power: real, eps2: real
        ) -> norm:
            return g_at(g, u[0], u[1]) + g_at(g, v[0], v[1])

    else:

        @wp.func
        def conductance(
            e: Edge, d: function, g: wp.array2d(dtype=norm), u: Place, v: Place, power: real, eps2: real
        ) -> norm:
            return norm(real(2.0))

    return conductance
