/* gradient_norm(u) = (|grad_w f(u)|^2 + eps^2)^power,   |grad_w f(u)|^2 = sum_v w(u, v) |f(v) - f(u)|^2
 *                                                                                  (eq. 9, 15, section 5.1)
 * One gradient norm for all M channels (G = 1), or one each (G = M). power 1/2 gives the local variation, (p - 2)/2 the
 * conductances of the p-Laplacian, p/2 the density of the energy. The power is taken of the sum, never of a root.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex of D neighbours: reads D weights and (D + 1) M values, of which a grid finds all but M in the
 * cache, on CSR also D indices; writes G numbers.
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

__kernel void gradient_norm(
    GRAPH_ARGS,
    __global const real *f, /* M channels */
    const real eps2,        /* eps^2 */
    const real power,
    /* output */
    __global real *out) /* G channels */
{
    VERTEX
    realN here[M], sum[G];
    for (int c = 0; c < M; ++c) here[c] = LOAD(f, AT(u, c, M));
    for (int c = 0; c < G; ++c) sum[c] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN d = LOAD(f, AT(v, c, M)) - here[c];
            sum[G == 1 ? 0 : c] += w * d * d;
        }
    END
    for (int c = 0; c < G; ++c) STORE(out, AT(u, c, G), USED(raise(sum[c] + eps2, power)));
}
