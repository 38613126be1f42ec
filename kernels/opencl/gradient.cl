/* gradient(u) = lam (f(u) - f0(u)) + p_laplacian(f)(u)
 *
 * The gradient of the energy (eq. 19), given the conductances (conductance.cl); 0 where lam is infinite. Without F0, f0
 * counts as 0: the result is the matrix of eq. 25 applied to f.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex: as p_laplacian, plus M values of f0, and lam.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#include "conductance.cl"

__kernel void gradient(
    GRAPH_ARGS,
    __global const real *f,  /* M channels */
    __global const real *f0, /* M channels; read with F0 */
    CONDUCTANCE_ARGS,
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN here[M], sum[M];
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    const laneN pinned = lam == (realN)(INFINITY);
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(f, AT(u, c, M));
        sum[c] = 0;
    }
    NEIGHBOURS
        CONDUCTANCES_OF_EDGE
        for (int c = 0; c < M; ++c) {
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M)));
            sum[c] -= conductance[SHARED(c)] * FLOW(d);
        }
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
    for (int c = 0; c < M; ++c) {
#ifdef F0
        const realN away = here[c] - LOAD(f0, AT(u, c, M));
#else
        const realN away = here[c];
#endif
        STORE(out, AT(u, c, M), USED(pinned ? (realN)(0) : sum[c] + lam * away));
    }
}
