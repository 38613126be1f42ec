"""rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 for a strip of cells u, one offset of the window after the other
                                                                                                   (section 5.2)
g is an outer product of one profile, so rho is a sum along the rows of the patch, then across them, both weighted by
the profile: a few additions per row and column of the patch instead of one per cell. All terms are >= 0 and no term is
subtracted again, so that a small distance next to a large one loses no digits.

A strip is S rows, along the next-to-last axis, of N neighbouring cells; a work item computes it with vectors of N. Each
row of a patch is summed once, and added to the distances of all cells whose patches contain it. On a GPU N = S = 1.
f is one plane of cells per channel, padded by the radius of the patch (numpy's "reflect") and, along a row, by zeros on
both sides for the reach of the window and a pack: reads need no check of the border, as `inside` is 0 beyond it.
Arithmetic per edge: (S + 2 r)/S times 2 (2 r + 1) multiplications and additions, and 3 M for a difference.

This is C++, as clang does not always vectorise loops over a Warp vector. The C++ in `weights` uses k (index of the
offset), from, until (the rows of the strip with a neighbour), rho[y], ahead (step from a cell to its neighbour in the
padded planes), cell0 (the first cell of the strip), centre0 (its index in the padded planes), and similarity(rho, k, u)
(the weight of the cell at u in the padded planes and its neighbour along offset k).
"""

import functools

import warp as wp

# Vectors of N reals, for which clang has operators; one real if N = 1, as on a GPU, whose compiler has no vectors.
# exp(x) for x <= 0, as the C library has none for vectors: x is reduced by n ln 2 in two parts (Cody and Waite; n by
# adding and subtracting 1.5 2^23), then the series to degree 7 (relative error 5e-9 on |r| <= ln(2)/2), times 2^n in
# the exponent bits; subnormal results are 0.
_PACK = """
#define WP_GPUREG_LOAD(p) ([](const T* at) { V v; __builtin_memcpy(&v, at, sizeof(V)); return v; }(p))
    typedef T V __attribute__((vector_size(N * sizeof(T))));
    typedef int I __attribute__((vector_size(N * sizeof(int))));
"""
_SCALAR = """
#define WP_GPUREG_LOAD(p) (*(p))
    typedef T V;
"""
_EXP_FLOAT = """
    auto exponential = [](V x) -> V {
        const V low = V{} - 88.0f;
        x = x > low ? x : low;
        const V n = (x * 1.44269504f + 12582912.0f) - 12582912.0f;
        const V r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
        V series = V{} + 1.98412698e-4f;
        series = series * r + 1.38888889e-3f;
        series = series * r + 8.33333333e-3f;
        series = series * r + 4.16666667e-2f;
        series = series * r + 1.66666667e-1f;
        series = series * r + 0.5f;
        series = series * r + 1.0f;
        series = series * r + 1.0f;
        const I bits = (__builtin_convertvector(n, I) + 127) << 23;
        V power;
        __builtin_memcpy(&power, &bits, sizeof(V));
        return x >= V{} - 87.3365f ? series * power : V{};
    };
"""
_EXP_LANES = """
    auto exponential = [](V x) -> V {
        T lane[N];
        __builtin_memcpy(lane, &x, sizeof(V));
        for (int l = 0; l < N; ++l)
            lane[l] = wp::exp(lane[l]);
        __builtin_memcpy(&x, lane, sizeof(V));
        return x;
    };
"""
_EXP_SCALAR = """
    auto exponential = [](V x) -> V { return wp::exp(x); };
"""

_STRIP = """
    enum { N = %(N)d, S = %(S)d, M = %(M)d, D = %(D)d, R = %(R)d };  // cells, rows, channels, axes, radius of a patch
    enum { MAPS = %(maps)d };
    enum { DOWN = D > 1 ? R : 0 };  // radius of a patch across the rows
    enum { PARTS = (N + 2 * R + N - 1) / N };  // packs that hold the patches' cells of one row
    typedef %(T)s T;
    %(pack)s
    %(exp)s
    // Where the strip is: its coordinates along the leading axes, its first row, and that row's place in the padded f.
    const int height = D > 1 ? p.sizes.data[D - 2] : 1, width = p.sizes.data[D - 1];
    const int strips = (height + S - 1) / S, y0 = (strip %% strips) * S, x0 = pack * N;
    int lead[D], rest = strip / strips;
    for (int a = D - 3; a >= 0; --a) {
        lead[a] = rest %% p.sizes.data[a];
        rest /= p.sizes.data[a];
    }
    long long row0 = 0;
    for (int a = 0; a < D - 2; ++a)
        row0 = (row0 + lead[a] + R) * (a + 1 < D - 2 ? p.sizes.data[a + 1] + 2 * R : 1);
    row0 = row0 * (height + 2 * DOWN) + y0;
    const int rows = height - y0 < S ? height - y0 : S, columns = width - x0 < N ? width - x0 : N;
    const long long cell0 = ((long long)strip / strips * height + y0) * width + x0;  // in functions without padding
    const long long centre0 = (row0 + DOWN) * p.pitch + p.left + R + x0;  // in the padded planes
    V rho[S];

%(begin)s
    for (int k = 0; k < p.n_offsets; ++k) {
        const int* offset = p.offsets.data + k * D;
        const int dx = offset[D - 1], dy = D > 1 ? offset[D > 1 ? D - 2 : 0] : 0;
        bool there = true;
        long long jump = 0;  // in padded rows
        for (int a = 0; a < D - 2; ++a) {
            const int c = lead[a] + offset[a];
            there = there && c >= 0 && c < p.sizes.data[a];
            jump = (jump + offset[a]) * (a + 1 < D - 2 ? p.sizes.data[a + 1] + 2 * R : 1);
        }
        jump = jump * (height + 2 * DOWN) + dy;
        // the rows of the strip whose neighbours are rows of the grid
        const int from = y0 + dy < 0 ? -(y0 + dy) : 0;
        const int bottom = rows < height - y0 - dy ? rows : height - y0 - dy;
        const int until = there && from < bottom ? bottom : from, patch_end = until > from ? until + 2 * DOWN : from;
        const long long ahead = jump * p.pitch + dx;
        auto similarity = [&](V rho, int k, long long u) -> V {
            V kept = rho - p.shift;
            if (MAPS)  // a and q of both ends
                kept -= WP_GPUREG_LOAD(p.maps.data + u) + WP_GPUREG_LOAD(p.maps.data + u + ahead);
            kept = kept > V{} ? kept : V{};
            if (MAPS)
                kept *= WP_GPUREG_LOAD(p.maps.data + p.plane + u) * WP_GPUREG_LOAD(p.maps.data + p.plane + u + ahead);
            const V w = exponential(-(kept * p.scale));
            return p.spatial.data[k] * (w >= p.cut ? w : V{});
        };

        for (int y = from; y < until; ++y)
            rho[y] = V{};
        for (int q = from; q < patch_end; ++q) {
            // the sum along row q of the patches, and over their leading axes
            V sum = V{};
            for (int i = 0; i < p.lines.shape[0]; ++i) {
                const T* here = p.f.data + (row0 + q + p.lines.data[i]) * p.pitch + p.left + x0;
                V squares[PARTS];
                for (int part = 0; part < PARTS; ++part) {
                    V square = V{};
                    for (int c = 0; c < M; ++c) {
                        const T* at = here + c * p.plane + part * N;
                        const V d = WP_GPUREG_LOAD(at) - WP_GPUREG_LOAD(at + ahead);
                        square += d * d;
                    }
                    squares[part] = square;
                }
                const T* square = (const T*)squares;
                V along = V{};
                for (int j = 0; j < 2 * R + 1; ++j)
                    along += p.profile.data[j] * WP_GPUREG_LOAD(square + j);
                sum += p.line_weights.data[i] * along;
            }
            const int first = q - 2 * DOWN > from ? q - 2 * DOWN : from;
            const int last = q < until - 1 ? q : until - 1;
            for (int y = first; y <= last; ++y)
                rho[y] += (D > 1 ? p.profile.data[q - y] : T(1)) * sum;
        }

%(weights)s
    }
%(end)s
#undef WP_GPUREG_LOAD
"""


@functools.cache
def struct(real):
    """Make the struct with the padded function, the window and the patch."""

    @wp.struct
    class Patches:
        f: wp.array(dtype=real)  # M planes of padded rows
        plane: wp.int64  # from a channel to the next
        pitch: wp.int64  # from a row to the next
        left: wp.int32  # zeros before each row
        inside: wp.array(dtype=real)  # one plane: 1 on the grid and in its mask, 0 elsewhere
        maps: wp.array(dtype=real)  # two planes: a and q of the cells, 0 elsewhere; read with `maps`
        sizes: wp.array(dtype=wp.int32)  # of the grid's axes
        offsets: wp.array(dtype=wp.int32)  # (n_offsets * axes,)
        n_offsets: wp.int32
        spatial: wp.array(dtype=real)  # (n_offsets,): s
        lines: wp.array(dtype=wp.int32)  # the patch along the leading axes: steps in padded rows,
        line_weights: wp.array(dtype=real)  # and their weights, factors of g
        profile: wp.array(dtype=real)  # (2 R + 1,): g along one axis
        shift: real
        scale: real
        cut: real  # exponentials below it count as 0

    return Patches


def source(real, ndim, M, R, N, S, *, maps, begin="", weights, end=""):
    """Return C++ for strip `strip` and pack `pack` of the Patches `p`, on a grid of `ndim` axes.

    `begin` goes before the loop over the offsets, `weights` to the end of its body, and `end` after it.
    """
    double = real == wp.float64
    return _STRIP % {
        "N": N,
        "S": S,
        "M": M,
        "D": ndim,
        "maps": int(maps),
        "R": R,
        "T": "double" if double else "float",
        "pack": _PACK if N > 1 else _SCALAR,
        "exp": _EXP_SCALAR if N == 1 else _EXP_LANES if double else _EXP_FLOAT,
        "begin": begin,
        "weights": weights,
        "end": end,
    }
