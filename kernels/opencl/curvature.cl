/* What kernels of Newton's method share: the numbers of a group with the edge norm.
 *
 * q = |df|^2 + eps^2 over the channels of an edge, not less than the smallest normal number.
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

#ifdef DOUBLE
#define TINY_ 2.2250738585072014e-308
#else
#define TINY_ 1.17549435e-38f
#endif

#define EDGE_G(q) ((real)0.5 * fmax(raise(q, (p - 2) / 2), (realN)(floor_)))
#ifdef Y
#define EDGE_FACTOR(q) ((2 - p) / (q))
#else
#define EDGE_FACTOR(q) ((real)0.5 * (2 - p) * raise(q, (p - 4) / 2))
#endif
