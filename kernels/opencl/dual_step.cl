/* prox of sigma phi* at z(u, .) = y + beta_y (y - y_previous) + sigma d_w(f + beta (f - f_previous))
 *
 * x = z s/r with r = |z(u, .)|, s = r - sigma length(r) (prox.cl). EDGE_NORM: r = |z(u, v)|.
 * SIGMA_ARRAY: sigma(u) for the edges that start at u, with EDGE_NORM the smaller one of both ends.
 *
 * One work item: the edges of one vertex (CSR) or of a pack of N (grid); no other work item reads or writes them. A
 * norm over all edges needs z twice: z is stored in `out` first.
 * Traffic per vertex with D neighbours: reads D weights, 2 D M edge values and 2 (D + 1) M vertex values (grid: all but
 * 2 M of the latter from the cache; CSR: also D indices); writes D M numbers.
 */
#include "prox.cl"

__kernel void dual_step(
    GRAPH_ARGS,
    __global const real *y,          /* M channels per directed edge */
    __global const real *f,          /* M channels */
    __global const real *f_previous, /* M channels */
    const real beta,
    const real beta_y,
    __global const real *sigmas, /* 1 channel; read with SIGMA_ARRAY */
    const real sigma_,           /* read without SIGMA_ARRAY */
    const real p,
    const real eps,
    /* the previous y, and output */
    __global real *out) /* M channels per directed edge */
{
    VERTEX
    realN here[M], square[G];
#ifdef SIGMA_ARRAY
    const realN sigma_u = LOAD(sigmas, AT(u, 0, 1));
#else
    const realN sigma_u = (realN)(sigma_);
#endif
    for (int c = 0; c < M; ++c) {
        const realN f_u = LOAD(f, AT(u, c, M));
        here[c] = f_u + beta * (f_u - LOAD(f_previous, AT(u, c, M)));
    }
    for (int c = 0; c < G; ++c) square[c] = 0;
    NEIGHBOURS
        realN z[M];
#if defined(SIGMA_ARRAY) && defined(EDGE_NORM)
        const realN sigma = fmin(sigma_u, LOAD(sigmas, AT(v, 0, 1)));
#else
        const realN sigma = sigma_u;
#endif
        for (int c = 0; c < M; ++c) {
            const realN f_v = LOAD(f, AT(v, c, M)), y_e = LOAD(y, EDGE_AT(c, M));
            const realN d = DIFFERENCE(here[c], f_v + beta * (f_v - LOAD(f_previous, AT(v, c, M))));
            z[c] = USED(y_e + beta_y * (y_e - LOAD(out, EDGE_AT(c, M))) + sigma * DERIVED(d));
        }
#if PROX == 2
        for (int c = 0; c < M; ++c) STORE(out, EDGE_AT(c, M), prox_factor(0, sigma, p, eps) * z[c]);
#elif defined(EDGE_NORM)
        for (int c = 0; c < G; ++c) square[c] = 0;
        for (int c = 0; c < M; ++c) square[SHARED(c)] += z[c] * z[c];
        for (int c = 0; c < G; ++c) square[c] = prox_factor(square[c], sigma, p, eps);
        for (int c = 0; c < M; ++c) STORE(out, EDGE_AT(c, M), square[SHARED(c)] * z[c]);
#else
        for (int c = 0; c < M; ++c) {
            square[SHARED(c)] += z[c] * z[c];
            STORE(out, EDGE_AT(c, M), z[c]);
        }
#endif
    END
#if PROX != 2 && !defined(EDGE_NORM)
    COLLECT(square, 0, G)
    /* otherwise the numbers may lie in memory */
    _Pragma("unroll") for (int c = 0; c < G; ++c) square[c] = prox_factor(square[c], sigma_u, p, eps);
    OFFSETS
    for (int c = 0; c < M; ++c) STORE(out, EDGE_AT(c, M), square[SHARED(c)] * LOAD(out, EDGE_AT(c, M)));
END
#endif
}
