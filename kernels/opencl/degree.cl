/* degree(u) = sum_v gamma(u, v)^2, which is sum_v w(u, v) with gamma = sqrt(w)                      (section 2.1)
 * with LARGEST: max_v gamma(u, v)^2
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights (CSR: also D indices); writes one number.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

__kernel void degree(
    GRAPH_ARGS,
    /* output */
    __global real *out) /* 1 channel */
{
    VERTEX
    realN sum[1] = {0};
    NEIGHBOURS
#ifdef LARGEST
        sum[0] = fmax(sum[0], HOLD);
#else
        sum[0] += HOLD;
#endif
    END
    COLLECT(sum, 0, 1)
    ONE_WRITES
    STORE(out, AT(u, 0, 1), USED(sum[0]));
}
