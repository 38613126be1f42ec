/* length(r) = the t >= 0 with sigma t + share phi'(t) = r,   phi(t) = (t^2 + eps^2)^(p/2) / p
 *
 * s = r - sigma length(r) is the norm of the proximal step of sigma (share phi)* from a point of norm r. With sigma =
 * 0, t = length(s) maximises s t - share phi(t), which gives the conjugate (share phi)*(s). PROX selects the case:
 *
 *   0   any p >= 1, eps >= 0: Halley's method     1   p = 1, eps = 0     2   p = 2     3   p > 1, eps = 0
 *
 * 1 and 2 have closed forms, 3 has one for the conjugate, and for p = 1.5 and 3. Halley's method solves log V = log r
 * for log t, V the left side: its slope lies between those of its two terms, which are nearly constant, and the start
 * is at most a factor of 2 off in V. Three or four steps reach rounding for p up to 6 and any r, sigma and eps tried.
 */
#ifndef PROX_CL
#define PROX_CL
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
#ifndef PROX
#define PROX 0
#endif

#define SHARED(c) (G == 1 ? 0 : (c))

/* The factor of phi: 1/2 with the edge norm, as an edge has two ends. */
#ifdef EDGE_NORM
#define SHARE ((real)0.5)
#else
#define SHARE ((real)1)
#endif

/* Unit of rounding, smallest normal number, largest number. */
#ifdef DOUBLE
#define ROUNDING 2.220446049250313e-16
#define TINY 2.2250738585072014e-308
#define HUGE 1.7976931348623157e308
#else
#define ROUNDING 1.1920929e-7f
#define TINY 1.17549435e-38f
#define HUGE 3.4028235e38f
#endif

/* The maximum number of steps. They stop once no lane moves by more than the share ENOUGH: the error after a step is of
 * the order of the cube of the error before, so that below a rounding is left. */
#define HALLEY_STEPS 30
#ifdef DOUBLE
#define ENOUGH 3e-6
#else
#define ENOUGH 2e-3f
#endif

/* Whether the condition, -1 or 0 per lane, is true in any lane. */
static inline bool any_lane(const laneN condition)
{
#if N == 1
    return condition != 0;
#else
    return any(condition) != 0;
#endif
}

/* Replace t by a better solution of V(t) = r, given x = r/V, the slope of log V over log t and its derivative, the
 * curvature; true if a lane without `usual` = 0 has moved by more than ENOUGH. log x and exp of the step are replaced by
 * quotients that are as exact as the method; a step is at most a factor of 7. */
static inline bool halley(realN *t, const realN x, const realN slope, const realN curvature, const laneN usual)
{
    const realN steep = (1 + x) * slope * slope, below = fmax(steep - (1 - x) * curvature, steep / 2);
    const realN most = below * (real)1.5f, above = clamp(2 * (1 - x) * slope, -most, most);
    const realN moved = *t * ((2 * below - above) / (2 * below + above));
    *t = usual ? moved : *t;
    return any_lane(fabs(above) > ENOUGH * below && usual);
}

#if PROX == 3
/* z >= 0 with a z + b (z/unit)^k = r, for k > 1, r > 0, a > 0, b > 0. */
static inline realN solved(const realN r, const realN a, const realN b, const real unit, const real k)
{
    if (k == 2) {
        /* the root of a square that loses no digits, without a^2 or r b, which may overflow */
        const realN c = 2 * sqrt(b) * sqrt(r) / unit, m = fmax(a, c), ratio = fmin(a, c) / m;
        return 2 * r / (a + m * sqrt(1 + ratio * ratio));
    }
    realN z = fmin(r / a, unit * raise(r / b, 1 / k));
    for (int i = 0; i < HALLEY_STEPS; ++i) {
        const realN power = b * raise(z / unit, k), V = a * z + power;
        const laneN usual = V > 0 && V < (realN)(HUGE);
        const realN inverse = 1 / V, part = power * inverse, rest = 1 - part;
        if (!halley(&z, r * inverse, rest + k * part, (k - 1) * (k - 1) * part * rest, usual)) break;
    }
    return z;
}
#else
/* For r >= 0 and sigma > 0, or sigma = 0 and p > 1. */
static inline realN length_of(const realN r, const realN sigma, const real p, const real eps)
{
    const real eps2 = eps * eps;
    /* a pack, because pow of a number is slow on a CPU */
    const realN narrow = eps > 0 ? raise((realN)(eps), 2 - p) : (realN)(p < 2 ? 0 : HUGE);
    const realN whole = r / SHARE;
    const laneN some = r > 0, positive = sigma > 0;
    /* the smaller one of the solutions with one term alone; phi'(t) is nearly min(t eps^(p - 2), t^(p - 1)) for p < 2,
     * max for p > 2, and for p = 1 it is t / sqrt(t^2 + eps^2) */
    realN t;
    if (p == 1) {
        const realN below = 1 - whole * whole;
        const laneN inside = below > 0;
        t = inside ? eps * whole / sqrt(inside ? below : (realN)(1)) : (realN)(HUGE);
        t = fmin(t, fmax((r - SHARE) / sigma, (realN)(eps)));
    } else {
        t = raise(whole, 1 / (p - 1));
        if (p < 2 || eps > 0) t = p < 2 ? fmax(t, whole * narrow) : fmin(t, whole * narrow);
    }
    t = positive ? fmin(t, r / sigma) : t;
    t = some ? clamp(t, (realN)(TINY), (realN)(HUGE)) : (realN)(0);
    for (int i = 0; i < HALLEY_STEPS; ++i) {
        const realN square = t * t + eps2;
        /* no step where squares underflow or overflow: the start is right there */
        const laneN usual = some && square > 0 && square < (realN)(INFINITY);
        const realN safe = usual ? square : (realN)(1);
        const realN term = SHARE * raise(safe, (p - 2) / 2) * t, V = sigma * t + term;
        const realN inverse = 1 / V, part = term * inverse, ratio = t * t / safe, less = (2 - p) * ratio;
        const realN curvature = part * ((1 - part) * less * less - 2 * less * (1 - ratio));
        if (!halley(&t, r * inverse, 1 - part * less, curvature, usual)) break;
    }
    return t;
}
#endif

/* The factor s/r of z in a proximal step, given |z|^2; 1 at z = 0. The certificate needs the result for p = 1 inside
 * the ball, in spite of the roundings of a norm. */
#define BALL (SHARE * (1 - 32 * ROUNDING))
static inline realN prox_factor(const realN square, const realN sigma, const real p, const real eps)
{
#if PROX == 1
    return square > BALL * BALL ? BALL / sqrt(square) : (realN)(1);
#elif PROX == 2
    return SHARE / (sigma + SHARE);
#else
    const realN r = sqrt(fmin(square, (realN)(HUGE)));
#if PROX == 3
    realN s;
    if (p < 2) {
        s = solved(r, (realN)(1), (realN)(sigma), SHARE, 1 / (p - 1));
    } else {
        const realN t = solved(r, sigma, (realN)(SHARE), (real)1, p - 1);
        s = 2 * sigma * t > r ? SHARE * raise(t, p - 1) : r - sigma * t;
    }
#else
    /* use the side of the equation that loses no digits */
    const realN t = length_of(r, sigma, p, eps), square_t = fmin(t * t + eps * eps, (realN)(HUGE));
    const laneN far = 2 * sigma * t > r && square_t > 0;
    realN s = far ? SHARE * t * raise(far ? square_t : (realN)(1), (p - 2) / 2) : r - sigma * t;
    if (p == 1) s = fmin(s, (realN)(BALL));
#endif
    const laneN some = r > 0;
    return some ? s / (some ? r : (realN)(1)) : (realN)(1);
#endif
}

/* (share phi)*(s), given s^2; for p = 1 a value s > share counts as share. */
static inline realN conjugate(const realN square, const real p, const real eps)
{
#if PROX == 1
    return (realN)(0);
#elif PROX == 2
    return square / (2 * SHARE) - SHARE * eps * eps / 2;
#else
#if PROX != 3
    if (p == 1) return -SHARE * eps * sqrt(fmax(1 - square / (SHARE * SHARE), (realN)(0)));
    const realN s = sqrt(square), t = length_of(s, (realN)(0), p, eps);
#else
    const realN s = sqrt(square), t = raise(square / (SHARE * SHARE), 1 / (2 * (p - 1)));
#endif
    /* t maximises s t - share phi(t), so a rounded exponent has only an effect of second order */
    const realN found = s * t - SHARE * raise(t * t + eps * eps, p / 2) / p;
    /* the conjugate is >= -share eps^p / p: -infinity or NaN comes from an overflow */
    return found >= -(realN)(HUGE) ? found : (realN)(INFINITY);
#endif
}

#endif
