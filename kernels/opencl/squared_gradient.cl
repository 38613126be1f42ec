/* The sum that gradient_norm and energy raise to a power. SUM_OF_SQUARES computes sum[G] from `here`, eps2 and
 * edge_power; all work items that share u have it (COLLECT):
 *
 *   vertex norm   sum_v d_w(f)(u, v)^2 + eps^2
 *   EDGE_NORM     sum_v (d_w(f)(u, v)^2 + eps^2)^edge_power, over the existing edges
 */
#ifndef SQUARED_GRADIENT_CL
#define SQUARED_GRADIENT_CL
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#ifndef M
#define M 1
#endif
#ifndef G
#define G 1
#endif

#ifdef EDGE_NORM
#define SUM_OF_SQUARES                                                                                        \
    for (int c = 0; c < G; ++c) sum[c] = 0;                                                                   \
    NEIGHBOURS                                                                                                \
        realN square[G];                                                                                      \
        for (int c = 0; c < G; ++c) square[c] = eps2;                                                         \
        for (int c = 0; c < M; ++c) {                                                                         \
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M)));                                        \
            square[G == 1 ? 0 : c] += SQUARED(d);                                                             \
        }                                                                                                     \
        _Pragma("unroll") for (int c = 0; c < G; ++c) sum[c] += WHERE(PRESENT, raise(square[c], edge_power)); \
    END                                                                                                       \
    COLLECT(sum, 0, G)
#else
#define SUM_OF_SQUARES                                                 \
    for (int c = 0; c < G; ++c) sum[c] = 0;                            \
    NEIGHBOURS                                                         \
        for (int c = 0; c < M; ++c) {                                  \
            const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M))); \
            sum[G == 1 ? 0 : c] += SQUARED(d);                         \
        }                                                              \
    END                                                                \
    COLLECT(sum, 0, G)                                                 \
    for (int c = 0; c < G; ++c) sum[c] += eps2;
#endif

#endif
