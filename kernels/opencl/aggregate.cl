/* out(x) = N_0(x) F(x) + sum_o N_o(x) F(x + o),   N_o(x) = sum_j s(x - j) w(x - j, x - j + o)
 *                                                                        (Buades, Coll, Morel, IPOL 2011, patchwise)
 * N_0(x) = sum_j c(x - j). The sums are over the offsets o of the window and j of a square patch of radius R such that
 * x + o, x - j and x - j + o are vertices. s = 1 / (sum of the weights around a vertex), and c is the share of the
 * centre. N_o(x) is the total weight of x + o in all patches that contain x: patches are averaged instead of pixels. F
 * has a channel of ones, or the mask; the host divides the other channels by its sum.
 *
 * Grid only. One work item: a pack of N. For each offset it sums s w down the 2 R + 1 rows of the patch, then along the
 * rows.
 * Traffic per vertex with D neighbours: reads D weights and 2 + M values, more if cache lines are evicted between the
 * rows of a patch; writes M numbers. Arithmetic per neighbour: 2 (2 R + 1) (1 + 2 R/N) + 2 R + 2 M.
 */
#include "grid.cl"

#ifndef R
#define R 1 /* radius of the patch */
#endif
#ifndef M
#define M 1
#endif
#define WIDE (1 + (2 * R + N - 1) / N) /* packs of a row that contain the patches of a pack */

/* The values of a pack at x, 0 for cells outside the row. */
#define ON_ROW(x_, values) (inner ? (values) : WHERE((x_) + LANES >= 0 && (x_) + LANES < width, values))

__kernel void aggregate(
    GRAPH_ARGS,
    const int n_lines,
    __global const int *lines,   /* (n_lines, NDIM): the rows of a patch, as steps along the leading axes, then
                                          in rows */
    __global const real *f,      /* M channels */
    __global const real *share,  /* 1 channel: s */
    __global const real *centre, /* 1 channel: c */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    const bool inner = x >= R + reach && x + (WIDE + 1) * N + R + reach <= width;
    int at[NDIM]; /* coordinates along the leading axes */
    for (int d = NDIM - 2, rest = row; d >= 0; rest /= shape[d], --d) at[d] = rest % shape[d];
    realN sum[M], down[WIDE];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    for (int k = -1; k < 2 * H; ++k) { /* -1: the centre */
        __global const int *offset = offsets + (long)max(k, 0) * NDIM;
        const int step = k < 0 ? 0 : offset[NDIM - 1], row_jump = k < 0 ? 0 : row_jumps[k];
        bool there = true;
        for (int d = 0; k >= 0 && d < NDIM - 1; ++d)
            there = there && at[d] + offset[d] >= 0 && at[d] + offset[d] < shape[d];
        if (!there) continue;
        for (int p = 0; p < WIDE; ++p) down[p] = 0;
        for (int l = 0; l < n_lines; ++l) {
            __global const int *line = lines + l * NDIM;
            bool exists = true;
            for (int d = 0; d < NDIM - 1; ++d) {
                const int here = at[d] + line[d], other = here + (k < 0 ? 0 : offset[d]);
                exists = exists && here >= 0 && here < shape[d] && other >= 0 && other < shape[d];
            }
            if (!exists) continue;
            const long r = row + line[NDIM - 1], from = guard + r * pitch;
            /* stored at u if k is a forward offset, otherwise at v */
            const long place = weight_guard + (k >= H ? (r * H + k - H) * weight_pitch
                                                      : ((r + row_jump) * H + H - 1 - k) * weight_pitch + step);
#pragma unroll
            for (int p = 0; p < WIDE; ++p) {
                const int column = x - R + p * N;
                if (column + N <= 0 || column >= width) continue;
                if (k < 0)
                    down[p] += ON_ROW(column, LOAD(centre, from + column));
                else
                    down[p] += ON_ROW(column, LOAD_WEIGHT(weights, place + column) * LOAD(share, from + column));
            }
        }
        realN n = down[0];
#pragma unroll
        for (int j = 1; j <= 2 * R; ++j) n += LOAD_PRIVATE((const real *)down, j);
        n = ON_ROW(x + step, n);
        const long v = u + row_jump * pitch + step;
        for (int c = 0; c < M; ++c) sum[c] += n * LOAD(f, AT(v, c, M));
    }
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(sum[c]));
}
