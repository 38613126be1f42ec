/* Number types: `real` and packs of N of them.
 *
 * A work item of a grid kernel treats N vertices that lie next to each other on a row, because PoCL does not vectorise
 * a kernel that has inner loops; N = 1 suits a GPU, and CSR graphs. N and the type come as build options:
 *   -DN=1|2|4|8|16   -DDOUBLE (float64, otherwise float32)   -DSUM_DOUBLE (the device has float64, for long sums)
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
typedef long lane; /* an integer as wide as real: comparisons of packs give packs of these */
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
#define AS_LANES(x) as_int(x)
#define AS_REALS(x) as_float(x)
#define LOAD(p, i) ((p)[i])
#define STORE(p, i, x) ((p)[i] = (x))
#define LOAD_PRIVATE(p, i) ((p)[i])
#define STORE_PRIVATE(p, i, x) ((p)[i] = (x))
#define LANES ((lane)0)
#else
typedef CONCATENATE(REAL_, N) realN;
typedef CONCATENATE(LANE_, N) laneN;
#define AS_LANES(x) CONCATENATE(as_int, N)(x)
#define AS_REALS(x) CONCATENATE(as_float, N)(x)
/* A pack at any number. PoCL makes a vload of 16 of loads of 2, and LLVM leaves some of them so: where the compiler is
 * clang, as PoCL's is, a pointer to packs of less alignment gives one instruction. */
#ifdef __clang__
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

/* A sum of weights below this is taken for 0: of numbers so small a quotient has few digits left, or none. */
#ifdef DOUBLE
#define SMALLEST 1e-290
#else
#define SMALLEST 1e-30f
#endif

/* x where the condition holds in a lane, 0 elsewhere; a stray NaN of an unused lane does not get through. */
#define WHERE(condition, x) ((condition) ? (realN)(x) : (realN)(0))

/* x^power for x >= 0. The exponents of p = 1 and p = 2 avoid pow; the branch is the same for all work items. */
static inline realN raise(const realN x, const real power)
{
    if (power == (real)1) return x;
    if (power == (real)0) return (realN)(1);
    if (power == (real)0.5) return sqrt(x);
    if (power == (real)-0.5) return (realN)(1) / sqrt(x);
    /* PoCL 3.1: the pow of a pack of doubles is wrong in its other lanes when one lane is 0. */
    const laneN positive = x > 0;
    return positive ? pow(positive ? x : (realN)(1), (realN)(power)) : (realN)(power > 0 ? (real)0 : (real)INFINITY);
}

/* 2^(x scale) for x >= 0 and scale <= 0; in float32, what is below 2^-126 comes out somewhere from 0 to 2^-126. The nearest
 * whole power falls out of the last bits of a sum with 1.5 2^23; the rest, 2^r with |r| <= 1/2, is the polynomial of
 * degree 5 with 1 at 0 whose largest relative error is least (9e-8, by linear programming; 1.9e-7 with its roundings), on
 * whose exponent the power is put. Ten operations, the same on every driver, where native_exp is 4e-6 to 2e-5 off. */
static inline realN exp2_scaled(const realN x, const real scale)
{
#ifdef DOUBLE
    return exp2(x * scale);
#else
    const realN shifted = x * scale + 12582912.0f;
    const realN whole = shifted - 12582912.0f, r = x * scale - whole;
    realN s = r * 0.001326465280726552f + 0.009671511128544807f;
    s = s * r + 0.05550733953714371f;
    s = s * r + 0.24022242426872253f;
    s = s * r + 0.6931470036506653f;
    s = s * r + 1.0f;
    const laneN bits = AS_LANES(s) + (AS_LANES(shifted) << 23);
    return AS_REALS(whole >= -126.0f ? bits : (laneN)(0));
#endif
}

/* A long sum: in float64 where the device has it, otherwise compensated (Neumaier), error about 2 roundings. */
#if defined(DOUBLE) || defined(SUM_DOUBLE)
typedef struct { double sum; } long_sum;
static inline long_sum sum_start(void) { long_sum s; s.sum = 0; return s; }
static inline long_sum sum_add(long_sum s, const real x) { s.sum += (double)x; return s; }
static inline double sum_value(const long_sum s) { return s.sum; }
typedef double sum_t;
#else
typedef struct { float sum, lost; } long_sum;
static inline long_sum sum_start(void) { long_sum s; s.sum = 0; s.lost = 0; return s; }
static inline long_sum sum_add(long_sum s, const real x)
{
    const float t = s.sum + x;
    s.lost += fabs(s.sum) >= fabs(x) ? (s.sum - t) + x : (x - t) + s.sum;
    s.sum = t;
    return s;
}
static inline float sum_value(const long_sum s) { return s.sum + s.lost; }
typedef float sum_t;
#endif

static inline long_sum sum_add_pack(long_sum s, const realN x)
{
#if N == 1
    return sum_add(s, x);
#else
    real parts[N];
    CONCATENATE(vstore, N)(x, 0, parts);
    for (int i = 0; i < N; ++i) s = sum_add(s, parts[i]);
    return s;
#endif
}

static inline real largest_lane(const realN x)
{
#if N == 1
    return x;
#else
    real parts[N], largest;
    STORE_PRIVATE(parts, 0, x);
    largest = parts[0];
    for (int i = 1; i < N; ++i) largest = parts[i] > largest ? parts[i] : largest;
    return largest;
#endif
}

/* What a sum or a function is divided by: a number, or with OVER a function of OVER channels, 1 or M. Lanes without a
 * vertex divide 0 by 0: USED. */
#define OVER_ARGS                                                                                                    \
    __global const real *overs, /* OVER channels; not read without */                                                \
    const real over_            /* not read with OVER */
#ifdef OVER
#define OVER_OF(x, c) ((x) / LOAD(overs, AT(u, OVER == 1 ? 0 : (c), OVER)))
#else
#define OVER_OF(x, c) ((x) / over_)
#endif

#endif
