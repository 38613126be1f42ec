/* rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2 over the offsets j of a patch                    (section 5.2)
 * similarity(u, v) = s(u, v) exp(-max(rho - shift, 0) scale)                               with -DSIMILARITY
 *                  = s(u, v) exp(-max(rho - shift - a(u) - a(v), 0) scale q(u) q(v))       and -DMAPS
 *
 * The similarity is w2 with scale = 1/h^2, and w1 with a patch of one pixel, scale = 1/sigma_X^2 and the spatial factor
 * s. Exponentials below `cut` count as 0. shift = 2 sigma^2 sum_j g_j per channel subtracts the contribution of noise
 * from the distance. f is padded by the radius of the patch (numpy's "reflect"), so that no patch leaves it.
 *
 * Grid: one work item computes the weights of all forward offsets on a block of cells (see strip.cl), in the layout of
 * grid.cl, including the zeros where an edge leaves the grid or the mask.
 * CSR: one work item computes the weights of all edges of one vertex; `site` is the centre of its patch in the padded
 * f.
 * Traffic per edge with a patch of P offsets: on a grid all from the cache; CSR: reads 2 P M values, mostly from the
 * cache; writes one number. Arithmetic per edge on CSR: 3 P M operations.
 */
#ifdef GRID
#include "strip.cl"
#else
#include "csr.cl"

#ifndef M
#define M 1
#endif
#endif

#ifdef GRID
#ifdef SIMILARITY
#define WEIGHT(rho, k, u, v) SIMILARITY_AT(rho, k, u, v)
#else
#define WEIGHT(rho, k, u, v) (rho)
#endif

/* Float16, rounded to the nearest, ties to even (grid.cl: HALF_WEIGHTS). */
#ifdef HALF_WEIGHTS
typedef half weight_t;
#if N == 1
#define PUT_WEIGHT(p, i, w) vstore_half_rte((float)(w), 0, (p) + (i))
#else
#define STORE_HALVES CONCATENATE(CONCATENATE(vstore_half, N), _rte)
#define PUT_WEIGHT(p, i, w) STORE_HALVES(CONCATENATE(convert_float, N)(w), 0, (p) + (i))
#endif
#else
typedef real weight_t;
#define PUT_WEIGHT(p, i, w) STORE(p, i, w)
#endif

ALONE __kernel void patch_distance(
    STRIP_ARGS,
    const long weight_pitch, /* of the weights, in the layout of grid.cl */
    const long weight_guard,
    /* output */
    __global weight_t *out) /* weights */
{
    STRIP_PLACE
    if (x0 >= width_) return;
    BLOCK_ARRAYS
    for (int k = 0; k < n_offsets; ++k) {
        STRIP_OFFSET(k)
        BLOCK_OF(k)
        FOR_ROWS (y, 0, rows) {
            __global weight_t *to = out + weight_guard + ((cell_row + y) * n_offsets + k) * weight_pitch + x0;
            const bool has = from <= y && y < until;
            if (has) ROW_OF(y)
            int p = 0;
            for (; p < B && x0 + p * N < width_; ++p) {
                const long u = centre0 + y * padded_pitch + p * N, v = u + ahead;
                realN w = 0;
                if (has) w = PRESENT_WEIGHT(WEIGHT(RHO(y, p), k, u, v), u, v, x0 + p * N);
                PUT_WEIGHT(to, p * N, w);
            }
            if (x0 + p * N < width_) continue;
            for (; x0 + p * N < weight_pitch; ++p) PUT_WEIGHT(to, p * N, (realN)(0)); /* the zeros after a row */
        }
    }
}
#else
/* clang-format off */
#define PATCH_ARGS                                                                                                    \
    __global const real *padded,       /* M channels, padded_plane values each */                                     \
    const long padded_plane,                                                                                          \
    const int n_patch,                                                                                                \
    __global const long *patch_jumps,  /* (n_patch,): steps inside padded */                                          \
    __global const real *g,            /* (n_patch,) */                                                               \
    const real shift,                                                                                                 \
    const real scale,                  /* -log2(e)/h^2 */                                                             \
    const real cut                     /* exponentials below it count as 0 */
/* clang-format on */

#ifdef MAPS
#define KEPT(rho, u, v) \
    (fmax((rho) - shift - (maps[2 * (u)] + maps[2 * (v)]), (real)0) * (maps[2 * (u) + 1] * maps[2 * (v) + 1]))
#else
#define KEPT(rho, u, v) fmax((rho) - shift, (real)0)
#endif
#ifdef SIMILARITY
static inline real unless_cut(const real w, const real cut) { return w >= cut ? w : 0; }
#define EPILOGUE(rho, spatial, u, v) ((spatial) * unless_cut(exp2_scaled(KEPT(rho, u, v), scale), cut))
#else
#define EPILOGUE(rho, spatial, u, v) (rho)
#endif

static inline realN patch_distance_between(
    __global const real *padded,
    const long padded_plane,
    const int n_patch,
    __global const long *patch_jumps,
    __global const real *g,
    const long a,
    const long b)
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

__kernel void patch_distance(
    GRAPH_ARGS,
    PATCH_ARGS,
    __global const long *site,    /* (n,) */
    __global const real *spatial, /* (n_edges,); read with SPATIAL */
    __global const real *maps,    /* (n, 2): a and q; read with MAPS */
    /* output */
    __global real *out) /* (n_edges,) */
{
    VERTEX
    EDGES
    const real rho = patch_distance_between(padded, padded_plane, n_patch, patch_jumps, g, site[u], site[v]);
#ifdef SPATIAL
    out[e] = EPILOGUE(rho, spatial[e], u, v);
#else
    out[e] = EPILOGUE(rho, 1, u, v);
#endif
END
}
#endif
