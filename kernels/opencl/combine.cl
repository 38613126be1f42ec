/* combine(u) = a x(u) + b y(u) / over(u)
 *
 * Where over is infinite: a x(u). With RATIOS a and b are multiplied by quotients of numbers on the device (0 if the
 * divisor is not > 0), and a term whose coefficient is 0 is left out, whatever its function is.
 *
 * One work item: one vertex (CSR) or a pack of N (grid); it reads only its own numbers, so that out may be x or y.
 * Traffic per vertex: reads 2 M values and over, writes M. The weights are not read.
 *   -DRATIOS
 */
#ifdef GRID
#include "grid.cl"
#else
#include "csr.cl"
#endif

#include "sums.cl"

#ifndef M
#define M 1
#endif

#ifdef RATIOS
#define TERM(a, x) ((a) == 0 ? (realN)(0) : (a) * (x))
#else
#define TERM(a, x) ((a) * (x))
#endif

/* factor times the quotient of two numbers; without RATIOS, or if a place is < 0, the factor */
static inline real coefficient(const real factor, __global const long_sum *numbers, const int above, const int below)
{
#ifdef RATIOS
    if (below >= 0) {
        const sum_t divisor = sum_value(numbers[below]);
        return divisor > 0 ? (real)(factor * (sum_value(numbers[above]) / divisor)) : 0;
    }
#endif
    return factor;
}

__kernel void combine(
    GRAPH_ARGS,
    const real a_,
    __global const real *x_, /* M channels */
    const real b_,
    __global const real *y_, /* M channels */
    OVER_ARGS,
    __global const long_sum *numbers, /* read with RATIOS */
    const int a_above,                /* places of the quotient that a_ is multiplied by; -1: none */
    const int a_below,
    const int b_above, /* likewise for b_ */
    const int b_below,
    /* output */
    __global real *out) /* M channels; x_, y_ or another buffer */
{
    const real a = coefficient(a_, numbers, a_above, a_below), b = coefficient(b_, numbers, b_above, b_below);
    VERTEX
    for (int c = 0; c < M; ++c) {
        const realN second = LOAD(y_, AT(u, c, M));
        STORE(out, AT(u, c, M), USED(TERM(a, LOAD(x_, AT(u, c, M))) + TERM(b, OVER_OF(second, c))));
    }
}
