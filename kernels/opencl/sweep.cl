/* One sweep of the Gauss-Jacobi process with its conductances, fused over a block of a grid    (eq. 9, 15, 25, 31)
 *
 *   g(u)   = (|grad_w f(u)|^2 + eps^2)^power,   power = (p - 2)/2
 *   J(u)   = (lam f0(u) + sum_v w (g(u) + g(v)) f(v)) / (lam + sum_v w (g(u) + g(v)))
 *   out(u) = f(u) + theta (J(u) - f(u))
 *
 * It is gradient_norm.cl and then jacobi_step.cl, vertex by vertex with their operations in their order, for gamma =
 * sqrt(w) and the vertex norm; lam, theta and the vertices that keep their data as there. What a vertex gets does not
 * depend on the block it falls in: an image cut into parts has the bits of the whole.
 *
 * One work item: a block, a band of rows times a stretch of columns. It goes down the rows; the gradient norms of a row
 * are found `jump` rows before those of its update are needed, and live in a ring of `slots` rows of its own, which stays
 * in the core's cache. So weights and f come from memory once, not twice, and g never goes there. The price: what a block
 * needs of g beyond its border is computed by its neighbours too.
 * Through a wide window (not compiled in) ROWS rows of PACKS packs go together: what a neighbour's f and g bring is used
 * by both rows, and there are several sums in the making, so that additions need not wait for each other. `segments` is
 * their common window: runs of steps on one row that lie in the window of the first row, of the second, or of both.
 * That suits a CPU: few work items, each long and with a cache of its own. A GPU has neither, and runs the two kernels.
 * Traffic per vertex: reads H weights, 2 M values and lam, writes M numbers.
 */
#ifndef GRID
#define GRID
#endif
#include "squared_gradient.cl"
#include "conductance.cl"

#define INLINE static inline __attribute__((always_inline))

/* PoCL's prefetch() does nothing. */
#ifdef __clang__
#define PREFETCH(p) __builtin_prefetch((const void *)(size_t)(p), 0, 2)
#else
#define PREFETCH(p) prefetch(p, N)
#endif

/* Whether a pack has all its neighbours, which a second copy of the code then takes for granted. With weights the zeros
 * among them say where the ends of a row are; a wide window, and one of more than two axes, asks for its rows. */
#if !defined(WEIGHTED) && NDIM <= 2
#define INSIDE(x, inner) ((inner) && (x) >= reach && (x) + N + reach <= width)
#elif defined(WINDOW)
#define INSIDE(x, inner) (inner)
#else
#define INSIDE(x, inner) false
#endif

/* The columns of a row, from `from` to `to`, that may be treated in blocks: these do not ask for the ends of a row. */
#ifdef WEIGHTED
#define BLOCKS_FROM(from) (from)
#define BLOCKS_TO(to) (to)
#else
#define BLOCKS_FROM(from) max(from, margin)
#define BLOCKS_TO(to) min(to, width - reach)
#endif

#ifdef LAM_ARRAY
#define LAM_AT(u) LOAD(lams, AT(u, 0, 1))
#else
#define LAM_AT(u) ((realN)(lam_))
#endif

/* The slot that lies `by` rows from another one, round the ring. */
INLINE int turned(const int slot, const int by, const int slots)
{
    const int moved = slot + by;
    return moved < 0 ? moved + slots : moved < slots ? moved : moved - slots;
}

/* What is left to do when the sums over the neighbours are there: of |grad f|^2, then of the two of eq. 25. */
INLINE void store_norms(
    const realN *sum, const real eps2, const real power, const int x, const int width, __global real *its_ring,
    const long ring_pitch)
{
    const laneN used = x + LANES < width;
    for (int c = 0; c < G; ++c) STORE(its_ring, c * ring_pitch + x, USED(raise(sum[c] + eps2, power)));
}

INLINE void store_update(
    const realN *sum, const realN *total, __global const real *f, __global const real *f0, __global const real *lams,
    const real lam_, const real theta, __global real *out, const long u, const int x, const int width, const long plane)
{
    const laneN used = x + LANES < width;
    const realN lam = LAM_AT(u);
    for (int c = 0; c < M; ++c) {
        const realN here = LOAD(f, AT(u, c, M)), data = LOAD(f0, AT(u, c, M));
        const realN denominator = lam + total[SHARED(c)];
        const laneN keeps_data = isinf(lam) || !(denominator > SMALLEST);
        const realN plain = (lam * data + sum[c]) / denominator;
        const realN moved = here + theta * (plain - here);
        STORE(out, AT(u, c, M), USED(keeps_data ? data : (theta == (real)1 ? plain : moved)));
    }
}

/* Gradient norms of a pack, into its row of the ring. */
INLINE void gradient_pack(
    GRAPH_ARGS, __global const real *f, const real eps2, const real power, const int x, const int row, const bool inside,
    __global real *its_ring, const long ring_pitch)
{
    const bool inner_columns = inside, inner_rows = inside;
    const long u = guard + row * pitch + x;
    ROW_COORDINATES
    realN here[M], sum[G];
    for (int c = 0; c < M; ++c) here[c] = LOAD(f, AT(u, c, M));
    for (int c = 0; c < G; ++c) sum[c] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M)));
            sum[SHARED(c)] += SQUARED(d);
        }
    END
    store_norms(sum, eps2, power, x, width, its_ring, ring_pitch);
}

/* The update of a pack of the row whose gradient norms are in slot `slot` of the ring. */
INLINE void update_pack(
    GRAPH_ARGS, __global const real *f, __global const real *f0, __global const real *lams, const real lam_,
    const real theta, __global real *out, const int x, const int row, const bool inside, __global const real *ring,
    const long ring_pitch, const int slot, const int slots)
{
    const bool inner_columns = inside, inner_rows = inside;
    const long u = guard + row * pitch + x;
    ROW_COORDINATES
    realN own[G], sum[M], total[G];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    for (int c = 0; c < G; ++c) {
        own[c] = LOAD(ring, ((long)slot * G + c) * ring_pitch + x);
        total[c] = 0;
    }
    NEIGHBOURS
        __global const real *g_v = ring + (long)turned(slot, row_jump, slots) * G * ring_pitch + step;
        realN conductance[G];
        for (int c = 0; c < G; ++c) {
            conductance[c] = own[c] + LOAD(g_v, c * ring_pitch + x);
            total[c] += HOLD * conductance[c];
        }
        for (int c = 0; c < M; ++c) sum[c] += PULL * conductance[SHARED(c)] * LOAD(f, AT(v, c, M));
    END
    store_update(sum, total, f, f0, lams, lam_, theta, out, u, x, width, plane);
}

#ifdef WINDOW
#define ROWS 1
#else
/* The same for ROWS rows of PACKS packs: 4 where 32 registers hold as many (AVX-512). All is written out pack by pack: a
 * loop would keep the sums in memory. */
#if NDIM != 2 || (M == 1 && (N == 16 || (N == 8 && defined(DOUBLE))))
#define PACKS 4
#define EACH_PACK(...)                                                                                               \
    { const int q = 0; __VA_ARGS__ }                                                                                 \
    { const int q = 1; __VA_ARGS__ }                                                                                 \
    { const int q = 2; __VA_ARGS__ }                                                                                 \
    { const int q = 3; __VA_ARGS__ }
#else
#define PACKS 2
#define EACH_PACK(...) { const int q = 0; __VA_ARGS__ } { const int q = 1; __VA_ARGS__ }
#endif
#if NDIM == 2
#define ROWS 2
#define BOTH(...) { const int r = 0; EACH_PACK(__VA_ARGS__) } { const int r = 1; EACH_PACK(__VA_ARGS__) }
#define SEGMENT_EXISTS (row + row_jump >= 0 && row + row_jump < n_rows)
#else
#define ROWS 1
#define BOTH(...) { const int r = 0; EACH_PACK(__VA_ARGS__) }
#define SEGMENT_EXISTS ROW_EXISTS(first[0])
#endif

/* A loop over the common window: first[r] + i is the number of the offset for row r, where first[r] >= 0. */
#define SEGMENTS                                                                                                     \
    for (int s = 0; s < n_segments; ++s) {                                                                           \
        const int row_jump = segments[5 * s], from = segments[5 * s + 1], count = segments[5 * s + 2];               \
        const int first[2] = {segments[5 * s + 3], segments[5 * s + 4]};                                             \
        if (!SEGMENT_EXISTS) continue;                                                                               \
        for (int i = 0; i < count; ++i) {                                                                            \
            const int step = from + i;                                                                               \
            const long v = u + row_jump * pitch + step;

/* A neighbour's part in the sums of row r. */
#ifdef WEIGHTED
#define OF_ROW(r_, ...)                                                                                              \
    if (r_ < ROWS && first[r_] >= 0) {                                                                               \
        const int r = r_, k = first[r_] + i;                                                                         \
        const long place =                                                                                           \
            weight_guard + x + (k >= H ? ((long)(row + r) * H + (k - H)) * weight_pitch                              \
                                       : ((long)(row + row_jump) * H + (H - 1 - k)) * weight_pitch + step);          \
        EACH_PACK(const realN w = LOAD(weights, place + q * N); __VA_ARGS__)                                         \
    }
#else
#define OF_ROW(r_, ...)                                                                                              \
    if (r_ < ROWS && first[r_] >= 0) {                                                                               \
        const int r = r_;                                                                                            \
        const real w = 1;                                                                                            \
        EACH_PACK(__VA_ARGS__)                                                                                       \
    }
#endif

INLINE void gradient_block(
    GRAPH_ARGS, const int n_segments, __global const int *segments, __global const real *f, const real eps2,
    const real power, const int x, const int row, const bool alone, __global real *its_ring, const long ring_pitch)
{
    const long u = guard + row * pitch + x;
    ROW_COORDINATES
    realN here[ROWS][PACKS][M], sum[ROWS][PACKS][G];
    BOTH(for (int c = 0; c < M; ++c) here[r][q][c] = LOAD(f, AT(u + r * pitch + q * N, c, M));
         for (int c = 0; c < G; ++c) sum[r][q][c] = 0;)
    SEGMENTS
#ifdef WEIGHTED
        /* The weights of the next rows, ROWS PACKS packs a turn, so that they are here in time. In the order of memory
         * where the block is as wide as the grid: a processor foresees one long stream, not hundreds of short ones. */
        if (first[0] >= H) {
            const int h = first[0] + i - H;
            const long next = weight_guard + (long)(row + ROWS) * H * weight_pitch;
            if (alone) {
                const long turn = next + ((long)(x / (PACKS * N)) * H + h) * ROWS * PACKS * N;
                EACH_PACK(PREFETCH(weights + turn + q * N);)
                if (ROWS == 2) { EACH_PACK(PREFETCH(weights + turn + (PACKS + q) * N);) }
            } else {
                const long turn = next + h * weight_pitch + x;
                EACH_PACK(PREFETCH(weights + turn + q * N);)
                if (ROWS == 2) { EACH_PACK(PREFETCH(weights + turn + H * weight_pitch + q * N);) }
            }
        }
#endif
        realN f_v[PACKS][M];
        EACH_PACK(for (int c = 0; c < M; ++c) f_v[q][c] = LOAD(f, AT(v + q * N, c, M));)
#define PART                                                                                                         \
    for (int c = 0; c < M; ++c) {                                                                                    \
        const realN d = DIFFERENCE(here[r][q][c], f_v[q][c]);                                                        \
        sum[r][q][SHARED(c)] += SQUARED(d);                                                                          \
    }
        OF_ROW(0, PART)
        OF_ROW(1, PART)
#undef PART
    }}
    BOTH(store_norms(sum[r][q], eps2, power, x + q * N, width, its_ring + r * G * ring_pitch, ring_pitch);)
}

INLINE void update_block(
    GRAPH_ARGS, const int n_segments, __global const int *segments, __global const real *f, __global const real *f0,
    __global const real *lams, const real lam_, const real theta, __global real *out, const int x, const int row,
    __global const real *ring, const long ring_pitch, const int slot, const int slots)
{
    const long u = guard + row * pitch + x;
    ROW_COORDINATES
    realN own[ROWS][PACKS][G], sum[ROWS][PACKS][M], total[ROWS][PACKS][G];
    BOTH(for (int c = 0; c < M; ++c) sum[r][q][c] = 0;
         for (int c = 0; c < G; ++c) {
             own[r][q][c] = LOAD(ring, ((long)turned(slot, r, slots) * G + c) * ring_pitch + x + q * N);
             total[r][q][c] = 0;
         })
    SEGMENTS
        __global const real *ring_v = ring + (long)turned(slot, row_jump, slots) * G * ring_pitch + step + x;
        realN f_v[PACKS][M], g_v[PACKS][G];
        EACH_PACK(for (int c = 0; c < M; ++c) f_v[q][c] = LOAD(f, AT(v + q * N, c, M));
                  for (int c = 0; c < G; ++c) g_v[q][c] = LOAD(ring_v, c * ring_pitch + q * N);)
#define PART                                                                                                         \
    realN conductance[G];                                                                                            \
    for (int c = 0; c < G; ++c) {                                                                                    \
        conductance[c] = own[r][q][c] + g_v[q][c];                                                                   \
        total[r][q][c] += HOLD * conductance[c];                                                                     \
    }                                                                                                                \
    for (int c = 0; c < M; ++c) sum[r][q][c] += PULL * conductance[SHARED(c)] * f_v[q][c];
        OF_ROW(0, PART)
        OF_ROW(1, PART)
#undef PART
    }}
    BOTH(store_update(sum[r][q], total[r][q], f, f0, lams, lam_, theta, out, u + r * pitch + q * N, x + q * N, width,
                      plane);)
}
#endif

__kernel void sweep(
    GRAPH_ARGS,
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    const real power,          /* (p - 2)/2 */
    const real eps2,           /* eps^2 */
    __global const real *lams, /* 1 channel; not read without LAM_ARRAY */
    const real lam_,           /* not read with LAM_ARRAY */
    const real theta,
    const int n_segments,      /* these two are not read with WINDOW */
    __global const int *segments, /* (n_segments, 5): jump of rows, first step, steps, first offset for either row or -1 */
    const int band,            /* rows of a block */
    const int stretch,         /* its columns, a multiple of N */
    const int jump,            /* largest jump of rows in the window */
    const int slots,           /* 2 jump + ROWS */
    const long ring_pitch,
    __global real *rings,      /* scratch: for each work item `slots` rows of G channels, ring_pitch each */
    /* output */
    __global real *out)        /* M channels; not f */
{
    const int margin = (reach + N - 1) / N * N;
    const long ring_size = slots * G * ring_pitch;
    const int from = (int)get_global_id(0) * stretch, top = (int)get_global_id(1) * band;
    const int to = min(from + stretch, width), bottom = min(top + band, n_rows);
    const int wide_from = max(from - margin, 0), wide_to = min(to + reach, width);
    /* Column x of the grid is column x + margin - from of the ring. What lies outside the grid stays 0. */
    __global real *whole = rings + (get_global_id(1) * get_global_size(0) + get_global_id(0)) * ring_size;
    for (long i = 0; i < ring_size; i += N) STORE(whole, i, (realN)(0));
    __global real *ring = whole + margin - from;

    int slot = 0; /* of the row whose gradient norms come next */
    for (int above = top - jump; above < bottom + jump; above += ROWS) {
        int begun = wide_to, done = wide_to; /* the columns between have been treated in blocks */
#ifndef WINDOW
        if (above >= 0 && above + ROWS <= n_rows) {
            begun = done = BLOCKS_FROM(wide_from);
            for (; done + PACKS * N <= BLOCKS_TO(wide_to); done += PACKS * N)
                gradient_block(
                    GRAPH, n_segments, segments, f, eps2, power, done, above, stretch >= width,
                    ring + (long)slot * G * ring_pitch, ring_pitch);
        }
#endif
        for (int row = max(above, 0); row < min(above + ROWS, n_rows); ++row) {
            const bool inner = row >= jump && row + jump < n_rows;
            __global real *its_ring = ring + (long)(slot + row - above) * G * ring_pitch;
            for (int x = wide_from == begun ? done : wide_from; x < wide_to; x = x + N == begun ? done : x + N)
                if (INSIDE(x, inner)) gradient_pack(GRAPH, f, eps2, power, x, row, true, its_ring, ring_pitch);
                else gradient_pack(GRAPH, f, eps2, power, x, row, false, its_ring, ring_pitch);
        }
        const int ready = above - jump;
        if (ready >= top) {
            const int its = turned(slot, -jump, slots);
            begun = done = to;
#ifndef WINDOW
            if (ready + ROWS <= bottom) {
                begun = done = BLOCKS_FROM(from);
                for (; done + PACKS * N <= BLOCKS_TO(to); done += PACKS * N)
                    update_block(
                        GRAPH, n_segments, segments, f, f0, lams, lam_, theta, out, done, ready, ring, ring_pitch, its,
                        slots);
            }
#endif
            for (int row = ready; row < min(ready + ROWS, bottom); ++row) {
                const bool inner = row >= jump && row + jump < n_rows;
                const int own = turned(its, row - ready, slots);
                for (int x = from == begun ? done : from; x < to; x = x + N == begun ? done : x + N)
                    if (INSIDE(x, inner))
                        update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, row, true, ring, ring_pitch, own, slots);
                    else
                        update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, row, false, ring, ring_pitch, own, slots);
            }
        }
        slot = slot + ROWS == slots ? 0 : slot + ROWS;
    }
}
