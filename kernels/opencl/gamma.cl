/* The factors of an edge (u, v), under the same names for both forms of gamma. Included by csr.cl and grid.cl.
 *
 * By default gamma = sqrt(w), with the weight w. GAMMA: one value per directed edge, own = gamma(u, v) and
 * other = gamma(v, u), from the buffer of the weights.
 *
 *   DIFFERENCE(a, b)   d of an edge with f(u) = a, f(v) = b, without the factor sqrt(w); d of the next three
 *   SQUARED(d)         d_w(f)(u, v)^2                                                            (eq. 4)
 *   DERIVED(d)         d_w(f)(u, v)
 *   FLOW(d)            gamma(u, v) d_w(f)(u, v)
 *   HOLD, PULL         gamma(u, v)^2 and gamma(u, v) gamma(v, u), for alpha and beta of eq. 25
 *   OWN                gamma(u, v)
 *   PRESENT            whether the edge exists; a sum over edges skips edges of weight 0
 */
#ifndef GAMMA_CL
#define GAMMA_CL

#ifdef GAMMA
#define DIFFERENCE(a, b) (other * (b) - own * (a))
#define SQUARED(d) ((d) * (d))
#define DERIVED(d) (d)
#define FLOW(d) (own * (d))
#define HOLD (own * own)
#define PULL (own * other)
#define OWN own
#define PRESENT ((own > 0) || (other > 0))
#else
#define DIFFERENCE(a, b) ((b) - (a))
#define SQUARED(d) (w * (d) * (d))
#define DERIVED(d) (sqrt(w) * (d))
#define FLOW(d) (w * (d))
#define HOLD w
#define PULL w
#define OWN sqrt(w)
#define PRESENT (w > 0)
#endif

#endif
