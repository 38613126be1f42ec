/* rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 for a block of cells u, one offset of the window after the other
 *                                                                                                  (section 5.2)
 * g is an outer product of one profile, so rho is a sum down the columns of the patch, then along its rows: a few
 * additions per cell instead of one per cell of the patch. All terms are >= 0 and no term is subtracted again, so that
 * a small distance next to a large one loses no digits. The order of the sums is the same for all cells of a block, so
 * that parts of an image give the same bits as the whole image.
 *
 * A block is S rows, along the next-to-last axis, of B packs of N neighbouring cells. For one offset, `sum_down` passes
 * each column of packs with the last rows in registers, and writes the sums down the patches to `down`; `sum_along`
 * turns a row of `down` into distances. FLAT, g = 1: a sum of 2 R + 1 rows is composed of sums of 1, 2, 4 and 8 rows,
 * each one addition of two sums of half the length. Otherwise each row has a weight: 2 R + 1 multiply-adds.
 * UNROLLED, on a GPU: see strip_unrolled.cl.
 *
 * f is one plane of cells per channel, padded by the radius of the patch (numpy's "reflect") and, along a row, by zeros
 * on both sides for the reach of the window and a block: reads need no check of the border, and edges across it get
 * weight 0. Arithmetic per edge: 3 Q, plus 4 additions for flat patches of side 7, times (1 + 2 R/S) (1 + 1/B) for the
 * overlap; then 2 R additions. All reads are from the L1 and L2 caches.
 */
#ifndef STRIP_CL
#define STRIP_CL
#include "reals.cl"

#ifndef NDIM
#define NDIM 2
#endif
#ifndef R
#define R 0 /* radius of the patch */
#endif
#ifndef S
#define S 1 /* rows of a block */
#endif
#ifndef B
#define B 1 /* packs in a row of a block */
#endif
#ifndef Q
#define Q 1 /* channels that the patches compare */
#endif
#ifndef A
#define A 0 /* on two axes: weights are sums of those of the (2 A + 1)^2 pairs (u - j, v - j) around a pair */
#endif

/* On a CPU a group is one work item: a larger one would need a copy of the arrays per work item. */
#if N > 1
#define ALONE __attribute__((reqd_work_group_size(1, 1, 1)))
#else
#define ALONE
#endif

#define DOWN (NDIM > 1 ? R : 0)           /* radius of the patch across the rows */
#define SPAN (B + (2 * A + N - 1) / N)    /* packs in a row of weights: the block, and A cells on each side */
#define WIDE (SPAN + (2 * R + N - 1) / N) /* packs in a row of `down` */

/* clang-format off */
#define STRIP_ARGS                                                                                                    \
    __global const real *guide,        /* Q planes of padded rows, which the patches compare */                       \
    const long padded_plane,           /* from a channel to the next */                                               \
    const long padded_pitch,           /* from a row to the next */                                                   \
    const long left,                   /* from the start of a padded row to the patch of its first cell */            \
    __global const real *inside,       /* one plane: 1 in the grid's mask, 0 elsewhere; read with MASKED */           \
    __global const real *maps,         /* two planes: a(u) and q(u), 0 outside the grid; read with MAPS */            \
    __global const int *sizes,         /* (NDIM,): of the grid's axes */                                              \
    const int n_offsets,                                                                                              \
    __global const int *steps,         /* (n_offsets, NDIM) */                                                        \
    __global const real *spatial,      /* (n_offsets,): s */                                                          \
    const int n_lines,                                                                                                \
    __global const long *lines,        /* (n_lines,): the patch along the leading axes, as steps in padded */         \
    __global const real *line_weights, /* (n_lines,): their weights, factors of g */                                  \
    __global const real *profile,      /* (2 R + 1,): g along one axis; read without FLAT */                          \
    const real shift,                                                                                                 \
    const real scale,                  /* -log2(e)/h^2 */                                                             \
    const real cut                     /* exponentials below it count as 0; read with CUT */
/* clang-format on */

#ifdef PAIRS
#define FIRST_STRIP first
#else
#define FIRST_STRIP 0
#endif

/* The block of this work item: the coordinates `lead` of its rows along the leading axes, its first row y0 and cell x0,
 * its number of `rows`, the index `cell_row` of its first row in functions without padding, and the indices in a padded
 * plane of its first cell, `centre0`, and of the first cell of that one's patch, `padded0`. */
#define STRIP_PLACE                                                                                         \
    const int height = NDIM > 1 ? sizes[NDIM > 1 ? NDIM - 2 : 0] : 1, width_ = sizes[NDIM - 1];             \
    const int strips = (height + S - 1) / S, strip = FIRST_STRIP + (int)get_global_id(1);                   \
    const int y0 = strip % strips * S, x0 = (int)get_global_id(0) * (B * N);                                \
    int lead[NDIM]; /* not read on two axes */                                                              \
    for (int a = NDIM - 3, rest = strip / strips; a >= 0; rest /= sizes[a], --a) lead[a] = rest % sizes[a]; \
    long padded_row = 0;                                                                                    \
    for (int a = 0; a < NDIM - 2; ++a) padded_row = padded_row * (sizes[a] + 2 * R) + lead[a] + R;          \
    padded_row = padded_row * (height + 2 * DOWN) + y0;                                                     \
    const int rows = min(S, height - y0);                                                                   \
    const long cell_row = (long)(strip / strips) * height + y0;                                             \
    const long padded0 = padded_row * padded_pitch + left + x0;                                             \
    const long centre0 = padded0 + DOWN * padded_pitch + R;

/* For offset k: the rows from .. until of the block whose neighbours are on the grid, and `ahead`, the step to the
 * neighbours in a padded plane. `leaves`: some cells or neighbours may be beyond the ends of the rows. */
#define STRIP_OFFSET(k)                                                                   \
    __global const int *step = steps + (k) * NDIM;                                        \
    const int dx = step[NDIM - 1], dy = NDIM > 1 ? step[NDIM > 1 ? NDIM - 2 : 0] : 0;     \
    bool there = true;                                                                    \
    long jump = 0;                                                                        \
    for (int a = 0; a < NDIM - 2; ++a) {                                                  \
        there = there && lead[a] + step[a] >= 0 && lead[a] + step[a] < sizes[a];          \
        jump = jump * (sizes[a] + 2 * R) + step[a];                                       \
    }                                                                                     \
    jump = jump * (height + 2 * DOWN) + dy;                                               \
    const int from = max(0, -(y0 + dy)), until = there ? min(rows, height - y0 - dy) : 0; \
    const long ahead = jump * padded_pitch + dx;                                          \
    const bool leaves = min(x0, x0 + dx) < 0 || max(x0, x0 + dx) + B * N > width_;

/* Whether the cells at x of a row are on the grid. */
#define ON_ROW(x) ((x) + LANES >= 0 && (x) + LANES < width_)

/* Squared differences of a pack at `at` and its neighbours, summed over channels and the patch's leading axes. */
static inline realN squares(
    __global const real *at,
    const long ahead,
    const long padded_plane,
    const int n_lines,
    __global const long *lines,
    __global const real *line_weights)
{
#if NDIM > 2
    realN sum = 0;
    for (int i = 0; i < n_lines; ++i) {
        realN square = 0;
        for (int c = 0; c < Q; ++c) {
            __global const real *here = at + lines[i] + c * padded_plane;
            const realN d = LOAD(here, 0) - LOAD(here, ahead);
            square += d * d;
        }
        sum += line_weights[i] * square;
    }
    return sum;
#else
    realN sum = 0;
    for (int c = 0; c < Q; ++c) {
        const realN d = LOAD(at, c * padded_plane) - LOAD(at, c * padded_plane + ahead);
        sum = c == 0 ? d * d : sum + d * d;
    }
    return sum;
#endif
}
#define SQUARES(at) squares(at, ahead, padded_plane, n_lines, lines, line_weights)

/* The weights from distances; `scale` is negative. */
static inline realN similarity(realN rho, const real spatial, const real shift, const real scale, const real cut)
{
#ifdef SHIFTED_DISTANCE
    rho = fmax(rho - shift, (realN)(0));
#endif
    realN w = exp2_scaled(rho, scale);
#ifdef CUT
    w = WHERE(w >= cut, w);
#endif
#ifdef SPATIAL
    return spatial * w;
#else
    return w;
#endif
}

/* The weights of a pack at u and its neighbours at v, indices in a padded plane, for offset k. */
#ifdef MAPS
#define SIMILARITY_AT(rho, k, u, v)                                            \
    similarity(                                                                \
        fmax((rho) - shift - (LOAD(maps, u) + LOAD(maps, v)), (realN)(0)) *    \
            (LOAD(maps, padded_plane + (u)) * LOAD(maps, padded_plane + (v))), \
        spatial[k], 0, scale, cut)
#else
#define SIMILARITY_AT(rho, k, u, v) similarity(rho, spatial[k], shift, scale, cut)
#endif

/* w, or 0 where an end is outside the grid or the mask; u, v: indices in a padded plane, x: the column of u. */
#ifdef MASKED
#define PRESENT_WEIGHT(w, u, v, x) WHERE(ON_ROW(x) && LOAD(inside, u) > 0 && LOAD(inside, v) > 0, w)
#else
#define PRESENT_WEIGHT(w, u, v, x) (leaves ? WHERE(ON_ROW(x) && ON_ROW((x) + dx), w) : (w))
#endif

/* A kernel declares BLOCK_ARRAYS; for offset k it uses BLOCK_OF once, ROW_OF for each row of the block with neighbours,
 * and then RHO, the distance of pack p in row y, or if it does not store its weights WEIGHT_OF. FOR_ROWS is a loop over
 * the rows first <= y < last of a block; UNROLL stands before other loops over arrays. */
#ifdef UNROLLED
#include "strip_unrolled.cl"
#else
#define UNROLL
#define FOR_ROWS(y, first, last) for (int y = (first); y < (last); ++y)
#define RHO(y, p) rho[p]

/* The sum of the last 2 R + 1 rows, from sums of 1, 2, 4 and 8 rows; SUMn(l) has the n rows up to the one l rows before
 * the last. */
#ifdef FLAT
#if R == 1
#define PATCH_SUM (SUM2(0) + SUM1(2))
#elif R == 2
#define PATCH_SUM (SUM4(0) + SUM1(4))
#elif R == 3
#define PATCH_SUM ((SUM4(0) + SUM2(4)) + SUM1(6))
#elif R == 4
#define PATCH_SUM (SUM8(0) + SUM1(8))
#elif R == 5
#define PATCH_SUM ((SUM8(0) + SUM2(8)) + SUM1(10))
#endif /* larger patches are summed row by row */
#endif

/* Write the sums down the patches of the rows from .. until, for `ahead`, to down[y * WIDE + pack]. */
static inline void sum_down(
    __global const real *first,
    const long padded_pitch,
    const long padded_plane,
    const long ahead,
    const int from,
    const int until,
    const int n_lines,
    __global const long *lines,
    __global const real *line_weights,
    __global const real *profile,
    realN *down)
{
    for (int p = 0; p < WIDE; ++p) {
        __global const real *at = first + from * padded_pitch + p * N;
#if R == 0 || NDIM == 1
        for (int y = from; y < until; ++y, at += padded_pitch) down[y * WIDE + p] = SQUARES(at);
#else
        /* the last rows of squares; the compiler turns the shifts below into renamed registers */
        realN row[2 * R + 1];
#pragma unroll
        for (int i = 0; i <= 2 * R; ++i) row[i] = 0;
#ifdef PATCH_SUM
        realN two[2 * R + 1], four[2 * R + 1];
#pragma unroll
        for (int i = 0; i <= 2 * R; ++i) two[i] = four[i] = 0;
#define SUM1(l) row[l]
#define SUM2(l) two[l]
#define SUM4(l) four[l]
#define SUM8(l) (four[0] + four[4])
#endif
        for (int q = from - 2 * R; q < until; ++q, at += padded_pitch) {
#pragma unroll
            for (int i = 2 * R; i > 0; --i) row[i] = row[i - 1];
            row[0] = SQUARES(at);
#ifdef PATCH_SUM
#pragma unroll
            for (int i = 2 * R; i > 0; --i) two[i] = two[i - 1];
            two[0] = row[0] + row[1];
#if R >= 2
#pragma unroll
            for (int i = 2 * R; i > 0; --i) four[i] = four[i - 1];
            four[0] = two[0] + two[2];
#endif
            if (q >= from) down[q * WIDE + p] = PATCH_SUM;
#else
            if (q >= from) {
                realN sum = profile[0] * row[2 * R];
#pragma unroll
                for (int i = 1; i <= 2 * R; ++i) sum += profile[i] * row[2 * R - i];
                down[q * WIDE + p] = sum;
            }
#endif
        }
#undef SUM1
#undef SUM2
#undef SUM4
#undef SUM8
#endif
    }
}
#define SUM_DOWN \
    sum_down(    \
        guide + padded0, padded_pitch, padded_plane, ahead, from, until, n_lines, lines, line_weights, profile, down)

/* Compute the distances of the packs of a row from the sums down its patches. */
#if defined(FLAT) && R == 3 && N == 16 && defined(__clang__)
/* A sum of 7 cells is composed of sums of 2: ((2 + 2) + 2) + 1, each one shuffle of two packs that are in registers,
 * instead of 6 loads that are not aligned. On PoCL 3.1 the whole step takes 6 percent less time. For packs of 8, which
 * PoCL 3.0 has, shuffles take five times as long as loads. */
#define SHIFTED(a, b, n)                                                                                        \
    __builtin_shufflevector(                                                                                    \
        a, b, n, n + 1, n + 2, n + 3, n + 4, n + 5, n + 6, n + 7, n + 8, n + 9, n + 10, n + 11, n + 12, n + 13, \
        n + 14, n + 15)
static inline void sum_along(const realN *c, __global const real *profile, realN *rho)
{
    realN here = c[0], next = c[1], two = here + SHIFTED(here, next, 1);
#pragma unroll
    for (int p = 0; p < SPAN; ++p) {
        /* the last pack has no cell of a patch after the next one */
        const realN after = p + 2 < WIDE ? c[p + 2] : next, two_next = next + SHIFTED(next, after, 1);
        rho[p] = ((two + SHIFTED(two, two_next, 2)) + SHIFTED(two, two_next, 4)) + SHIFTED(here, next, 6);
        here = next, next = after, two = two_next;
    }
}
#else
/* Shifted packs are loaded, from the L1 cache. */
static inline void sum_along(const realN *c, __global const real *profile, realN *rho)
{
    const real *numbers = (const real *)c;
#pragma unroll
    for (int p = 0; p < SPAN; ++p) {
#if R == 0 || defined(FLAT)
        realN sum = c[p];
#pragma unroll
        for (int j = 1; j <= 2 * R; ++j) sum += LOAD_PRIVATE(numbers, p * N + j);
#else
        realN sum = profile[0] * c[p];
#pragma unroll
        for (int j = 1; j <= 2 * R; ++j) sum += profile[j] * LOAD_PRIVATE(numbers, p * N + j);
#endif
        rho[p] = sum;
    }
}
#endif

/* With A, the weights of A rows and cells around the block are computed too, and summed along the rows; WEIGHT_OF sums
 * them down the columns. */
#if A > 0
#define BLOCK_ARRAYS realN down[(S + 2 * A) * WIDE], rho[SPAN], single[SPAN], across[(S + 2 * A) * B];
#define BLOCK_OF(k)                                                                                                   \
    for (int i = 0; i < (S + 2 * A) * B; ++i) across[i] = 0;                                                          \
    if (from < until) {                                                                                               \
        const int low = max(-A, -min(y0, y0 + dy)), high = min(rows + A, height - max(y0, y0 + dy));                  \
        const bool leaves = min(x0, x0 + dx) < A || max(x0, x0 + dx) - A + SPAN * N > width_;                         \
        sum_down(                                                                                                     \
            guide + padded0 - A, padded_pitch, padded_plane, ahead, low, high, n_lines, lines, line_weights, profile, \
            down + A * WIDE);                                                                                         \
        for (int y = low; y < high; ++y) {                                                                            \
            sum_along(down + (y + A) * WIDE, profile, rho);                                                           \
            for (int p = 0; p < SPAN; ++p) {                                                                          \
                const long u = centre0 + y * padded_pitch + p * N - A, v = u + ahead;                                 \
                single[p] = PRESENT_WEIGHT(SIMILARITY_AT(rho[p], k, u, v), u, v, x0 - A + p * N);                     \
            }                                                                                                         \
            for (int p = 0; p < B; ++p) {                                                                             \
                realN sum = LOAD_PRIVATE((const real *)single, p * N);                                                \
                for (int j = 1; j <= 2 * A; ++j) sum += LOAD_PRIVATE((const real *)single, p * N + j);                \
                across[(y + A) * B + p] = sum;                                                                        \
            }                                                                                                         \
        }                                                                                                             \
    }
#define ROW_OF(y)
#define WEIGHT_OF(k, y, p, u, v) sum_across(across + (y) * B + (p))
static inline realN sum_across(const realN *across)
{
    realN sum = across[0];
#pragma unroll
    for (int i = 1; i <= 2 * A; ++i) sum += across[i * B];
    return sum;
}
#else
#define BLOCK_ARRAYS realN down[S * WIDE], rho[SPAN];
#define BLOCK_OF(k) \
    if (from < until) SUM_DOWN;
#define ROW_OF(y) sum_along(down + (y) * WIDE, profile, rho);
#define WEIGHT_OF(k, y, p, u, v) SIMILARITY_AT(RHO(y, p), k, u, v)
#endif
#endif

#endif
