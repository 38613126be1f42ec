/* ascend(u) = y(u) + step(u) (r - A y)(u),   y(v) = step(v) r(v) + e(aggregate of v)
 *
 * The way up of a V-cycle on a level that is a stored graph: the correction e of the next level is added to the Jacobi
 * sweep from zero, and one more sweep is done (relax.cl has A). y is computed where it is needed and not stored. Where
 * step is 0, as at pinned vertices, the result is y.
 *
 * One work item: one vertex.
 * Traffic per vertex with D neighbours: reads D indices, D weights, D + 1 steps and aggregates, (D + 1) M values of r
 * and of e (most from the cache), and lam; writes M values.
 */
#include "csr.cl"

#ifndef M
#define M 1
#endif

/* y(v), c-th channel */
#define CORRECTED(v, a, by, c) ((by) * r[AT(v, c, M)] + ((a) >= 0 ? e_[(long)(a) * M + (c)] : 0))

__kernel void ascend(
    GRAPH_ARGS,
    __global const int *of,    /* (n,): the aggregate of each vertex, or -1 */
    __global const real *e_,   /* M channels, on the next level */
    __global const real *r,    /* M channels */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    __global const real *step, /* 1 channel */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    const real by = step[u];
    const int a = of[u];
#ifdef LAM_ARRAY
    const real lam = lams[u];
#else
    const real lam = lam_;
#endif
    real here[M], left[M];
    for (int c = 0; c < M; ++c) {
        here[c] = CORRECTED(u, a, by, c);
        left[c] = r[AT(u, c, M)] - lam * here[c];
    }
    NEIGHBOURS
        const real across = step[v];
        const int b = of[v];
        for (int c = 0; c < M; ++c) {
            const real d = DIFFERENCE(here[c], CORRECTED(v, b, across, c));
            left[c] += 2 * FLOW(d);
        }
    END
    /* lam is infinite at pinned vertices */
    for (int c = 0; c < M; ++c) out[AT(u, c, M)] = by == 0 ? here[c] : here[c] + by * left[c];
}
