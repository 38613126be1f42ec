/* energy = sum_u [ 1/p (|grad_w f(u)|^2 + eps^2)^(p/2) + lam(u)/2 |f(u) - f0(u)|^2 ]        (eq. 19, 20 with 15)
 *
 * EDGE_NORM: the first term is 1/(2 p) sum_v (d_w(f)(u, v)^2 + eps^2)^(p/2), over the edges whose gamma is not 0 (eq.
 * 30). With one gradient norm per channel (G = M) the first term is summed over channels. The second term is 0 where
 * lam is infinite, as f = f0 there.
 *
 * One work item: some of the vertices, or packs of a row of a grid; sums.cl says which, and how they are added.
 * Traffic per vertex with D neighbours: reads D weights, (D + 2) M values and lam (CSR: also D indices); with SUMS 2 M
 * values, G sums and lam.
 */
#include "squared_gradient.cl"
#include "sums.cl"

__kernel void energy(
    GRAPH_ARGS,
    const long segment,        /* vertices or packs of a work item; read without GROUP */
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    __global const real *sums, /* G channels: what SUM_OF_SQUARES gives, read with SUMS in its place */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    const real p,
    const real eps2, /* eps^2 */
    /* output */
    __global long_sum *out) /* one part per work item, or per group with GROUP */
{
#ifndef SUMS
    const real edge_power = p / 2;
#endif
    long_sum total = sum_start();
    SEGMENT_BEGIN
        realN here[M], sum[G], fidelity = 0;
        for (int c = 0; c < M; ++c) {
            here[c] = LOAD(f, AT(u, c, M));
            const realN d = here[c] - LOAD(f0, AT(u, c, M));
            fidelity += d * d;
        }
#ifdef SUMS
        for (int c = 0; c < G; ++c) sum[c] = LOAD(sums, AT(u, c, G));
#else
        SUM_OF_SQUARES
#endif
#ifdef LAM_ARRAY
        const realN lam = LOAD(lams, AT(u, 0, 1));
#else
        const realN lam = (realN)(lam_);
#endif
        realN density = isinf(lam) ? (realN)(0) : lam * fidelity / 2;
#ifdef EDGE_NORM
        for (int c = 0; c < G; ++c) density += sum[c] / (2 * p);
#else
        for (int c = 0; c < G; ++c) density += raise(sum[c], p / 2) / p;
#endif
        total = sum_add_pack(total, USED(density));
    SEGMENT_END
    WRITE_PART(total)
}
