/* One sweep of the Gauss-Jacobi process with its conductances, fused over a block of a grid    (eq. 9, 15, 25, 31)
 *
 *   g(u)   = (|grad_w f(u)|^2 + eps^2)^power,   power = (p - 2)/2
 *   J(u)   = (lam f0(u) + sum_v w (g(u) + g(v)) f(v)) / (lam + sum_v w (g(u) + g(v)))
 *   out(u) = f(u) + theta (J(u) - f(u))
 *
 * It does the operations of gradient_norm.cl and jacobi_step.cl in their order, for gamma = sqrt(w) and the vertex
 * norm. The result at a vertex does not depend on its block: parts of an image give the same bits as the whole image.
 *
 * One work item: a block, a band of rows times a stretch of columns. It goes down the rows; the gradient norms of a row
 * are computed `jump` rows before its update, in a ring of rows that stays in the cache of the core. So weights and f
 * are read from memory once, not twice, and g is never written there. In return, neighbouring blocks both compute g
 * near their border. For a wide window on a plane (WIDE) see sweep_wide.cl. This needs few long work items, each with
 * its own cache, as on a CPU; a GPU runs the two kernels.
 * Traffic per vertex: reads H weights (WIDE: twice), 2 M values and lam; writes M numbers.
 */
#ifndef GRID
#define GRID
#endif
#include "squared_gradient.cl"
#include "conductance.cl"

#define INLINE static inline __attribute__((always_inline))

#if !defined(WINDOW) && NDIM <= 2 && !defined(RECOMPUTED)
#define WIDE
#define RING_ROW (3 * G + M) /* g; partial sums: |grad f|^2, conductances, neighbours */
#else
#define RING_ROW G
#endif

/* Whether all neighbours of a pack exist, for which the code is compiled without checks. With weights, zeros mark the
 * ends of a row; on three axes or more each row is checked. */
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

/* The slot `by` rows from another one in the ring. */
INLINE int turned(const int slot, const int by, const int slots)
{
    const int moved = slot + by;
    return moved < 0 ? moved + slots : moved < slots ? moved : moved - slots;
}

/* Finish the gradient norms and, below, the update (eq. 25), given the sums over the neighbours. */
INLINE void store_norms(
    const realN *sum,
    const real eps2,
    const real power,
    const int x,
    const int width,
    __global real *its_ring,
    const long ring_pitch)
{
    const laneN used = x + LANES < width;
    for (int c = 0; c < G; ++c) STORE(its_ring, c * ring_pitch + x, USED(raise(sum[c] + eps2, power)));
}

INLINE void store_update(
    const realN *sum,
    const realN *total,
    __global const real *f,
    __global const real *f0,
    __global const real *lams,
    const real lam_,
    const real theta,
    __global real *out,
    const long u,
    const int x,
    const int width,
    const long plane)
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

#ifdef WIDE
#include "sweep_wide.cl"
#else
/* Compute the gradient norms of a pack, in its row of the ring. */
INLINE void gradient_pack(
    GRAPH_ARGS,
    __global const real *f,
    const real eps2,
    const real power,
    const int x,
    const int row,
    const bool inside,
    __global real *its_ring,
    const long ring_pitch)
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

/* Update a pack of the row whose gradient norms are in slot `slot` of the ring. */
INLINE void update_pack(
    GRAPH_ARGS,
    __global const real *f,
    __global const real *f0,
    __global const real *lams,
    const real lam_,
    const real theta,
    __global real *out,
    const int x,
    const int row,
    const bool inside,
    __global const real *ring,
    const long ring_pitch,
    const int slot,
    const int slots)
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

#endif

__kernel void sweep(
    GRAPH_ARGS,
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    const real power,          /* (p - 2)/2 */
    const real eps2,           /* eps^2 */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    const real theta,
    const int band,    /* rows of a block */
    const int stretch, /* columns of a block, a multiple of N */
    const int jump,    /* largest offset in rows */
    const int slots,   /* rows of a ring: 2 jump + 1, with WIDE jump + 1 */
    const long ring_pitch,
    __global real *rings, /* scratch: `slots` rows of RING_ROW * ring_pitch numbers per work item */
    /* output */
    __global real *out) /* M channels; not f */
{
    const int margin = (reach + N - 1) / N * N;
    const long ring_size = slots * RING_ROW * ring_pitch;
    const int from = (int)get_global_id(0) * stretch, top = (int)get_global_id(1) * band;
    const int to = min(from + stretch, width), bottom = min(top + band, n_rows);
    const int wide_from = max(from - margin, 0), wide_to = min(to + reach, width);
    /* Column x of the grid is column x + margin - from of the ring, which is 0 outside the grid. */
    __global real *whole = rings + (get_global_id(1) * get_global_size(0) + get_global_id(0)) * ring_size;
    for (long i = 0; i < ring_size; i += N) STORE(whole, i, (realN)(0));
    __global real *ring = whole + margin - from;

#ifdef WIDE
    sweep_wide(
        GRAPH, f, f0, lams, lam_, theta, power, eps2, jump, slots, ring, ring_pitch, from, to, top, bottom, wide_from,
        wide_to, out);
#else
    int slot = 0; /* of the next row of gradient norms */
    for (int row = top - jump; row < bottom + jump; ++row) {
        if (row >= 0 && row < n_rows) {
            const bool inner = row >= jump && row + jump < n_rows;
            __global real *its_ring = ring + (long)slot * G * ring_pitch;
            for (int x = wide_from; x < wide_to; x += N)
                if (INSIDE(x, inner))
                    gradient_pack(GRAPH, f, eps2, power, x, row, true, its_ring, ring_pitch);
                else
                    gradient_pack(GRAPH, f, eps2, power, x, row, false, its_ring, ring_pitch);
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
