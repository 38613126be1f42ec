/* length(r) = the t >= 0 with sigma t + share phi'(t) = r,   phi(t) = (t^2 + eps^2)^(p/2) / p
 *
 * s = r - sigma length(r) is the norm of the proximal step of sigma (share phi)* from a point of norm r. With sigma =
 * 0, t = length(s) maximises s t - share phi(t), which gives the conjugate (share phi)*(s). PROX selects the case:
 *
 *   0   any p >= 1, eps >= 0: Newton's method     1   p = 1, eps = 0     2   p = 2     3   p > 1, eps = 0
 *
 * 1 and 2 have closed forms, 3 has one for the conjugate. Newton's method converges from one side: phi' is concave for
 * p < 2, so it starts below the solution, and convex for p > 2, so it starts above. To avoid NaN, quotients are
 * replaced by their limits where squares underflow or overflow.
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

/* The maximum number of Newton steps; they stop once no lane changes. */
#define NEWTON_STEPS 60

/* Whether the condition, -1 or 0 per lane, is true in any lane. */
static inline bool any_lane(const laneN condition)
{
#if N == 1
    return condition != 0;
#else
    return any(condition) != 0;
#endif
}

/* For r >= 0 and sigma > 0, or sigma = 0 and p > 1. */
static inline realN length_of(const realN r, const realN sigma, const real p, const real eps)
{
    const real eps2 = eps * eps, narrow = eps > 0 ? pow(eps, 2 - p) : (real)(p < 2 ? 0 : HUGE);
    const realN whole = r / SHARE;
    const laneN positive = sigma > 0;
    realN t;
    if (p < 2) {
        /* one of the two terms is at least r / 2, and phi'(t) <= min(t eps^(p - 2), t^(p - 1)) */
        const realN least = positive ? whole / 2 : whole;
        t = least * narrow;
        if (p > 1) t = fmax(t, raise(least, 1 / (p - 1)));
        t = positive ? fmin(t, r / (2 * sigma)) : t;
        if (p == 1) t = fmax(t, (r - SHARE) / sigma);
    } else {
        /* no term is larger than r, and phi'(t) >= max(t eps^(p - 2), t^(p - 1)) */
        t = raise(whole, 1 / (p - 1));
        if (eps > 0) t = fmin(t, whole * narrow);
        t = positive ? fmin(t, r / sigma) : t;
    }
    const laneN some = r > 0;
    t = some ? clamp(t, (realN)(TINY), (realN)(HUGE)) : (realN)(0);
    for (int i = 0; i < NEWTON_STEPS; ++i) {
        const realN square = t * t + eps2;
        const laneN usual = square > 0 && square < (realN)(INFINITY);
        const realN safe = usual ? square : (realN)(1);
        const realN g = usual ? raise(safe, (p - 2) / 2) : (realN)(0);
        const realN ratio = usual ? t * t / safe : (realN)(1);
        const realN value = sigma * t + SHARE * g * t - r;
        const realN rise = sigma + SHARE * g * (1 + (p - 2) * ratio);
        const laneN rising = rise > 0 && some;
        const realN step = rising ? value / (rising ? rise : (realN)(1)) : (realN)(0);
        const realN moved = fmax(t - step, (realN)(0));
        /* the steps are monotone: a step back is rounding */
        const laneN moving = (p < 2 ? moved - t : t - moved) > 2 * ROUNDING * t;
        t = moved;
        if (!any_lane(moving)) break;
    }
    return t;
}

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
    /* use the side of the equation that loses no digits */
    const realN t = length_of(r, sigma, p, eps), square_t = fmin(t * t + eps * eps, (realN)(HUGE));
    const laneN far = 2 * sigma * t > r && square_t > 0;
    realN s = far ? SHARE * t * raise(far ? square_t : (realN)(1), (p - 2) / 2) : r - sigma * t;
    if (p == 1) s = fmin(s, (realN)(BALL));
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
