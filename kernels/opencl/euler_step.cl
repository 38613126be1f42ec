/* One step of the explicit Euler process                                                          (eq. 24)
 *
 *   out(u) = f(u) + tau (lam (f0(u) - f(u)) - p_laplacian(f)(u))
 *
 * tau is a number, or one value per vertex (TAU_ARRAY: a factor of gamma per vertex is a change of variable, which also
 * changes the step); lam likewise (LAM_ARRAY). Where lam is infinite, out = f0. The p-Laplacian is eq. 12 with the
 * conductances of conductance.cl.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights, and (D + 2) M values, (D + 1) G conductances (none with the
 * edge norm), lam and tau (grid: all but 2 M + G + 2 from the cache; CSR: also D indices); writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#include "conductance.cl"

__kernel void euler_step(
    GRAPH_ARGS,
    __global const real *f,  /* M channels */
    __global const real *f0, /* M channels */
    CONDUCTANCE_ARGS,
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    __global const real *taus, /* 1 channel; read with TAU_ARRAY */
    const real tau_,           /* read without TAU_ARRAY */
    /* output */
    __global real *out) /* M channels; not f */
{
    VERTEX
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
#ifdef TAU_ARRAY
    const realN tau = LOAD(taus, AT(u, 0, 1));
#else
    const realN tau = (realN)(tau_);
#endif
    realN here[M], sum[M];
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(f, AT(u, c, M));
        sum[c] = 0;
    }
    NEIGHBOURS
        CONDUCTANCES_OF_EDGE
        for (int c = 0; c < M; ++c) {
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M)));
            sum[c] += conductance[SHARED(c)] * FLOW(d);
        }
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M));
        const realN moved = here[c] + tau * (lam * (data - here[c]) + sum[c]);
        STORE(out, AT(u, c, M), USED(isinf(lam) ? data : moved));
    }
}
