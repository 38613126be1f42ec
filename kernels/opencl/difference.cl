/* difference(u, v) = gamma(v, u) f(v) - gamma(u, v) f(u)                          (eq. 4; the edge derivative of eq. 5)
 *
 * One work item: the edges of one vertex (CSR) or of a pack of N (grid).
 * Traffic per vertex of D neighbours: reads D weights and (D + 1) M values, of which a grid finds all but M in the
 * cache, on CSR also D indices; writes D M numbers, on a grid 0 where an edge leaves it.
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
