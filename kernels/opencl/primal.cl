/* primal(u) = f0(u) - adjoint(y)(u) / lam(u)
 *
 * The function f of a dual variable y; f0 where lam is infinite.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex: as adjoint, plus M values of f0, and lam.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void primal(
    GRAPH_ARGS,
    __global const real *y,    /* M channels per directed edge */
    __global const real *f0,   /* M channels */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN sum[M];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) sum[c] += OWN * (LOAD(y, OPPOSITE_AT(c, M)) - LOAD(y, EDGE_AT(c, M)));
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(LOAD(f0, AT(u, c, M)) - sum[c] / lam));
}
