/* adjoint(u) = sum_v gamma(u, v) (H(v, u) - H(u, v))                                     (eq. 7, Proposition 1)
 *
 * The divergence is -adjoint.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights and 2 D M edge values (grid: half of them from the cache; CSR:
 * also D indices of opposite edges); writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void adjoint(
    GRAPH_ARGS,
    __global const real *H_, /* M channels per directed edge */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN sum[M];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) sum[c] += OWN * (LOAD(H_, OPPOSITE_AT(c, M)) - LOAD(H_, EDGE_AT(c, M)));
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(sum[c]));
}
