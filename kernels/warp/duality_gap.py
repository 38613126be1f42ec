"""sum_u [phi(|grad_w f(u)|) + phi*(|y(u, .)|) - sum_v d_w(f)(u, v) y(u, v) + |lam (f - f0) + adjoint(y)|^2 / (2 lam)]

The energy of f minus the dual energy of y, phi(t) = (t^2 + eps^2)^(p/2) / p (prox.py); all terms are >= 0. Edge norm:
phi/2 and its conjugate per edge. The last term is 0 where lam is infinite. With a box f lies in it, lam may be 0, and
with s = adjoint(y) and fhat = clip(f0 - s / lam, low, high) the last term is

  lam / 2 (f - fhat)^2 + (s + lam (fhat - f0)) (f - fhat)      lam = 0: max(s, 0) (f - low) + max(-s, 0) (high - f)

One work item: a segment of a row, as in energy.py; it writes its sum in float64, and total.py adds the sums.
Traffic per vertex with D neighbours: reads D weights, 2 D M edge values (grid: half of them from the cache), (D + 2) M
vertex values and lam (with a box: and 2 M values); CSR: also D indices of neighbours and D of opposite edges.
"""

import functools

import warp as wp

from . import gamma, prox, reals
from .adjoint import outflow_around


@functools.cache
def make(access, M, G, case, edge_norm, lam_array, box):
    """Make the kernel for one kind of graph, M channels, G norms, and a case of prox.py.

    lam may be an array; with or without a box.
    """
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    edge_at = access.edge_at
    channels = reals.make(real, M, G)
    function, norm, square_of = channels.function, channels.norm, channels.squared
    at, edge_value = reals.reading(function), reals.reading(function, 3)
    of = gamma.make(real, access.directed, M, 1)
    difference, derived = of.difference, of.derived
    duality = prox.make(real, case, edge_norm).duality
    outflow = outflow_around(access, M)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)

    if G == 1:

        @wp.func
        def product_of(a: function, b: function) -> norm:
            return norm(wp.dot(a, b))

    else:

        @wp.func
        def product_of(a: function, b: function) -> norm:
            return wp.cw_mul(a, b)

    @wp.func
    def of_norms(square: norm, dual: norm, product: norm, p: real, eps: real) -> real:
        total = real(0.0)
        for c in range(G):
            total += duality(square[c], dual[c], product[c], p, eps)
        return total

    @wp.func
    def in_box(here: real, s: real, data: real, lam: real, low: real, high: real) -> real:
        if lam == real(0.0):
            # an end may be infinite where s is 0
            if s > real(0.0):
                return s * (here - low)
            if s < real(0.0):
                return s * (here - high)
            return real(0.0)
        free = data - s / lam
        nearest = wp.min(wp.max(free, low), high)
        if free == nearest:
            unmet = lam * (here - data) + s
            return unmet * unmet / (real(2.0) * lam)
        apart = here - nearest
        return apart * (lam / real(2.0) * apart + s + lam * (nearest - data))

    @wp.func
    def density(
        graph: Graph,
        f: wp.array2d(dtype=function),
        y: wp.array3d(dtype=function),
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        low: wp.array2d(dtype=function),
        high: wp.array2d(dtype=function),
        p: real,
        eps: real,
        u: Place,
    ) -> real:
        here = at(f, u[0], u[1])
        total = real(0.0)
        square = norm()
        dual = norm()
        product = norm()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                k = edge_at(u, i)
                e = edge(graph, u, i, v)
                d = derived(e, difference(e, here, at(f, v[0], v[1])))
                y_e = edge_value(y, k[0], k[1], k[2])
                if wp.static(edge_norm):
                    total += of_norms(square_of(d), square_of(y_e), product_of(d, y_e), p, eps)
                else:
                    square += square_of(d)
                    dual += square_of(y_e)
                    product += product_of(d, y_e)
            i += 1
        if wp.static(not edge_norm):
            total = of_norms(square, dual, product, p, eps)
        lam_u = lam_at(lam, u)
        if wp.static(box):
            if not wp.isinf(lam_u):
                s = outflow(graph, y, u)
                data, below, above = at(f0, u[0], u[1]), at(low, u[0], u[1]), at(high, u[0], u[1])
                for c in range(M):
                    total += in_box(here[c], s[c], data[c], lam_u, below[c], above[c])
        elif not wp.isinf(lam_u):
            residual = lam_u * (here - at(f0, u[0], u[1])) + outflow(graph, y, u)
            total += wp.dot(residual, residual) / (real(2.0) * lam_u)
        return total

    @wp.func
    def segment_sum(
        graph: Graph,
        f: wp.array2d(dtype=function),
        y: wp.array3d(dtype=function),
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        low: wp.array2d(dtype=function),
        high: wp.array2d(dtype=function),
        p: real,
        eps: real,
        row: int,
        begin: int,
        stride: int,
        count: int,
    ) -> wp.float64:
        total = wp.float64(0.0)
        x = int(begin)
        last = wp.min(f.shape[1], begin + count * stride)
        while x < last:
            total += wp.float64(density(graph, f, y, f0, lam, low, high, p, eps, place(graph, row, x)))
            x += stride
        return total

    @wp.kernel(module="unique", enable_backward=False)
    def duality_gap(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        y: wp.array3d(dtype=function),  # M channels per directed edge
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        low: wp.array2d(dtype=function),  # M channels; read with a box
        high: wp.array2d(dtype=function),  # M channels; read with a box
        p: real,
        eps: real,
        reach: int,  # step from a segment's first vertex to that of the next segment
        stride: int,  # step between the vertices of a segment
        count: int,  # vertices in a segment
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=wp.float64),  # (rows, segments)
    ):
        i, j = wp.tid()
        row, s = first[0] + i, first[1] + j
        out[row, s] = segment_sum(graph, f, y, f0, lam, low, high, p, eps, row, s * reach, stride, count)

    return duality_gap
