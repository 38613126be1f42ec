/* dot = sum_u a(u) b(u) / over(u)
 *
 * The term is 0 where over is infinite.
 *
 * One work item: some of the vertices, or packs of a row of a grid; sums.cl says which, and how they are added.
 * The kernel is named dot_product, as OpenCL C has a built-in dot.
 * Traffic per vertex: reads 2 M values and over. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif
#include "sums.cl"

#ifndef M
#define M 1
#endif

__kernel void dot_product(
    GRAPH_ARGS,
    const long segment,     /* vertices or packs of a work item; read without GROUP */
    __global const real *a, /* M channels */
    __global const real *b, /* M channels */
    OVER_ARGS,
    /* output */
    __global long_sum *out) /* one part per work item, or per group with GROUP */
{
    long_sum total = sum_start();
    SEGMENT_BEGIN
        for (int c = 0; c < M; ++c) {
            const realN product = LOAD(a, AT(u, c, M)) * LOAD(b, AT(u, c, M));
            total = sum_add_pack(total, USED(OVER_OF(product, c)));
        }
    SEGMENT_END
    WRITE_PART(total)
}
