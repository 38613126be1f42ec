/* y(u, .) = y(u, .) min(1, most(u)/|y(u, .)|),   in place
 *
 * The dual variable of a primal-dual step is made no longer than a slope can be, most = share q^((p - 1)/2).
 * EDGE_NORM: the same for each edge, with q = |df|^2 + eps^2 computed from f.
 *
 * One work item: the edges of one vertex (CSR) or of a pack of N (grid); no other work item reads or writes them.
 * Traffic per vertex with D neighbours: reads D M edge values twice and most (edge norm: once, D weights and (D + 1) M
 * values of f), writes D M.
 */
#include "curvature.cl"

__kernel void shorten(
    GRAPH_ARGS,
    __global const real *f_,   /* M channels; read with EDGE_NORM */
    __global const real *most, /* 1 channel; not read with EDGE_NORM */
    const real p,              /* read with EDGE_NORM, as the next */
    const real eps,
    /* input and output */
    __global real *y) /* M channels per directed edge */
{
    VERTEX
    realN square[1];
    square[0] = 0;
#ifdef EDGE_NORM
    realN f_u[M];
    for (int c = 0; c < M; ++c) f_u[c] = LOAD(f_, AT(u, c, M));
    NEIGHBOURS
        realN q = 0;
        square[0] = 0;
        for (int c = 0; c < M; ++c) {
            const realN y_e = LOAD(y, EDGE_AT(c, M)), d = DIFFERENCE(f_u[c], LOAD(f_, AT(v, c, M)));
            square[0] += y_e * y_e;
            q += SQUARED(d);
        }
        q = fmax(q + eps * eps, (realN)(SMALLEST));
        const realN length = sqrt(square[0]), longest = (real)0.5 * raise(q, (p - 1) / 2);
        const realN by = length > longest ? longest / length : (realN)(1);
        for (int c = 0; c < M; ++c) STORE(y, EDGE_AT(c, M), by * LOAD(y, EDGE_AT(c, M)));
    END
#else
    NEIGHBOURS
        for (int c = 0; c < M; ++c) {
            const realN y_e = LOAD(y, EDGE_AT(c, M));
            square[0] += y_e * y_e;
        }
    END
    COLLECT(square, 0, 1)
    const realN length = sqrt(square[0]), longest = LOAD(most, AT(u, 0, 1));
    const realN by = length > longest ? longest / length : (realN)(1);
    OFFSETS
    for (int c = 0; c < M; ++c) STORE(y, EDGE_AT(c, M), by * LOAD(y, EDGE_AT(c, M)));
END
#endif
}
