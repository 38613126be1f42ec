"""rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 over the offsets j of a patch                    (section 5.2)
similarity(u, v) = s(u, v) exp(-max(rho - shift, 0) scale)                               with `similarity`

The similarity is w2 with scale = 1/h^2, and w1 with a patch of one pixel, scale = 1/sigma_X^2 and the spatial factor s.
shift = 2 sigma^2 sum_j g_j per channel takes the noise's share off the distance.
f comes padded by the patch's radius (numpy's "reflect") as rows of cells, so that no read of a patch leaves it: one
work item never asks where the border is. A patch is a bundle of lines: line l of the patch around cell (y, x) is the
cells x - r .. x + r of the padded row y + lines[l].

Grid: one work item gives the weight of one forward offset h at one vertex, in the layout of grid.py, the zeros that
lead out of the grid or the mask included. CSR: one work item gives the weights of all edges of one vertex; `site` is
where its patch is centred in the padded f.
Traffic per edge of a patch of P offsets: reads 2 P M values, nearly all from the cache; writes one number.
Arithmetic per edge: 3 P M operations. (A kernel whose cost is independent of P is possible for flat patches.)
"""

import functools

import warp as wp

from .reals import vector


@functools.cache
def distance(real, M, similarity):
    """Two functions: rho of the patches around two cells of the padded f, and what the weight makes of it."""
    function = vector(real, M)

    @wp.func
    def between(
        padded: wp.array2d(dtype=function),
        lines: wp.array(dtype=wp.int32),
        g: wp.array2d(dtype=real),
        a: wp.vec2i,
        b: wp.vec2i,
    ) -> real:
        rho = real(0.0)
        left = g.shape[1] // 2
        for line in range(lines.shape[0]):
            row_a = a[0] + lines[line]
            row_b = b[0] + lines[line]
            for j in range(g.shape[1]):
                d = padded[row_a, a[1] - left + j] - padded[row_b, b[1] - left + j]
                rho += g[line, j] * wp.dot(d, d)
        return rho

    if similarity:

        @wp.func
        def epilogue(rho: real, spatial: real, shift: real, scale: real) -> real:
            return spatial * wp.exp(-wp.max(rho - shift, real(0.0)) * scale)

    else:

        @wp.func
        def epilogue(rho: real, spatial: real, shift: real, scale: real) -> real:
            return rho

    return between, epilogue


@functools.cache
def make_grid(access, M, similarity, masked):
    """The kernel for a grid."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    neighbour, exists = access.neighbour, access.exists
    function, number = vector(real, M), vector(real, 1)
    between, epilogue = distance(real, M, similarity)

    if masked:

        @wp.func
        def joined(graph: Graph, mask: wp.array2d(dtype=number), u: Place, v: Place) -> bool:
            if exists(graph, v):
                return mask[u[0], u[1]][0] > real(0.0) and mask[v[0], v[1]][0] > real(0.0)
            return False

    else:

        @wp.func
        def joined(graph: Graph, mask: wp.array2d(dtype=number), u: Place, v: Place) -> bool:
            return exists(graph, v)

    @wp.kernel(module="unique", enable_backward=False)
    def patch_distance(
        graph: Graph,
        padded: wp.array2d(dtype=function),  # M channels
        lines: wp.array(dtype=wp.int32),  # (n_lines,)
        g: wp.array2d(dtype=real),  # (n_lines, 2 r + 1)
        shift: real,
        scale: real,
        padded_rows: wp.array(dtype=wp.vec2i),  # (n_rows,): where the patch of each row's first cell is centred
        spatial: wp.array(dtype=real),  # (H,)
        mask: wp.array2d(dtype=number),  # 1 channel, 1 inside; not read without `masked`
        # output
        out: wp.array3d(dtype=real),  # weights, in the layout of grid.py
    ):
        row, h, x = wp.tid()
        u = place(graph, row, x)
        v = neighbour(graph, u, graph.H + h)
        w = real(0.0)
        if joined(graph, mask, u, v):
            site_u = padded_rows[u[0]] + wp.vec2i(0, u[1])
            site_v = padded_rows[v[0]] + wp.vec2i(0, v[1])
            w = epilogue(between(padded, lines, g, site_u, site_v), spatial[h], shift, scale)
        out[row, h, x] = w

    return patch_distance


@functools.cache
def make_csr(access, M, similarity, with_spatial):
    """The kernel for a CSR graph."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour = access.begin, access.end, access.neighbour
    function = vector(real, M)
    between, epilogue = distance(real, M, similarity)

    if with_spatial:

        @wp.func
        def factor(spatial: wp.array(dtype=real), e: int) -> real:
            return spatial[e]

    else:

        @wp.func
        def factor(spatial: wp.array(dtype=real), e: int) -> real:
            return real(1.0)

    @wp.func
    def write_edges(
        graph: Graph,
        padded: wp.array2d(dtype=function),
        lines: wp.array(dtype=wp.int32),
        g: wp.array2d(dtype=real),
        shift: real,
        scale: real,
        site: wp.array(dtype=wp.vec2i),
        spatial: wp.array(dtype=real),
        u: Place,
        out: wp.array(dtype=real),
    ):
        for e in range(begin(graph, u), end(graph, u)):
            v = neighbour(graph, u, e)
            rho = between(padded, lines, g, site[u[1]], site[v[1]])
            out[e] = epilogue(rho, factor(spatial, e), shift, scale)

    @wp.kernel(module="unique", enable_backward=False)
    def patch_distance(
        graph: Graph,
        padded: wp.array2d(dtype=function),  # M channels
        lines: wp.array(dtype=wp.int32),  # (n_lines,)
        g: wp.array2d(dtype=real),  # (n_lines, 2 r + 1)
        shift: real,
        scale: real,
        site: wp.array(dtype=wp.vec2i),  # (n,)
        spatial: wp.array(dtype=real),  # (n_edges,); not read without `with_spatial`
        # output
        out: wp.array(dtype=real),  # (n_edges,)
    ):
        row, x = wp.tid()
        write_edges(graph, padded, lines, g, shift, scale, site, spatial, place(graph, row, x), out)

    return patch_distance
