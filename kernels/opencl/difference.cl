/* difference(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u)                          (eq. 4; the edge derivative of eq. 5)
 *
 * One work item: the edges of one vertex (CSR) or of a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights and (D + 1) M values (grid: all but M from the cache; CSR: also
 * D indices); writes D M numbers, 0 where an edge leaves the grid.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void difference(
    GRAPH_ARGS,
    __global const real *f, /* M channels */
    /* output */
    __global real *out) /* M channels per directed edge */
{
    VERTEX
    realN here[M];
    for (int c = 0; c < M; ++c) here[c] = LOAD(f, AT(u, c, M));
    CLEAR_EDGES(out, M)
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M)));
            STORE(out, EDGE_AT(c, M), USED(DERIVED(d)));
        }
    END
}
