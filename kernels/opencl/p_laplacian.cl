/* p_laplacian(u) = sum_v gamma(u, v) c(u, v) (gamma(u, v) f(u) - gamma(v, u) f(v))                      (eq. 12)
 *
 * c is the conductance of the edge (conductance.cl): g(u) + g(v) with g = |grad_w f|^(p - 2), 2 for p = 2 (eq. 16), or,
 * with the edge norm, |d_w(f)(u, v)|^(p - 2) (the derivative of eq. 30).
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights, and (D + 1) M values and (D + 1) G conductances (none with the
 * edge norm; grid: all but M + G from the cache; CSR: also D indices); writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#include "conductance.cl"

__kernel void p_laplacian(
    GRAPH_ARGS,
    __global const real *f, /* M channels */
    CONDUCTANCE_ARGS,
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN here[M], sum[M];
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
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(sum[c]));
}
