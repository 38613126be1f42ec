"""The sum that gradient_norm and energy raise to a power:

vertex norm   sum_v d_w(f)(u, v)^2 + eps^2
edge norm     sum_v (d_w(f)(u, v)^2 + eps^2)^edge_power, over the existing edges
"""

import functools

import warp as wp

from . import gamma, reals


@functools.cache
def make(access, M, G, edge_norm):
    """Make a function that computes the sum at a vertex as a norm."""
    real, Graph, Place = access.real, access.Graph, access.Place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    channels = reals.make(real, M, G)
    function, norm, raised = channels.function, channels.norm, channels.raised
    at = reals.reading(function)
    of = gamma.make(real, access.directed, M, G)
    difference, squared, present = of.difference, of.squared, of.present

    if edge_norm:

        @wp.func
        def around(graph: Graph, f: wp.array2d(dtype=function), u: Place, eps2: real, edge_power: real) -> norm:
            here = at(f, u[0], u[1])
            total = norm()
            i = begin(graph, u)
            last = end(graph, u)
            while i < last:
                v = neighbour(graph, u, i)
                if exists(graph, v):
                    e = edge(graph, u, i, v)
                    if present(e):
                        total += raised(squared(e, difference(e, here, at(f, v[0], v[1]))), eps2, edge_power)
                i += 1
            return total

    else:

        @wp.func
        def around(graph: Graph, f: wp.array2d(dtype=function), u: Place, eps2: real, edge_power: real) -> norm:
            here = at(f, u[0], u[1])
            total = norm()
            i = begin(graph, u)
            last = end(graph, u)
            while i < last:
                v = neighbour(graph, u, i)
                if exists(graph, v):
                    e = edge(graph, u, i, v)
                    total += squared(e, difference(e, here, at(f, v[0], v[1])))
                i += 1
            return total + norm(eps2)

    return around
