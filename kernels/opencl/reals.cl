/* Number types: `real` and packs of N of them.
 *
 * A work item of a grid kernel computes a pack, N adjacent vertices on a row, because PoCL does not vectorise a kernel
 * with inner loops; N = 1 on a GPU, and for CSR graphs. Build options:
 *   -DN=1|2|4|8|16   -DALIGNED   -DDOUBLE (float64, otherwise float32)
 *   -DSUM_DOUBLE (the device has float64, for long sums)
 */
#ifndef REALS_CL
#define REALS_CL

#ifndef N
#define N 1
#endif

#define CONCATENATE_(a, b) a##b
#define CONCATENATE(a, b) CONCATENATE_(a, b)

#ifdef DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
typedef long lane; /* an integer with the size of real: the result of comparisons of packs */
#define REAL_ double
#define LANE_ long
#else
#ifdef SUM_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif
typedef float real;
typedef int lane;
#define REAL_ float
#define LANE_ int
#endif

#if N == 1
typedef real realN;
typedef lane laneN;
#define AS_LANES(x) CONCATENATE(as_, LANE_)(x)
#define TO_REALS(x) ((real)(x))
#define TO_LANES(x) ((lane)(x))
#define AS_REALS(x) CONCATENATE(as_, REAL_)(x)
#define LOAD(p, i) ((p)[i])
#define STORE(p, i, x) ((p)[i] = (x))
#define LOAD_PRIVATE(p, i) ((p)[i])
#define STORE_PRIVATE(p, i, x) ((p)[i] = (x))
#define LANES ((lane)0)
#else
typedef CONCATENATE(REAL_, N) realN;
typedef CONCATENATE(LANE_, N) laneN;
#define AS_LANES(x) CONCATENATE(as_, laneN_)(x)
#define TO_REALS(x) CONCATENATE(convert_, realN_)(x)
#define TO_LANES(x) CONCATENATE(convert_, laneN_)(x)
#define laneN_ CONCATENATE(LANE_, N)
#define realN_ CONCATENATE(REAL_, N)
#define AS_REALS(x) CONCATENATE(as_, realN_)(x)
#ifdef ALIGNED /* all packs begin at a multiple of their size */
#define LOAD(p, i) (*(__global const realN *)((p) + (i)))
#define STORE(p, i, x) (*(__global realN *)((p) + (i)) = (x))
#define LOAD_PRIVATE(p, i) CONCATENATE(vload, N)(0, (p) + (i))
#define STORE_PRIVATE(p, i, x) CONCATENATE(vstore, N)((x), 0, (p) + (i))
/* Read or write a pack at any index. PoCL splits a vload16 into loads of 2, and LLVM does not merge all of them; with
 * clang, PoCL's compiler, a pointer to packs of smaller alignment gives one instruction. */
#elif defined(__clang__)
typedef realN realN_anywhere __attribute__((aligned(sizeof(real))));
#define LOAD(p, i) (*(__global const realN_anywhere *)((p) + (i)))
#define STORE(p, i, x) (*(__global realN_anywhere *)((p) + (i)) = (x))
#define LOAD_PRIVATE(p, i) (*(const realN_anywhere *)((p) + (i)))
#define STORE_PRIVATE(p, i, x) (*(realN_anywhere *)((p) + (i)) = (x))
#else
#define LOAD(p, i) CONCATENATE(vload, N)(0, (p) + (i))
#define STORE(p, i, x) CONCATENATE(vstore, N)((x), 0, (p) + (i))
#define LOAD_PRIVATE(p, i) CONCATENATE(vload, N)(0, (p) + (i))
#define STORE_PRIVATE(p, i, x) CONCATENATE(vstore, N)((x), 0, (p) + (i))
#endif
#if N == 2
#define LANES ((laneN)(0, 1))
#elif N == 4
#define LANES ((laneN)(0, 1, 2, 3))
#elif N == 8
#define LANES ((laneN)(0, 1, 2, 3, 4, 5, 6, 7))
#elif N == 16
#define LANES ((laneN)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#endif
#endif

/* A sum of weights below this counts as 0, because quotients of smaller numbers lose their digits. */
#ifdef DOUBLE
#define SMALLEST 1e-290
#else
#define SMALLEST 1e-30f
#endif

/* x in the lanes where the condition is true, 0 in the others, even if x is NaN there. */
#define WHERE(condition, x) ((condition) ? (realN)(x) : (realN)(0))

/* x^power = 2^(power log2 x) for x > 0. The error is at most 3.4 roundings, measured on 65536 numbers from e^-80 to
 * e^80 with nine powers and both types; pow may have 32. It computes a pack at once, PoCL's pow one lane at a time.
 * With x = 2^e m, m from 1/sqrt(2) to sqrt(2), one fma subtracts the integer part of power log2 x from power e, so that
 * no digit of the rest is lost. log2 m is the series of artanh((m - 1)/(m + 1)), without terms below a rounding; for
 * 2^r see exp2_of. Subnormal results are 0. */
#ifdef DOUBLE
#define MANTISSA 52
#define LEAST_NORMAL 2.2250738585072014e-308
#define SCALE_UP 18014398509481984.0 /* 2^54 */
#define SCALED_BY 54
#define ROOT_BITS 0x3fe6a09e667f3bcdL /* sqrt(1/2) */
#define EXPONENTS 1023
static inline realN log2_over_s(const realN t)
{
    realN series = t * 0.11541560327111706 + 0.12545174268599682;
    series = series * t + 0.13739952770371081;
    series = series * t + 0.15186263588304877;
    series = series * t + 0.16972882833987804;
    series = series * t + 0.19235933878519512;
    series = series * t + 0.22195308321368667;
    series = series * t + 0.26230818925253879;
    series = series * t + 0.3205988979753252;
    series = series * t + 0.41219858311113239;
    series = series * t + 0.57707801635558531;
    series = series * t + 0.96179669392597555;
    series = series * t + 2.8853900817779268;
    return series;
}
/* 2^r for |r| <= 1/2, by its series. */
static inline realN exp2_of(const realN r)
{
    realN y = r * 1.3691488853904124e-12 + 2.5678435993488196e-11;
    y = y * r + 4.4455382718708101e-10;
    y = y * r + 7.0549116208011209e-09;
    y = y * r + 1.0178086009239696e-07;
    y = y * r + 1.3215486790144305e-06;
    y = y * r + 1.5252733804059838e-05;
    y = y * r + 0.00015403530393381606;
    y = y * r + 0.0013333558146428441;
    y = y * r + 0.0096181291076284769;
    y = y * r + 0.055504108664821576;
    y = y * r + 0.24022650695910069;
    y = y * r + 0.69314718055994529;
    y = y * r + 1;
    return y;
}
#else
#define MANTISSA 23
#define LEAST_NORMAL 1.17549435e-38f
#define SCALE_UP 16777216.0f /* 2^24 */
#define SCALED_BY 24
#define ROOT_BITS 0x3f3504f3 /* sqrt(1/2) */
#define EXPONENTS 127
static inline realN log2_over_s(const realN t)
{
    realN series = t * 0.32059890f + 0.41219859f;
    series = series * t + 0.57707802f;
    series = series * t + 0.96179669f;
    series = series * t + 2.8853901f;
    return series;
}
/* 2^r for |r| <= 1/2: the polynomial of degree 5 with value 1 at 0 and the smallest maximum relative error (9e-8, found
 * by linear programming; 1.9e-7 with roundings). */
static inline realN exp2_of(const realN r)
{
    realN y = r * 0.001326465280726552f + 0.009671511128544807f;
    y = y * r + 0.05550733953714371f;
    y = y * r + 0.24022242426872253f;
    y = y * r + 0.6931470036506653f;
    y = y * r + 1.0f;
    return y;
}
#endif
static inline realN power_of(const realN x, const real power)
{
    const laneN small = x < LEAST_NORMAL;
    const realN scaled = small ? x * SCALE_UP : x;
    const laneN e = (AS_LANES(scaled) - ROOT_BITS) >> MANTISSA;
    const realN m = AS_REALS(AS_LANES(scaled) - (e << MANTISSA));
    const realN s = (m - 1) / (m + 1), log_m = log2_over_s(s * s) * s * power;
    const realN exponent = TO_REALS(e) - (small ? (realN)(SCALED_BY) : (realN)(0));
    const realN whole = rint(fma(exponent, (realN)(power), log_m));
    const realN r = fma(exponent, (realN)(power), -whole) + log_m;
    const laneN high = whole > EXPONENTS, low = whole < 1 - EXPONENTS;
    const laneN k = TO_LANES(high || low ? (realN)(0) : whole);
    const realN result = AS_REALS(AS_LANES(exp2_of(r)) + (k << MANTISSA));
    return high ? (realN)(INFINITY) : low ? (realN)(0) : result;
}

/* x^power for x >= 0. The branch is the same for all work items. */
static inline realN raise(const realN x, const real power)
{
    if (power == (real)1) return x;
    if (power == (real)0) return (realN)(1);
    if (power == (real)0.5) return sqrt(x);
    if (power == (real)-0.5) return (realN)(1) / sqrt(x);
    if (4 * power == rint(4 * power) && fabs(power) <= 3) {
        /* p = 1.5, 3, 4, 6 and others: products and roots, which are correct for 0 and infinity */
        real rest = fabs(power);
        realN y = 1;
        for (; rest >= 1; rest -= 1) y *= x;
        if (rest >= (real)0.5) {
            y *= sqrt(x);
            rest -= (real)0.5;
        }
        if (rest > 0) y *= sqrt(sqrt(x));
        return power < 0 ? 1 / y : y;
    }
    /* 0, infinity and NaN are special cases */
    const laneN usual = x > 0 && x < (realN)(INFINITY);
    return usual ? power_of(usual ? x : (realN)(1), power) : power > 0 ? x : 1 / x;
}

/* 2^(x scale) for x >= 0 and scale <= 0; in float32, a value below 2^-126 gives a result from 0 to 2^-126. The sum with
 * 1.5 2^23 has the nearest integer power in its last bits, which are added to the exponent of 2^r, r the rest. These
 * are ten operations, the same on every driver; native_exp has errors of 4e-6 to 2e-5. */
static inline realN exp2_scaled(const realN x, const real scale)
{
#ifdef DOUBLE
    return exp2(x * scale);
#else
    const realN shifted = x * scale + 12582912.0f;
    const realN whole = shifted - 12582912.0f, r = x * scale - whole;
    const laneN bits = AS_LANES(exp2_of(r)) + (AS_LANES(shifted) << MANTISSA);
    return AS_REALS(whole >= -126.0f ? bits : (laneN)(0));
#endif
}

/* A divisor: a number, or with OVER a function of OVER channels, 1 or M. Lanes without a vertex divide 0 by 0, so the
 * result needs USED. */
/* clang-format off */
#define OVER_ARGS                                                                                                     \
    __global const real *overs, /* OVER channels; read with OVER */                                                   \
    const real over_            /* read without OVER */
/* clang-format on */
#ifdef OVER
#define OVER_OF(x, c) ((x) / LOAD(overs, AT(u, OVER == 1 ? 0 : (c), OVER)))
#else
#define OVER_OF(x, c) ((x) / over_)
#endif

#endif
