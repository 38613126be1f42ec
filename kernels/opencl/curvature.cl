/* What kernels of Newton's method share: the numbers of a group with the edge norm.
 *
 * q = |df|^2 + eps^2 over the channels of an edge, at least SMALLEST, so that no quotient overflows.
 *   EDGE_G(q)        share q^((p - 2)/2), at least share floor_
 *   EDGE_FACTOR(q)   of the inner products: share (2 - p) q^((p - 4)/2); with Y (2 - p)/q
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif

#define EDGE_G(q) ((real)0.5 * fmax(raise(q, (p - 2) / 2), (realN)(floor_)))
#ifdef Y
#define EDGE_FACTOR(q) ((2 - p) / (q))
#else
#define EDGE_FACTOR(q) ((real)0.5 * (2 - p) * raise(q, (p - 4) / 2))
#endif
