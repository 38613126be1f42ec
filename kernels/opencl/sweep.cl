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
 * are found `jump` rows before those of its update are needed, and live in a ring of 2 jump + 1 rows of its own, which
 * stays in the core's cache. So weights and f come from memory once, not twice, and g never goes there. The price: what a
 * block needs of g beyond its border is computed by its neighbours too.
 * That suits a CPU: few work items, each long and with a cache of its own. A GPU has neither, and runs the two kernels.
 * Traffic per vertex: reads H weights, 2 M values and lam, writes M numbers.
 */
#ifndef GRID
#define GRID
#endif
#include "squared_gradient.cl"
#include "conductance.cl"

/* Whether a pack has all its neighbours, which a second copy of the code then takes for granted. With weights the zeros
 * among them say where the ends of a row are; beyond two axes rows are asked for one by one. */
#if NDIM > 2
#define INSIDE(x, inner) false
#elif defined(WEIGHTED)
#define INSIDE(x, inner) (inner)
#else
#define INSIDE(x, inner) ((inner) && (x) >= reach && (x) + N + reach <= width)
#endif

#define INLINE static inline __attribute__((always_inline))

/* Gradient norms of a pack, into a row of the ring. */
INLINE void gradient_pack(
    GRAPH_ARGS, __global const real *f, const real eps2, const real power, const int x, const int row, const bool inside,
    __global real *its_ring, const long ring_pitch)
{
    const bool inner_columns = inside, inner_rows = inside;
    PACK_OF(x, row)
    realN here[M], sum[G];
    for (int c = 0; c < M; ++c) here[c] = LOAD(f, AT(u, c, M));
    SUM_OF_SQUARES
    for (int c = 0; c < G; ++c) STORE(its_ring, c * ring_pitch + x, USED(raise(sum[c], power)));
}

/* The update of a pack of the row whose gradient norms are in slot `slot` of the ring. */
INLINE void update_pack(
    GRAPH_ARGS, __global const real *f, __global const real *f0, __global const real *lams, const real lam_,
    const real theta, __global real *out, const int x, const int row, const bool inside, __global const real *ring,
    const long ring_pitch, const int slot, const int slots)
{
    const bool inner_columns = inside, inner_rows = inside;
    PACK_OF(x, row)
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    realN here[M], own[G], sum[M], total[G];
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(f, AT(u, c, M));
        sum[c] = 0;
    }
    for (int c = 0; c < G; ++c) {
        own[c] = LOAD(ring, ((long)slot * G + c) * ring_pitch + x);
        total[c] = 0;
    }
    NEIGHBOURS
        const int turned = slot + row_jump;
        const int slot_v = turned < 0 ? turned + slots : turned < slots ? turned : turned - slots;
        realN conductance[G];
        for (int c = 0; c < G; ++c) {
            conductance[c] = own[c] + LOAD(ring, ((long)slot_v * G + c) * ring_pitch + x + step);
            total[c] += HOLD * conductance[c];
        }
        for (int c = 0; c < M; ++c) sum[c] += PULL * conductance[SHARED(c)] * LOAD(f, AT(v, c, M));
    END
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M));
        const realN denominator = lam + total[SHARED(c)];
        const laneN keeps_data = isinf(lam) || !(denominator > SMALLEST);
        const realN plain = (lam * data + sum[c]) / denominator;
        const realN moved = here[c] + theta * (plain - here[c]);
        STORE(out, AT(u, c, M), USED(keeps_data ? data : (theta == (real)1 ? plain : moved)));
    }
}

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
    const long ring_pitch,
    __global real *rings,      /* scratch: for each work item 2 jump + 1 rows of G channels, ring_pitch each */
    /* output */
    __global real *out)        /* M channels; not f */
{
    const int slots = 2 * jump + 1, margin = (reach + N - 1) / N * N;
    const long ring_size = slots * G * ring_pitch;
    const int from = (int)get_global_id(0) * stretch, top = (int)get_global_id(1) * band;
    const int to = min(from + stretch, width), bottom = min(top + band, n_rows);
    /* Column x of the grid is column x + margin - from of the ring. What lies outside the grid stays 0. */
    __global real *whole = rings + (get_global_id(1) * get_global_size(0) + get_global_id(0)) * ring_size;
    for (long i = 0; i < ring_size; i += N) STORE(whole, i, (realN)(0));
    __global real *ring = whole + margin - from;

    int slot = 0; /* of the row whose gradient norms come next */
    for (int row = top - jump; row < bottom + jump; ++row) {
        if (row >= 0 && row < n_rows) {
            const bool inner = row >= jump && row + jump < n_rows;
            __global real *its_ring = ring + (long)slot * G * ring_pitch;
            for (int x = max(from - margin, 0); x < min(to + reach, width); x += N)
                if (INSIDE(x, inner)) gradient_pack(GRAPH, f, eps2, power, x, row, true, its_ring, ring_pitch);
                else gradient_pack(GRAPH, f, eps2, power, x, row, false, its_ring, ring_pitch);
        }
        const int ready = row - jump;
        if (ready >= top) {
            const bool inner = ready >= jump && ready + jump < n_rows;
            const int its = slot < jump ? slot - jump + slots : slot - jump;
            for (int x = from; x < to; x += N)
                if (INSIDE(x, inner))
                    update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, ready, true, ring, ring_pitch, its, slots);
                else
                    update_pack(GRAPH, f, f0, lams, lam_, theta, out, x, ready, false, ring, ring_pitch, its, slots);
        }
        slot = slot + 1 == slots ? 0 : slot + 1;
    }
}
