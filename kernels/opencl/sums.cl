/* Long sums and maxima over all vertices, in two launches without atomics.
 *
 * First, dot, energy, duality_gap and max_change: a work item takes its vertices between SEGMENT_BEGIN and SEGMENT_END
 * (csr.cl, grid.cl) and gives its result to WRITE_PART. Then total.cl adds the parts, in one work group.
 *
 * On a CPU a work item takes neighbouring vertices and writes one part. On a GPU (GROUP) neighbouring work items take
 * neighbouring vertices, each with a stride, and a work group of GROUP work items writes one part, by a tree in local
 * memory. The number of work groups depends on the number of vertices only, and so do the bits of a result.
 *
 * A sum is in float64 if the device has it. Otherwise it is a pair of float32, the sum and what its additions lost
 * (Neumaier): n additions are off by about n u^2 of the sum of sizes, u = 2^-24.
 *   -DGROUP=256   -DMAXIMUM (the largest number instead of the sum)
 */
#ifndef SUMS_CL
#define SUMS_CL
#include "reals.cl"

#if defined(DOUBLE) || defined(SUM_DOUBLE)
typedef struct {
    double sum;
} long_sum;
static inline long_sum sum_start(void)
{
    long_sum s;
    s.sum = 0;
    return s;
}
static inline long_sum sum_add(long_sum s, const real x)
{
    s.sum += (double)x;
    return s;
}
static inline long_sum both_sums(long_sum a, const long_sum b)
{
    a.sum += b.sum;
    return a;
}
static inline double sum_value(const long_sum s) { return s.sum; }
typedef double sum_t;
#else
typedef struct {
    float sum, lost;
} long_sum;
static inline long_sum sum_start(void)
{
    long_sum s;
    s.sum = 0;
    s.lost = 0;
    return s;
}
static inline long_sum sum_add(long_sum s, const real x)
{
    const float t = s.sum + x;
    s.lost += fabs(s.sum) >= fabs(x) ? (s.sum - t) + x : (x - t) + s.sum;
    s.sum = t;
    return s;
}
static inline long_sum both_sums(long_sum a, const long_sum b)
{
    a = sum_add(a, b.sum);
    a.lost += b.lost;
    return a;
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

static inline long_sum largest_lane(const realN x)
{
    long_sum s = sum_start();
#if N == 1
    s.sum = x;
#else
    real parts[N];
    STORE_PRIVATE(parts, 0, x);
    s.sum = parts[0];
    for (int i = 1; i < N; ++i) s.sum = parts[i] > s.sum ? parts[i] : s.sum;
#endif
    return s;
}

#ifdef MAXIMUM
#define BOTH(a, b) ((a).sum >= (b).sum ? (a) : (b))
#else
#define BOTH(a, b) both_sums(a, b)
#endif

#ifdef GROUP
/* The result of all work items of the group, for each of them. */
static inline long_sum over_group(const long_sum own, __local long_sum *parts)
{
    const int l = get_local_id(0);
    parts[l] = own;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int step = GROUP / 2; step > 0; step /= 2) {
        if (l < step) parts[l] = BOTH(parts[l], parts[l + step]);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    return parts[0];
}
#define WRITE_PART(result)                            \
    __local long_sum parts[GROUP];                    \
    const long_sum whole = over_group(result, parts); \
    if (get_local_id(0) == 0) out[get_group_id(0)] = whole;
#else
#define WRITE_PART(result) out[SEGMENT_INDEX] = (result);
#endif

#endif
