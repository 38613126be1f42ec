/* relax(u) = x(u) + step(u) (r(u) - (A x)(u))
 *
 * One Jacobi sweep for A x = r, step = omega/diagonal, with the matrix of eq. 25 at p = 2:
 *
 *     (A x)(u) = lam(u) x(u) + 2 sum_v gamma(u, v) (gamma(u, v) x(u) - gamma(v, u) x(v))
 *
 * Where step is 0, as at pinned vertices, the result is x.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex: as gradient with lam, plus M values of r, and step.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void relax(
    GRAPH_ARGS,
    __global const real *x_,   /* M channels */
    __global const real *r,    /* M channels */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    __global const real *step, /* 1 channel */
    /* output */
    __global real *out) /* M channels; another buffer than x_ */
{
    VERTEX
    realN here[M], sum[M];
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(x_, AT(u, c, M));
        sum[c] = 0;
    }
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN d = DIFFERENCE(here[c], LOAD(x_, AT(v, c, M)));
            sum[c] += FLOW(d);
        }
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
    const realN by = LOAD(step, AT(u, 0, 1));
    for (int c = 0; c < M; ++c) {
        const realN left = LOAD(r, AT(u, c, M)) + 2 * sum[c] - lam * here[c];
        /* lam is infinite at pinned vertices */
        STORE(out, AT(u, c, M), USED(by == 0 ? here[c] : here[c] + by * left));
    }
}
