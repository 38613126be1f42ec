/* What gamma makes of an edge (u, v), under the same names for its two forms. Included by csr.cl and grid.cl.
 *
 * gamma = sqrt(w), symmetric: w is the weight. GAMMA: one value per directed edge, own = gamma(u, v) and
 * other = gamma(v, u); they come from the buffer of the weights.
 *
 *   DIFFERENCE(a, b)   d of an edge with f(u) = a, f(v) = b, up to the factor sqrt(w) that the next three bring in
 *   SQUARED(d)         d_w(f)(u, v)^2                                                            (eq. 4)
 *   DERIVED(d)         d_w(f)(u, v)
 *   FLOW(d)            gamma(u, v) d_w(f)(u, v)
 *   HOLD, PULL         gamma(u, v)^2, gamma(u, v) gamma(v, u): what alpha and beta of eq. 25 begin with
 *   OWN                gamma(u, v)
 *   PRESENT            whether there is an edge at all: an edge without weight has no term in a sum over edges
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
