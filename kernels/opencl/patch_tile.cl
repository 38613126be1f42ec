/* Distances of patches on two axes, for a GPU: columns in registers, rows through local memory.
 *
 *   rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2,   g an outer product of one symmetric profile          (section 5.2)
 *
 * A work group has S rows of COLUMNS cells u. For one offset of the window, work item l
 *   down    squares the differences of column l of the cells of all patches, which it has in registers, and of a column
 *           of a tile in local memory; it adds them down the patches, and writes S sums to local memory;
 *   along   adds these sums along the rows, for S/4 rows of 4 neighbouring cells.
 * One barrier lies between the two. The tile has the rows of v for one dy, and CHUNK steps dx. It is read from functions
 * in the layout of grid.cl; cells outside of the grid are reflected, without repeating the edge cell.
 *
 * All terms are >= 0 and none is subtracted again. The order of a sum does not depend on where its cell is in a block.
 * Local memory: a tile of Q IR WIDE numbers, and S ITEMS sums. Words of local memory per pair of cells: with 7 x 7
 * patches, S = 16 and one channel 6.3. Arithmetic: 3 Q IR/S for the squares, 4 to 5 additions along each axis.
 */
#ifndef PATCH_TILE_CL
#define PATCH_TILE_CL
#include "reals.cl"
#include "reflected.cl"

#ifndef R
#define R 0 /* radius of the patch */
#endif
#ifndef Q
#define Q 1 /* channels that the patches compare */
#endif
#ifndef S
#define S 16 /* rows of a block, a multiple of 4 */
#endif

#define ITEMS 128                         /* work items of a group */
#define CHUNK 24                          /* steps along a row that a tile has room for */
#define COLUMNS ((ITEMS - 2 * R) / 4 * 4) /* of a block */
#define OWN_ROWS (S / 4)                  /* rows of a work item, of 4 cells */
#define CELLS (4 * OWN_ROWS)              /* cells of a work item */
#define IR (S + 2 * R)                    /* rows of a tile */
#define WIDE (ITEMS + CHUNK)              /* cells of a row of a tile */
#define NEAR ((4 + 2 * R + 3) / 4 * 4)    /* sums of a row that 4 cells need, in vectors of 4 */

#define real4 CONCATENATE(REAL_, 4)

/* The patch's weights along an axis from its centre on, g. */
#ifdef FLAT
#define PROFILE_OF(profile) const real *g = 0; /* not read */
#else
#define PROFILE_OF(profile) \
    real g[R + 1];          \
    _Pragma("unroll") for (int j = 0; j <= R; ++j) g[j] = profile[R + j];
#endif

/* The sum over a patch along one axis of a[i], ..., a[i + 2 R]. Flat: of sums of 1, 2, 4 and 8, which the compiler makes
 * once for all i. */
#ifdef FLAT
#define OF2(a, i) ((a)[i] + (a)[(i) + 1])
#define OF4(a, i) (OF2(a, i) + OF2(a, (i) + 2))
#define OF8(a, i) (OF4(a, i) + OF4(a, (i) + 4))
#if R == 0
#define OVER_PATCH(a, i) (a)[i]
#elif R == 1
#define OVER_PATCH(a, i) (OF2(a, i) + (a)[(i) + 2])
#elif R == 2
#define OVER_PATCH(a, i) (OF4(a, i) + (a)[(i) + 4])
#elif R == 3
#define OVER_PATCH(a, i) (OF4(a, i) + (OF2(a, (i) + 4) + (a)[(i) + 6]))
#elif R == 4
#define OVER_PATCH(a, i) (OF8(a, i) + (a)[(i) + 8])
#elif R == 5
#define OVER_PATCH(a, i) (OF8(a, i) + (OF2(a, (i) + 8) + (a)[(i) + 10]))
#elif R == 6
#define OVER_PATCH(a, i) (OF8(a, i) + (OF4(a, (i) + 8) + (a)[(i) + 12]))
#elif R == 7
#define OVER_PATCH(a, i) (OF8(a, i) + (OF4(a, (i) + 8) + (OF2(a, (i) + 12) + (a)[(i) + 14])))
#else
#define OVER_PATCH(a, i) ((OF8(a, i) + OF8(a, (i) + 8)) + (a)[(i) + 16])
#endif
#else
#define OVER_PATCH(a, i) over_patch((a) + (i), g)
static inline real over_patch(const real *a, const real *g)
{
    real sum = g[0] * a[R];
#pragma unroll
    for (int j = 1; j <= R; ++j) sum += g[j] * (a[R - j] + a[R + j]);
    return sum;
}
#endif

/* Copy column l of the cells of all patches of a block to registers. */
static inline void load_column(
    __global const real *guide,
    const int height,
    const int width,
    const long pitch,
    const long plane,
    const int y,
    const int x,
    real *column)
{
    const int from = reflected(x, width);
#pragma unroll
    for (int q = 0; q < IR; ++q) {
        const long at = reflected(y + q, height) * pitch + from;
#pragma unroll
        for (int c = 0; c < Q; ++c) column[c * IR + q] = guide[at + c * plane];
    }
}

/* Copy the tile whose first cell is (y, x); the work items take turns. */
static inline void load_patches(
    __global const real *guide,
    const int height,
    const int width,
    const long pitch,
    const long plane,
    const int y,
    const int x,
    const int l,
    __local real *tile)
{
    const int from = reflected(x + l, width), beside = reflected(x + l + ITEMS, width);
#pragma unroll 2
    for (int q = 0; q < IR; ++q) {
        const long row = reflected(y + q, height) * pitch;
#pragma unroll
        for (int c = 0; c < Q; ++c) {
            __local real *to = tile + (c * IR + q) * WIDE + l;
            to[0] = guide[row + c * plane + from];
            if (l < WIDE - ITEMS) to[ITEMS] = guide[row + c * plane + beside];
        }
    }
}

/* Write the sums down the patches of column l to `sums`, for the column `other` of the tile. */
static inline void sum_down(
    const real *column, __local const real *other, const real *g, const int l, __local real *sums)
{
    real square[IR];
#pragma unroll
    for (int q = 0; q < IR; ++q) {
        real d = column[q] - other[q * WIDE];
        square[q] = d * d;
#pragma unroll
        for (int c = 1; c < Q; ++c) {
            d = column[c * IR + q] - other[(c * IR + q) * WIDE];
            square[q] += d * d;
        }
    }
#pragma unroll
    for (int q = 0; q < S; ++q) sums[q * ITEMS + l] = OVER_PATCH(square, q);
}

/* Read four numbers at a multiple of four. */
static inline void load_four(__local const real *at, real *to)
{
    const real4 four = *(__local const real4 *)at;
    to[0] = four.x;
    to[1] = four.y;
    to[2] = four.z;
    to[3] = four.w;
}

/* Move the values of a row of 4 cells by one; the last one is then to be read. */
static inline void move_on(real *row)
{
    row[0] = row[1];
    row[1] = row[2];
    row[2] = row[3];
}

/* 33 or more bits of a row of the mask; 0 for a row outside of the grid. */
static inline ulong bits_at(__global const uint *mask, const int pitch, const int row, const int height, const int bit)
{
    if (row < 0 || row >= height) return 0;
    __global const uint *words = mask + (long)row * pitch + bit / 32;
    return (words[0] | (ulong)words[1] << 32) >> bit % 32;
}

/* Whether both ends of a pair of this dx are in the mask, at cell (y, i) of a work item's weights. */
#define PAIR_IN_MASK(y, i) ((far_bits[y] >> step & near_bits[y]) >> (i) & 1)

/* The weight at a distance, without the spatial factor; `outside` is 0, or infinite where there is no pair. */
static inline real weight_at(
    const real distance, const real outside, const real strength, const real scale, const real cut)
{
    const real w = exp2_scaled(fmax(distance, outside) * strength, scale);
#ifdef CUT
    return w >= cut ? w : 0;
#else
    return w;
#endif
}

#endif
