/* sum_u [phi(|grad_w f(u)|) + phi*(|y(u, .)|) - sum_v d_w(f)(u, v) y(u, v) + |lam (f - f0) + adjoint(y)|^2 / (2 lam)]
 *
 * The energy of f minus the dual energy of y, phi(t) = (t^2 + eps^2)^(p/2) / p (prox.cl); all terms are >= 0.
 * EDGE_NORM: phi/2 and its conjugate per edge. The last term is 0 where lam is infinite. BOX: f lies in
 * the box, lam may be 0, and with s = adjoint(y) and fhat = clip(f0 - s / lam, low, high) the last term is
 *
 *   lam / 2 (f - fhat)^2 + (s + lam (fhat - f0)) (f - fhat)      lam = 0: max(s, 0) (f - low) + max(-s, 0) (high - f)
 *
 * One work item: some of the vertices, or packs of a row of a grid; sums.cl says which, and how they are added.
 * Traffic per vertex with D neighbours: reads D weights, 2 D M edge values (grid: half of them from the cache), (D + 2)
 * M vertex values and lam (BOX: and 2 M values); CSR: also D indices of neighbours and D of opposite edges.
 */
#include "prox.cl"
#include "sums.cl"

/* phi + phi* - product, for one norm. */
#define DUALITY(c) (SHARE * raise(derivative[c] + eps * eps, p / 2) / p + conjugate(dual[c], p, eps) - product[c])

__kernel void duality_gap(
    GRAPH_ARGS,
    const long segment,         /* vertices or packs of a work item; read without GROUP */
    __global const real *f,     /* M channels */
    __global const real *y,     /* M channels per directed edge */
    __global const real *f0,    /* M channels */
    __global const real *lams,  /* 1 channel; read with LAM_ARRAY */
    const real lam_,            /* read without LAM_ARRAY */
    __global const real *lows,  /* M channels; read with BOX */
    __global const real *highs, /* M channels; read with BOX */
    const real p,
    const real eps,
    /* output */
    __global long_sum *out) /* one part per work item, or per group with GROUP */
{
    long_sum total = sum_start();
    SEGMENT_BEGIN
        realN here[M], residual[M], derivative[G], dual[G], product[G], terms = 0;
#ifdef LAM_ARRAY
        const realN lam = LOAD(lams, AT(u, 0, 1));
#else
        const realN lam = (realN)(lam_);
#endif
        const laneN pinned = lam == (realN)(INFINITY);
        for (int c = 0; c < M; ++c) {
            here[c] = LOAD(f, AT(u, c, M));
#ifdef BOX
            residual[c] = 0;
#else
            residual[c] = (pinned ? (realN)(0) : lam) * (here[c] - LOAD(f0, AT(u, c, M)));
#endif
        }
        for (int c = 0; c < G; ++c) derivative[c] = dual[c] = product[c] = 0;
        NEIGHBOURS
#ifdef EDGE_NORM
            for (int c = 0; c < G; ++c) derivative[c] = dual[c] = product[c] = 0;
#endif
            for (int c = 0; c < M; ++c) {
                const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M))), y_e = LOAD(y, EDGE_AT(c, M));
                derivative[SHARED(c)] += SQUARED(d);
                dual[SHARED(c)] += y_e * y_e;
                product[SHARED(c)] += DERIVED(d) * y_e;
                residual[c] += OWN * (LOAD(y, OPPOSITE_AT(c, M)) - y_e);
            }
#ifdef EDGE_NORM
            for (int c = 0; c < G; ++c) terms += DUALITY(c);
#endif
        END
#ifndef EDGE_NORM
        for (int c = 0; c < G; ++c) terms += DUALITY(c);
#endif
#ifdef BOX
        const laneN known = lam > 0 && !pinned;
        const realN pull = known ? lam : (realN)(1);
        for (int c = 0; c < M; ++c) {
            const realN s = residual[c], data = LOAD(f0, AT(u, c, M));
            const realN low = LOAD(lows, AT(u, c, M)), high = LOAD(highs, AT(u, c, M));
            const realN free_hat = data - s / pull, hat = fmin(fmax(free_hat, low), high);
            const realN apart = here[c] - hat, unmet = pull * (here[c] - data) + s;
            const realN at_end = apart * (pull / 2 * apart + s + pull * (hat - data));
            const realN with_data = free_hat == hat ? unmet * unmet / (2 * pull) : at_end;
            /* an end may be infinite where s is 0 */
            const realN without =
                (s > 0 ? s * (here[c] - low) : (realN)(0)) + (s < 0 ? s * (here[c] - high) : (realN)(0));
            terms += pinned ? (realN)(0) : known ? with_data : without;
        }
#else
        for (int c = 0; c < M; ++c) terms += pinned ? (realN)(0) : residual[c] * residual[c] / (2 * lam);
#endif
        total = sum_add_pack(total, USED(terms));
    SEGMENT_END
    WRITE_PART(total)
}
