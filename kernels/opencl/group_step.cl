/* The step of the model at p = 2 on groups of patches, with a matrix for lam, and the mean of the patches' estimates
 *                                                             (eq. 25 with values in R^M; Lebrun, Buades, Morel 2013)
 * For each group, with N_u members v, their patches a(v) of f0 and b(v) of the guide, and means m, m_b over the group:
 *
 *   C = 1/(N_u - 1) sum_v (b(v) - m_b)(b(v) - m_b)^T,   S = diag(mean over v of the variances of the patch)
 *   r(v) = S (C + S)^-1 (a(v) - m)
 *   out(x) = f0(x) - (sum of r over all patches of all groups that cover x) / (number of these patches)
 *
 * One work item: the groups of one block of references, one after the other. It adds to `sums` and `counts`, so blocks
 * that write the same cells do not run at the same time: there is one launch for each parity of the block's number along
 * each axis, and two blocks of one launch have a block between them. So no atomics are needed, and every cell is summed
 * in the same order, also in a part of a grid.
 *   members    their patches lie one after the other in `patches`, each in packs of N numbers, the last one filled by 0
 *   C          upper triangle of packs: TILE rows at a time in registers, a sum over the members
 *   (C+S)^-1   by the symmetric sweep operator, which needs no square roots and no triangular solves: after a sweep with
 *              each row, the matrix is -(C+S)^-1
 *   r          TILE members at a time in registers, a sum over the rows of the matrix
 * MEAN: the second kernel, one work item a pack of cells, CELLS of them a group: divides the sums.
 * Arithmetic per group and channel, in packs, P = ceil(M/N) of a patch: about N_u M P (1/2 + 1) + M M P/2 multiply-adds.
 * Traffic per group: the window from the cache, N_u M numbers of sums and counts read and written.
 */
#include "lattice.cl"

#ifndef MOST
#define MOST 80 /* members at most */
#endif
#define PACKS ((M + N - 1) / N) /* of a patch */
#define MP (PACKS * N)
#define TILE (PACKS <= 4 ? 4 : 2)
#define PIVOTS (N < 4 ? N : 4)                     /* rows of a sweep */
#define SWEPT ((M + PIVOTS - 1) / PIVOTS * PIVOTS) /* rows of the matrix with those of the identity after it */
/* Reads of lines in one load: D numbers, rounded up. */
#if PX < 2
#define WIDE 4
#elif PX < 4
#define WIDE 8
#else
#define WIDE 16
#endif
/* Numbers of a patch in memory: its last line may write beyond it. */
#define ROOM ((M + WIDE + N - 1) / N * N)

#ifdef MEAN
#ifndef CELLS
#define CELLS 1
#endif
__attribute__((reqd_work_group_size(CELLS, 1, 1))) __kernel void group_step(
    LATTICE_ARGS,
    __global const real *f0,    /* `channels` planes */
    __global const real *guide, /* `channels` planes */
    __global const real *sums,  /* `channels` planes */
    __global const real *uses,  /* one plane, at the first cell of a patch: how often it is a member */
    const long out_pitch,       /* in the layout of grid.cl */
    const long out_plane,
    const long out_guard,
    /* output */
    __global real *out) /* `channels` channels */
{
    const int x = (int)get_global_id(0) * N, row = (int)get_global_id(1), y = row % sizes.y, z = row / sizes.y;
    const long at = PLACE(z + PZ, y + PY, x + PX), to = out_guard + row * out_pitch + x;
    if (x >= sizes.x) return;
    realN count = 0;
    for (int line = 0; line < LINES; ++line) {
        const int above = line / (2 * PY + 1), over = line % (2 * PY + 1);
        if (above > z + PZ || over > y + PY) continue;
        for (int q = 0; q < D; ++q) count += LOAD(uses, at - above * layer - over * pitch - q);
    }
    for (int c = 0; c < channels; ++c) {
        const realN data = LOAD(f0, at + c * plane);
        const realN value = count > 0 ? data - LOAD(sums, at + c * plane) / count : LOAD(guide, at + c * plane);
        STORE(out, to + c * out_plane, WHERE(x + LANES < sizes.x, value));
    }
}
#else

#define realW CONCATENATE(REAL_, WIDE)
#define laneW CONCATENATE(LANE_, WIDE)
#if WIDE == 4
#define COLUMNS ((laneW)(0, 1, 2, 3))
#elif WIDE == 8
#define COLUMNS ((laneW)(0, 1, 2, 3, 4, 5, 6, 7))
#else
#define COLUMNS ((laneW)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#endif

/* Add a line of a patch. With GAP, cells after it may be written, with what they hold: no other block has them. */
static inline void add_line(const real *line, __global real *to)
{
#ifdef GAP
    const realW value = CONCATENATE(vload, WIDE)(0, line);
    CONCATENATE(vstore, WIDE)(CONCATENATE(vload, WIDE)(0, to) + (COLUMNS < D ? value : (realW)(0)), 0, to);
#else
#pragma unroll
    for (int q = 0; q < D; ++q) to[q] += line[q];
#endif
}

/* Copy the patch at `from` of a plane to packs. */
static inline void copy_patch(__global const real *from, const long pitch, const long layer, real *to)
{
#pragma unroll
    for (int line = 0; line < LINES; ++line) {
        __global const real *row = from + (line / (2 * PY + 1)) * layer + (line % (2 * PY + 1)) * pitch;
        real *own = to + line * D;
        /* the next line overwrites the numbers after D */
        CONCATENATE(vstore, WIDE)(CONCATENATE(vload, WIDE)(0, row), 0, own);
    }
    for (int q = M; q < MP; ++q) to[q] = 0;
}

/* Copy the patches of all members, less their mean; the mean goes to `mean` if it is not null. */
static inline void copy_patches(
    __global const real *plane, const long *places, const int n, const long pitch, const long layer, real *patches)
{
    realN mean[PACKS];
#pragma unroll
    for (int p = 0; p < PACKS; ++p) mean[p] = 0;
    /* two loops: a pack that is read right after the lines in it were written has to wait for them */
    for (int v = 0; v < n; ++v) copy_patch(plane + places[v], pitch, layer, patches + v * ROOM);
    for (int v = 0; v < n; ++v)
#pragma unroll
        for (int p = 0; p < PACKS; ++p) mean[p] += LOAD_PRIVATE(patches, v * ROOM + p * N);
#pragma unroll
    for (int p = 0; p < PACKS; ++p) mean[p] /= (real)n;
    for (int v = 0; v < n; ++v)
#pragma unroll
        for (int p = 0; p < PACKS; ++p)
            STORE_PRIVATE(patches, v * ROOM + p * N, LOAD_PRIVATE(patches, v * ROOM + p * N) - mean[p]);
}

/* The upper triangle of packs of the covariance of n centred patches, (MP, MP). */
static inline void covariance(const real *patches, const int n, real *matrix)
{
    const real share = 1 / (real)max(n - 1, 1);
#pragma unroll
    for (int first = 0; first < PACKS; ++first)
        for (int i = first * N; i < min(first * N + N, M); i += TILE) {
            realN sum[TILE * PACKS];
#pragma unroll
            for (int k = 0; k < TILE * PACKS; ++k) sum[k] = 0;
            for (int v = 0; v < n; ++v) {
                const real *patch = patches + v * ROOM;
#pragma unroll
                for (int p = first; p < PACKS; ++p) {
                    const realN column = LOAD_PRIVATE(patch, p * N);
#pragma unroll
                    for (int r = 0; r < TILE; ++r) sum[r * PACKS + p] += patch[i + r] * column;
                }
            }
#pragma unroll
            for (int r = 0; r < TILE; ++r)
#pragma unroll
                for (int p = first; p < PACKS; ++p)
                    STORE_PRIVATE(matrix, (i + r) * MP + p * N, sum[r * PACKS + p] * share);
        }
}

/* Replace a symmetric positive matrix of PIVOTS rows by its inverse. */
static inline void invert(real *matrix)
{
#pragma unroll
    for (int k = 0; k < PIVOTS; ++k) {
        const real inverse = 1 / matrix[k * PIVOTS + k];
        matrix[k * PIVOTS + k] = 1;
#pragma unroll
        for (int j = 0; j < PIVOTS; ++j) matrix[k * PIVOTS + j] *= inverse;
#pragma unroll
        for (int i = 0; i < PIVOTS; ++i) {
            if (i == k) continue;
            const real factor = matrix[i * PIVOTS + k];
            matrix[i * PIVOTS + k] = 0;
#pragma unroll
            for (int j = 0; j < PIVOTS; ++j) matrix[i * PIVOTS + j] -= factor * matrix[k * PIVOTS + j];
        }
    }
}

/* Replace a symmetric positive matrix, of which the upper triangle of packs is given, by -1 times its inverse.
 *
 * A sweep with the rows K of a block, P = matrix(K, K): matrix(i, j) -= matrix(i, K) P^-1 matrix(K, j), then
 * matrix(K, j) = P^-1 matrix(K, j), and matrix(K, K) = -P^-1. PIVOTS rows at a time, because a sweep with one row would
 * read and write the matrix for one multiply-add per number. */
static inline void sweep(real *matrix)
{
    for (int k = 0; k < SWEPT; k += PIVOTS) {
        real rows[PIVOTS * MP], swept[PIVOTS * MP], inverse[PIVOTS * PIVOTS];
        const int from = k / N * N;
        for (int j = 0; j < from; ++j)
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r) rows[r * MP + j] = matrix[j * MP + k + r];
#pragma unroll
        for (int r = 0; r < PIVOTS; ++r) {
            for (int j = from; j < MP; j += N) STORE_PRIVATE(rows, r * MP + j, LOAD_PRIVATE(matrix, (k + r) * MP + j));
#pragma unroll
            for (int c = 0; c < PIVOTS; ++c) inverse[r * PIVOTS + c] = rows[r * MP + k + c];
        }
        invert(inverse);
#pragma unroll
        for (int p = 0; p < PACKS; ++p)
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r) {
                realN sum = 0;
#pragma unroll
                for (int c = 0; c < PIVOTS; ++c) sum += inverse[r * PIVOTS + c] * LOAD_PRIVATE(rows, c * MP + p * N);
                STORE_PRIVATE(swept, r * MP + p * N, sum);
            }
#pragma unroll
        for (int first = 0; first < PACKS; ++first) {
            realN pivots[PIVOTS * PACKS];
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r)
#pragma unroll
                for (int p = first; p < PACKS; ++p) pivots[r * PACKS + p] = LOAD_PRIVATE(swept, r * MP + p * N);
            for (int i = first * N; i < min(first * N + N, SWEPT); ++i)
#pragma unroll
                for (int p = first; p < PACKS; ++p) {
                    realN row = LOAD_PRIVATE(matrix, i * MP + p * N);
#pragma unroll
                    for (int r = 0; r < PIVOTS; ++r) row -= rows[r * MP + i] * pivots[r * PACKS + p];
                    STORE_PRIVATE(matrix, i * MP + p * N, row);
                }
        }
        for (int j = 0; j < min(from + N, SWEPT); ++j)
#pragma unroll
            for (int r = 0; r < PIVOTS; ++r) matrix[j * MP + k + r] = swept[r * MP + j];
#pragma unroll
        for (int r = 0; r < PIVOTS; ++r) {
            for (int j = from; j < MP; j += N) STORE_PRIVATE(matrix, (k + r) * MP + j, LOAD_PRIVATE(swept, r * MP + j));
#pragma unroll
            for (int c = 0; c < PIVOTS; ++c) matrix[(k + r) * MP + k + c] = -inverse[r * PIVOTS + c];
        }
    }
}

ALONE __kernel void group_step(
    LATTICE_ARGS,
    const int4 first,               /* the block of the launch's first work item */
    const int4 block,               /* sides of a block, in cells */
    __global const real *f0,        /* `channels` planes */
    __global const real *guide,     /* `channels` planes */
    __global const real *variances, /* one plane; read if it is a map */
    const int mapped,
    const real variance_,                /* read if it is none */
    __global const ushort *members,      /* (references, MOST) */
    __global const int *sizes_of_groups, /* (references,) */
    /* output */
    __global real *sums, /* `channels` planes; added to */
    __global real *uses) /* one plane, at the first cell of a patch: how often it is a member; added to */
{
    const int bx = first.x + 2 * (int)get_global_id(0), by = first.y + 2 * (int)get_global_id(1);
    const int bz = first.z + 2 * (int)get_global_id(2);
    real patches[(MOST + TILE) * ROOM], matrix[MP * MP], variance[MP], change[TILE * ROOM];
    long places[MOST];
    for (int q = 0; q < MP; ++q) variance[q] = q < M ? variance_ : 0;
    for (int k = bz * block.z / steps.z; k < counts.z && REFERENCE(k, z) < (bz + 1) * block.z; ++k)
        for (int j = by * block.y / steps.y; j < counts.y && REFERENCE(j, y) < (by + 1) * block.y; ++j)
            for (int i = bx * block.x / steps.x; i < counts.x && REFERENCE(i, x) < (bx + 1) * block.x; ++i) {
                const long reference = ((long)k * counts.y + j) * counts.x + i;
                const int n = sizes_of_groups[reference];
                if (n == 0) continue;
                const int x = REFERENCE(i, x) - WX, y = REFERENCE(j, y) - WY, z = REFERENCE(k, z) - WZ;
                for (int v = 0; v < n; ++v) {
                    const int place = members[reference * MOST + v], row = place / SIDE;
                    places[v] = PLACE(z + row / (2 * WY + 1), y + row % (2 * WY + 1), x + place % SIDE);
                    uses[places[v]] += 1;
                }
                if (mapped) {
                    for (int q = 0; q < MP; ++q) variance[q] = 0;
                    for (int v = 0; v < n; ++v) {
                        copy_patch(variances + places[v], pitch, layer, change);
                        for (int q = 0; q < M; ++q) variance[q] += change[q];
                    }
                    for (int q = 0; q < M; ++q) variance[q] /= (real)n;
                }
                for (int c = 0; c < channels; ++c) {
                    copy_patches(guide + c * plane, places, n, pitch, layer, patches);
                    covariance(patches, n, matrix);
                    for (int q = M; q < SWEPT; ++q)
                        for (int p = q / N * N; p < MP; ++p) matrix[q * MP + p] = 0;
                    for (int q = 0; q < SWEPT; ++q) matrix[q * MP + q] += q < M ? variance[q] : 1;
                    sweep(matrix);
                    /* both triangles of -(C+S)^-1, times -S from one side */
                    for (int q = 0; q < M; ++q)
                        for (int p = 0; p < q / N * N; ++p) matrix[q * MP + p] = matrix[p * MP + q];
                    for (int q = 0; q < M; ++q)
#pragma unroll
                        for (int p = 0; p < PACKS; ++p)
                            STORE_PRIVATE(
                                matrix, q * MP + p * N,
                                -LOAD_PRIVATE(matrix, q * MP + p * N) * LOAD_PRIVATE(variance, p * N));
                    copy_patches(f0 + c * plane, places, n, pitch, layer, patches);
                    for (int v = 0; v < n; v += TILE) {
                        realN sum[TILE * PACKS];
#pragma unroll
                        for (int t = 0; t < TILE * PACKS; ++t) sum[t] = 0;
                        /* members after the last one have old numbers, which are not used */
                        const real *patch = patches + v * ROOM;
                        for (int q = 0; q < M; ++q) {
                            realN row[PACKS];
#pragma unroll
                            for (int p = 0; p < PACKS; ++p) row[p] = LOAD_PRIVATE(matrix, q * MP + p * N);
#pragma unroll
                            for (int t = 0; t < TILE; ++t)
#pragma unroll
                                for (int p = 0; p < PACKS; ++p) sum[t * PACKS + p] += patch[t * ROOM + q] * row[p];
                        }
#pragma unroll
                        for (int t = 0; t < TILE; ++t)
#pragma unroll
                            for (int p = 0; p < PACKS; ++p) STORE_PRIVATE(change, t * ROOM + p * N, sum[t * PACKS + p]);
                        for (int t = 0; t < TILE && v + t < n; ++t) {
                            __global real *to = sums + c * plane + places[v + t];
#pragma unroll
                            for (int line = 0; line < LINES; ++line)
                                add_line(
                                    change + t * ROOM + line * D,
                                    to + (line / (2 * PY + 1)) * layer + (line % (2 * PY + 1)) * pitch);
                        }
                    }
                }
            }
}
#endif
