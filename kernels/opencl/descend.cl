/* descend(a) = sum over the vertices u of the aggregate a of (r - A x)(u),   x = step r
 *
 * The way down of a V-cycle on a level that is a stored graph: the residual of one Jacobi sweep from zero, summed over
 * the aggregates (relax.cl has A, restrict.cl the lists). x is computed where it is needed and not stored, so that a
 * level takes one launch each way.
 *
 * One work item: one aggregate.
 * Traffic per vertex with D neighbours: reads its place, D indices, D weights, D + 1 steps, (D + 1) M values of r (most
 * from the cache) and lam; per aggregate: reads a start, writes M values.
 */
#include "csr.cl"

#ifndef M
#define M 1
#endif

__kernel void descend(
    GRAPH_ARGS,
    const long aggregates,
    __global const int *starts,  /* (aggregates + 1,): where the list of each aggregate begins */
    __global const int *members, /* vertices */
    __global const real *r,      /* M channels */
    __global const real *lams,   /* 1 channel; read with LAM_ARRAY */
    const real lam_,             /* read without LAM_ARRAY */
    __global const real *step,   /* 1 channel */
    /* output */
    __global real *out) /* (aggregates, M) */
{
    const long a = get_global_id(0);
    if (a >= aggregates) return;
    real sum[M];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    for (int i = starts[a]; i < starts[a + 1]; ++i) {
        const long u = members[i];
        const real by = step[u];
#ifdef LAM_ARRAY
        const real lam = lams[u];
#else
        const real lam = lam_;
#endif
        real here[M];
        for (int c = 0; c < M; ++c) {
            const real r_u = r[AT(u, c, M)];
            here[c] = by * r_u;
            sum[c] += r_u - lam * here[c];
        }
        NEIGHBOURS
            const real across = step[v];
            for (int c = 0; c < M; ++c) {
                const real d = DIFFERENCE(here[c], across * r[AT(v, c, M)]);
                sum[c] += 2 * FLOW(d);
            }
        END
    }
    for (int c = 0; c < M; ++c) out[a * M + c] = sum[c];
}
