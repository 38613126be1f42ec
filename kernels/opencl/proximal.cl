/* proximal(u) = (f - tau s + tau lam f0) / (1 + tau lam), clipped to [low, high],   s = adjoint(y)
 *
 * f0 where lam is infinite. BOX: clipped. The share of f0 is w / (1 + w) with w = tau lam, so that neither a small w nor
 * an infinite one loses digits.
 *
 * One work item: one vertex (CSR) or a pack of N (grid). `out` may be f.
 * Traffic per vertex: as adjoint, plus 2 M values of f and f0, lam, tau (BOX: and 2 M values).
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

__kernel void proximal(
    GRAPH_ARGS,
    __global const real *f,     /* M channels */
    __global const real *y,     /* M channels per directed edge */
    __global const real *f0,    /* M channels */
    __global const real *lams,  /* 1 channel; read with LAM_ARRAY */
    const real lam_,            /* read without LAM_ARRAY */
    __global const real *taus,  /* 1 channel; read with TAU_ARRAY */
    const real tau_,            /* read without TAU_ARRAY */
    __global const real *lows,  /* M channels; read with BOX */
    __global const real *highs, /* M channels; read with BOX */
    /* output */
    __global real *out) /* M channels; may be f */
{
    VERTEX
    realN sum[M];
    for (int c = 0; c < M; ++c) sum[c] = 0;
    NEIGHBOURS
        for (int c = 0; c < M; ++c) sum[c] += OWN * (LOAD(y, OPPOSITE_AT(c, M)) - LOAD(y, EDGE_AT(c, M)));
    END
    COLLECT(sum, 0, M)
    ONE_WRITES
#ifdef LAM_ARRAY
    const realN lam = LOAD(lams, AT(u, 0, 1));
#else
    const realN lam = (realN)(lam_);
#endif
#ifdef TAU_ARRAY
    const realN tau = LOAD(taus, AT(u, 0, 1));
#else
    const realN tau = (realN)(tau_);
#endif
    const laneN pinned = lam == (realN)(INFINITY);
    const realN w = tau * lam, share = w > 1 ? 1 / (1 + 1 / w) : w / (1 + w);
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, AT(u, c, M)), from = LOAD(f, AT(u, c, M)) - tau * sum[c];
        realN moved = from + share * (data - from);
#ifdef BOX
        moved = fmin(fmax(moved, LOAD(lows, AT(u, c, M))), LOAD(highs, AT(u, c, M)));
#endif
        STORE(out, AT(u, c, M), USED(pinned ? data : moved));
    }
}
