/* The distances of patches over a block of cells, for strip.cl on a GPU: no private array in memory.
 *
 * N = B = 1. A work item has the distances of S rows of one column: it sums along the rows first, with the last 2 R + 1
 * sums in registers, and all loops over rows are unrolled, as an array in registers has no index at run time. Patches of
 * a radius above RING are summed cell by cell, with S = 1, and so are those whose weights are averaged.
 * Arithmetic per edge: (1 + 2 R/S) (2 R + 1) (3 Q + 1) for the sums along the rows, then 2 (2 R + 1); as many loads as
 * squares, from the L1 cache.
 */
#ifndef STRIP_UNROLLED_CL
#define STRIP_UNROLLED_CL

/* The largest radius of a patch whose sums are in registers. */
#ifdef DOUBLE
#define RING 4
#else
#define RING 8
#endif

/* With long rows of patches the program would be long, too: there the sums take their places by comparisons. */
#if (2 * R + 1) * Q <= 16
#define UNROLL_SHORT _Pragma("unroll")
#define PUT_DISTANCE(q, sum) \
    if ((q) >= 2 * DOWN) rho[(q) - 2 * DOWN] = (sum);
#else
#define UNROLL_SHORT _Pragma("unroll 1")
#define PUT_DISTANCE(q, sum) \
    _Pragma("unroll") for (int y = 0; y < S; ++y) rho[y] = (q) - 2 * DOWN == y ? (sum) : rho[y];
#endif

#define UNROLL _Pragma("unroll")
#define FOR_ROWS(y, first, last) UNROLL for (int y = 0; y < S; ++y) if ((first) <= y && y < (last))
#define RHO(y, p) rho[y]

#ifdef FLAT
#define TIMES_PROFILE(j, x) (x)
#else
#define TIMES_PROFILE(j, x) (profile[j] * (x))
#endif

/* The distance of two patches, cell by cell, as loops. */
static inline real distance_between(
    __global const real *first,
    const long padded_pitch,
    const long padded_plane,
    const long ahead,
    const int n_lines,
    __global const long *lines,
    __global const real *line_weights,
    __global const real *profile)
{
    real rho = 0;
    for (int i = 0; i <= 2 * DOWN; ++i) {
        __global const real *at = first + i * padded_pitch;
        real sum = 0;
        for (int j = 0; j <= 2 * R; ++j) sum += profile[j] * SQUARES(at + j);
        rho += (DOWN > 0 ? profile[i] : 1) * sum;
    }
    return rho;
}

/* The distances of the rows from .. until of the block. */
static inline void distances(
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
    real *rho)
{
#if R > RING
    rho[0] = distance_between(first, padded_pitch, padded_plane, ahead, n_lines, lines, line_weights, profile);
#else
    real ring[2 * DOWN + 1]; /* sums along the last rows */
#pragma unroll
    for (int i = 0; i <= 2 * DOWN; ++i) ring[i] = 0;
#pragma unroll
    for (int y = 0; y < S; ++y) rho[y] = 0;
    UNROLL_SHORT for (int q = 0; q < S + 2 * DOWN; ++q)
    {
        /* rows that no distance needs are not read, they may be outside of the buffer */
        __global const real *at = first + clamp(q, from, until - 1 + 2 * DOWN) * padded_pitch;
#pragma unroll
        for (int i = 0; i < 2 * DOWN; ++i) ring[i] = ring[i + 1];
        real along = 0, sum = 0;
        UNROLL_SHORT for (int j = 0; j <= 2 * R; ++j) along += TIMES_PROFILE(j, SQUARES(at + j));
        ring[2 * DOWN] = along;
#pragma unroll
        for (int i = 0; i <= 2 * DOWN; ++i) sum += DOWN > 0 ? TIMES_PROFILE(i, ring[i]) : ring[i];
        PUT_DISTANCE(q, sum)
    }
#endif
}
#define DISTANCES(rho) \
    distances(         \
        guide + padded0, padded_pitch, padded_plane, ahead, from, until, n_lines, lines, line_weights, profile, rho)

#define ROW_OF(y) ;
#if A > 0
#define BLOCK_ARRAYS
#define BLOCK_OF(k)
#define WEIGHT_OF(k, y, p, u, v) averaged_weight(STRIP, k, ahead, x0, y0, u, padded0)
#define STRIP                                                                                                \
    guide, padded_plane, padded_pitch, left, inside, maps, sizes, n_offsets, steps, spatial, n_lines, lines, \
        line_weights, profile, shift, scale, cut

/* The sum of the weights around the pair of offset k at cell (y0, x0), of pairs that are on the grid; for S = 1. */
static inline real averaged_weight(
    STRIP_ARGS, const int k, const long ahead, const int x0, const int y0, const long centre, const long patch)
{
    const int dy = steps[2 * k], dx = steps[2 * k + 1], height = sizes[0], width = sizes[1];
    real sum = 0;
    for (int i = max(-A, -min(y0, y0 + dy)); i <= A && max(y0, y0 + dy) + i < height; ++i)
        for (int j = max(-A, -min(x0, x0 + dx)); j <= A && max(x0, x0 + dx) + j < width; ++j) {
            const long step = i * padded_pitch + j, u = centre + step, v = u + ahead;
            const real rho = distance_between(
                guide + patch + step, padded_pitch, padded_plane, ahead, n_lines, lines, line_weights, profile);
#ifdef MASKED
            if (!(inside[u] > 0 && inside[v] > 0)) continue;
#endif
            sum += SIMILARITY_AT(rho, k, u, v);
        }
    return sum;
}
#else
#define BLOCK_ARRAYS real rho[S];
#define BLOCK_OF(k) \
    if (from < until) DISTANCES(rho);
#define WEIGHT_OF(k, y, p, u, v) SIMILARITY_AT(RHO(y, p), k, u, v)
#endif

#endif
