/* The step of the model at p = 2 on groups of patches, with a matrix for lam, and the mean of the patches' estimates
 *                                                             (eq. 25 with values in R^M; Lebrun, Buades, Morel 2013)
 * For each group, with N_u members v, their patches a(v) of f0 and b(v) of the guide, and means m, m_b over the group:
 *
 *   C = 1/(N_u - 1) sum_v (b(v) - m_b)(b(v) - m_b)^T,   S = diag(mean over v of the variances of the patch)
 *   r(v) = S (C + S)^-1 (a(v) - m)          a(v) - b(v) if trace C > worst min S
 *   out(x) = f0(x) - (sum of r over all patches of all groups that cover x) / (number of these patches)
 *
 * One work item: the groups of one block of references, one after the other. It adds to `sums` and `uses`, so blocks
 * that write the same cells do not run at the same time: there is one launch for each parity of the block's number along
 * each axis, and two blocks of one launch have a block between them. So no atomics are needed, and every cell is summed
 * in the same order, also in a part of a grid.
 *   members    their patches lie one after the other in `patches`, each in packs of N numbers, the last one filled by 0
 *   C          upper triangle of packs: TILE rows at a time in registers, a sum over the members
 *   (C+S)^-1   by two triangles, Z Z^T (see `factor`), PIVOTS rows at a time
 *   r          TILE members at a time in registers, a sum over the rows of Z, then of Z^T
 * MEAN: the second kernel, one work item a pack of cells, CELLS of them a group: divides the sums.
 * Arithmetic per group and channel, in packs, P = ceil(M/N) of a patch: about N_u M P (1/2 + 1) + M M P/3 multiply-adds.
 * Traffic per group: the window from the cache, N_u M numbers of sums and counts read and written.
 */
#include "lattice.cl"

#ifndef MOST
#define MOST 80 /* members at most */
#endif
/* Reads of lines in one load: D numbers, rounded up. */
#if PX < 2
#define WIDE 4
#elif PX < 4
#define WIDE 8
#else
#define WIDE 16
#endif
#include "triangles.cl"

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
/* As in reals.cl; a call of vload8 with doubles also fails in PoCL where the CPU has no registers of 8 doubles. */
#ifdef __clang__
typedef realW realW_anywhere __attribute__((aligned(sizeof(real))));
#define LOAD_WIDE(p) (*(const realW_anywhere *)(p))
#define LOAD_WIDE_GLOBAL(p) (*(__global const realW_anywhere *)(p))
#define STORE_WIDE(p, x) (*(realW_anywhere *)(p) = (x))
#define STORE_WIDE_GLOBAL(p, x) (*(__global realW_anywhere *)(p) = (x))
#else
#define LOAD_WIDE(p) CONCATENATE(vload, WIDE)(0, p)
#define LOAD_WIDE_GLOBAL(p) LOAD_WIDE(p)
#define STORE_WIDE(p, x) CONCATENATE(vstore, WIDE)((x), 0, p)
#define STORE_WIDE_GLOBAL(p, x) STORE_WIDE(p, x)
#endif
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
    const realW value = LOAD_WIDE(line);
    STORE_WIDE_GLOBAL(to, LOAD_WIDE_GLOBAL(to) + (COLUMNS < D ? value : (realW)(0)));
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
        STORE_WIDE(own, LOAD_WIDE_GLOBAL(row));
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

ALONE __kernel void group_step(
    LATTICE_ARGS,
    const int4 first,               /* the block of the launch's first work item */
    const int4 block,               /* sides of a block, in cells */
    __global const real *f0,        /* `channels` planes */
    __global const real *guide,     /* `channels` planes */
    __global const real *variances, /* one plane; read if it is a map */
    const int mapped,
    const real variance_,                /* read if it is none */
    const real worst,                    /* largest trace of C over the least variance */
    __global const ushort *members,      /* (references, MOST) */
    __global const int *sizes_of_groups, /* (references,) */
    /* output */
    __global real *sums, /* `channels` planes; added to */
    __global real *uses) /* one plane, at the first cell of a patch: how often it is a member; added to */
{
    const int bx = first.x + 2 * (int)get_global_id(0), by = first.y + 2 * (int)get_global_id(1);
    const int bz = first.z + 2 * (int)get_global_id(2);
    /* the covariance is computed in TILE rows, of which the last ones may be beyond the matrix */
    real patches[(MOST + TILE) * ROOM], matrix[(MP + TILE) * MP], diagonal[MP * N], variance[MP], change[TILE * ROOM];
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
                    real trace = 0, least = variance[0];
                    for (int q = 0; q < M; ++q) {
                        trace += matrix[q * MP + q];
                        least = fmin(least, variance[q]);
                    }
                    const bool known = trace <= worst * least;
                    for (int q = M; q < SWEPT; ++q)
                        for (int p = q / N * N; p < MP; ++p) matrix[q * MP + p] = 0;
                    for (int q = 0; q < SWEPT; ++q) matrix[q * MP + q] += q < M ? variance[q] : 1;
                    if (known) factor(matrix, diagonal);
                    copy_patches(f0 + c * plane, places, n, pitch, layer, patches);
                    for (int v = 0; v < n; v += TILE) {
                        /* members after the last one have old numbers, which are not used */
                        if (known) solve(matrix, diagonal, patches + v * ROOM, change);
                        for (int t = 0; t < TILE && v + t < n; ++t) {
                            if (known) {
#pragma unroll
                                for (int p = 0; p < PACKS; ++p)
                                    STORE_PRIVATE(
                                        change, t * ROOM + p * N,
                                        LOAD_PRIVATE(change, t * ROOM + p * N) * LOAD_PRIVATE(variance, p * N));
                            } else {
                                copy_patch(f0 + c * plane + places[v + t], pitch, layer, change + t * ROOM);
                                copy_patch(guide + c * plane + places[v + t], pitch, layer, patches);
                                for (int q = 0; q < M; ++q) change[t * ROOM + q] -= patches[q];
                            }
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
