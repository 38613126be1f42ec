/* rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 over the offsets j of a patch                    (section 5.2)
 * similarity(u, v) = s(u, v) exp(-max(rho - shift, 0) scale)                               with -DSIMILARITY
 *
 * The similarity is w2 with scale = 1/h^2, and w1 with a patch of one pixel, scale = 1/sigma_X^2 and the spatial factor
 * s. shift = 2 sigma^2 sum_j g_j per channel takes the noise's share off the distance.
 * f comes padded by the patch's radius (numpy's "reflect"), so that no read of a patch leaves it: one work item never
 * asks where the border is.
 *
 * Grid: one work item gives a pack of N weights, of one forward offset h, in the layout of grid.cl, the zeros that lead
 * out of the grid or the mask included. CSR: one work item gives the weights of all edges of one vertex; `site` is where
 * its patch is centred in the padded f.
 * Traffic per edge of a patch of P offsets: reads 2 P M values, nearly all from the cache; writes one number.
 * Arithmetic per edge: 3 P M operations. (A kernel whose cost is independent of P is possible for flat patches.)
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

#ifdef SIMILARITY
#define EPILOGUE(rho, spatial) ((spatial) * exp(-fmax((rho) - shift, (realN)(0)) * scale))
#else
#define EPILOGUE(rho, spatial) (rho)
#endif

#define PATCH_ARGS                                                                                                   \
    __global const real *padded,       /* M channels of padded_plane values each */                                  \
    const long padded_plane,                                                                                         \
    const int n_patch,                                                                                               \
    __global const long *patch_jumps,  /* (n_patch,): steps inside padded */                                         \
    __global const real *g,            /* (n_patch,) */                                                              \
    const real shift,                                                                                                \
    const real scale

static inline realN patch_distance_between(
    __global const real *padded, const long padded_plane, const int n_patch, __global const long *patch_jumps,
    __global const real *g, const long a, const long b)
{
    realN rho = 0;
    for (int c = 0; c < M; ++c)
        for (int j = 0; j < n_patch; ++j) {
            const long at = c * padded_plane + patch_jumps[j];
            const realN d = LOAD(padded, at + a) - LOAD(padded, at + b);
            rho += g[j] * d * d;
        }
    return rho;
}

#ifdef GRID
__kernel void patch_distance(
    GRAPH_ARGS,
    PATCH_ARGS,
    __global const long *padded_rows,  /* (n_rows,): where the patch of each row's first cell is centred in padded */
    __global const real *spatial,      /* (H,) */
    __global const real *mask,         /* 1 channel, 1 inside; not read without MASKED */
    /* output */
    __global real *out)                /* weights, in the layout of grid.cl */
{
    if ((int)get_global_id(0) * N >= width) return;
    const int h = get_global_id(1), k = H + h;
    PACK_AT((int)get_global_id(0) * N, (int)get_global_id(2))
    const int step = offsets[k * NDIM + NDIM - 1];
    realN w = 0;
    if (ROW_EXISTS(k)) {
        const int row_v = row + row_jumps[k];
        const realN rho = patch_distance_between(
            padded, padded_plane, n_patch, patch_jumps, g, padded_rows[row] + x, padded_rows[row_v] + x + step);
        w = WHERE(used && x + LANES + step >= 0 && x + LANES + step < width, EPILOGUE(rho, spatial[h]));
#ifdef MASKED
        w = WHERE(LOAD(mask, u) > 0 && LOAD(mask, guard + row_v * pitch + x + step) > 0, w);
#endif
    }
    STORE(out, weight_guard + ((long)row * H + h) * weight_pitch + x, w);
}
#else
__kernel void patch_distance(
    GRAPH_ARGS,
    PATCH_ARGS,
    __global const long *site,     /* (n,) */
    __global const real *spatial,  /* (n_edges,); not read without SPATIAL */
    /* output */
    __global real *out)            /* (n_edges,) */
{
    VERTEX
    for (long e = indptr[u]; e < indptr[u + 1]; ++e) {
        const real rho = patch_distance_between(
            padded, padded_plane, n_patch, patch_jumps, g, site[u], site[indices[e]]);
#ifdef SPATIAL
        out[e] = EPILOGUE(rho, spatial[e]);
#else
        out[e] = EPILOGUE(rho, 1);
#endif
    }
}
#endif
