/* A vertex's neighbours in a CSR graph. Gives the primitives the same names as grid.cl, so that each is written once:
 *
 *   GRAPH_ARGS                 the kernel arguments that hold the graph
 *   VERTEX                     declares this work item's vertex u, or ends the work item
 *   AT(u, c, channels)         index of channel c of vertex u in a function of that many channels
 *   NEIGHBOURS ... END         a loop over the neighbours v of u with weight w
 *   USED(x)                    x, or 0 in lanes that hold no vertex (here: x)
 *   SEGMENT_BEGIN ... SEGMENT_END    a loop over all vertices u of this work item's segment, for sums
 *
 * Functions on vertices are interleaved, (n, channels): a gather brings all channels of a neighbour at once.
 */
#ifndef CSR_CL
#define CSR_CL
#include "reals.cl"

#ifndef INDEX
#define INDEX int
#endif

#define GRAPH_ARGS                                                                                                   \
    const long n,                      /* number of vertices */                                                      \
    __global const long *indptr,       /* (n + 1,) */                                                                \
    __global const INDEX *indices,     /* (n_edges,) */                                                              \
    __global const real *weights       /* (n_edges,), one per directed edge; not read without WEIGHTED */

#define VERTEX                                                                                                       \
    const long u = get_global_id(0);                                                                                 \
    if (u >= n) return;

#define AT(u, c, channels) ((long)(u) * (channels) + (c))

#ifdef WEIGHTED
#define EDGE_WEIGHT(e) weights[e]
#else
#define EDGE_WEIGHT(e) (real)1
#endif

#define NEIGHBOURS                                                                                                   \
    for (long e = indptr[u]; e < indptr[u + 1]; ++e) {                                                               \
        const long v = indices[e];                                                                                   \
        const real w = EDGE_WEIGHT(e);
#define END }

#define USED(x) (x)

#define SEGMENT_BEGIN                                                                                                \
    for (long u = (long)get_global_id(0) * segment; u < n && u < ((long)get_global_id(0) + 1) * segment; ++u) {
#define SEGMENT_END }
#define SEGMENT_INDEX get_global_id(0)

#endif
