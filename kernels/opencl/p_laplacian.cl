/* p_laplacian(u) = sum_v w(u, v) (g(u) + g(v)) (f(u) - f(v)),   g = |grad_w f|^(p - 2)          (eq. 12)
 *
 * Without conductances (CONDUCTANCES not defined) g is 1: p = 2, the Laplacian of eq. 16.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex of D neighbours: reads D weights, (D + 1) M values and (D + 1) G conductances, of which a grid
 * finds all but M + G in the cache, on CSR also D indices; writes M numbers.
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif
#ifndef G
#define G 1
#endif

__kernel void p_laplacian(
    GRAPH_ARGS,
    __global const real *f, /* M channels */
    __global const real *g, /* G channels: the conductances; not read without CONDUCTANCES */
    /* output */
    __global real *out) /* M channels */
{
    VERTEX
    realN here[M], sum[M];
    for (int c = 0; c < M; ++c) {
        here[c] = LOAD(f, AT(u, c, M));
        sum[c] = 0;
    }
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
#ifdef CONDUCTANCES
            const int k_ = G == 1 ? 0 : c;
            const realN t = w * (LOAD(g, AT(u, k_, G)) + LOAD(g, AT(v, k_, G)));
#else
            const realN t = 2 * w;
#endif
            sum[c] += t * (here[c] - LOAD(f, AT(v, c, M)));
        }
    END
    for (int c = 0; c < M; ++c) STORE(out, AT(u, c, M), USED(sum[c]));
}
