/* A block of the fused sweep with a wide window on a plane                                    (eq. 9, 15, 25, 31)
 *
 *   the equations of sweep.cl, which includes this file if WIDE is defined: a window that is not compiled in, on at
 *   most two axes
 *
 * The weights take most of the time: the data in use by a block exceed the L2 cache, and each weight would be read for
 * both its ends in both passes. So the forward weights of a row are used for both ends at once, run by run (adjacent
 * offsets on one row): first for the far end, the row ahead, whose partial sums are in the ring, then for the near end.
 * A row thus adds its neighbours in the order of their offsets, as in the two kernels.
 *
 * One work item: a block, as in sweep.cl. A row of its ring has RING_ROW = 3 G + M rows of numbers: g, and the partial
 * sums of |grad f|^2, of the conductances and of the neighbours.
 * Traffic per vertex: reads H weights twice, 2 M values and lam; writes M numbers.
 */
/* PoCL's prefetch() does nothing. */
#if defined(WEIGHTED) && defined(__clang__)
#define PREFETCH(p) __builtin_prefetch((const void *)(size_t)(p))
#else
#define PREFETCH(p)
#endif

/* Packs at a time, for independent additions; with several channels one pack has enough of them. */
#define PACKS (M == 1 ? 4 : 1)
#define EACH_PACK _Pragma("unroll") for (int q = 0; q < P; ++q)

/* The weights of a run for the packs q; EDGE_WEIGHT is 0 in lanes without a neighbour. */
#ifdef WEIGHTED
#define RUN_WEIGHT const realN w = LOAD_WEIGHT(w0, x + q * N + j * stride);
#define EDGE_WEIGHT RUN_WEIGHT
#define IN_BLOCKS(x) true
#else
#define RUN_WEIGHT const real w = 1;
#define EDGE_WEIGHT const realN w = WHERE(x + LANES + step + j >= 0 && x + LANES + step + j < width, 1);
#define IN_BLOCKS(x) ((x) >= reach && (x) + PACKS * N + reach <= width)
#endif

/* Add a run to the sums of |grad f|^2 of one of its ends, the row `here`. Offset j leads to the row `there`, `step` + j
 * cells on, and its weights are at w0 + j stride. */
#define GRADIENT_PACKS(WEIGHT)                                                                        \
    realN own[P][M], sum[P][G];                                                                       \
    EACH_PACK                                                                                         \
    {                                                                                                 \
        for (int c = 0; c < M; ++c) own[q][c] = LOAD(here, c * plane + x + q * N);                    \
        for (int c = 0; c < G; ++c) sum[q][c] = LOAD(sums, c * ring_pitch + x + q * N);               \
    }                                                                                                 \
    for (int j = 0; j < count; ++j) EACH_PACK                                                         \
        {                                                                                             \
            WEIGHT                                                                                    \
            for (int c = 0; c < M; ++c) {                                                             \
                const realN d = DIFFERENCE(own[q][c], LOAD(there, c * plane + x + q * N + step + j)); \
                sum[q][SHARED(c)] += SQUARED(d);                                                      \
            }                                                                                         \
        }                                                                                             \
    EACH_PACK                                                                                         \
    {                                                                                                 \
        for (int c = 0; c < G; ++c) STORE(sums, c * ring_pitch + x + q * N, sum[q][c]);               \
    }

INLINE void gradient_run(
    __global const real *here,
    __global const real *there,
    const long plane,
    __global const weight_t *w0,
    const long stride,
    const int step,
    const int count,
    const int from,
    const int to,
    const int reach,
    const int width,
    __global real *sums,
    const long ring_pitch)
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

/* Likewise for the sums of the update: of the conductances (G rows from `sums` on) and of the neighbours (M more rows).
 * Weights `coming` numbers ahead are prefetched, as they are no longer in the L2 cache. */
#define UPDATE_PACKS(WEIGHT)                                                                                \
    realN own[P][G], total[P][G], sum[P][M];                                                                \
    EACH_PACK                                                                                               \
    {                                                                                                       \
        for (int c = 0; c < G; ++c) own[q][c] = LOAD(g_here, c * ring_pitch + x + q * N);                   \
        for (int c = 0; c < G; ++c) total[q][c] = LOAD(sums, c * ring_pitch + x + q * N);                   \
        for (int c = 0; c < M; ++c) sum[q][c] = LOAD(sums, (G + c) * ring_pitch + x + q * N);               \
    }                                                                                                       \
    for (int j = 0; j < count; ++j) EACH_PACK                                                               \
        {                                                                                                   \
            WEIGHT                                                                                          \
            realN conductance[G];                                                                           \
            for (int c = 0; c < G; ++c) {                                                                   \
                conductance[c] = own[q][c] + LOAD(g_there, c * ring_pitch + x + q * N + step + j);          \
                total[q][c] += HOLD * conductance[c];                                                       \
            }                                                                                               \
            for (int c = 0; c < M; ++c)                                                                     \
                sum[q][c] += PULL * conductance[SHARED(c)] * LOAD(there, c * plane + x + q * N + step + j); \
            PREFETCH(w0 + x + q * N + j * stride + coming);                                                 \
        }                                                                                                   \
    EACH_PACK                                                                                               \
    {                                                                                                       \
        for (int c = 0; c < G; ++c) STORE(sums, c * ring_pitch + x + q * N, total[q][c]);                   \
        for (int c = 0; c < M; ++c) STORE(sums, (G + c) * ring_pitch + x + q * N, sum[q][c]);               \
    }

INLINE void update_run(
    __global const real *g_here,
    __global const real *g_there,
    __global const real *there,
    const long plane,
    __global const weight_t *w0,
    const long stride,
    const int step,
    const int count,
    const int from,
    const int to,
    const int reach,
    const int width,
    __global real *sums,
    const long ring_pitch,
    const long coming)
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

#define RING(row) (ring + (long)((row) % slots) * RING_ROW * ring_pitch)
#define F_ROW(row) (f + guard + (row) * pitch)

/* The forward runs of a row of weights. For the far end, the offsets of a run are in reverse order. */
/* clang-format off */
#define FORWARD_RUNS(row)                                                                                             \
    for (int run = n_runs / 2; run < n_runs; ++run) {                                                                 \
        const int first = runs[3 * run], step = runs[3 * run + 1], count = runs[3 * run + 2];                         \
        const int ahead = (row) + row_jumps[first];                                                                   \
        if (ahead >= n_rows) continue;                                                                                \
        const int back = 1 - step - count;                                                                            \
        __global const weight_t *near_weights =                                                                       \
            weights + weight_guard + ((long)(row) * H + (first - H)) * weight_pitch;                                  \
        __global const weight_t *far_weights = near_weights + (count - 1) * weight_pitch + back;
/* clang-format on */

/* Sweep the rows top .. bottom and columns from .. to, with gradient norms in the columns wide_from .. wide_to. */
INLINE void sweep_wide(
    GRAPH_ARGS,
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    const real theta,
    const real power,    /* (p - 2)/2 */
    const real eps2,     /* eps^2 */
    const int jump,      /* largest offset in rows */
    const int slots,     /* rows of the ring: jump + 1 */
    __global real *ring, /* `slots` rows of RING_ROW * ring_pitch numbers, 0 at first */
    const long ring_pitch,
    const int from,
    const int to,
    const int top,
    const int bottom,
    const int wide_from,
    const int wide_to,
    __global real *out) /* M channels; not f */
{
    /* clang-format off */
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
/* clang-format on */
}
