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
 * are found `jump` rows before its update, and live in a ring of rows of the block's own, which stays in the core's cache.
 * So weights and f come from memory once, not twice, and g never goes there. The price: what a block needs of g beyond its
 * border is computed by its neighbours too.
 * Through a wide window on a plane (WIDE: not compiled in) weights decide: all that a block has under way is more than the
 * second cache holds, and each weight would be fetched for both its ends in both passes. So a row's forward weights serve
 * both ends at once: run by run (offsets next to each other on one row) first the far end, the row ahead, whose sums wait
 * in the ring, then the near one. A row thus meets its neighbours in the order of their offsets, as in the two kernels.
 * That suits a CPU: few work items, each long and with a cache of its own. A GPU has neither, and runs the two kernels.
 * Traffic per vertex: reads H weights (WIDE: twice), 2 M values and lam, writes M numbers.
 */
#ifndef GRID
#define GRID
#endif
#include "squared_gradient.cl"
#include "conductance.cl"

#define INLINE static inline __attribute__((always_inline))

#if !defined(WINDOW) && NDIM <= 2 && !defined(RECOMPUTED)
#define WIDE
#define RING_ROW (3 * G + M) /* g, |grad f|^2 so far; of the update, sums of conductances and of neighbours so far */
#else
#define RING_ROW G
#endif

/* Whether a pack has all its neighbours, which a second copy of the code then takes for granted. With weights the zeros
 * among them say where the ends of a row are; beyond two axes rows are asked for one by one. */
#if NDIM > 2
#define INSIDE(x, inner) false
#elif defined(WEIGHTED)
#define INSIDE(x, inner) (inner)
#else
#define INSIDE(x, inner) ((inner) && (x) >= reach && (x) + N + reach <= width)
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

#ifndef WIDE
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

#else
/* PoCL's prefetch() does nothing. */
#if defined(WEIGHTED) && defined(__clang__)
#define PREFETCH(p) __builtin_prefetch((const void *)(size_t)(p))
#else
#define PREFETCH(p)
#endif

/* Packs treated together, so that additions need not wait for each other; more channels have sums enough. */
#define PACKS (M == 1 ? 4 : 1)
#define EACH_PACK _Pragma("unroll") for (int q = 0; q < P; ++q)

/* Weights of a run for the packs q, and their lanes that have a neighbour. */
#ifdef WEIGHTED
#define RUN_WEIGHT const realN w = LOAD_WEIGHT(w0, x + q * N + j * stride);
#define EDGE_WEIGHT RUN_WEIGHT
#define IN_BLOCKS(x) true
#else
#define RUN_WEIGHT const real w = 1;
#define EDGE_WEIGHT const realN w = WHERE(x + LANES + step + j >= 0 && x + LANES + step + j < width, 1);
#define IN_BLOCKS(x) ((x) >= reach && (x) + PACKS * N + reach <= width)
#endif

/* A run's part in the sums of |grad f|^2 of one of its ends, the row `here`; the other end is the row `there`, `step` cells
 * on and one more for each offset. Its weights are w0, and `stride` numbers on for each offset. */
#define GRADIENT_PACKS(WEIGHT)                                                                                       \
    realN own[P][M], sum[P][G];                                                                                      \
    EACH_PACK {                                                                                                      \
        for (int c = 0; c < M; ++c) own[q][c] = LOAD(here, c * plane + x + q * N);                                   \
        for (int c = 0; c < G; ++c) sum[q][c] = LOAD(sums, c * ring_pitch + x + q * N);                              \
    }                                                                                                                \
    for (int j = 0; j < count; ++j)                                                                                  \
        EACH_PACK {                                                                                                  \
            WEIGHT                                                                                                   \
            for (int c = 0; c < M; ++c) {                                                                            \
                const realN d = DIFFERENCE(own[q][c], LOAD(there, c * plane + x + q * N + step + j));                \
                sum[q][SHARED(c)] += SQUARED(d);                                                                     \
            }                                                                                                        \
        }                                                                                                            \
    EACH_PACK for (int c = 0; c < G; ++c) STORE(sums, c * ring_pitch + x + q * N, sum[q][c]);

INLINE void gradient_run(
    __global const real *here, __global const real *there, const long plane, __global const weight_t *w0, const long stride,
    const int step, const int count, const int from, const int to, const int reach, const int width,
    __global real *sums, const long ring_pitch)
{
    for (int x = from; x < to;) {
        if (x + PACKS * N <= to && IN_BLOCKS(x)) {
            enum { P = PACKS };
            GRADIENT_PACKS(RUN_WEIGHT)
            x += P * N;
        } else {
            enum { P = 1 };
            GRADIENT_PACKS(EDGE_WEIGHT)
            x += N;
        }
    }
}

/* The same for the sums of the update, of the conductances (G rows from `sums` on) and of the neighbours (M more). The
 * weights that lie `coming` numbers on are asked for: by now they have left the second cache. */
#define UPDATE_PACKS(WEIGHT)                                                                                         \
    realN own[P][G], total[P][G], sum[P][M];                                                                         \
    EACH_PACK {                                                                                                      \
        for (int c = 0; c < G; ++c) own[q][c] = LOAD(g_here, c * ring_pitch + x + q * N);                            \
        for (int c = 0; c < G; ++c) total[q][c] = LOAD(sums, c * ring_pitch + x + q * N);                            \
        for (int c = 0; c < M; ++c) sum[q][c] = LOAD(sums, (G + c) * ring_pitch + x + q * N);                        \
    }                                                                                                                \
    for (int j = 0; j < count; ++j)                                                                                  \
        EACH_PACK {                                                                                                  \
            WEIGHT                                                                                                   \
            realN conductance[G];                                                                                    \
            for (int c = 0; c < G; ++c) {                                                                            \
                conductance[c] = own[q][c] + LOAD(g_there, c * ring_pitch + x + q * N + step + j);                   \
                total[q][c] += HOLD * conductance[c];                                                                \
            }                                                                                                        \
            for (int c = 0; c < M; ++c)                                                                              \
                sum[q][c] += PULL * conductance[SHARED(c)] * LOAD(there, c * plane + x + q * N + step + j);          \
            PREFETCH(w0 + x + q * N + j * stride + coming);                                                          \
        }                                                                                                            \
    EACH_PACK {                                                                                                      \
        for (int c = 0; c < G; ++c) STORE(sums, c * ring_pitch + x + q * N, total[q][c]);                            \
        for (int c = 0; c < M; ++c) STORE(sums, (G + c) * ring_pitch + x + q * N, sum[q][c]);                        \
    }

INLINE void update_run(
    __global const real *g_here, __global const real *g_there, __global const real *there, const long plane,
    __global const weight_t *w0, const long stride, const int step, const int count, const int from, const int to,
    const int reach, const int width, __global real *sums, const long ring_pitch, const long coming)
{
    for (int x = from; x < to;) {
        if (x + PACKS * N <= to && IN_BLOCKS(x)) {
            enum { P = PACKS };
            UPDATE_PACKS(RUN_WEIGHT)
            x += P * N;
        } else {
            enum { P = 1 };
            UPDATE_PACKS(EDGE_WEIGHT)
            x += N;
        }
    }
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
    const int band,            /* rows of a block */
    const int stretch,         /* its columns, a multiple of N */
    const int jump,            /* largest jump of rows in the window */
    const int slots,           /* rows of a ring: 2 jump + 1, with WIDE jump + 1 */
    const long ring_pitch,
    __global real *rings,      /* scratch: for each work item `slots` rows of G numbers, with WIDE of 3 G + M, ring_pitch each */
    /* output */
    __global real *out)        /* M channels; not f */
{
    const int margin = (reach + N - 1) / N * N;
    const long ring_size = slots * RING_ROW * ring_pitch;
    const int from = (int)get_global_id(0) * stretch, top = (int)get_global_id(1) * band;
    const int to = min(from + stretch, width), bottom = min(top + band, n_rows);
    const int wide_from = max(from - margin, 0), wide_to = min(to + reach, width);
    /* Column x of the grid is column x + margin - from of the ring. What lies outside the grid stays 0. */
    __global real *whole = rings + (get_global_id(1) * get_global_size(0) + get_global_id(0)) * ring_size;
    for (long i = 0; i < ring_size; i += N) STORE(whole, i, (realN)(0));
    __global real *ring = whole + margin - from;

#ifdef WIDE
#define RING(row) (ring + (long)((row) % slots) * RING_ROW * ring_pitch)
#define F_ROW(row) (f + guard + (row) * pitch)
/* The forward runs of a row of weights. Toward the far end a run is gone through from its last offset to its first. */
#define FORWARD_RUNS(row)                                                                                            \
    for (int run = n_runs / 2; run < n_runs; ++run) {                                                                \
        const int first = runs[3 * run], step = runs[3 * run + 1], count = runs[3 * run + 2];                        \
        const int ahead = (row) + row_jumps[first];                                                                  \
        if (ahead >= n_rows) continue;                                                                               \
        const int back = 1 - step - count;                                                                           \
        __global const weight_t *near_weights = weights + weight_guard + ((long)(row) * H + (first - H)) * weight_pitch; \
        __global const weight_t *far_weights = near_weights + (count - 1) * weight_pitch + back;
    for (int row = max(top - 2 * jump, 0); row < bottom + jump; ++row) {
        if (row < n_rows) {
            FORWARD_RUNS(row)
                if (ahead >= top - jump && ahead < bottom + jump)
                    gradient_run(
                        F_ROW(ahead), F_ROW(row), plane, far_weights, 1 - weight_pitch, back, count, wide_from, wide_to,
                        reach, width, RING(ahead) + G * ring_pitch, ring_pitch);
                if (row >= top - jump)
                    gradient_run(
                        F_ROW(row), F_ROW(ahead), plane, near_weights, weight_pitch, step, count, wide_from, wide_to,
                        reach, width, RING(row) + G * ring_pitch, ring_pitch);
            }
            if (row >= top - jump)
                for (int x = wide_from; x < wide_to; x += N) {
                    realN sum[G];
                    for (int c = 0; c < G; ++c) {
                        sum[c] = LOAD(RING(row), (G + c) * ring_pitch + x);
                        STORE(RING(row), (G + c) * ring_pitch + x, (realN)(0));
                    }
                    store_norms(sum, eps2, power, x, width, RING(row), ring_pitch);
                }
        }
        const int ready = row - jump;
        if (ready < max(top - jump, 0) || ready >= bottom) continue;
        FORWARD_RUNS(ready)
            if (ahead >= top && ahead < bottom)
                update_run(
                    RING(ahead), RING(ready), F_ROW(ready), plane, far_weights, 1 - weight_pitch, back, count, from, to,
                    reach, width, RING(ahead) + 2 * G * ring_pitch, ring_pitch, 0);
            if (ready >= top)
                update_run(
                    RING(ready), RING(ahead), F_ROW(ahead), plane, near_weights, weight_pitch, step, count, from, to,
                    reach, width, RING(ready) + 2 * G * ring_pitch, ring_pitch, H * weight_pitch);
        }
        for (int x = from; ready >= top && x < to; x += N) {
            realN total[G + M];
            for (int c = 0; c < G + M; ++c) {
                total[c] = LOAD(RING(ready), (2 * G + c) * ring_pitch + x);
                STORE(RING(ready), (2 * G + c) * ring_pitch + x, (realN)(0));
            }
            store_update(
                total + G, total, f, f0, lams, lam_, theta, out, guard + ready * pitch + x, x, width, plane);
        }
    }
#else
    int slot = 0; /* of the row whose gradient norms come next */
    for (int row = top - jump; row < bottom + jump; ++row) {
        if (row >= 0 && row < n_rows) {
            const bool inner = row >= jump && row + jump < n_rows;
            __global real *its_ring = ring + (long)slot * G * ring_pitch;
            for (int x = wide_from; x < wide_to; x += N)
                if (INSIDE(x, inner)) gradient_pack(GRAPH, f, eps2, power, x, row, true, its_ring, ring_pitch);
                else gradient_pack(GRAPH, f, eps2, power, x, row, false, its_ring, ring_pitch);
        }
        const int ready = row - jump;
        if (ready >= top) {
            const bool inner = ready >= jump && ready + jump < n_rows;
            const int its = turned(slot, -jump, slots);
            for (int x = from; x < to; x += N)
                if (INSIDE(x, inner))
                    update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, ready, true, ring, ring_pitch, its, slots);
                else
                    update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, ready, false, ring, ring_pitch, its, slots);
        }
        slot = slot + 1 == slots ? 0 : slot + 1;
    }
#endif
}
