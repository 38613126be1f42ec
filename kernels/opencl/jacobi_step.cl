/* One sweep of the Gauss-Jacobi process                                                       (eq. 25, 31)
 *
 *   J(u)   = (lam f0(u) + sum_v beta(u, v) f(v)) / (lam + sum_v alpha(u, v))
 *   out(u) = f(u) + theta (J(u) - f(u))
 *
 * alpha = gamma(u, v)^2 c(u, v), beta = gamma(u, v) gamma(v, u) c(u, v), c the conductance of the edge
 * (conductance.cl). lam is a number, or one value per vertex (LAM_ARRAY). Where lam is infinite, or the denominator is
 * at most SMALLEST (lam and all weights are about 0), out = f0. theta = 1 is the paper's process.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights, and (D + 2) M values, (D + 1) G conductances (none with the
 * edge norm) and lam (grid: all but 2 M + G + 1 from the cache; CSR: also D indices); writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#include "conductance.cl"

__kernel void jacobi_step(
    GRAPH_ARGS,
    __global const real *f,  /* M channels */
    __global const real *f0, /* M channels */
    CONDUCTANCE_ARGS,
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
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
    realN here[M], sum[M], total[G];
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(f, AT(u, c, M));
        sum[c] = 0;
    }
    for (int c = 0; c < G; ++c) total[c] = 0;
    NEIGHBOURS
        CONDUCTANCES_OF_EDGE
        for (int c = 0; c < G; ++c) total[c] += HOLD * conductance[c];
        for (int c = 0; c < M; ++c) sum[c] += PULL * conductance[SHARED(c)] * LOAD(f, AT(v, c, M));
    END
    COLLECT(total, 0, G)
    COLLECT(sum, G, M)
    ONE_WRITES
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M));
        const realN denominator = lam + total[SHARED(c)];
        const laneN keeps_data = isinf(lam) || !(denominator > SMALLEST);
        const realN plain = (lam * data + sum[c]) / denominator;
        const realN moved = here[c] + theta * (plain - here[c]);
        STORE(out, AT(u, c, M), USED(keeps_data ? data : (theta == (real)1 ? plain : moved)));
    }
}
