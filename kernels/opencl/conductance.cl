/* The conductance of an edge (u, v), for the p-Laplacian, both processes and the gradient:
 *
 *   vertex norm    g(u) + g(v), g = |grad_w f|^(p - 2) from a buffer (CONDUCTANCES), or 2: p = 2     (eq. 12, 25)
 *   edge norm      (d_w(f)(u, v)^2 + eps^2)^((p - 2)/2), from f itself (EDGE_NORM)                  (from eq. 30)
 *
 * CONDUCTANCES_OF_EDGE is used in a loop over the neighbours, with f(u) in `here`. It declares conductance[G]; G = 1:
 * one for all channels.
 */
#ifndef CONDUCTANCE_CL
#define CONDUCTANCE_CL

#ifndef M
#define M 1
#endif
#ifndef G
#define G 1
#endif

#define SHARED(c) (G == 1 ? 0 : (c))

/* clang-format off */
#define CONDUCTANCE_ARGS                                                                                              \
    __global const real *g,   /* G channels; read with CONDUCTANCES */                                                \
    const real power,         /* (p - 2)/2; read with EDGE_NORM */                                                    \
    const real eps2           /* eps^2; read with EDGE_NORM */
/* clang-format on */

#ifdef EDGE_NORM
#define CONDUCTANCES_OF_EDGE                                       \
    realN conductance[G];                                          \
    for (int c = 0; c < G; ++c) conductance[c] = eps2;             \
    for (int c = 0; c < M; ++c) {                                  \
        const realN d = DIFFERENCE(here[c], LOAD(f, AT(v, c, M))); \
        conductance[SHARED(c)] += SQUARED(d);                      \
    }                                                              \
    for (int c = 0; c < G; ++c) conductance[c] = raise(conductance[c], power);
#elif defined(CONDUCTANCES)
#define CONDUCTANCES_OF_EDGE \
    realN conductance[G];    \
    for (int c = 0; c < G; ++c) conductance[c] = LOAD(g, AT(u, c, G)) + LOAD(g, AT(v, c, G));
#else
#define CONDUCTANCES_OF_EDGE const realN conductance[1] = {(realN)(2)};
#endif

#endif
