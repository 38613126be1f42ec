/* combine(u) = a x(u) + b y(u) / over(u)
 *
 * Where over is infinite: a x(u).
 *
 * One work item: one vertex (CSR) or a pack of N (grid); it reads only its own numbers, so that out may be x or y.
 * Traffic per vertex: reads 2 M values and over, writes M. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void combine(
    GRAPH_ARGS,
    const real a,
    __global const real *x_, /* M channels */
    const real b,
    __global const real *y_, /* M channels */
    OVER_ARGS,
    /* output */
    __global real *out) /* M channels; x_, y_ or another buffer */
{
    VERTEX
    for (int c = 0; c < M; ++c) {
        const realN second = LOAD(y_, AT(u, c, M));
        STORE(out, AT(u, c, M), USED(a * LOAD(x_, AT(u, c, M)) + b * OVER_OF(second, c)));
    }
}
