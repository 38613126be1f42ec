/* One sweep at p = 2 on a grid of two axes, with weights that are never stored, as in similarity_step.cl, for a GPU
 *                                                                                           (eq. 25, section 5.2)
 *   out(u) = (lam f0(u) + sum_v 2 w(u, v) f(v)) / (lam + sum_v 2 w(u, v))
 *   w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2
 *   with A, a weight is the sum of these over the pairs (u - j, v - j), |j| <= A along each axis
 *   MAPS: see patch_distance.cl; LARGEST: lam is in units of the largest weight around u
 *
 * The patches compare the Q channels of `guide`, which is f, or with GUIDED another function. Patches of one cell that
 * are not averaged (POINTS) need no sums, and no barrier for an offset.
 *
 * One work group: a block of cells (patch_tile.cl). One work item: the results of S/4 rows of 4 neighbouring cells. It
 * has the values f(v) of its pairs in registers; from one dx to the next they move by one cell, so that it reads one
 * value per row. With A, it first writes the weights of as many cells, A to the left and above, to local memory, and
 * adds those around each cell after another barrier: S - 2 A rows and COLUMNS - 2 A columns of a block have results.
 * Borders: a pair beyond the ends of its rows has the factor 0, one beyond the first or the last row an infinite
 * distance, whose exponential is 0. With MASKED the mask is rows of bits, 0 outside of the grid.
 * Traffic per vertex: reads M + Q values, lam and f0, and for each dy 1.4 Q IR/S values from the cache; writes M
 * numbers. GUIDED and MAPS read M and 2 more values per pair of 4 cells from the cache.
 */
#include "patch_tile.cl"
#include "quotient.cl"

#ifndef A
#define A 0
#endif
#if R == 0 && A == 0
#define POINTS
#endif
#ifdef LARGEST
#define UNIT_OF_LAM(i) largest[i]
#else
#define UNIT_OF_LAM(i) 1
#endif

#define BLOCK_X (COLUMNS - 2 * A) /* cells of a block with a result */
#define BLOCK_Y (S - 2 * A)
#define AROUND ((4 + 2 * A + 3) / 4 * 4) /* weights of a row that 4 cells need, in vectors of 4 */

/* In row y, the value of `column` cells to the right of the first cell of a work item, at the first dx of the tile. */
#define SEEN(c, y, column) tile[((c) * IR + own_row + R + (y)) * WIDE + R + 4 * lane + (column)]
#define FROM_CACHE(function, c, y, column) \
    function[(c) * plane + far_rows[y] + clamp(x0 - A + first + (column), 0, width - 1)]
#ifdef GUIDED
#define VALUE(c, y, column) f[(channel + (c)) * plane + value_rows[y] + clamp(x0 + first + (column), 0, width - 1)]
#else
#define VALUE(c, y, column) tile[((c) * IR + own_row + R + A + (y)) * WIDE + R + A + 4 * lane + (column)]
#endif

/* What the single cells `here` are compared with. */
#ifdef GUIDED
#define THERE seen
#else
#define THERE far
#endif

/* Whether a pair with a result is on the grid; sums of weights of other pairs do not count. */
#ifdef MASKED
#define COUNTS(y, i) PAIR_IN_MASK((y) + A, (i) + A)
#else
#define COUNTS(y, i) (IS_ON(x0 + (i), dx, width) && IS_ON(y0 + (y), dy, height))
#endif
#define IS_ON(at, step, size) ((at) + (step) >= 0 && (at) + (step) < (size))

/* The sums of the weights around 4 cells of each row. */
static inline void average(__local const real *weights, real *w)
{
    real across[(OWN_ROWS + 2 * A) * 4];
#pragma unroll
    for (int y = 0; y < OWN_ROWS + 2 * A; ++y) {
        real row[AROUND];
#pragma unroll
        for (int i = 0; i < AROUND; i += 4) load_four(weights + y * ITEMS + i, row + i);
#pragma unroll
        for (int i = 0; i < 4; ++i) {
            real sum = row[i];
#pragma unroll
            for (int j = 1; j <= 2 * A; ++j) sum += row[i + j];
            across[4 * y + i] = sum;
        }
    }
#pragma unroll
    for (int i = 0; i < CELLS; ++i) {
        real sum = across[i];
#pragma unroll
        for (int j = 1; j <= 2 * A; ++j) sum += across[i + 4 * j];
        w[i] = sum;
    }
}

/* Weight i of row y from its distance, without the spatial factor. */
#ifdef MAPS
#define WEIGHT(rho, y, i)                                                                                            \
    weight_at(                                                                                                       \
        (rho) - shift - (near_map[i] + far_map[i]), outside[y], near_map[CELLS + (i)] * far_map[CELLS + (i)], scale, \
        cut)
#elif defined(SHIFTED_DISTANCE)
#define WEIGHT(rho, y, i) weight_at((rho) - shift, outside[y], 1, scale, cut)
#else
#define WEIGHT(rho, y, i) weight_at(rho, outside[y], 1, scale, cut)
#endif

__attribute__((reqd_work_group_size(ITEMS, 1, 1))) __kernel void similarity_step(
    __global const real *guide, /* Q channels */
    __global const real *f,     /* read with GUIDED; otherwise f is the guide */
    const int channel,          /* the first of the M channels of f, f0 and out; 0 without GUIDED */
    __global const uint *mask,  /* (height, mask_pitch) words of 32 cells; read with MASKED */
    const int mask_pitch,       /* words */
    const int mask_left,        /* bits of a row before its first cell */
    __global const real *maps,  /* 2 channels: a(u) and q(u); read with MAPS */
    const int height,
    const int width,
    const int reach_y, /* largest offsets */
    const int reach_x,
    __global const real *spatial, /* (2 reach_y + 1, 2 reach_x + 1): s, 0 outside of the window */
    __global const real *profile, /* (2 R + 1,): g along one axis; read without FLAT */
    const real shift,
    const real scale, /* -log2(e)/h^2, < 0 */
    const real cut,   /* exponentials below it count as 0; read with CUT */
    FUNCTION_ARGS)
{
    __local real tile[Q * IR * WIDE];
    const int l = (int)get_local_id(0), lane = l % (ITEMS / 4), own_row = l / (ITEMS / 4) * OWN_ROWS;
    const int block_x = (int)get_group_id(0) * BLOCK_X, block_y = (int)get_group_id(1) * BLOCK_Y;
    const int x0 = block_x + 4 * lane, y0 = block_y + own_row;
    const bool weighs = 4 * lane < COLUMNS;
    const bool active = 4 * lane < BLOCK_X && own_row < BLOCK_Y && x0 < width && y0 < height;
#ifdef POINTS
    real here[Q * CELLS];
#pragma unroll
    for (int c = 0; c < Q; ++c)
#pragma unroll
        for (int i = 0; i < CELLS; ++i)
            here[c * CELLS + i] =
                guide[c * plane + guard + min(y0 + i / 4, height - 1) * pitch + min(x0 + i % 4, width - 1)];
#ifdef GUIDED
    real seen[Q * CELLS];
#endif
#else
    /* the last vectors read a little beyond */
    __local real sums[(A > 0 ? 1 : 2) * S * ITEMS + 32] __attribute__((aligned(32)));
    int half_of_sums = 0;
    real column[Q * IR];
    PROFILE_OF(profile)
    load_column(guide + guard, height, width, pitch, plane, block_y - A - R, block_x - A - R + l, column);
#endif
#if A > 0
    __local real weights[(S + 2 * A) * ITEMS + 32] __attribute__((aligned(32)));
#endif
    real total[CELLS], pull[CELLS * M], far[M * CELLS];
#pragma unroll
    for (int i = 0; i < CELLS; ++i) total[i] = 0;
#pragma unroll
    for (int i = 0; i < CELLS * M; ++i) pull[i] = 0;
#ifdef LARGEST
    real largest[CELLS];
#pragma unroll
    for (int i = 0; i < CELLS; ++i) largest[i] = 0;
#endif
#ifdef MASKED
    /* bit x of a row: the mask at its cell x, or at the far end of the pair for the first dx of the tile */
    const int first_bit = x0 - A + mask_left;
    ulong far_bits[OWN_ROWS + A];
    uint near_bits[OWN_ROWS + A];
#pragma unroll
    for (int y = 0; y < OWN_ROWS + A; ++y)
        near_bits[y] = (uint)bits_at(mask, mask_pitch, y0 - A + y, height, first_bit);
#endif
#ifdef MAPS
    real near_map[2 * CELLS], far_map[2 * CELLS];
#pragma unroll
    for (int i = 0; i < 2 * CELLS; ++i) {
        const int y = clamp(y0 - A + i % CELLS / 4, 0, height - 1), x = clamp(x0 - A + i % 4, 0, width - 1);
        near_map[i] = maps[i / CELLS * plane + guard + y * pitch + x];
    }
#endif
    for (int dy = max(-reach_y, 1 - S - block_y); dy <= min(reach_y, height - 1 - block_y); ++dy)
        for (int first = -reach_x; first <= reach_x; first += CHUNK) {
            barrier(CLK_LOCAL_MEM_FENCE);
            load_patches(
                guide + guard, height, width, pitch, plane, block_y - A - R + dy, block_x - A - R + first, l, tile);
            barrier(CLK_LOCAL_MEM_FENCE);
            real outside[OWN_ROWS];
#pragma unroll
            for (int y = 0; y < OWN_ROWS; ++y) {
                const int u = y0 - A + y, v = u + dy;
                outside[y] = min(u, v) >= 0 && max(u, v) < height ? 0 : INFINITY;
            }
#ifdef MASKED
#pragma unroll
            for (int y = 0; y < OWN_ROWS + A; ++y)
                far_bits[y] = bits_at(mask, mask_pitch, y0 - A + y + dy, height, first_bit + first);
#endif
#ifdef GUIDED
            long value_rows[OWN_ROWS];
#pragma unroll
            for (int y = 0; y < OWN_ROWS; ++y) value_rows[y] = guard + clamp(y0 + y + dy, 0, height - 1) * pitch;
#endif
#ifdef MAPS
            long far_rows[OWN_ROWS];
#pragma unroll
            for (int y = 0; y < OWN_ROWS; ++y) far_rows[y] = guard + clamp(y0 - A + y + dy, 0, height - 1) * pitch;
#endif
            /* before the first dx, the first three values of each row */
            for (int step = -3; step < min(CHUNK, reach_x + 1 - first); ++step) {
                if (active) {
#pragma unroll
                    for (int row = 0; row < M * OWN_ROWS; ++row) {
                        move_on(far + 4 * row);
                        far[4 * row + 3] = VALUE(row / OWN_ROWS, row % OWN_ROWS, step + 3);
                    }
                }
#if defined(POINTS) && defined(GUIDED)
                if (weighs) {
#pragma unroll
                    for (int row = 0; row < Q * OWN_ROWS; ++row) {
                        move_on(seen + 4 * row);
                        seen[4 * row + 3] = SEEN(row / OWN_ROWS, row % OWN_ROWS, step + 3);
                    }
                }
#endif
#ifdef MAPS
#pragma unroll
                for (int row = 0; row < 2 * OWN_ROWS; ++row) {
                    move_on(far_map + 4 * row);
                    far_map[4 * row + 3] = FROM_CACHE(maps, row / OWN_ROWS, row % OWN_ROWS, step + 3);
                }
#endif
                if (step < 0) continue;
                const int dx = first + step;
                const real s = spatial[(dy + reach_y) * (2 * reach_x + 1) + dx + reach_x];
                if (s == 0) continue;
#ifndef POINTS
#if A == 0
                /* by the offsets done: with that of dx, one left out would give the same half twice, a race */
                half_of_sums = 1 - half_of_sums;
#endif
                __local real *of_offset = sums + half_of_sums * S * ITEMS;
                sum_down(column, tile + step + l, g, l, of_offset);
                barrier(CLK_LOCAL_MEM_FENCE);
#endif
                real w[CELLS];
                if (weighs) {
                    real factor[4]; /* the spatial one, or 0 beyond the ends of the rows */
#pragma unroll
                    for (int i = 0; i < 4; ++i) {
                        const int u = x0 - A + i, v = u + dx;
                        factor[i] = min(u, v) >= 0 && max(u, v) < width ? s : 0;
                    }
#pragma unroll
                    for (int y = 0; y < OWN_ROWS; ++y) {
#ifndef POINTS
                        real near[NEAR];
#pragma unroll
                        for (int i = 0; i < NEAR; i += 4)
                            load_four(of_offset + (own_row + y) * ITEMS + 4 * lane + i, near + i);
#endif
#pragma unroll
                        for (int i = 0; i < 4; ++i) {
                            const int cell = 4 * y + i;
#ifdef POINTS
                            real rho = 0;
#pragma unroll
                            for (int c = 0; c < Q; ++c) {
                                const real d = here[c * CELLS + cell] - THERE[c * CELLS + cell];
                                rho = c == 0 ? d * d : rho + d * d;
                            }
#else
                            const real rho = OVER_PATCH(near, i);
#endif
                            w[cell] = factor[i] * WEIGHT(rho, y, cell);
#ifdef MASKED
                            w[cell] = PAIR_IN_MASK(y, i) ? w[cell] : 0;
#endif
                        }
                    }
                }
#if A > 0
                if (weighs)
#pragma unroll
                    for (int y = 0; y < OWN_ROWS; ++y)
                        *(__local real4 *)(weights + (own_row + y) * ITEMS + 4 * lane) =
                            (real4)(w[4 * y], w[4 * y + 1], w[4 * y + 2], w[4 * y + 3]);
                barrier(CLK_LOCAL_MEM_FENCE);
                if (active) average(weights + own_row * ITEMS + 4 * lane, w);
#endif
                if (active) {
#pragma unroll
                    for (int i = 0; i < CELLS; ++i) {
#if A > 0
                        w[i] = COUNTS(i / 4, i % 4) ? w[i] : 0;
#endif
                        total[i] += w[i];
#ifdef LARGEST
                        largest[i] = fmax(largest[i], w[i]);
#endif
#pragma unroll
                        for (int c = 0; c < M; ++c) pull[i * M + c] += w[i] * far[c * CELLS + i];
                    }
                }
            }
        }
    if (!active) return;
#pragma unroll
    for (int i = 0; i < CELLS; ++i) {
        const int x = x0 + i % 4, y = y0 + i / 4;
        if (x < min(width, block_x + BLOCK_X) && y < min(height, block_y + BLOCK_Y))
            finish(
                total[i], pull + i * M, x, y, width, pitch, plane, guard, f0 + channel * plane, lams, lam_,
                (real)(UNIT_OF_LAM(i)), out + channel * plane);
    }
}
