/* Weights from patches on a grid of two axes, as in patch_distance.cl, for a GPU                       (section 5.2)
 *
 *   w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2
 *   or rho itself, without SIMILARITY; 0 where an edge leaves the grid or the mask
 *
 * One work group: a block of cells (patch_tile.cl). One work item: the weights of all forward offsets of S/4 rows of 4
 * neighbouring cells, in the layout of grid.cl, and the zeros behind the rows.
 * Traffic per vertex: reads Q values, and for each dy 1.4 Q IR/S from the cache; writes a number per forward offset.
 */
#include "patch_tile.cl"

/* Float16, rounded to the nearest, ties to even (grid.cl: HALF_WEIGHTS). */
#ifdef HALF_WEIGHTS
typedef half weight_t;
#define PUT_WEIGHT(p, w) vstore_half_rte((float)(w), 0, p)
#else
typedef real weight_t;
#define PUT_WEIGHT(p, w) (*(p) = (w))
#endif

#ifdef SIMILARITY
#ifdef SHIFTED_DISTANCE
#define WEIGHT(rho, y, i) (factor[i] * weight_at((rho) - shift, outside[y], 1, scale, cut))
#else
#define WEIGHT(rho, y, i) (factor[i] * weight_at(rho, outside[y], 1, scale, cut))
#endif
#else
#define WEIGHT(rho, y, i) (factor[i] > 0 && outside[y] == 0 ? (rho) : 0)
#endif

__attribute__((reqd_work_group_size(ITEMS, 1, 1))) __kernel void patch_distance(
    __global const real *f, /* Q channels */
    const long pitch,       /* of f, in the layout of grid.cl */
    const long plane,
    const long guard,
    __global const uint *mask, /* (height, mask_pitch) words of 32 cells; read with MASKED */
    const int mask_pitch,      /* words */
    const int mask_left,       /* bits of a row before its first cell */
    const int height,
    const int width,
    const int reach_y, /* largest offsets */
    const int reach_x,
    const int H,                  /* forward offsets */
    __global const int *places,   /* (reach_y + 1, 2 reach_x + 1): of a forward offset, or -1 */
    __global const real *spatial, /* (H,): s */
    __global const real *profile, /* (2 R + 1,): g along one axis; read without FLAT */
    const real shift,
    const real scale,        /* -log2(e)/h^2, < 0 */
    const real cut,          /* exponentials below it count as 0; read with CUT */
    const long weight_pitch, /* of the weights, in the layout of grid.cl */
    const long weight_guard,
    /* output */
    __global weight_t *out) /* weights */
{
    __local real tile[Q * IR * WIDE];
    /* two halves; the last vectors read a little beyond */
    __local real sums[2 * S * ITEMS + 32] __attribute__((aligned(32)));
    const int l = (int)get_local_id(0), lane = l % (ITEMS / 4), own_row = l / (ITEMS / 4) * OWN_ROWS;
    const int block_x = (int)get_group_id(0) * COLUMNS, block_y = (int)get_group_id(1) * S;
    const int x0 = block_x + 4 * lane, y0 = block_y + own_row;
    const bool active = 4 * lane < COLUMNS && x0 < weight_pitch && y0 < height;
    int half_of_sums = 0;
    real column[Q * IR];
    PROFILE_OF(profile)
    load_column(f + guard, height, width, pitch, plane, block_y - R, block_x - R + l, column);
#ifdef MASKED
    const int first_bit = x0 + mask_left;
    ulong far_bits[OWN_ROWS];
    uint near_bits[OWN_ROWS];
#pragma unroll
    for (int y = 0; y < OWN_ROWS; ++y) near_bits[y] = (uint)bits_at(mask, mask_pitch, y0 + y, height, first_bit);
#endif
    for (int dy = 0; dy <= reach_y; ++dy)
        for (int first = -reach_x; first <= reach_x; first += CHUNK) {
            barrier(CLK_LOCAL_MEM_FENCE);
            load_patches(f + guard, height, width, pitch, plane, block_y - R + dy, block_x - R + first, l, tile);
            barrier(CLK_LOCAL_MEM_FENCE);
            real outside[OWN_ROWS];
#pragma unroll
            for (int y = 0; y < OWN_ROWS; ++y) {
                outside[y] = y0 + y + dy < height ? 0 : INFINITY;
#ifdef MASKED
                far_bits[y] = bits_at(mask, mask_pitch, y0 + y + dy, height, first_bit + first);
#endif
            }
            for (int step = 0; step < min(CHUNK, reach_x + 1 - first); ++step) {
                const int dx = first + step, h = places[dy * (2 * reach_x + 1) + dx + reach_x];
                if (h < 0) continue;
                half_of_sums = 1 - half_of_sums; /* by the offsets done, as in similarity_step_gpu.cl */
                __local real *of_offset = sums + half_of_sums * S * ITEMS;
                sum_down(column, tile + step + l, g, l, of_offset);
                barrier(CLK_LOCAL_MEM_FENCE);
                if (active) {
                    const real s = spatial[h];
                    real factor[4];
#pragma unroll
                    for (int i = 0; i < 4; ++i) {
                        const int u = x0 + i, v = u + dx;
                        factor[i] = min(u, v) >= 0 && max(u, v) < width ? s : 0;
                    }
#pragma unroll
                    for (int y = 0; y < OWN_ROWS; ++y) {
                        real near[NEAR];
#pragma unroll
                        for (int i = 0; i < NEAR; i += 4)
                            load_four(of_offset + (own_row + y) * ITEMS + 4 * lane + i, near + i);
                        __global weight_t *to = out + weight_guard + ((long)(y0 + y) * H + h) * weight_pitch + x0;
#pragma unroll
                        for (int i = 0; i < 4; ++i) {
                            const real rho = OVER_PATCH(near, i);
                            real w = WEIGHT(rho, y, i);
#ifdef MASKED
                            w = PAIR_IN_MASK(y, i) ? w : 0;
#endif
                            if (y0 + y < height && x0 + i < weight_pitch) PUT_WEIGHT(to + i, w);
                        }
                    }
                }
            }
        }
}
