"""out(x) = N_0(x) F(x) + sum_o N_o(x) F(x + o),   N_o(x) = sum_j s(x - j) w(x - j, x - j + o)
                                                                      (Buades, Coll, Morel, IPOL 2011, patchwise)
N_0(x) = sum_j c(x - j). The sums are over the offsets o of the window and j of a square patch of radius R such that
x + o, x - j and x - j + o are vertices. s = 1 / (sum of the weights around a vertex), and c is the share of the centre.
N_o(x) is the total weight of x + o in all patches that contain x: patches are averaged instead of pixels. F has a
channel of ones, or the mask; the host divides the other channels by its sum.

Grid only. One work item: one vertex.
Traffic per vertex with D neighbours and patches of P cells: reads P D weights and shares, mostly from the cache, and
D M values; writes M numbers. Arithmetic per neighbour: 2 P + 2 M.
"""

import functools

import warp as wp

from .reals import reading, vector, writing


@functools.cache
def make(access, M):
    """Make the kernel for a grid and M channels."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    function, number = vector(real, M), vector(real, 1)
    value_at, number_at, put = reading(function), reading(number), writing(function)

    @wp.func
    def own(
        graph: Graph,
        patch: wp.array(dtype=Place),
        f: wp.array2d(dtype=function),
        centre: wp.array2d(dtype=number),
        x: Place,
    ) -> function:
        n = real(0.0)
        j = wp.int32(0)
        while j < patch.shape[0]:
            u = x + patch[j]
            if exists(graph, u):
                n += number_at(centre, u[0], u[1])[0]
            j += 1
        return value_at(f, x[0], x[1]) * n

    @wp.func
    def around(
        graph: Graph,
        patch: wp.array(dtype=Place),
        f: wp.array2d(dtype=function),
        share: wp.array2d(dtype=number),
        x: Place,
    ) -> function:
        total = function()
        o = begin(graph, x)
        last = end(graph, x)
        while o < last:
            y = neighbour(graph, x, o)
            if exists(graph, y):
                n = real(0.0)
                j = wp.int32(0)
                while j < patch.shape[0]:
                    u = x + patch[j]
                    v = neighbour(graph, u, o)
                    if exists(graph, u) and exists(graph, v):
                        n += edge(graph, u, o, v) * number_at(share, u[0], u[1])[0]
                    j += 1
                total += value_at(f, y[0], y[1]) * n
            o += 1
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def aggregate(
        graph: Graph,
        patch: wp.array(dtype=Place),  # the steps to the cells of a patch
        f: wp.array2d(dtype=function),  # M channels
        share: wp.array2d(dtype=number),  # 1 channel: s
        centre: wp.array2d(dtype=number),  # 1 channel: c
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        here = place(graph, row, x)
        put(out, row, x, own(graph, patch, f, centre, here) + around(graph, patch, f, share, here))

    return aggregate
