/* The members of the group of each reference u: the patches of a window that are most like that of u   (section 5.2)
 *
 *   d(u, v) = sum over channels and cells of a patch of (g(u + j) - g(v + j))^2
 *   t = max(n-th smallest d(u, v) over the window,  limit level(u)),   members: d(u, v) <= t
 *
 * Of K > MOST members, in row-major order, those of rank i with floor((i + 1) MOST/K) > floor(i MOST/K) remain: they
 * are spread evenly over the window, not the nearest, which are alike only because their noise is.
 *
 * One work item: one reference. It computes the distances of the window, row by row in packs of N; cells outside the
 * grid or its mask have distance infinity. The n-th smallest is found on the bits of a number, which are in the order of
 * the numbers for those >= 0: each step counts the distances up to a bound between two others, by halves and by the
 * counts at both ends in turn. It ends at a bound with n distances, or, where several distances are equal, after at
 * most twice as many steps as a number has bits.
 * Arithmetic per reference: 3 M (2 WZ + 1)(2 WY + 1) times the packs of a row per channel, then about 10 comparisons per
 * pack. Traffic per reference: the window and its patches from the cache; writes MOST + 1 numbers of 2 and 4 bytes.
 */
#include "lattice.cl"

#ifndef MOST
#define MOST 80 /* members at most */
#endif
#define PACKS ((SIDE + N - 1) / N)         /* of a row of the window */
#define ROWS ((2 * WZ + 1) * (2 * WY + 1)) /* of the window */
#ifdef DOUBLE
#define LARGEST 0x7fefffffffffffffL
#else
#define LARGEST 0x7f7fffff
#endif

/* Number of distances up to a bound. */
static inline int count_up_to(const realN *d, const real bound)
{
    laneN total = 0;
    for (int i = 0; i < ROWS * PACKS; ++i) total += d[i] <= bound ? (laneN)(1) : (laneN)(0);
#if N == 1
    return (int)total;
#else
    lane parts[N];
    CONCATENATE(vstore, N)(total, 0, parts);
    int sum = 0;
    for (int i = 0; i < N; ++i) sum += (int)parts[i];
    return sum;
#endif
}

/* A bound with n distances up to it, or with more if the n-th smallest is not the only one of its value; `least` has
 * `total` of them, which are fewer, and gets the number. If it is 0 the search begins with all numbers, otherwise with
 * factors of 4, because most bounds are near it. Then every second step divides by the numbers of distances up to both
 * ends instead of by 2: on pictures 5 steps instead of 9. */
static inline real nth_smallest(const realN *d, const int n, const real least, int *total)
{
    lane low = CONCATENATE(as_, LANE_)(least), high = LARGEST;
    int below = *total, above = ROWS * PACKS * N;
    const lane factor = (lane)2 << MANTISSA;
    if (least >= LEAST_NORMAL)
        while (high - low > factor && above > n) {
            const int found = count_up_to(d, CONCATENATE(as_, REAL_)(low + factor));
            if (found >= n) {
                high = low + factor;
                above = found;
                break;
            }
            low += factor;
            below = found;
        }
    for (bool halve = least < LEAST_NORMAL; high - low > 1 && above > n; halve = !halve) {
        const real share = halve ? (real)0.5 : (n - (real)0.5 - below) / (above - below);
        const lane middle = low + max((lane)1, min(high - low - 1, (lane)((high - low) * share)));
        const int found = count_up_to(d, CONCATENATE(as_, REAL_)(middle));
        if (found >= n) {
            high = middle;
            above = found;
        } else {
            low = middle;
            below = found;
        }
    }
    *total = above;
    return CONCATENATE(as_, REAL_)(high);
}

ALONE __kernel void patch_groups(
    LATTICE_ARGS,
    __global const real *guide,  /* `channels` planes: g */
    __global const real *inside, /* one plane: 1 in the grid's mask, 0 elsewhere; read if masked */
    const int masked,
    __global const real *level, /* one plane; read if levelled */
    const int levelled,
    const int nearest, /* n */
    const real limit_, /* of d, for level 1 */
    /* output */
    __global ushort *members,      /* (references, MOST): places in the window, row-major */
    __global int *sizes_of_groups) /* (references,) */
{
    const int i = (int)get_global_id(0), j = (int)get_global_id(1), k = (int)get_global_id(2);
    const int x = REFERENCE(i, x), y = REFERENCE(j, y), z = REFERENCE(k, z);
    const long reference = ((long)k * counts.y + j) * counts.x + i, u = PLACE(z, y, x);
    const long middle = PLACE(z + PZ, y + PY, x + PX);
    if (masked && inside[middle] == 0) {
        sizes_of_groups[reference] = 0;
        return;
    }
    realN d[ROWS * PACKS];
    for (int row = 0; row < ROWS; ++row) {
        const int zv = z + row / (2 * WY + 1) - WZ, yv = y + row % (2 * WY + 1) - WY;
        realN sum[PACKS];
#pragma unroll
        for (int p = 0; p < PACKS; ++p) sum[p] = 0;
        if (zv < 0 || zv >= sizes.z || yv < 0 || yv >= sizes.y) {
            for (int p = 0; p < PACKS; ++p) d[row * PACKS + p] = (realN)(INFINITY);
            continue;
        }
        const long v = PLACE(zv, yv, x - WX);
        for (int c = 0; c < channels; ++c)
            for (int line = 0; line < LINES; ++line) {
                const long at = c * plane + (line / (2 * PY + 1)) * layer + (line % (2 * PY + 1)) * pitch;
#pragma unroll
                for (int q = 0; q < D; ++q) {
                    const realN own = (realN)(guide[u + at + q]);
#pragma unroll
                    for (int p = 0; p < PACKS; ++p) {
                        const realN difference = LOAD(guide, v + at + q + p * N) - own;
                        sum[p] += difference * difference;
                    }
                }
            }
        const long cells = PLACE(zv + PZ, yv + PY, x - WX + PX);
        for (int p = 0; p < PACKS; ++p) {
            const laneN column = p * N + LANES, xv = x - WX + column;
            laneN there = column < SIDE && xv >= 0 && xv < sizes.x;
            if (masked) there = there && LOAD(inside, cells + p * N) != 0;
            d[row * PACKS + p] = there ? sum[p] : (realN)(INFINITY);
        }
    }
    const real largest = CONCATENATE(as_, REAL_)((lane)LARGEST);
    const int n = min(nearest, count_up_to(d, largest));
    /* below the distance of cells that are no members */
    const real limit = fmin(levelled ? limit_ * level[middle] : limit_, largest);
    real bound = limit;
    int total = count_up_to(d, limit);
    if (total < n) {
        bound = nth_smallest(d, n, limit, &total);
    }
    int found = 0, share = 0;
    __global ushort *own = members + reference * MOST;
    for (int row = 0; row < ROWS; ++row)
        for (int p = 0; p < PACKS; ++p) {
            const realN pack = d[row * PACKS + p];
#if N == 1 /* any() of a number looks at its sign, and 1 is true here */
            if (!(pack <= bound)) continue;
#else
            if (!any(pack <= (realN)(bound))) continue;
#endif
            real parts[N];
            STORE_PRIVATE(parts, 0, pack);
            for (int q = 0; q < N; ++q) {
                if (!(parts[q] <= bound)) continue;
                share += MOST;
                if (total > MOST && share < total) continue;
                share -= total;
                own[found++] = (ushort)(row * SIDE + p * N + q);
            }
        }
    sizes_of_groups[reference] = found;
}
