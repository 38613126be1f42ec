"""rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 for a block of cells u, one offset of the window after the other
                                                                                                   (section 5.2)
g is an outer product of one profile, so rho is a sum down the columns of the patch, then along its rows: a few
additions per cell instead of one per cell of the patch. All terms are >= 0 and no term is subtracted again, so that a
small distance next to a large one loses no digits. The sums of a cell have the same order wherever its block begins.

A block is S rows, along the next-to-last axis, of B packs of N neighbouring cells. For one offset, `sum_down` passes
each column of packs with the last rows in registers, and writes the sums down the patches to `down`; `sum_along` turns
a row of `down` into distances. `flat`, g = 1: a sum of 2 R + 1 rows is composed of sums of 1, 2, 4 and 8 rows, each one
addition of two sums of half the length. Otherwise each row has a weight: 2 R + 1 multiply-adds. Where N = B = S = 1, a
work item computes the distances of one cell in its registers.

f is one plane of cells per channel, padded by the radius of the patch (numpy's "reflect") and, along a row, by zeros on
both sides for the reach of the window and a block (padded.py): reads need no check of the border, as `inside` is 0
beyond it. Arithmetic per edge: 3 Q, plus 4 additions for flat patches of side 7, times (1 + 2 R/S) (1 + 1/B) for the
overlap; then 2 R additions.

With A, weights are sums of those of the (2 A + 1)^2 pairs (u - j, v - j) around a pair: those of A rows and cells
around the block are computed too, and summed along the rows, then down the columns.

This is C++, as clang does not always vectorise loops over a Warp vector. The names that the parts of `source` use:
- k: index of the offset; from, until: the rows of the block whose neighbours are on the grid
- x0, cell0, centre0: column of the block's first cell; its index in functions, and in a padded plane
- ahead: step from a cell to its neighbour in a padded plane
- distances(y): the distances of the packs of row y, in rho[p]
- weights(y): the weights of the packs of row y, in w[p]; 0 where an end is not on the grid or not in its mask
"""

import functools

import warp as wp

# Vectors of N reals, for which clang has operators; one real if N = 1, as on a GPU, whose compiler has no vectors.
# exp(x) for x <= 0, as the C library has none for vectors: x is reduced by n ln 2 in two parts (Cody and Waite; n by
# adding and subtracting 1.5 2^23), then the series to degree 7 (relative error 5e-9 on |r| <= ln(2)/2), times 2^n in
# the exponent bits; subnormal results are 0.
_PACK = """
#define WP_GPUREG_LOAD(p) ([](const T* at) { V v; __builtin_memcpy(&v, at, sizeof(V)); return v; }(p))
#define WP_GPUREG_INLINE __attribute__((always_inline))
#define WP_GPUREG_UNROLL _Pragma("unroll")
    typedef T V __attribute__((vector_size(N * sizeof(T))));
    typedef int I __attribute__((vector_size(N * sizeof(int))));
"""
_SCALAR = """
#define WP_GPUREG_LOAD(p) (*(p))
#define WP_GPUREG_INLINE
#define WP_GPUREG_UNROLL _Pragma("unroll")
    typedef T V;
"""
_EXP_FLOAT = """
    auto exponential = [](V x) WP_GPUREG_INLINE -> V {
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
#ifndef __CUDA_ARCH__
#pragma clang fp contract(fast)  // not Warp's default
#endif
    enum { N = %(N)d, S = %(S)d, B = %(B)d, Q = %(Q)d, D = %(D)d, R = %(R)d, A = %(A)d };
    enum { FLAT = %(flat)d, MAPS = %(maps)d };
    enum { DOWN = D > 1 ? R : 0, SIDE = 2 * R + 1 };  // radius of a patch across the rows; its side
    enum { SPAN = B + (2 * A + N - 1) / N };          // packs in a row of weights: the block, and A cells on each side
    enum { WIDE = SPAN + (2 * R + N - 1) / N };       // packs in a row of `down`
    enum { ONE_ROW = S == 1 && A == 0 };              // then no index depends on y, and arrays are registers of a GPU
    typedef %(T)s T;
    %(pack)s
    %(exp)s
    // The block: its coordinates along the leading axes, its first row and column, that cell's place in the padded f.
    const int height = D > 1 ? p.sizes.data[D - 2] : 1, width = p.sizes.data[D - 1];
    const int strips = (height + S - 1) / S, y0 = (strip %% strips) * S, x0 = block * (B * N);
    int lead[D], rest = strip / strips;
    for (int a = D - 3; a >= 0; --a) {
        lead[a] = rest %% p.sizes.data[a];
        rest /= p.sizes.data[a];
    }
    long long row0 = 0;
    for (int a = 0; a < D - 2; ++a)
        row0 = row0 * (p.sizes.data[a] + 2 * R) + lead[a] + R;
    row0 = row0 * (height + 2 * DOWN) + y0;
    const int rows = height - y0 < S ? height - y0 : S, columns = width - x0 < B * N ? width - x0 : B * N;
    const long long cell0 = ((long long)strip / strips * height + y0) * width + x0;
    const long long padded0 = row0 * p.pitch + p.left + x0, centre0 = padded0 + DOWN * p.pitch + R;
    T profile[SIDE];
    for (int j = 0; j < SIDE; ++j)
        profile[j] = p.profile.data[j];
    V down[(S + 2 * A) * WIDE], rho[SPAN], w[SPAN], across[A > 0 ? (S + 2 * A) * B : 1];

%(begin)s
    for (int k = 0; k < p.n_offsets; ++k) {
        const int* offset = p.offsets.data + k * D;
        const int dx = offset[D - 1], dy = D > 1 ? offset[D > 1 ? D - 2 : 0] : 0;
        bool there = true;
        long long jump = 0;  // in padded rows
        for (int a = 0; a < D - 2; ++a) {
            const int c = lead[a] + offset[a];
            there = there && c >= 0 && c < p.sizes.data[a];
            jump = jump * (p.sizes.data[a] + 2 * R) + offset[a];
        }
        jump = jump * (height + 2 * DOWN) + dy;
        const int from = y0 + dy < 0 ? -(y0 + dy) : 0;
        const int bottom = rows < height - y0 - dy ? rows : height - y0 - dy;
        const int until = there && from < bottom ? bottom : from;
        const long long ahead = jump * p.pitch + dx;
        // whether an end of an edge of these cells may be missing
        const bool leaves = p.masked || (dx < 0 ? dx : 0) + x0 < A || (dx > 0 ? dx : 0) + x0 - A + SPAN * N > width;

        // Squared differences of a pack and its neighbours, summed over channels and the patch's leading axes.
        auto squares = [&](const T* at) WP_GPUREG_INLINE -> V {
            if (D > 2) {
                V sum = V{};
                for (int i = 0; i < p.lines.shape[0]; ++i) {
                    const T* here = at + (long long)p.lines.data[i] * p.pitch;
                    V square = V{};
                    for (int c = 0; c < Q; ++c) {
                        const V d = WP_GPUREG_LOAD(here + c * p.plane) - WP_GPUREG_LOAD(here + c * p.plane + ahead);
                        square += d * d;
                    }
                    sum += p.line_weights.data[i] * square;
                }
                return sum;
            }
            const V first = WP_GPUREG_LOAD(at) - WP_GPUREG_LOAD(at + ahead);
            V sum = first * first;
            for (int c = 1; c < Q; ++c) {
                const V d = WP_GPUREG_LOAD(at + c * p.plane) - WP_GPUREG_LOAD(at + c * p.plane + ahead);
                sum += d * d;
            }
            return sum;
        };
        // Write the sums down the patches of some rows, for packs from the cell at `corner`, to to[y * WIDE + pack].
        auto sum_down = [&](const T* corner, int first, int last, V* to) WP_GPUREG_INLINE {
            for (int pack = 0; pack < WIDE; ++pack) {
                const T* at = corner + first * p.pitch + pack * N;
                if (DOWN == 0) {
                    for (int y = first; y < last; ++y, at += p.pitch)
                        to[(ONE_ROW ? 0 : y) * WIDE + pack] = squares(at);
                    continue;
                }
                // the last rows of squares, and of their sums
                %(declare)s
                for (int y = first - 2 * R; y < last; ++y, at += p.pitch) {
                    %(shift)s
                    if (y >= first)
                        to[(ONE_ROW ? 0 : y) * WIDE + pack] = %(sum)s;
                }
            }
        };
        // Compute the distances of the packs of a row from the sums down its patches.
        auto sum_along = [&](const V* from) WP_GPUREG_INLINE {
            const T* numbers = (const T*)from;
            WP_GPUREG_UNROLL
            for (int pack = 0; pack < SPAN; ++pack) {
                V sum = FLAT ? from[pack] : profile[0] * from[pack];
                WP_GPUREG_UNROLL
                for (int j = 1; j < SIDE; ++j) {
                    const V next = WP_GPUREG_LOAD(numbers + pack * N + j);
                    sum += FLAT ? next : profile[j] * next;
                }
                rho[pack] = sum;
            }
        };
        // The weight of a distance; u: index of the pack in a padded plane.
        auto similarity = [&](V distance, long long u) WP_GPUREG_INLINE -> V {
            V kept = distance - p.shift;
            if (MAPS)  // a and q of both ends
                kept -= WP_GPUREG_LOAD(p.maps.data + u) + WP_GPUREG_LOAD(p.maps.data + u + ahead);
            kept = kept > V{} ? kept : V{};
            if (MAPS)
                kept *= WP_GPUREG_LOAD(p.maps.data + p.plane + u) * WP_GPUREG_LOAD(p.maps.data + p.plane + u + ahead);
            const V similar = exponential(-(kept * p.scale));
            return p.spatial.data[k] * (similar >= p.cut ? similar : V{});
        };
        auto present = [&](V weight, long long u) WP_GPUREG_INLINE -> V {
            if (!leaves)
                return weight;
            return weight * (WP_GPUREG_LOAD(p.inside.data + u) * WP_GPUREG_LOAD(p.inside.data + u + ahead));
        };
        auto distances = [&](int y) WP_GPUREG_INLINE { sum_along(down + (ONE_ROW ? 0 : y) * WIDE); };
        auto weights = [&](int y) WP_GPUREG_INLINE {
            const long long u = centre0 + y * p.pitch;
            if (A == 0)
                sum_along(down + (ONE_ROW ? 0 : y) * WIDE);
            WP_GPUREG_UNROLL
            for (int pack = 0; pack < B; ++pack) {
                V weight;
                if (A == 0)
                    weight = similarity(rho[pack], u + pack * N);
                else {
                    weight = across[y * B + pack];
                    WP_GPUREG_UNROLL
                    for (int j = 1; j <= 2 * A; ++j)
                        weight += across[A > 0 ? (y + j) * B + pack : 0];
                }
                w[pack] = present(weight, u + pack * N);
            }
        };

        if (from < until && A == 0)
            sum_down(p.f.data + padded0, from, until, down);
        if (from < until && A > 0) {
            // the rows around, as far as both ends are on the grid: y goes from -A to rows + A
            const int above = y0 < y0 + dy ? y0 : y0 + dy, below = height - (y0 > y0 + dy ? y0 : y0 + dy);
            const int first = above < A ? -above : -A, last = rows + A < below ? rows + A : below;
            for (int i = 0; i < (S + 2 * A) * B; ++i)
                across[A > 0 ? i : 0] = V{};
            sum_down(p.f.data + padded0 - A, first, last, down + A * WIDE);
            for (int y = first; y < last; ++y) {
                const long long u = centre0 + y * p.pitch - A;
                sum_along(down + (y + A) * WIDE);
                WP_GPUREG_UNROLL
                for (int pack = 0; pack < SPAN; ++pack)
                    w[pack] = present(similarity(rho[pack], u + pack * N), u + pack * N);
                WP_GPUREG_UNROLL
                for (int pack = 0; pack < B; ++pack) {
                    V sum = w[pack];
                    WP_GPUREG_UNROLL
                    for (int j = 1; j <= 2 * A; ++j)
                        sum += WP_GPUREG_LOAD((const T*)w + pack * N + j);
                    across[A > 0 ? (y + A) * B + pack : 0] = sum;
                }
            }
        }
%(body)s
    }
%(end)s
#undef WP_GPUREG_LOAD
#undef WP_GPUREG_INLINE
#undef WP_GPUREG_UNROLL
"""


def _last_rows(R, flat):
    """Return C++ that declares the last 2 R + 1 rows of squares, takes another one, and the sum of all.

    A name for each row: of an array, clang would move the elements in memory.
    """
    side, half = 2 * R + 1, (1, 2, 4, 8)
    runs = []  # of a flat patch: first row of each run, and its length, the longest first
    for length in half[::-1] if flat else (1,):
        while side - sum(n for _, n in runs) >= length:
            runs.append((sum(n for _, n in runs), length))
    names = {n: name for n, name in zip(half, ("row", "two", "four", "eight"), strict=True) if n <= runs[0][1]}
    declare = " ".join(f"V {', '.join(f'{name}{i} = V{{}}' for i in range(side))};" for name in names.values())
    shift = " ".join(f"{name}{i} = {name}{i - 1};" for name in names.values() for i in range(side - 1, 0, -1))
    shift += " row0 = squares(at);"
    shift += "".join(f" {names[n]}0 = {names[n // 2]}0 + {names[n // 2]}{n // 2};" for n in names if n > 1)
    if flat:
        return declare, shift, " + ".join(f"{names[n]}{at}" for at, n in runs)
    # a row's weight is that of its place in the patch
    return declare, shift, " + ".join(f"profile[{i}] * row{side - 1 - i}" for i in range(side))


@functools.cache
def struct(real):
    """Make the struct with the padded function, the window and the patch."""

    @wp.struct
    class Patches:
        f: wp.array(dtype=real)  # Q planes of padded rows, which the patches compare
        plane: wp.int64  # from a channel to the next
        pitch: wp.int64  # from a row to the next
        left: wp.int32  # zeros before each row
        inside: wp.array(dtype=real)  # one plane: 1 on the grid and in its mask, 0 elsewhere
        masked: wp.int32  # whether the grid has a mask
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


def source(real, form, *, begin="", body, end=""):
    """Return C++ for block `block` of strip `strip` of the Patches `p`.

    `form` is (axes, Q, R, A, flat, maps, N, S, B). `begin` goes before the loop over the offsets, `body` to the end of
    its body, and `end` after it.
    """
    double, names = real == wp.float64, ("D", "Q", "R", "A", "flat", "maps", "N", "S", "B")
    found = {name: int(value) for name, value in zip(names, form, strict=True)}
    declare, shift, total = _last_rows(found["R"], found["flat"])
    return _STRIP % {
        **found,
        "declare": declare,
        "shift": shift,
        "sum": total,
        "T": "double" if double else "float",
        "pack": _PACK if found["N"] > 1 else _SCALAR,
        "exp": _EXP_SCALAR if found["N"] == 1 else _EXP_LANES if double else _EXP_FLOAT,
        "begin": begin,
        "body": body,
        "end": end,
    }
