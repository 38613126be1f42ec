/* One sweep of the Gauss-Jacobi process at p = 2 on a grid, with weights that are never stored    (eq. 25, section 5.2)
 *
 *   out(u) = (lam f0(u) + sum_v 2 w(u, v) f(v)) / (lam + sum_v 2 w(u, v))
 *   w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2
 *   with A, a weight is the sum of these over the pairs (u - j, v - j), |j| <= A along each axis
 *   MAPS: see patch_distance.cl; LARGEST: lam is in units of the largest weight around u (not with PAIRS)
 *
 * The patches compare the Q channels of `guide`, which is f or other data on the same grid. Where lam is infinite, or
 * the denominator is at most SMALLEST, out = f0.
 *
 * One work item: a block of cells (strip.cl). By default it sums over the whole window of its cells. On two axes a CPU
 * uses two launches instead, which compute each weight once for both ends of the edge:
 *   PAIRS   the forward half of the window, sorted by its last axis. A work item adds the terms of both ends to its own
 *           sums, which extend beyond its block, and writes them to its slot of `slots`: no two work items write the
 *           same number. For one step dx along the rows, the sums of the other ends are in the lanes of the first ends
 *           (`far`); they are moved by dx once per dx instead of once per offset.
 *   SLOTS   for each cell of a block, adds the slots that contain it, in a fixed order, and writes the result.
 * Traffic per vertex: M + Q values, lam and f0, the rest mostly from the cache; writes M numbers; with PAIRS also
 * writes and reads about 4 (1 + M) numbers of slots. Arithmetic per edge: as strip.cl, 11 for the exponential, and
 * 1 + 2 M; with PAIRS per two edges, but twice 1 + 2 M.
 */
#include "strip.cl"
#include "quotient.cl"

#ifndef REACH
#define REACH 1 /* PAIRS, SLOTS: largest offset in rows */
#endif
#ifndef SIDE
#define SIDE N /* PAIRS, SLOTS: cells on each side of the block in a row of a slot, a multiple of N */
#endif

#ifdef LARGEST
#define UNIT_OF_LAM(i) largest[i]
#else
#define UNIT_OF_LAM(i) 1
#endif

#define SUMS (1 + M)                           /* of the weights, and of each channel */
#define SLOT_PITCH (B * N + 2 * SIDE)          /* a row of one of the sums in a slot */
#define SLOT ((S + REACH) * SUMS * SLOT_PITCH) /* numbers in a slot */

/* clang-format off */
#define SLOT_ARGS                                                                                                     \
    const int first,                   /* strip of the launch's first work item */                                    \
    const int blocks,                  /* in a strip */                                                               \
    const int ring                     /* number of strips with slots; strip i has those of i modulo ring */
/* clang-format on */

#define FINISH(total, pull, x, row, unit) \
    finish(total, pull, x, row, width_, pitch, plane, guard, f0, lams, lam_, (realN)(unit), out)

#ifdef SLOTS
ALONE __kernel void similarity_step(
    const int height_,
    const int width_,
    SLOT_ARGS,
    __global const real *slots, /* ring * blocks slots */
    FUNCTION_ARGS)
{
    const int block = (int)get_global_id(0), strip = first + (int)get_global_id(1);
    const int above = (REACH + S - 1) / S, beside = (SIDE + B * N - 1) / (B * N);
    const int rows = min(S, height_ - strip * S);
    for (int y = 0; y < rows; ++y)
        for (int p = 0; p < B; ++p) {
            const int x = (block * B + p) * N;
            if (x >= width_) break;
            realN sum[SUMS];
            for (int c = 0; c < SUMS; ++c) sum[c] = 0;
            for (int i = max(0, strip - above); i <= strip; ++i) {
                const int row = y + (strip - i) * S;
                if (row >= S + REACH) continue;
                for (int j = max(0, block - beside); j <= min(blocks - 1, block + beside); ++j) {
                    const int column = SIDE + (block - j) * B * N + p * N;
                    if (column < 0 || column >= SLOT_PITCH) continue;
                    __global const real *slot = slots + ((long)(i % ring) * blocks + j) * SLOT;
                    for (int c = 0; c < SUMS; ++c) sum[c] += LOAD(slot, (row * SUMS + c) * SLOT_PITCH + column);
                }
            }
            FINISH(sum[0], sum + 1, x, (long)strip * S + y, 1);
        }
}
#elif defined(PAIRS)
ALONE __kernel void similarity_step(
    STRIP_ARGS,
    __global const real *f, /* M planes, as the guide's */
    SLOT_ARGS,
    /* output */
    __global real *slots) /* ring * blocks slots */
{
    STRIP_PLACE
    __global real *slot = slots + ((long)(strip % ring) * blocks + get_global_id(0)) * SLOT;
    realN near[S * B * SUMS], far[(S + REACH) * B * SUMS];
    BLOCK_ARRAYS
    for (int i = 0; i < S * B * SUMS; ++i) near[i] = 0;
    for (int i = 0; i < (S + REACH) * B * SUMS; ++i) far[i] = 0;
    for (int i = 0; i < SLOT; i += N) STORE(slot, i, (realN)(0));
    for (int k = 0; k < n_offsets; ++k) {
        STRIP_OFFSET(k)
        BLOCK_OF(k)
        for (int y = from; y < until; ++y) {
            ROW_OF(y)
#pragma unroll
            for (int p = 0; p < B; ++p) {
                const long u = centre0 + y * padded_pitch + p * N, v = u + ahead;
                const realN w = PRESENT_WEIGHT(WEIGHT_OF(k, y, p, u, v), u, v, x0 + p * N);
                realN *at_u = near + (y * B + p) * SUMS, *at_v = far + ((y + dy) * B + p) * SUMS;
                at_u[0] += w;
                at_v[0] += w;
                for (int c = 0; c < M; ++c) {
                    at_u[1 + c] += w * LOAD(f, c * padded_plane + v);
                    at_v[1 + c] += w * LOAD(f, c * padded_plane + u);
                }
            }
        }
        if (k + 1 < n_offsets && steps[(k + 1) * NDIM + NDIM - 1] == dx) continue;
        for (int i = 0; i < (S + REACH) * B; ++i)
            for (int c = 0; c < SUMS; ++c) {
                const int to = (i / B * SUMS + c) * SLOT_PITCH + SIDE + i % B * N + dx;
                STORE(slot, to, LOAD(slot, to) + far[i * SUMS + c]);
                far[i * SUMS + c] = 0;
            }
    }
    for (int i = 0; i < S * B; ++i)
        for (int c = 0; c < SUMS; ++c) {
            const int to = (i / B * SUMS + c) * SLOT_PITCH + SIDE + i % B * N;
            STORE(slot, to, LOAD(slot, to) + near[i * SUMS + c]);
        }
}
#else
ALONE __kernel void similarity_step(
    STRIP_ARGS,
    __global const real *f, /* planes as the guide's */
    const int channel,      /* the first of the M channels of f, f0 and out */
    FUNCTION_ARGS)
{
    STRIP_PLACE
    if (x0 >= width_) return;
    realN total[S * B], pull[S * B * M];
    BLOCK_ARRAYS
    UNROLL for (int i = 0; i < S * B; ++i) total[i] = 0;
#ifdef LARGEST
    realN largest[S * B];
    UNROLL for (int i = 0; i < S * B; ++i) largest[i] = 0;
#endif
    UNROLL for (int i = 0; i < S * B * M; ++i) pull[i] = 0;
    for (int k = 0; k < n_offsets; ++k) {
        STRIP_OFFSET(k)
        BLOCK_OF(k)
        FOR_ROWS (y, from, until) {
            ROW_OF(y)
#pragma unroll
            for (int p = 0; p < B; ++p) {
                const long u = centre0 + y * padded_pitch + p * N, v = u + ahead;
                const realN w = PRESENT_WEIGHT(WEIGHT_OF(k, y, p, u, v), u, v, x0 + p * N);
                total[y * B + p] += w;
#ifdef LARGEST
                largest[y * B + p] = fmax(largest[y * B + p], w);
#endif
                realN *sums = pull + (y * B + p) * M;
                UNROLL for (int c = 0; c < M; ++c) sums[c] += w * LOAD(f, (channel + c) * padded_plane + v);
            }
        }
    }
    f0 += channel * plane;
    out += channel * plane;
    FOR_ROWS (y, 0, rows)
        for (int p = 0; p < B && x0 + p * N < width_; ++p)
            FINISH(total[y * B + p], pull + (y * B + p) * M, x0 + p * N, cell_row + y, UNIT_OF_LAM(y * B + p));
}
#endif
