/* The neighbours of a vertex in a stored (CSR) graph, under the same names as in grid.cl:
 *
 *   GRAPH_ARGS                 the kernel arguments for the graph
 *   VERTEX                     declares the vertex u of this work item, or ends the work item
 *   AT(u, c, channels)         index of channel c of vertex u in a function of that many channels
 *   NEIGHBOURS ... END         a loop over the neighbours v of u, with the edge variables for gamma.cl
 *   EDGES ... END              the same loop without the edge variables
 *   OFFSETS ... END            a loop over the edges of u, which has only EDGE_AT and OPPOSITE_AT
 *   COLLECT(x, first, channels)   after the loop, adds up x[channels] over the work items that share u (csr_gpu.cl);
 *                              first: the sums that were collected before
 *   ONE_WRITES                 after all sums: ends all work items that share u but one
 *   EDGE_AT(c, channels)       in the loop, index of channel c of the edge (u, v) in a function on the edges
 *   OPPOSITE_AT(c, channels)   likewise for (v, u)
 *   CLEAR_EDGES(p, channels)   writes 0 for edges that do not exist (only on a grid)
 *   USED(x)                    x, or 0 in lanes without a vertex (only on a grid)
 *   SEGMENT_BEGIN ... SEGMENT_END    a loop over all vertices u of this work item, for sums (sums.cl)
 *
 * Functions on vertices are interleaved, (n, channels): a neighbour's channels are adjacent.
 */
#ifndef CSR_CL
#define CSR_CL
#include "reals.cl"
#include "gamma.cl"

#ifndef INDEX
#define INDEX int
#endif

#define AT(u, c, channels) ((long)(u) * (channels) + (c))

#ifdef GAMMA
#define EDGE_FACTORS const real own = weights[e], other = weights[mirror[e]];
#elif defined(WEIGHTED)
#define EDGE_FACTORS const real w = weights[e];
#else
#define EDGE_FACTORS const real w = 1;
#endif

#if defined(SLICED) || defined(TEAM)
#include "csr_gpu.cl"
#else
/* clang-format off */
#define GRAPH_ARGS                                                                                                    \
    const long n,                      /* number of vertices */                                                       \
    __global const long *indptr,       /* (n + 1,) */                                                                 \
    __global const INDEX *indices,     /* (n_edges,) */                                                               \
    __global const real *weights,      /* (n_edges,), one per directed edge: w with WEIGHTED, gamma with GAMMA */     \
    __global const long *mirror        /* (n_edges,): the index of (v, u); read with GAMMA, and by adjoint */
/* clang-format on */

#define VERTEX                       \
    const long u = get_global_id(0); \
    if (u >= n) return;

/* clang-format off */
#define EDGES                                                                                                         \
    for (long e = indptr[u]; e < indptr[u + 1]; ++e) {                                                                \
        const long v = indices[e];
#define NEIGHBOURS                                                                                                    \
    EDGES                                                                                                             \
        EDGE_FACTORS
#define OFFSETS for (long e = indptr[u]; e < indptr[u + 1]; ++e) {
/* clang-format on */
#define COLLECT(x, first, channels)
#define ONE_WRITES
#endif
/* clang-format off */
#define END }
/* clang-format on */

#define EDGE_AT(c, channels) (e * (channels) + (c))
#define OPPOSITE_AT(c, channels) (mirror[e] * (channels) + (c))
#define CLEAR_EDGES(p, channels)

#define USED(x) (x)

#ifdef GROUP
#define SEGMENT_BEGIN for (long u = get_global_id(0); u < n; u += get_global_size(0)) {
#else
#define SEGMENT_BEGIN \
    for (long u = (long)get_global_id(0) * segment; u < n && u < ((long)get_global_id(0) + 1) * segment; ++u) {
#endif
#define SEGMENT_END }
#define SEGMENT_INDEX get_global_id(0)

#endif
