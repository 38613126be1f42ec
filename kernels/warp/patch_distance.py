"""rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 over the offsets j of a patch                    (section 5.2)
similarity(u, v) = s(u, v) exp(-max(rho - shift, 0) scale)                               with `similarity`
                 = s(u, v) exp(-max(rho - shift - a(u) - a(v), 0) scale q(u) q(v))       and `maps`

The similarity is w2 with scale = 1/h^2, and w1 with a patch of one pixel, scale = 1/sigma_X^2 and the spatial factor s.
Exponentials below `cut` count as 0. shift = 2 sigma^2 sum_j g_j per channel subtracts the contribution of noise from
the distance. f is padded by the radius of the patch (numpy's "reflect"), so that no patch leaves it.

Grid: one work item computes the weights of all forward offsets on a block of cells (strip.py), in the layout of
grid.py, including the zeros where an edge leaves the grid or the mask.
CSR: one work item computes the weights of all edges of one vertex; `site` is the centre of its patch. Line l of the
patch around cell (y, x) is the cells x - r .. x + r of the padded row y + lines[l].
Traffic per edge with a patch of P offsets: reads 2 P M values, mostly from the cache; writes one number.
Arithmetic per edge: 3 P M operations.
"""

import functools

import warp as wp

from . import strip
from .reals import reading, vector


@functools.cache
def distance(real, M, similarity):
    """Make two functions: rho of the patches around two cells of the padded f, and the weight from rho."""
    function = vector(real, M)
    at, g_at, line_at = reading(function), reading(real), reading(wp.int32, 1)

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
        line = wp.int32(0)
        while line < lines.shape[0]:
            row_a = a[0] + line_at(lines, line)
            row_b = b[0] + line_at(lines, line)
            j = wp.int32(0)
            while j < g.shape[1]:
                d = at(padded, row_a, a[1] - left + j) - at(padded, row_b, b[1] - left + j)
                rho += g_at(g, line, j) * wp.dot(d, d)
                j += 1
            line += 1
        return rho

    if similarity:

        @wp.func
        def epilogue(rho: real, spatial: real, shift: real, scale: real, q: real, cut: real) -> real:
            w = wp.exp(-(wp.max(rho - shift, real(0.0)) * q) * scale)
            if w < cut:
                w = real(0.0)
            return spatial * w

    else:

        @wp.func
        def epilogue(rho: real, spatial: real, shift: real, scale: real, q: real, cut: real) -> real:
            return rho

    return between, epilogue


_WEIGHTS = """
        for (int y = 0; y < rows; ++y) {
            const bool has = from <= y && y < until;
            const T* here = p.inside.data + centre0 + y * p.pitch;
            auto* const to = out.data + ((cell0 / width + y) * p.n_offsets + k) * width + x0;
            if (has)
                WEIGHTS(y);
            for (int x = 0; x < columns; ++x)
                to[x] = ROUND(has && here[x] > T(0) && here[x + ahead] > T(0) ? ((const T*)FOUND)[B * N == 1 ? 0 : x]
                                                                              : T(0));
        }
"""


@functools.cache
def make_grid(real, similarity, half, form):
    """Make the kernel for a grid, and patches and blocks of a form (`strip.source`); `half`: weights in float16."""
    Patches, weight = strip.struct(real), wp.float16 if half else real
    names = ("weights", "w") if similarity else ("distances", "rho")
    body = _WEIGHTS.replace("WEIGHTS", names[0]).replace("FOUND", names[1])
    body = body.replace("ROUND", "wp::half" if half else "")

    @wp.func_native(strip.source(real, form, body=body))
    def write_block(p: Patches, out: wp.array3d(dtype=weight), strip: int, block: int): ...

    @wp.kernel(module="unique", enable_backward=False)
    def patch_distance(
        p: Patches,  # with the forward offsets
        first: wp.vec2i,  # strip and block of the launch's first work item
        # output
        out: wp.array3d(dtype=weight),  # weights, in the layout of grid.py
    ):
        i, j = wp.tid()
        write_block(p, out, first[0] + i, first[1] + j)

    return patch_distance


@functools.cache
def make_csr(access, M, similarity, with_spatial, with_maps):
    """Make the kernel for a CSR graph."""
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

    if with_maps:

        @wp.func
        def taken_off(maps: wp.array(dtype=real), u: int, v: int) -> real:
            return maps[2 * u] + maps[2 * v]

        @wp.func
        def strength(maps: wp.array(dtype=real), u: int, v: int) -> real:
            return maps[2 * u + 1] * maps[2 * v + 1]

    else:

        @wp.func
        def taken_off(maps: wp.array(dtype=real), u: int, v: int) -> real:
            return real(0.0)

        @wp.func
        def strength(maps: wp.array(dtype=real), u: int, v: int) -> real:
            return real(1.0)

    @wp.func
    def write_edges(
        graph: Graph,
        padded: wp.array2d(dtype=function),
        lines: wp.array(dtype=wp.int32),
        g: wp.array2d(dtype=real),
        shift: real,
        scale: real,
        cut: real,
        site: wp.array(dtype=wp.vec2i),
        spatial: wp.array(dtype=real),
        maps: wp.array(dtype=real),
        u: Place,
        out: wp.array(dtype=real),
    ):
        e = begin(graph, u)
        last = end(graph, u)
        while e < last:
            v = neighbour(graph, u, e)
            rho = between(padded, lines, g, site[u[1]], site[v[1]])
            off = shift + taken_off(maps, u[1], v[1])
            out[e] = epilogue(rho, factor(spatial, e), off, scale, strength(maps, u[1], v[1]), cut)
            e += 1

    @wp.kernel(module="unique", enable_backward=False)
    def patch_distance(
        graph: Graph,
        padded: wp.array2d(dtype=function),  # M channels
        lines: wp.array(dtype=wp.int32),  # (n_lines,)
        g: wp.array2d(dtype=real),  # (n_lines, 2 r + 1)
        shift: real,
        scale: real,
        cut: real,
        site: wp.array(dtype=wp.vec2i),  # (n,)
        spatial: wp.array(dtype=real),  # (n_edges,); read with `with_spatial`
        maps: wp.array(dtype=real),  # (2 n,): a and q per vertex; read with `with_maps`
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array(dtype=real),  # (n_edges,)
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        write_edges(graph, padded, lines, g, shift, scale, cut, site, spatial, maps, place(graph, row, x), out)

    return patch_distance
