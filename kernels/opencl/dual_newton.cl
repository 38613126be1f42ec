/* y(u, v) = g(u) (df + dh)(u, v) - s(u) y(u, v),   in place
 *
 * Newton's step h of the dual variable: g = share q^((p - 2)/2), s = (2 - p)/q <df, dh>, q = |df|^2 + eps^2 over the
 * edges of a vertex. The numbers g and s of each vertex are given. EDGE_NORM: those of each edge, computed from f.
 *
 * One work item: the edges of one vertex (CSR) or of a pack of N (grid); no other work item reads or writes them.
 * Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values (grid: all but 2 M from the cache; CSR: also
 * D indices), g, the products and D M edge values; writes D M.
 */
#define Y
#include "curvature.cl"

__kernel void dual_newton(
    GRAPH_ARGS,
    __global const real *f_,       /* M channels */
    __global const real *h_,       /* M channels */
    __global const real *g,        /* 1 channel; not read with EDGE_NORM */
    __global const real *products, /* 2 channels, of which the first is s; not read with EDGE_NORM */
    const real p,                  /* read with EDGE_NORM, as the next two */
    const real eps,
    const real floor_,
    /* input and output */
    __global real *y) /* M channels per directed edge */
{
    VERTEX
    realN f_u[M], h_u[M];
    for (int c = 0; c < M; ++c) {
        f_u[c] = LOAD(f_, AT(u, c, M));
        h_u[c] = LOAD(h_, AT(u, c, M));
    }
#ifndef EDGE_NORM
    const realN by = LOAD(g, AT(u, 0, 1)), along = LOAD(products, AT(u, 0, 2));
#endif
    NEIGHBOURS
        realN df[M], dh[M];
        for (int c = 0; c < M; ++c) {
            df[c] = DIFFERENCE(f_u[c], LOAD(f_, AT(v, c, M)));
            dh[c] = DIFFERENCE(h_u[c], LOAD(h_, AT(v, c, M)));
        }
#ifdef EDGE_NORM
        realN q = 0, along = 0;
        for (int c = 0; c < M; ++c) {
            q += SQUARED(df[c]);
            along += DERIVED(df[c]) * DERIVED(dh[c]);
        }
        q = fmax(q + eps * eps, (realN)(SMALLEST));
        const realN by = EDGE_G(q);
        along *= EDGE_FACTOR(q);
#endif
        for (int c = 0; c < M; ++c) {
            const realN y_e = LOAD(y, EDGE_AT(c, M));
            STORE(y, EDGE_AT(c, M), USED(by * (DERIVED(df[c]) + DERIVED(dh[c])) - along * y_e));
        }
    END
}
