/* gradient_norm(u) = (|grad_w f(u)|^2 + eps^2)^power,   |grad_w f(u)|^2 = sum_v d_w(f)(u, v)^2
 *                                                                                  (eq. 9, 15, section 5.1)
 * With gamma = sqrt(w), d_w(f)(u, v)^2 = w(u, v) |f(v) - f(u)|^2. G = 1: one gradient norm for all M channels; G = M:
 * one per channel. power = 1/2 gives the local variation, (p - 2)/2 the conductances of the p-Laplacian, p/2 the
 * density of the energy.
 *
 * EDGE_NORM: (sum_v (d_w(f)(u, v)^2 + eps^2)^edge_power)^power instead, over the edges whose gamma is not 0; p/2 and
 * 1/p give the L^p norm of eq. 10.
 *
 * One work item: one vertex (CSR) or a pack of N (grid).
 * Traffic per vertex with D neighbours: reads D weights and (D + 1) M values (grid: all but M from the cache; CSR: also
 * D indices); writes G numbers.
 */
#include "squared_gradient.cl"

__kernel void gradient_norm(
    GRAPH_ARGS,
    __global const real *f, /* M channels */
    const real eps2,        /* eps^2 */
    const real power,
    const real edge_power, /* read with EDGE_NORM */
    /* output */
    __global real *out) /* G channels */
{
    VERTEX
    realN here[M], sum[G];
    for (int c = 0; c < M; ++c) here[c] = LOAD(f, AT(u, c, M));
    SUM_OF_SQUARES
    ONE_WRITES
    /* otherwise the numbers may lie in memory */
    _Pragma("unroll") for (int c = 0; c < G; ++c) STORE(out, AT(u, c, G), USED(raise(sum[c], power)));
}
