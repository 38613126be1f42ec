/* The distances of patches of a block of packs, for a CPU; strip.cl includes this file, and strip_unrolled.cl for a GPU.
 *
 * `sum_down` passes each column of packs and writes the sums down the patches to an array of the block, `sum_along` adds
 * these along a row. The arrays of a work item are in the L1 and L2 caches.
 */
#define UNROLL
#define FOR_ROWS(y, first, last) for (int y = (first); y < (last); ++y)
#define RHO(y, p) rho[p]

/* The sum of the last 2 R + 1 rows, from sums of 1, 2, 4 and 8 rows; SUMn(l) has the n rows up to the one l rows before
 * the last. */
#ifdef FLAT
#if R == 1
#define PATCH_SUM (SUM2(0) + SUM1(2))
#elif R == 2
#define PATCH_SUM (SUM4(0) + SUM1(4))
#elif R == 3
#define PATCH_SUM ((SUM4(0) + SUM2(4)) + SUM1(6))
#elif R == 4
#define PATCH_SUM (SUM8(0) + SUM1(8))
#elif R == 5
#define PATCH_SUM ((SUM8(0) + SUM2(8)) + SUM1(10))
#endif /* larger patches are summed row by row */
#endif

/* Write the sums down the patches of the rows from .. until, for `ahead`, to down[y * WIDE + pack]. */
static inline void sum_down(
    __global const real *first,
    const long padded_pitch,
    const long padded_plane,
    const long ahead,
    const int from,
    const int until,
    const int n_lines,
    __global const long *lines,
    __global const real *line_weights,
    __global const real *profile,
    realN *down)
{
    for (int p = 0; p < WIDE; ++p) {
        __global const real *at = first + from * padded_pitch + p * N;
#if R == 0 || NDIM == 1
        for (int y = from; y < until; ++y, at += padded_pitch) down[y * WIDE + p] = SQUARES(at);
#else
        /* the last rows of squares; the compiler turns the shifts below into renamed registers */
        realN row[2 * R + 1];
#pragma unroll
        for (int i = 0; i <= 2 * R; ++i) row[i] = 0;
#ifdef PATCH_SUM
        realN two[2 * R + 1], four[2 * R + 1];
#pragma unroll
        for (int i = 0; i <= 2 * R; ++i) two[i] = four[i] = 0;
#define SUM1(l) row[l]
#define SUM2(l) two[l]
#define SUM4(l) four[l]
#define SUM8(l) (four[0] + four[4])
#endif
        for (int q = from - 2 * R; q < until; ++q, at += padded_pitch) {
#pragma unroll
            for (int i = 2 * R; i > 0; --i) row[i] = row[i - 1];
            row[0] = SQUARES(at);
#ifdef PATCH_SUM
#pragma unroll
            for (int i = 2 * R; i > 0; --i) two[i] = two[i - 1];
            two[0] = row[0] + row[1];
#if R >= 2
#pragma unroll
            for (int i = 2 * R; i > 0; --i) four[i] = four[i - 1];
            four[0] = two[0] + two[2];
#endif
            if (q >= from) down[q * WIDE + p] = PATCH_SUM;
#else
            if (q >= from) {
                realN sum = profile[0] * row[2 * R];
#pragma unroll
                for (int i = 1; i <= 2 * R; ++i) sum += profile[i] * row[2 * R - i];
                down[q * WIDE + p] = sum;
            }
#endif
        }
#undef SUM1
#undef SUM2
#undef SUM4
#undef SUM8
#endif
    }
}
#define SUM_DOWN \
    sum_down(    \
        guide + padded0, padded_pitch, padded_plane, ahead, from, until, n_lines, lines, line_weights, profile, down)

/* Compute the distances of the packs of a row from the sums down its patches. */
#if defined(FLAT) && R == 3 && N == 16 && defined(__clang__)
/* A sum of 7 cells is composed of sums of 2: ((2 + 2) + 2) + 1, each one shuffle of two packs that are in registers,
 * instead of 6 loads that are not aligned. On PoCL 3.1 the whole step takes 6 percent less time. For packs of 8, which
 * PoCL 3.0 has, shuffles take five times as long as loads. */
#define SHIFTED(a, b, n)                                                                                        \
    __builtin_shufflevector(                                                                                    \
        a, b, n, n + 1, n + 2, n + 3, n + 4, n + 5, n + 6, n + 7, n + 8, n + 9, n + 10, n + 11, n + 12, n + 13, \
        n + 14, n + 15)
static inline void sum_along(const realN *c, __global const real *profile, realN *rho)
{
    realN here = c[0], next = c[1], two = here + SHIFTED(here, next, 1);
#pragma unroll
    for (int p = 0; p < SPAN; ++p) {
        /* the last pack has no cell of a patch after the next one */
        const realN after = p + 2 < WIDE ? c[p + 2] : next, two_next = next + SHIFTED(next, after, 1);
        rho[p] = ((two + SHIFTED(two, two_next, 2)) + SHIFTED(two, two_next, 4)) + SHIFTED(here, next, 6);
        here = next, next = after, two = two_next;
    }
}
#else
/* Shifted packs are loaded, from the L1 cache. */
static inline void sum_along(const realN *c, __global const real *profile, realN *rho)
{
    const real *numbers = (const real *)c;
#pragma unroll
    for (int p = 0; p < SPAN; ++p) {
#if R == 0 || defined(FLAT)
        realN sum = c[p];
#pragma unroll
        for (int j = 1; j <= 2 * R; ++j) sum += LOAD_PRIVATE(numbers, p * N + j);
#else
        realN sum = profile[0] * c[p];
#pragma unroll
        for (int j = 1; j <= 2 * R; ++j) sum += profile[j] * LOAD_PRIVATE(numbers, p * N + j);
#endif
        rho[p] = sum;
    }
}
#endif

/* With A, the weights of A rows and cells around the block are computed too, and summed along the rows; WEIGHT_OF sums
 * them down the columns. */
#if A > 0
#define BLOCK_ARRAYS realN down[(S + 2 * A) * WIDE], rho[SPAN], single[SPAN], across[(S + 2 * A) * B];
#define BLOCK_OF(k)                                                                                                   \
    for (int i = 0; i < (S + 2 * A) * B; ++i) across[i] = 0;                                                          \
    if (from < until) {                                                                                               \
        const int low = max(-A, -min(y0, y0 + dy)), high = min(rows + A, height - max(y0, y0 + dy));                  \
        const bool leaves = min(x0, x0 + dx) < A || max(x0, x0 + dx) - A + SPAN * N > width_;                         \
        sum_down(                                                                                                     \
            guide + padded0 - A, padded_pitch, padded_plane, ahead, low, high, n_lines, lines, line_weights, profile, \
            down + A * WIDE);                                                                                         \
        for (int y = low; y < high; ++y) {                                                                            \
            sum_along(down + (y + A) * WIDE, profile, rho);                                                           \
            for (int p = 0; p < SPAN; ++p) {                                                                          \
                const long u = centre0 + y * padded_pitch + p * N - A, v = u + ahead;                                 \
                single[p] = PRESENT_WEIGHT(SIMILARITY_AT(rho[p], k, u, v), u, v, x0 - A + p * N);                     \
            }                                                                                                         \
            for (int p = 0; p < B; ++p) {                                                                             \
                realN sum = LOAD_PRIVATE((const real *)single, p * N);                                                \
                for (int j = 1; j <= 2 * A; ++j) sum += LOAD_PRIVATE((const real *)single, p * N + j);                \
                across[(y + A) * B + p] = sum;                                                                        \
            }                                                                                                         \
        }                                                                                                             \
    }
#define ROW_OF(y)
#define WEIGHT_OF(k, y, p, u, v) sum_across(across + (y) * B + (p))
static inline realN sum_across(const realN *across)
{
    realN sum = across[0];
#pragma unroll
    for (int i = 1; i <= 2 * A; ++i) sum += across[i * B];
    return sum;
}
#else
#define BLOCK_ARRAYS realN down[S * WIDE], rho[SPAN];
#define BLOCK_OF(k) \
    if (from < until) SUM_DOWN;
#define ROW_OF(y) sum_along(down + (y) * WIDE, profile, rho);
#define WEIGHT_OF(k, y, p, u, v) SIMILARITY_AT(RHO(y, p), k, u, v)
#endif
