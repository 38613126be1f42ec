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
#include "strip_packs.cl"
#endif

#endif
