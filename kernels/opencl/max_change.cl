/* max_change = max over vertices and channels of |a - b|; infinity if any difference is not a number.
 *
 * One work item: a segment of vertices (CSR) or of packs of a row (grid); it writes its maximum; the host takes the
 * largest one. Traffic per vertex: reads 2 M values. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void max_change(
    GRAPH_ARGS,
    const long segment,
    __global const real *a, /* M channels */
    __global const real *b, /* M channels */
    /* output */
    __global real *out) /* one number per segment */
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
    out[SEGMENT_INDEX] = largest_lane(largest);
}
