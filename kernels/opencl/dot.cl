/* dot = sum_u a(u) b(u) / over(u)
 *
 * The term is 0 where over is infinite.
 *
 * One work item: a segment of vertices (CSR) or of packs of a row (grid); it writes its sum; the host adds the sums.
 * The kernel is named dot_product, as OpenCL C has a built-in dot.
 * Traffic per vertex: reads 2 M values and over. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void dot_product(
    GRAPH_ARGS,
    const long segment,
    __global const real *a, /* M channels */
    __global const real *b, /* M channels */
    OVER_ARGS,
    /* output */
    __global sum_t *out) /* one number per segment */
{
    long_sum total = sum_start();
    SEGMENT_BEGIN
        for (int c = 0; c < M; ++c) {
            const realN product = LOAD(a, AT(u, c, M)) * LOAD(b, AT(u, c, M));
            total = sum_add_pack(total, USED(OVER_OF(product, c)));
        }
    SEGMENT_END
    out[SEGMENT_INDEX] = sum_value(total);
}
