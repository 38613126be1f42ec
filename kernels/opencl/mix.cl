/* out_q(u) = sum_c matrix[q, c] f_c(u)
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex: reads m values, writes m_out. The weights are not read.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

/* `mix` is a built-in function of OpenCL C. */
__kernel void mix_channels(
    GRAPH_ARGS,
    const int m, /* channels of f, and of the result */
    const int m_out,
    __global const real *matrix, /* (m_out, m) */
    __global const real *f,      /* m channels */
    /* output */
    __global real *out) /* m_out channels; another buffer than f */
{
    VERTEX
    for (int q = 0; q < m_out; ++q) {
        realN sum = matrix[q * m] * LOAD(f, AT(u, 0, m));
        for (int c = 1; c < m; ++c) sum += matrix[q * m + c] * LOAD(f, AT(u, c, m));
        STORE(out, AT(u, q, m_out), USED(sum));
    }
}
