/* One step of the explicit Euler process                                                          (eq. 24)
 *
 *   out(u) = f(u) + tau (lam (f0(u) - f(u)) - p_laplacian(f)(u))
 *
 * tau is a number, or one value per vertex (TAU_ARRAY: gamma with a factor of the vertex's own is a change of variable,
 * which changes the step too); lam likewise (LAM_ARRAY). Where lam is infinite, out = f0. The p-Laplacian is eq. 12
 * with the conductances of conductance.cl.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex of D neighbours: reads D weights, (D + 2) M values, (D + 1) G conductances (none with the edge
 * norm), lam and tau, of which a grid finds all but 2 M + G + 2 in the cache, on CSR also D indices; writes M numbers.
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
    __global const real *lams, /* 1 channel; not read without LAM_ARRAY */
    const real lam_,           /* not read with LAM_ARRAY */
    __global const real *taus, /* 1 channel; not read without TAU_ARRAY */
    const real tau_,           /* not read with TAU_ARRAY */
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
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M));
        const realN moved = here[c] + tau * (lam * (data - here[c]) + sum[c]);
        STORE(out, AT(u, c, M), USED(isinf(lam) ? data : moved));
    }
}
