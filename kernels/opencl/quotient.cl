/* The last step of a sweep whose weights are not stored: a quotient of two sums                            (eq. 25)
 *
 *   out(u) = (lam f0(u) + 2 pull(u)) / (lam + 2 total(u)),   total = sum_v w(u, v),   pull = sum_v w(u, v) f(v)
 *
 * Where lam is infinite, or the denominator is at most SMALLEST, out = f0. LARGEST: lam is in units of `unit`.
 */
#ifndef QUOTIENT_CL
#define QUOTIENT_CL
#include "reals.cl"

#ifndef M
#define M 1
#endif

/* clang-format off */
#define FUNCTION_ARGS                                                                                                 \
    const long pitch,                  /* of functions, in the layout of grid.cl */                                   \
    const long plane,                                                                                                 \
    const long guard,                                                                                                 \
    __global const real *f0,           /* M channels */                                                               \
    __global const real *lams,         /* 1 channel; read with LAM_ARRAY */                                           \
    const real lam_,                   /* read without LAM_ARRAY */                                                   \
    /* output */                                                                                                      \
    __global real *out                 /* M channels; not f */
/* clang-format on */

/* Write the new value of the pack at x, from half the sums of the weights and of the weighted values. */
static inline void finish(
    const realN total,
    const realN *pull,
    const int x,
    const long row,
    const int width,
    const long pitch,
    const long plane,
    const long guard,
    __global const real *f0,
    __global const real *lams,
    const real lam_,
    const realN unit,
    __global real *out)
{
    const long u = guard + row * pitch + x;
#ifdef LAM_ARRAY
    realN lam = LOAD(lams, u);
#else
    realN lam = (realN)(lam_);
#endif
#ifdef LARGEST
    lam = isinf(lam) ? lam : lam * unit;
#endif
    const realN denominator = lam + 2 * total;
    const laneN keeps_data = isinf(lam) || !(denominator > SMALLEST);
#pragma unroll
    for (int c = 0; c < M; ++c) {
        const realN data = LOAD(f0, u + c * plane);
        const realN moved = (lam * data + 2 * pull[c]) / denominator;
        STORE(out, u + c * plane, WHERE(x + LANES < width, keeps_data ? data : moved));
    }
}

#endif
