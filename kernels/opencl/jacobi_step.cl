/* One sweep of the Gauss-Jacobi process                                                       (eq. 25, 31)
 *
 *   J(u)   = (lam f0(u) + sum_v a(u, v) f(v)) / (lam + sum_v a(u, v)),   a(u, v) = w(u, v) (g(u) + g(v))
 *   out(u) = f(u) + theta (J(u) - f(u))
 *
 * g = |grad_w f|^(p - 2), or 1 without conductances (CONDUCTANCES not defined; p = 2). lam is a number, or one value per
 * vertex (LAM_ARRAY). Where lam is infinite, or the denominator is not above SMALLEST (lam and
 * all weights are 0, or nearly), out = f0. theta = 1 is the paper's process.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex of D neighbours: reads D weights, (D + 2) M values, (D + 1) G conductances and lam, of which a grid
 * finds all but 2 M + G + 1 in the cache, on CSR also D indices; writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif
#ifndef G
#define G 1
#endif

__kernel void jacobi_step(
    GRAPH_ARGS,
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    __global const real *g,    /* G channels: the conductances; not read without CONDUCTANCES */
    __global const real *lams, /* 1 channel; not read without LAM_ARRAY */
    const real lam_,           /* not read with LAM_ARRAY */
    const real theta,
    /* output */
    __global real *out) /* M channels; not f */
{
    VERTEX
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    realN sum[M], total[G];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    for (int c = 0; c < G; ++c) total[c] = 0;
    NEIGHBOURS
#ifdef CONDUCTANCES
        realN a[G];
        for (int c = 0; c < G; ++c) a[c] = w * (LOAD(g, AT(u, c, G)) + LOAD(g, AT(v, c, G)));
#else
        const realN a[1] = {2 * w};
#endif
        for (int c = 0; c < G; ++c) total[c] += a[c];
        for (int c = 0; c < M; ++c) sum[c] += a[G == 1 ? 0 : c] * LOAD(f, AT(v, c, M));
    END
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M));
        const realN old = LOAD(f, AT(u, c, M));
        const realN denominator = lam + total[G == 1 ? 0 : c];
        const laneN keeps_data = isinf(lam) || !(denominator > SMALLEST);
        const realN moved = old + theta * ((lam * data + sum[c]) / denominator - old);
        const realN plain = (lam * data + sum[c]) / denominator;
        STORE(out, AT(u, c, M), USED(keeps_data ? data : (theta == (real)1 ? plain : moved)));
    }
}
