/* Patches b times the inverse of a symmetric positive matrix of M rows, for group_step.cl: K^-1 b = Z Z^T b.
 *
 * A patch is PACKS packs of N numbers, the last ones 0, and a matrix has rows of as many packs. The rows after the M-th
 * are those of the identity, so that PIVOTS rows are treated at a time.
 */
#ifndef TRIANGLES_CL
#define TRIANGLES_CL
#include "lattice.cl"

#ifndef WIDE
#define WIDE N /* numbers that a write may reach beyond a patch */
#endif
#define PACKS ((M + N - 1) / N) /* of a patch */
#define MP (PACKS * N)
#define TILE (PACKS <= 4 ? 4 : 2)
#define PIVOTS (N < 4 ? N : 4)                     /* rows of the matrix at a time */
#define SWEPT ((M + PIVOTS - 1) / PIVOTS * PIVOTS) /* rows of the matrix with those of the identity after it */
/* Numbers of a patch in memory: its last line may write beyond it. */
#define ROOM ((M + WIDE + N - 1) / N * N)

/* Replace a symmetric positive matrix of PIVOTS rows, L L^T, by the inverse of its lower triangle L. */
static inline void invert_block(real *block)
{
    real lower[PIVOTS * PIVOTS];
#pragma unroll
    for (int i = 0; i < PIVOTS; ++i)
#pragma unroll
        for (int j = 0; j <= i; ++j) {
            real sum = block[i * PIVOTS + j];
#pragma unroll
            for (int c = 0; c < j; ++c) sum -= lower[i * PIVOTS + c] * lower[j * PIVOTS + c];
            lower[i * PIVOTS + j] = i == j ? 1 / sqrt(sum) : sum * lower[j * PIVOTS + j]; /* the diagonal inverted */
        }
#pragma unroll
    for (int j = 0; j < PIVOTS; ++j)
#pragma unroll
        for (int i = 0; i < PIVOTS; ++i) {
            real sum = i == j ? 1 : 0;
#pragma unroll
            for (int c = j; c < i; ++c) sum -= lower[i * PIVOTS + c] * block[c * PIVOTS + j];
            block[i * PIVOTS + j] = i < j ? 0 : sum * lower[i * PIVOTS + i];
        }
}

/* Replace a symmetric positive matrix K, of which the upper triangle of packs is given, by the upper triangle Z with
 * Z Z^T = K^-1, and by its transpose below: packs of the diagonal of Z^T are in `diagonal`, those left of them in the
 * matrix. K = U^T U, and Z = U^-1. PIVOTS rows at a time: one row at a time would read and write a pack for one
 * multiply-add.
 *
 * We apply Z and Z^T one after the other instead of K^-1: its rounding errors times a patch would have the size of
 * cond(K) roundings of the patch, those of Z only that of its square root. */
static inline void factor(real *matrix, real *diagonal)
{
    real inverses[SWEPT * PIVOTS];
    for (int k = 0; k < SWEPT; k += PIVOTS) { /* U */
        real *block = inverses + k * PIVOTS;
        const int from = k / N * N;
#pragma unroll
        for (int r = 0; r < PIVOTS; ++r)
#pragma unroll
            for (int c = 0; c < PIVOTS; ++c) block[r * PIVOTS + c] = matrix[(k + min(r, c)) * MP + k + max(r, c)];
        invert_block(block);
        for (int j = from; j < MP; j += N) {
            realN rows[PIVOTS];
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r) rows[r] = LOAD_PRIVATE(matrix, (k + r) * MP + j);
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r) {
                realN sum = 0;
#pragma unroll
                for (int c = 0; c <= r; ++c) sum += block[r * PIVOTS + c] * rows[c];
                STORE_PRIVATE(matrix, (k + r) * MP + j, sum);
            }
        }
#pragma unroll
        for (int first = 0; first < PACKS; ++first) {
            if (first * N + N <= k + PIVOTS) continue;
            realN pivots[PIVOTS * PACKS];
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r)
#pragma unroll
                for (int p = first; p < PACKS; ++p) pivots[r * PACKS + p] = LOAD_PRIVATE(matrix, (k + r) * MP + p * N);
            for (int i = max(first * N, k + PIVOTS); i < min(first * N + N, SWEPT); ++i)
#pragma unroll
                for (int p = first; p < PACKS; ++p) {
                    realN row = LOAD_PRIVATE(matrix, i * MP + p * N);
#pragma unroll
                    for (int r = 0; r < PIVOTS; ++r) row -= matrix[(k + r) * MP + i] * pivots[r * PACKS + p];
                    STORE_PRIVATE(matrix, i * MP + p * N, row);
                }
        }
    }
    for (int k = SWEPT - PIVOTS; k >= 0; k -= PIVOTS) { /* Z, from the last rows */
        const real *block = inverses + k * PIVOTS;
        realN sum[PIVOTS * PACKS];
#pragma unroll
        for (int i = 0; i < PIVOTS * PACKS; ++i) sum[i] = 0;
#pragma unroll
        for (int first = 0; first < PACKS; ++first)
            for (int i = max(first * N, k + PIVOTS); i < min(first * N + N, SWEPT); ++i)
#pragma unroll
                for (int p = first; p < PACKS; ++p) {
                    const realN row = LOAD_PRIVATE(matrix, i * MP + p * N);
#pragma unroll
                    for (int r = 0; r < PIVOTS; ++r) sum[r * PACKS + p] += matrix[(k + r) * MP + i] * row;
                }
#pragma unroll
        for (int r = 0; r < PIVOTS; ++r)
#pragma unroll
            for (int p = 0; p < PACKS; ++p) {
                if (p < k / N) continue;
                realN row = 0;
#pragma unroll
                for (int c = r; c < PIVOTS; ++c) row -= block[c * PIVOTS + r] * sum[c * PACKS + p];
                STORE_PRIVATE(matrix, (k + r) * MP + p * N, row);
            }
#pragma unroll
        for (int r = 0; r < PIVOTS; ++r)
#pragma unroll
            for (int c = 0; c < PIVOTS; ++c) matrix[(k + r) * MP + k + c] = block[c * PIVOTS + r];
    }
    for (int i = 0; i < SWEPT; ++i) { /* Z^T */
        const int from = i / N * N;
        for (int j = 0; j < from; ++j) matrix[i * MP + j] = matrix[j * MP + i];
        for (int j = from; j < from + N; ++j) diagonal[i * N + j - from] = j < SWEPT ? matrix[j * MP + i] : 0;
    }
}

/* Replace TILE patches b by Z Z^T b. */
static inline void solve(const real *matrix, const real *diagonal, const real *patches, real *solved)
{
    realN sum[TILE * PACKS];
#pragma unroll
    for (int t = 0; t < TILE * PACKS; ++t) sum[t] = 0;
#pragma unroll
    for (int first = 0; first < PACKS; ++first)
        for (int q = first * N; q < min(first * N + N, M); ++q)
#pragma unroll
            for (int p = first; p < PACKS; ++p) {
                const realN row = LOAD_PRIVATE(matrix, q * MP + p * N);
#pragma unroll
                for (int t = 0; t < TILE; ++t) sum[t * PACKS + p] += patches[t * ROOM + q] * row;
            }
#pragma unroll
    for (int t = 0; t < TILE; ++t)
#pragma unroll
        for (int p = 0; p < PACKS; ++p) STORE_PRIVATE(solved, t * ROOM + p * N, sum[t * PACKS + p]);
#pragma unroll
    for (int t = 0; t < TILE * PACKS; ++t) sum[t] = 0;
#pragma unroll
    for (int last = 0; last < PACKS; ++last)
        for (int q = last * N; q < min(last * N + N, M); ++q)
#pragma unroll
            for (int p = 0; p <= last; ++p) {
                const realN row = p == last ? LOAD_PRIVATE(diagonal, q * N) : LOAD_PRIVATE(matrix, q * MP + p * N);
#pragma unroll
                for (int t = 0; t < TILE; ++t) sum[t * PACKS + p] += solved[t * ROOM + q] * row;
            }
#pragma unroll
    for (int t = 0; t < TILE; ++t)
#pragma unroll
        for (int p = 0; p < PACKS; ++p) STORE_PRIVATE(solved, t * ROOM + p * N, sum[t * PACKS + p]);
}

#endif
