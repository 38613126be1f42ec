/* The changes r of the patches of each group, as in group_step.cl, for a GPU: no private array in memory.
 *
 *   C = 1/(N_u - 1) sum_v (b(v) - m_b)(b(v) - m_b)^T,   S = diag(mean over v of the variances of the patch)
 *   r(v) = S (C + S)^-1 (a(v) - m)          a(v) - b(v) if trace C > worst min S
 *
 * One work group: one of a range of references, one channel after the other.
 *   C          blocks of two lines of a patch in registers, D D numbers; the members are dealt to SUBSETS work items
 *              for each block, which add what they have in order
 *   C+S        = L P L^T with 1 on the diagonal of L; W = L^-1 and the pivots P by elimination, not the inverse, as in
 *              group_step.cl: PARTS work items have a row in registers, work item p columns p, p + PARTS, ...; the row
 *              of a pivot goes through local memory, with one barrier. Registers have no index at run time, so a row
 *              moves by one after PARTS pivots: the pivots are in the first.
 *   r          S W^T P^-1 W (a - m); each work item has a line of the patches of TURN members in registers
 *   sums       a patch has one cell in each class of cells of the tile that differ by whole patches: work item l adds
 *              the numbers of its class, member by member, so that no two write one cell, and no barrier is between
 * The tile of sums is written for group_gather.cl, with a mark for each place of the window that is a member.
 * Arithmetic per group and channel: N_u M (M + 1)/2 + M^3/2 + N_u M M multiply-adds.
 * Local memory: two tiles (with FAR none), M M + BATCH M + 2 PARTS COLUMNS + 3 M numbers, 8 MOST bytes. Traffic per group and channel:
 * reads the tile's cells of f0 and guide from the cache, writes the tile; once, PLACES bytes.
 */
#include "group_tile.cl"

#define ITEMS (M <= 32 ? 64 : 128)
#define PARTS (ITEMS / M)                               /* work items of a row of the matrix */
#define COLUMNS ((M + 4 * PARTS - 1) / (4 * PARTS) * 4) /* of a work item */
#define BLOCKS (LINES * (LINES + 1) / 2)                /* of the covariance */
#define AT_ONCE (BLOCKS < ITEMS ? BLOCKS : ITEMS)       /* blocks */
#define SUBSETS (ITEMS / AT_ONCE)                       /* of the members */
#define SLOTS (ITEMS / LINES)                           /* members at once */
#define TURN 3                                          /* members of a work item */
#define BATCH (SLOTS * TURN)

/* The mean over the members of cell `cell` of their patches. */
static inline real mean_of(TILE_SPACE const real *tile, __local const int *places, const int n, const int cell)
{
    real sum = 0;
    for (int v = 0; v < n; ++v) sum += tile[places[v] + cell];
    return sum / (real)n;
}

/* The covariance of n patches, (M, M). */
static inline void covariance(
    TILE_SPACE const real *tile,
    __local const int *places,
    __local const real *mean,
    const int n,
    const int l,
    __local real *matrix)
{
    const real share = 1 / (real)max(n - 1, 1);
    const int subset = l / AT_ONCE;
    for (int first = 0; first < BLOCKS; first += AT_ONCE) {
        const int block = first + l % AT_ONCE;
        const bool on = block < BLOCKS && subset < SUBSETS;
        int i = 0, j = on ? block : 0; /* lines */
        while (j >= LINES - i) {
            j -= LINES - i;
            ++i;
        }
        j += i;
        real sum[D * D], mean_i[D], mean_j[D];
#pragma unroll
        for (int q = 0; q < D * D; ++q) sum[q] = 0;
#pragma unroll
        for (int q = 0; q < D; ++q) {
            mean_i[q] = mean[i * D + q];
            mean_j[q] = mean[j * D + q];
        }
        const int own_i = LINE_AT(i), own_j = LINE_AT(j);
        for (int v = on ? subset : n; v < n; v += SUBSETS) {
            TILE_SPACE const real *patch = tile + places[v];
            real line_i[D], line_j[D];
#pragma unroll
            for (int q = 0; q < D; ++q) {
                line_i[q] = patch[own_i + q] - mean_i[q];
                line_j[q] = patch[own_j + q] - mean_j[q];
            }
#pragma unroll
            for (int q = 0; q < D; ++q)
#pragma unroll
                for (int r = 0; r < D; ++r) sum[q * D + r] += line_i[q] * line_j[r];
        }
        for (int s = 0; s < SUBSETS; ++s) {
            if (on && subset == s)
#pragma unroll
                for (int q = 0; q < D; ++q)
#pragma unroll
                    for (int r = 0; r < D; ++r) {
                        __local real *to = matrix + (i * D + q) * M + j * D + r;
                        const real whole = s == 0 ? sum[q * D + r] : *to + sum[q * D + r];
                        const real value = s + 1 < SUBSETS ? whole : whole * share;
                        *to = value;
                        if (i != j && s + 1 == SUBSETS) matrix[(j * D + r) * M + i * D + q] = value;
                    }
            barrier(FENCE);
        }
    }
}

/* Replace the matrix + S by W, and `scale` by 1/P. A pivot k is matrix(k, k); then
 * matrix(i, j) -= matrix(i, k) matrix(k, j)/P(k) in the rows i > k, and matrix(i, k) = -matrix(i, k)/P(k): the columns
 * up to k are those of W, and what is right of them and below is symmetric. */
static inline void factor(
    __local real *matrix, __local const real *variance, __local real *scale, __local real *pivots, const int l)
{
    const int part = l / M, own = l % M, place = own % PARTS * COLUMNS; /* column `own` is at place + at of a pivot */
    const bool on = part < PARTS;
    int at = own / PARTS;
    real row[COLUMNS];
#pragma unroll
    for (int j = 0; j < COLUMNS; ++j) {
        const int column = j * PARTS + part;
        row[j] = on && column < M ? matrix[own * M + column] + (column == own ? variance[own] : 0) : 0;
    }
#pragma unroll 4
    for (int turn = 0; turn < COLUMNS; ++turn) {
        for (int p = 0; p < PARTS; ++p) {
            const int k = turn * PARTS + p;
            __local real *pivot = pivots + k % 2 * PARTS * COLUMNS; /* the other one may still be read */
            if (on && own == k)
#pragma unroll
                for (int j = 0; j < COLUMNS; ++j) pivot[part * COLUMNS + j] = row[j];
            barrier(FENCE);
            if (!on || own < k || k >= M) continue;
            const real inverse = 1 / pivot[p * COLUMNS];
            if (own == k) {
                scale[k] = inverse;
                continue;
            }
            const real share = pivot[place + at] * inverse; /* by symmetry: matrix(own, k)/P(k) */
#pragma unroll
            for (int j = 0; j < COLUMNS; ++j) row[j] -= share * pivot[part * COLUMNS + j];
            if (part == p) row[0] = -share;
        }
        const real begin = row[0];
#pragma unroll
        for (int j = 0; j + 1 < COLUMNS; ++j) row[j] = row[j + 1];
        row[COLUMNS - 1] = begin;
        at = at == 0 ? COLUMNS - 1 : at - 1;
    }
#pragma unroll
    for (int j = 0; j < COLUMNS; ++j) {
        const int column = j * PARTS + part;
        if (on && column < M) matrix[own * M + column] = row[j];
    }
    barrier(FENCE);
    /* the rest of the lines of the patch; what is right of them is not read */
    for (int i = l; i < M * D; i += ITEMS) {
        const int r = i / D, column = r / D * D + i % D;
        if (column >= r) matrix[r * M + column] = column == r;
    }
}

/* A line of P^-1 W (x - mean) for the patches x of TURN members. */
static inline void forward(
    __local const real *matrix,
    __local const real *scale,
    __local const real *mean,
    TILE_SPACE const real *const *patches,
    const int line,
    real *sum)
{
#pragma unroll
    for (int t = 0; t < TURN * D; ++t) sum[t] = 0;
    for (int other = 0; other <= line; ++other)
#pragma unroll
        for (int q = 0; q < D; ++q) {
            __local const real *weights = matrix + line * D * M + other * D + q;
            real x[TURN];
#pragma unroll
            for (int t = 0; t < TURN; ++t) x[t] = patches[t][LINE_AT(other) + q] - mean[other * D + q];
#pragma unroll
            for (int r = 0; r < D; ++r)
#pragma unroll
                for (int t = 0; t < TURN; ++t) sum[t * D + r] += weights[r * M] * x[t];
        }
#pragma unroll
    for (int r = 0; r < D; ++r)
#pragma unroll
        for (int t = 0; t < TURN; ++t) sum[t * D + r] *= scale[line * D + r];
}

/* A line of W^T y for TURN members, whose y are SLOTS M numbers apart. */
static inline void back(__local const real *matrix, __local const real *y, const int line, real *sum)
{
#pragma unroll
    for (int t = 0; t < TURN * D; ++t) sum[t] = 0;
    for (int other = line; other < LINES; ++other)
#pragma unroll
        for (int q = 0; q < D; ++q) {
            __local const real *weights = matrix + (other * D + q) * M + line * D;
#pragma unroll
            for (int r = 0; r < D; ++r)
#pragma unroll
                for (int t = 0; t < TURN; ++t) sum[t * D + r] += weights[r] * y[t * SLOTS * M + other * D + q];
        }
}

__attribute__((reqd_work_group_size(ITEMS, 1, 1))) __kernel void group_step(
    LATTICE_ARGS,
    const int first,                /* the reference of the launch's first work group */
    __global const real *f0,        /* `channels` planes */
    __global const real *guide,     /* `channels` planes */
    __global const real *variances, /* one plane; read if it is a map */
    const int mapped,
    const real variance_,                /* read if it is none */
    const real worst,                    /* trace C over min S at most */
    __global const ushort *members,      /* (references, MOST) */
    __global const int *sizes_of_groups, /* (references,) */
    /* output */
    __global real *tiles,  /* (work groups, channels, TILE): sums of r */
    __global uchar *marks, /* (work groups, PLACES): 1 for a member */
    __global real *values) /* (work groups, TILE): scratch memory with FAR */
{
    __local real matrix[M * M], changes[BATCH * M], pivots[2 * PARTS * COLUMNS];
    __local real mean[M], variance[M], scale[M];
    __local int places[MOST];   /* tile cell where a member's patch begins */
    __local uchar4 turns[MOST]; /* its x, y, z less whole patches */
    const int l = (int)get_local_id(0), slot = (int)get_group_id(0), reference = first + slot;
    const int n = sizes_of_groups[reference], line_of = reference / counts.x;
    const int4 corner = (int4)(REFERENCE(reference % counts.x, x) - WX, REFERENCE(line_of % counts.y, y) - WY,
                               REFERENCE(line_of / counts.y, z) - WZ, 0);
    if (n == 0) return; /* all of them */
#ifdef FAR
    __global real *tile = values + (long)slot * TILE;
    __global uchar *marked = marks + (long)slot * PLACES;
#else
    __local real tile[TILE], sums[TILE];
    __local uchar *marked = (__local uchar *)sums;
#endif
    for (int i = l; i < PLACES; i += ITEMS) marked[i] = 0;
    barrier(FENCE);
    for (int v = l; v < n; v += ITEMS) {
        const int place = members[(long)reference * MOST + v], row = place / SIDE, x = place % SIDE;
        marked[place] = 1;
        places[v] = ROW_AT(row) + x;
        turns[v] = (uchar4)(x % D, row % (2 * WY + 1) % DY, row / (2 * WY + 1) % (2 * PZ + 1), 0);
    }
    barrier(FENCE);
#ifndef FAR
    for (int i = l; i < PLACES; i += ITEMS) marks[(long)slot * PLACES + i] = marked[i];
#endif
    /* place of this work item in a patch, and in a class of cells */
    const int xl = l % D, yl = l / D % DY, zl = l / D / DY;
    real noise = 0;
    for (int v = 0; mapped && l < M && v < n; ++v) {
        const int place = members[(long)reference * MOST + v], row = place / SIDE;
        const int x = corner.x + place % SIDE + xl, y = corner.y + row % (2 * WY + 1) + yl;
        noise += variances[PLACE(corner.z + row / (2 * WY + 1) + zl, y, x)];
    }
    if (l < M) variance[l] = mapped ? noise / (real)n : variance_;
    const int line = min(l / SLOTS, LINES - 1), own = l % SLOTS * M + line * D; /* in r and y */
    for (int c = 0; c < channels; ++c) {
        __global real *own_tile = tiles + ((long)slot * channels + c) * TILE;
#ifdef FAR
        __global real *sums = own_tile;
#endif
        load_tile(guide + before + c * plane, sizes, pitch, layer, corner, l, ITEMS, tile);
        barrier(FENCE);
        for (int i = l; i < TILE; i += ITEMS) sums[i] = 0;
        if (l < M) mean[l] = mean_of(tile, places, n, LINE_AT(l / D) + xl);
        barrier(FENCE);
        covariance(tile, places, mean, n, l, matrix);
        real trace = 0, least = variance[0];
        for (int q = 0; q < M; ++q) {
            trace += matrix[q * M + q];
            least = fmin(least, variance[q]);
        }
        const bool known = trace <= worst * least;
        load_tile(f0 + before + c * plane, sizes, pitch, layer, corner, l, ITEMS, tile);
        factor(matrix, variance, scale, pivots, l);
        if (l < M) mean[l] = mean_of(tile, places, n, LINE_AT(l / D) + xl);
        barrier(FENCE);
        for (int from = 0; from < n; from += BATCH) {
            TILE_SPACE const real *patches[TURN];
            real sum[TURN * D];
#pragma unroll
            for (int t = 0; t < TURN; ++t) patches[t] = tile + places[min(from + l % SLOTS + t * SLOTS, n - 1)];
            forward(matrix, scale, mean, patches, line, sum);
#pragma unroll
            for (int t = 0; t < TURN * D; ++t)
                if (l < LINES * SLOTS) changes[own + t / D * SLOTS * M + t % D] = sum[t];
            barrier(FENCE);
            back(matrix, changes + l % SLOTS * M, line, sum);
            barrier(FENCE);
#pragma unroll
            for (int t = 0; t < TURN * D; ++t)
                if (l < LINES * SLOTS) changes[own + t / D * SLOTS * M + t % D] = variance[line * D + t % D] * sum[t];
            barrier(FENCE);
            for (int v = from; l < M && v < min(from + BATCH, n); ++v) {
                const uchar4 turn = turns[v];
                int x = xl - turn.x, y = yl - turn.y, z = zl - turn.z;
                x += x < 0 ? D : 0;
                y += y < 0 ? DY : 0;
                z += z < 0 ? 2 * PZ + 1 : 0;
                const int in_patch = z * DY + y, at = places[v] + LINE_AT(in_patch) + x;
                real change = changes[(v - from) * M + in_patch * D + x];
                if (!known) {
                    const int row = at / TILE_X, yt = corner.y + row % TILE_Y, zt = corner.z + row / TILE_Y;
                    change = tile[at] - guide[c * plane + PLACE(zt, yt, corner.x + at % TILE_X)];
                }
                sums[at] += change;
            }
            barrier(FENCE);
        }
#ifndef FAR
        for (int i = l; i < TILE; i += ITEMS) own_tile[i] = sums[i];
#endif
    }
}
