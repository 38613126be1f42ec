/* hessian(u) = lam h + d*[ g dh - s df ],           s = share (2 - p) q^((p - 4)/2) <df, dh>
 * with Y:      lam h + d*[ g dh - 1/2 (s y + t df) ],  s = (2 - p)/q <df, dh>,  t = (2 - p)/q <y, dh>
 *
 * The second derivatives of the energy, or the matrix of a primal-dual step with the dual variable y, applied to h;
 * g = share q^((p - 2)/2), q = |df|^2 + eps^2 over the edges of a vertex. The numbers g, s, t of each vertex are given.
 * EDGE_NORM: q is that of an edge, all is computed from f, and y(v, u) = -y(u, v). 0 where lam is infinite.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values and 2 or 3 (D + 1) numbers (grid: all but
 * those of u from the cache; CSR: also D indices), with Y 2 D M edge values (edge norm: D M), and lam; writes M values.
 */
#include "curvature.cl"

#ifdef Y
#define PARTS 2
#else
#define PARTS 1
#endif

__kernel void hessian(
    GRAPH_ARGS,
    __global const real *h_,       /* M channels */
    __global const real *f_,       /* M channels */
    __global const real *y,        /* M channels per directed edge; read with Y */
    __global const real *g,        /* 1 channel; not read with EDGE_NORM */
    __global const real *products, /* 1 channel: s; with Y 2: s and t; not read with EDGE_NORM */
    __global const real *lams,     /* 1 channel; read with LAM_ARRAY */
    const real lam_,               /* read without LAM_ARRAY */
    const real p,                  /* read with EDGE_NORM, as the next two */
    const real eps,
    const real floor_,
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN f_u[M], h_u[M], sum[M];
    for (int c = 0; c < M; ++c) {
        f_u[c] = LOAD(f_, AT(u, c, M));
        h_u[c] = LOAD(h_, AT(u, c, M));
        sum[c] = 0;
    }
#ifndef EDGE_NORM
    const realN g_u = LOAD(g, AT(u, 0, 1)), s_u = LOAD(products, AT(u, 0, PARTS));
#ifdef Y
    const realN t_u = LOAD(products, AT(u, 1, PARTS));
#endif
#endif
    NEIGHBOURS
#ifdef EDGE_NORM
        realN df[M], dh[M], q = 0, along = 0, across = 0;
        for (int c = 0; c < M; ++c) {
            df[c] = DIFFERENCE(f_u[c], LOAD(f_, AT(v, c, M)));
            dh[c] = DIFFERENCE(h_u[c], LOAD(h_, AT(v, c, M)));
            q += SQUARED(df[c]);
            along += DERIVED(df[c]) * DERIVED(dh[c]);
#ifdef Y
            across += LOAD(y, EDGE_AT(c, M)) * DERIVED(dh[c]);
#endif
        }
        q = fmax(q + eps * eps, (realN)(SMALLEST));
        const realN conductance = 2 * EDGE_G(q), factor = EDGE_FACTOR(q);
        for (int c = 0; c < M; ++c) {
#ifdef Y
            sum[c] += USED(
                conductance * FLOW(dh[c]) - factor * (OWN * LOAD(y, EDGE_AT(c, M)) * along + FLOW(df[c]) * across));
#else
            sum[c] += USED(conductance * FLOW(dh[c]) - 2 * factor * along * FLOW(df[c]));
#endif
        }
#else
        const realN conductance = g_u + LOAD(g, AT(v, 0, 1)), s_v = LOAD(products, AT(v, 0, PARTS));
#ifdef Y
        const realN t = (t_u + LOAD(products, AT(v, 1, PARTS))) / 2;
#else
        const realN t = s_u + s_v;
#endif
        for (int c = 0; c < M; ++c) {
            const realN df = DIFFERENCE(f_u[c], LOAD(f_, AT(v, c, M))), dh = DIFFERENCE(h_u[c], LOAD(h_, AT(v, c, M)));
            sum[c] += conductance * FLOW(dh) - t * FLOW(df);
#ifdef Y
            sum[c] += OWN * (s_v * LOAD(y, OPPOSITE_AT(c, M)) - s_u * LOAD(y, EDGE_AT(c, M))) / 2;
#endif
        }
#endif
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    const laneN pinned = lam == (realN)(INFINITY);
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(pinned ? (realN)(0) : lam * h_u[c] - sum[c]));
}
