/* The members of the group of each reference u, as in patch_groups.cl, for a GPU: no private array in memory.
 *
 * One work group: one reference; every work item has a run of places in a row of the window, or TURNS of them, and the
 * distances of these in registers.
 *   tile      the window of a channel in local memory; a line of it, RUN + D - 1 cells, is read once for RUN places
 *   bound     every step of the bisection counts the distances up to a bound: each work item writes its count, and all
 *             add all of them, as packed numbers of 16 bits
 *   members   a work item's places follow those of the work items before it, so a sum of counts gives their ranks; rank
 *             i goes to number floor(i MOST/K), if the next rank does not
 * Integers and distances only, and comparisons: the members do not depend on how the work is shared out.
 * Arithmetic per reference: 2 M operations per place and channel, then about 20 steps of RUN comparisons and 64
 * additions. Local memory: 4 or 8 bytes per cell of the tile. Traffic: reads the tile's cells of each channel from the
 * cache, writes MOST + 1 numbers of 2 and 4 bytes.
 */
#include "group_tile.cl"

#define ITEMS 128
/* Runs of a row; numbers of a run; runs of a work item. */
#define SEGMENTS (ROWS > ITEMS ? 1 : ITEMS / ROWS < SIDE ? ITEMS / ROWS : SIDE)
#define RUN ((SIDE + SEGMENTS - 1) / SEGMENTS)
#define TURNS ((ROWS + ITEMS - 1) / ITEMS)
#ifdef DOUBLE
#define LARGEST 0x7fefffffffffffffL
#else
#define LARGEST 0x7f7fffff
#endif
#define AS_REAL(x) CONCATENATE(as_, REAL_)(x)

typedef union {
    ushort of[ITEMS];
    uint4 packed[ITEMS / 8];
} item_counts;

/* The sum of the counts of all work items. */
static inline int sum_of(__local const item_counts *counts)
{
    uint4 sum = 0;
#pragma unroll
    for (int i = 0; i < ITEMS / 8; ++i) sum += counts->packed[i];
    const uint both = sum.x + sum.y + sum.z + sum.w;
    return (int)((both & 0xffff) + (both >> 16));
}

__attribute__((reqd_work_group_size(ITEMS, 1, 1))) __kernel void patch_groups(
    LATTICE_ARGS,
    __global const real *guide,  /* `channels` planes: g */
    __global const real *inside, /* one plane: 1 in the grid's mask, 0 elsewhere; read if masked */
    const int masked,
    __global const real *level, /* one plane; read if levelled */
    const int levelled,
    const int nearest, /* n */
    const real limit_, /* of d, for level 1 */
    /* output */
    __global ushort *members,      /* (references, MOST): places in the window, row-major */
    __global int *sizes_of_groups) /* (references,) */
{
    /* the last run of a row may extend beyond the tile */
    __local real tile[TILE + SEGMENTS * RUN - SIDE];
    __local item_counts found;
    const int l = (int)get_local_id(0);
    const int i = (int)get_group_id(0), j = (int)get_group_id(1), k = (int)get_group_id(2);
    const int x = REFERENCE(i, x), y = REFERENCE(j, y), z = REFERENCE(k, z);
    const long reference = ((long)k * counts.y + j) * counts.x + i, middle = PLACE(z + PZ, y + PY, x + PX);
    const int4 first = (int4)(x - WX, y - WY, z - WZ, 0);
    real d[TURNS * RUN];
#pragma unroll
    for (int o = 0; o < TURNS * RUN; ++o) d[o] = 0;
    for (int c = 0; c < channels; ++c) {
        load_tile(guide + before + c * plane, sizes, pitch, layer, first, l, ITEMS, tile);
        barrier(CLK_LOCAL_MEM_FENCE);
#pragma unroll
        for (int turn = 0; turn < TURNS; ++turn) {
            const int run = l * TURNS + turn;
            __local const real *v = tile + ROW_AT(min(run / SEGMENTS, ROWS - 1)) + run % SEGMENTS * RUN;
            __local const real *u = tile + (WZ * TILE_Y + WY) * TILE_X + WX;
            for (int line = 0; line < LINES; ++line) {
                real cells[RUN + D - 1];
#pragma unroll
                for (int q = 0; q < RUN + D - 1; ++q) cells[q] = v[LINE_AT(line) + q];
#pragma unroll
                for (int q = 0; q < D; ++q) {
                    const real own = u[LINE_AT(line) + q];
#pragma unroll
                    for (int r = 0; r < RUN; ++r) {
                        const real difference = cells[r + q] - own;
                        d[turn * RUN + r] += difference * difference;
                    }
                }
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const bool here = !masked || inside[middle] != 0;
#pragma unroll
    for (int turn = 0; turn < TURNS; ++turn) {
        const int run = l * TURNS + turn, row = run / SEGMENTS;
        const int yv = first.y + row % (2 * WY + 1), zv = first.z + row / (2 * WY + 1);
        const bool on = here && row < ROWS && yv >= 0 && yv < sizes.y && zv >= 0 && zv < sizes.z;
#pragma unroll
        for (int r = 0; r < RUN; ++r) {
            const int column = run % SEGMENTS * RUN + r, xv = first.x + column;
            bool there = on && column < SIDE && xv >= 0 && xv < sizes.x;
            if (masked && there) there = inside[PLACE(zv + PZ, yv + PY, xv + PX)] != 0;
            if (!there) d[turn * RUN + r] = INFINITY;
        }
    }
    /* the bound is between low and high, which has at least n distances, or all; see nth_smallest in patch_groups.cl */
    /* below the distance of cells that are no members */
    const real limit = fmin(levelled ? limit_ * level[middle] : limit_, AS_REAL((lane)LARGEST));
    const lane factor = (lane)2 << MANTISSA;
    lane low = -1, high = LARGEST, bound = CONCATENATE(as_, LANE_)(limit);
    bool by_factors = limit >= LEAST_NORMAL, searching = true;
    while (searching) {
        int own = 0;
#pragma unroll
        for (int o = 0; o < TURNS * RUN; ++o) own += d[o] <= AS_REAL(bound);
        found.of[l] = (ushort)own;
        barrier(CLK_LOCAL_MEM_FENCE);
        const int total = sum_of(&found);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (total >= nearest) {
            high = bound;
            searching = total > nearest && low >= 0;
            by_factors = false;
        } else
            low = bound;
        searching = searching && high - low > 1;
        bound = by_factors && high - low > factor ? low + factor : low + (high - low) / 2;
    }
    const real least = AS_REAL(high);
    int own = 0, rank = 0;
#pragma unroll
    for (int o = 0; o < TURNS * RUN; ++o) own += d[o] <= least;
    found.of[l] = (ushort)own;
    barrier(CLK_LOCAL_MEM_FENCE);
    const int total = sum_of(&found), share = max(total, MOST);
    for (int before_l = 0; before_l < l; ++before_l) rank += found.of[before_l];
#pragma unroll
    for (int o = 0; o < TURNS * RUN; ++o) {
        const int run = l * TURNS + o / RUN, place = run / SEGMENTS * SIDE + run % SEGMENTS * RUN + o % RUN;
        if (!(d[o] <= least)) continue;
        const int to = rank * MOST / share;
        ++rank;
        if (rank * MOST / share > to) members[reference * MOST + to] = (ushort)place;
    }
    if (l == 0) sizes_of_groups[reference] = min(total, MOST);
}
