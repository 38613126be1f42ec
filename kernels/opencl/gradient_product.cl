/* gradient_product(u) = by(u) <df, dh>(u, .),   given y also by(u) <y, dh>(u, .)
 *
 * Inner products over the edges of a vertex and the channels, d the difference d_w (eq. 4).
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights, 2 (D + 1) M values (grid: all but 2 M from the cache; CSR: also
 * D indices), by, and with Y D M edge values; writes 1 or 2 numbers.
 */
#include "curvature.cl"

__kernel void gradient_product(
    GRAPH_ARGS,
    __global const real *f_, /* M channels */
    __global const real *h_, /* M channels */
    __global const real *by, /* 1 channel */
    __global const real *y,  /* M channels per directed edge; read with Y */
    /* output */
    __global real *out) /* 1 channel, with Y 2 */
{
    VERTEX
    realN f_u[M], h_u[M], sum[2];
    for (int c = 0; c < M; ++c) {
        f_u[c] = LOAD(f_, AT(u, c, M));
        h_u[c] = LOAD(h_, AT(u, c, M));
    }
    sum[0] = sum[1] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN df = DIFFERENCE(f_u[c], LOAD(f_, AT(v, c, M))), dh = DIFFERENCE(h_u[c], LOAD(h_, AT(v, c, M)));
#ifdef Y
            const realN slope = DERIVED(dh);
            sum[0] += DERIVED(df) * slope;
            sum[1] += LOAD(y, EDGE_AT(c, M)) * slope;
#else
            sum[0] += DERIVED(df) * DERIVED(dh);
#endif
        }
    END
    COLLECT(sum, 0, 2)
    ONE_WRITES
    const realN factor = LOAD(by, AT(u, 0, 1));
#ifdef Y
    STORE(out, AT(u, 0, 2), USED(factor * sum[0]));
    STORE(out, AT(u, 1, 2), USED(factor * sum[1]));
#else
    STORE(out, AT(u, 0, 1), USED(factor * sum[0]));
#endif
}
