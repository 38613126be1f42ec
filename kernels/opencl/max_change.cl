/* max_change = max over vertices and channels of |a - b|; infinity if any difference is not a number.
 *
 * One work item: some of the vertices, or packs of a row of a grid; sums.cl says which, and how the largest is found.
 * Traffic per vertex: reads 2 M values. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#define MAXIMUM
#include "sums.cl"

#ifndef M
#define M 1
#endif

__kernel void max_change(
    GRAPH_ARGS,
    const long segment,     /* vertices or packs of a work item; read without GROUP */
    __global const real *a, /* M channels */
    __global const real *b, /* M channels */
    /* output */
    __global long_sum *out) /* one part per work item, or per group with GROUP */
{
    realN largest = 0;
    SEGMENT_BEGIN
        for (int c = 0; c < M; ++c) {
            realN d = fabs(LOAD(a, AT(u, c, M)) - LOAD(b, AT(u, c, M)));
            /* fmax would drop a NaN: use infinity instead */
            d = isnan(d) ? (realN)(INFINITY) : d;
            largest = fmax(largest, USED(d));
        }
    SEGMENT_END
    WRITE_PART(largest_lane(largest))
}
