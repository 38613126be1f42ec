/* The neighbours of a pack of N adjacent vertices on a row of an implicit grid of NDIM axes, under the same names as in
 * csr.cl, which explains them. A row is a line of cells along the last axis.
 *
 * Layout. Functions are planar: channel c of row r begins at c * plane + guard + r * pitch. Rows are padded to a
 * multiple of N: the lanes past the end of a row have no vertex, and are 0 in every function that is read. There are
 * `guard` cells before and after all rows, so that the reads of border packs stay inside the buffer.
 * Weights are stored once per pair of vertices, for the forward half of the window, interleaved by row so that a sweep
 * reads them in order: weight h of cell x of row r is at weight_guard + (r * H + h) * weight_pitch + x. Each row of
 * weights is followed by more zeros than the reach of the window, so that a pack reads 0 past both ends of its row.
 * Functions on the edges (also gamma, with GAMMA) have the same layout for the whole window of 2 H offsets: channel c
 * of offset k is at the index of weight k * channels + c; 0 where an edge leaves the grid.
 *
 * The window. Adjacent offsets on one row form a run: the row is looked up and checked once per run, and the inner loop
 * steps by one cell and one row of weights. A small window is compiled in (WINDOW offsets, of WINDOW_ROWS and
 * WINDOW_STEPS) and unrolled; all other windows share one binary.
 */
#ifndef GRID_CL
#define GRID_CL
#include "reals.cl"
#include "gamma.cl"

#ifndef NDIM
#define NDIM 2
#endif

#ifdef HALF_WEIGHTS
typedef half weight_t;
#else
typedef real weight_t;
#endif

/* clang-format off */
#define GRAPH_ARGS                                                                                                    \
    const int width,                     /* cells in a row */                                                         \
    const int n_rows,                                                                                                 \
    const long pitch,                                                                                                 \
    const long plane,                                                                                                 \
    const long guard,                                                                                                 \
    const int H,                         /* forward offsets, half the window */                                       \
    const int reach,                     /* largest step along a row */                                               \
    __global const int *shape,           /* (NDIM,) */                                                                \
    __global const int *offsets,         /* (2 H, NDIM), lexicographic; the opposite of k is 2 H - 1 - k */           \
    __global const int *row_jumps,       /* (2 H,): rows from a vertex to its neighbour */                            \
    const int n_runs,                                                                                                 \
    __global const int *runs,            /* (n_runs, 3): first offset, its step along the row, offsets in the run */  \
    const long weight_pitch,                                                                                          \
    const long weight_guard,                                                                                          \
    __global const weight_t *weights,    /* w with WEIGHTED, gamma with GAMMA; with RECOMPUTED the function F */      \
    __global const real *nearness,       /* (H,): spatial factors of the weights; read with RECOMPUTED */             \
    const real weight_shift,             /* read with RECOMPUTED, as the next */                                      \
    const real weight_scale
/* clang-format on */

/* With HALF_WEIGHTS weights are in float16: the relative error is at most 2^-11, or the absolute one 2^-25 for weights
 * below 2^-14. vload_half is one instruction on a GPU, but slow in PoCL 3.0, so the packs of a CPU are converted by their
 * bits. As weights are >= 0, their bits shifted to those of a float32 are exactly the weight times 2^-112, but a device
 * that flushes subnormal numbers (FLUSHED) reads 0 for those below 2^-14, whose bits count multiples of 2^-24. */
#ifdef HALF_WEIGHTS
#if N == 1
#define LOAD_WEIGHT(p, i) ((real)vload_half(0, (p) + (i)))
#elif N <= 4
#define LOAD_WEIGHT(p, i) CONCATENATE(CONCATENATE(convert_, REAL_), N)(CONCATENATE(vload_half, N)(0, (p) + (i)))
#else
typedef CONCATENATE(ushort, N) ushortN_anywhere __attribute__((aligned(2)));
typedef CONCATENATE(int, N) intN;
typedef CONCATENATE(float, N) floatN;
static inline floatN from_half(const intN bits)
{
#ifdef FLUSHED
    const floatN large = CONCATENATE(as_float, N)((bits << 13) + (112 << 23));
    return bits < 1024 ? CONCATENATE(convert_float, N)(bits) * 5.9604644775390625e-8f : large;
#else
    return CONCATENATE(as_float, N)(bits << 13) * 5.192296858534828e33f; /* 2^112 */
#endif
}
#define HALVES(p, i) CONCATENATE(convert_int, N)(*(__global const ushortN_anywhere *)((p) + (i)))
#define LOAD_WEIGHT(p, i) CONCATENATE(CONCATENATE(convert_, REAL_), N)(from_half(HALVES(p, i)))
#endif
#else
#define LOAD_WEIGHT(p, i) LOAD(p, i)
#endif

/* GRAPH_ARGS as the arguments of a call. */
/* clang-format off */
#define GRAPH                                                                                                         \
    width, n_rows, pitch, plane, guard, H, reach, shape, offsets, row_jumps, n_runs, runs, weight_pitch,              \
    weight_guard, weights, nearness, weight_shift, weight_scale
/* clang-format on */

/* The coordinates of a row along the leading axes, and whether the row at offset k exists. */
#if NDIM == 1
#define ROW_COORDINATES
#define ROW_EXISTS(k) true
#elif NDIM == 2
#define ROW_COORDINATES
#define ROW_EXISTS(k) (row + offsets[(k) * 2] >= 0 && row + offsets[(k) * 2] < n_rows)
#else
#define ROW_COORDINATES  \
    int place[NDIM - 1]; \
    for (int d = NDIM - 2, rest = row; d >= 0; rest /= shape[d], --d) place[d] = rest % shape[d];
#define ROW_EXISTS(k) row_exists(place, shape, offsets + (long)(k) * NDIM)
static inline bool row_exists(const int *place, __global const int *shape, __global const int *offset)
{
    bool inside = true;
    for (int d = 0; d < NDIM - 1; ++d) inside = inside && place[d] + offset[d] >= 0 && place[d] + offset[d] < shape[d];
    return inside;
}
#endif

/* inner_columns: all neighbours of the pack are between the ends of their rows. inner_rows: all neighbouring rows
 * exist, so that they need no check. */
#define PACK_AT(x_, row_)                                                                \
    const int x = (x_), row = (row_);                                                    \
    const bool inner_columns = x >= reach && x + N + reach <= width, inner_rows = false; \
    PACK_OF(x, row)
#define PACK_OF(x, row)                         \
    const long u = guard + (row) * pitch + (x); \
    const laneN used = (x) + LANES < width;     \
    ROW_COORDINATES

#define VERTEX                                                                         \
    if ((int)get_global_id(0) * N >= width || (int)get_global_id(1) >= n_rows) return; \
    PACK_AT((int)get_global_id(0) * N, (int)get_global_id(1))

#define AT(u, c, channels) ((u) + (c) * plane)

#define EDGE_AT(c, channels) (weight_guard + (((long)row * 2 * H + k) * (channels) + (c)) * weight_pitch + x)
#define OPPOSITE_AT(c, channels) \
    (weight_guard + (((long)(row + row_jump) * 2 * H + (2 * H - 1 - k)) * (channels) + (c)) * weight_pitch + x + step)
#define CLEAR_EDGES(p, channels)    \
    for (int k = 0; k < 2 * H; ++k) \
        for (int c = 0; c < (channels); ++c) STORE(p, EDGE_AT(c, channels), (realN)(0));

#ifdef RECOMPUTED
#ifndef Q
#define Q 1
#endif
/* The weight s exp2(scale max(|F(u) - F(v)|^2 - shift, 0)), F the Q channels of `compared`; with MASKED_WEIGHTS one
 * more channel is the mask. This is slower than to load weights of a wide window, but nothing is stored per edge. */
static inline realN recomputed(
    __global const real *compared,
    const long plane,
    const long u,
    const long v,
    const real near,
    const real shift,
    const real scale)
{
    realN rho = 0;
    for (int c = 0; c < Q; ++c) {
        const realN d = LOAD(compared, u + c * plane) - LOAD(compared, v + c * plane);
        rho += d * d;
    }
    const realN w = near * exp2_scaled(fmax(rho - shift, (realN)(0)), scale);
#ifdef MASKED_WEIGHTS
    return WHERE(LOAD(compared, u + Q * plane) > 0 && LOAD(compared, v + Q * plane) > 0, w);
#else
    return w;
#endif
}
#endif

/* The edge from u along offset k: its weight is stored at u if k is a forward offset, otherwise at v. Without weights,
 * only packs near an end of their row check their neighbours; the results of lanes without a vertex are dropped. */
#ifdef GAMMA
#define EDGE_PLACE
#define EDGE_FACTORS const realN own = LOAD(weights, EDGE_AT(0, 1)), other = LOAD(weights, OPPOSITE_AT(0, 1));
#elif defined(WEIGHTED)
#define EDGE_PLACE                                                               \
    const long place =                                                           \
        weight_guard + (forward ? ((long)row * HALF + (k - HALF)) * weight_pitch \
                                : ((long)(row + row_jump) * HALF + (HALF - 1 - k)) * weight_pitch + step);
#define EDGE_FACTORS const realN w = LOAD_WEIGHT(weights, place + x);
#elif defined(RECOMPUTED)
#define EDGE_PLACE const real near = nearness[k >= HALF ? k - HALF : HALF - 1 - k];
#define EDGE_FACTORS                                                              \
    realN w = recomputed(weights, plane, u, v, near, weight_shift, weight_scale); \
    if (!inner_columns) w = WHERE(x + LANES + step >= 0 && x + LANES + step < width, w);
#else
#define EDGE_PLACE
#define EDGE_FACTORS \
    const realN w = inner_columns ? (realN)(1) : WHERE(x + LANES + step >= 0 && x + LANES + step < width, 1);
#endif

#ifdef WINDOW
__constant const int window_steps[] = {WINDOW_STEPS};
#if NDIM == 1
#define WINDOW_ROW(k) 0
#else
__constant const int window_rows[] = {WINDOW_ROWS};
#define WINDOW_ROW(k) window_rows[k]
#endif
#define HALF (WINDOW / 2)
/* clang-format off */
#define OFFSETS                                                                                                       \
    _Pragma("unroll") for (int k = 0; k < WINDOW; ++k) {                                                              \
        const int row_jump = WINDOW_ROW(k), step = window_steps[k];                                                   \
        const bool forward = k >= HALF;                                                                               \
        if (!inner_rows && (row + row_jump < 0 || row + row_jump >= n_rows)) continue;                                \
        const long v = u + row_jump * pitch + step;                                                                   \
        EDGE_PLACE
#define END }
/* clang-format on */
#else
#define HALF H
/* clang-format off */
#define OFFSETS                                                                                                       \
    for (int run = 0; run < n_runs; ++run) {                                                                          \
        const int first = runs[3 * run], from = runs[3 * run + 1], last = first + runs[3 * run + 2];                  \
        if (!inner_rows && !ROW_EXISTS(first)) continue;                                                              \
        const int row_jump = row_jumps[first];                                                                        \
        const bool forward = 2 * run >= n_runs;                                                                       \
        for (int k = first; k < last; ++k) {                                                                          \
            const int step = from + k - first;                                                                        \
            const long v = u + row_jump * pitch + step;                                                               \
            EDGE_PLACE
#define END }}
/* clang-format on */
#endif
#define NEIGHBOURS \
    OFFSETS        \
    EDGE_FACTORS

#define USED(x) WHERE(used, x)
#define COLLECT(x, first, channels)
#define ONE_WRITES

#ifdef GROUP
/* Every so many packs, counted row by row: a row and a place on it, so that no division is in the loop. */
#define SEGMENT_BEGIN                                                                                    \
    const int packs = (width + N - 1) / N;                                                               \
    const int next_rows = (int)get_global_size(0) / packs, next_packs = (int)get_global_size(0) % packs; \
    int pack = (int)get_global_id(0) % packs, line = (int)get_global_id(0) / packs;                      \
    for (; line < n_rows;                                                                                \
         pack += next_packs, line += next_rows + (pack >= packs), pack -= pack >= packs ? packs : 0) {   \
        PACK_AT(pack * N, line)
#else
#define SEGMENT_BEGIN                                                                           \
    for (int begin = get_global_id(0) * (int)segment * N;                                       \
         begin < width && begin < (int)(get_global_id(0) + 1) * (int)segment * N; begin += N) { \
        PACK_AT(begin, (int)get_global_id(1))
#endif
#define SEGMENT_END }
#define SEGMENT_INDEX (get_global_id(1) * get_global_size(0) + get_global_id(0))

#endif
