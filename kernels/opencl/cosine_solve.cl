/* out = T^-1 (T r / eigenvalues),  T the cosine transform (DCT-II) along each axis of a grid
 *
 *     (T r)(k) = 2 sum_i r(i) cos(pi k (2 i + 1) / (2 n))
 *
 * One launch is a step of one axis with n cells (Makhoul 1980), in a work space of complex numbers. Each has
 * cells of two lines as its real and imaginary part.
 *   STEP 0: from the function, sorted: v(i) = r(2 i), v(n - 1 - i) = r(2 i + 1)
 *   STEP 1: a step of the Fourier transform V of v, of radix R (Stockham): sums of R numbers; R may be any factor of n
 *   STEP 2: to the function: (T r)(k) = w V(k) + conj(w) V(n - k), w = exp(-i pi k / (2 n)), divided by eigenvalues
 * and backward: V(k) = conj(w) (t(k) - i t(n - k)) / 2 from the function, the same Fourier transform, and
 * v(i) = V(-i) / n.
 *
 * One work item: a number of the work space.
 * Traffic per cell and axis: STEP 0 and STEP 2 read 1 number (STEP 2 and eigenvalues) and write 1, STEP 1 likewise; the
 * R reads of STEP 1 are shared with R - 1 neighbours.
 *   -DSTEP=0
 */
#include "reals.cl"

#ifndef STEP
#define STEP 0
#endif

#ifdef DOUBLE
typedef double2 complex_t;
#else
typedef float2 complex_t;
#endif

static inline complex_t times(const complex_t a, const complex_t b)
{
    return (complex_t)(a.x * b.x - a.y * b.y, a.x * b.y + a.y * b.x);
}

/* the place of the first cell of a line in the function: lines follow the columns, then rows, then channels */
static inline long line_start(
    const long line,
    const int columns,
    const int inner,
    const int outer,
    const long block,
    const long pitch,
    const long column,
    const long plane,
    const long guard)
{
    const long row = line / columns, slice = row / inner;
    return (slice / outer) * plane + guard + ((slice % outer) * block + row % inner) * pitch + line % columns * column;
}

__kernel void cosine_solve(
    const int n,        /* cells of a line */
    const long lines,   /* of all channels */
    const int backward, /* the inverse transform */
    const int by_line,  /* the next number of the work space is of the next pair of lines, not of the next cell */
    const int columns,  /* lines side by side in a row */
    const int inner,    /* rows side by side in a slice */
    const int outer,    /* slices */
    const long block,   /* rows of a slice */
    const long pitch,   /* places from a row to the next one */
    const long column,  /* places from a column to the next one */
    const long plane,   /* places from a channel to the next one */
    const long guard,   /* place of the first cell */
    const long along,   /* places from a cell of a line to the next one */
    const int width,    /* cells of a row of the grid */
    const int radix,    /* R of STEP 1 */
    const int done,     /* product of the radices before */
    const int divided,  /* whether STEP 2 divides */
    __global const complex_t *roots,   /* (n,): exp(-2 pi i k / n) */
    __global const complex_t *quarter, /* (n,): exp(-pi i k / (2 n)) */
    __global const real *over,         /* eigenvalues, row by row without padding; read if `divided` */
    __global const real *f,            /* the function that STEP 0 reads */
    __global const complex_t *from,    /* the work space that STEP 1 and 2 read */
    __global complex_t *to,            /* the work space that STEP 0 and 1 write */
    /* output */
    __global real *out) /* the function that STEP 2 writes; it may be f */
{
    const long at = get_global_id(0), pairs = (lines + 1) / 2;
    if (at >= pairs * n) return;
    const long pair = by_line ? at % pairs : at / n, cell_step = by_line ? pairs : 1;
    const int i = by_line ? at / pairs : at % n;
    const long origin = by_line ? pair : pair * n;
#if STEP != 1
    const int second = 2 * pair + 1 < lines;
    const long a = line_start(2 * pair, columns, inner, outer, block, pitch, column, plane, guard);
    const long b = second ? line_start(2 * pair + 1, columns, inner, outer, block, pitch, column, plane, guard) : a;
#endif
#if STEP == 0
    if (backward) {
        const long k = i * along, other = (n - i) * along;
        complex_t t = (complex_t)(f[a + k], second ? f[b + k] : 0);
        if (i > 0) t += (complex_t)(second ? f[b + other] : 0, -f[a + other]);
        const complex_t w = quarter[i];
        to[at] = times(t, (complex_t)(w.x, -w.y)) / 2;
    } else {
        const long j = (2 * i < n ? 2 * i : 2 * (n - 1 - i) + 1) * along;
        to[at] = (complex_t)(f[a + j], second ? f[b + j] : 0);
    }
#elif STEP == 1
    const int left = n / (radix * done), q = i % done, k = i / done % radix, p = i / done / radix;
    const int turn = (long)k * (n / radix) % n;
    int angle = (long)p * k * done % n;
    complex_t sum = 0;
    for (int j = 0; j < radix; ++j) {
        sum += times(from[origin + (long)(q + done * (p + left * j)) * cell_step], roots[angle]);
        angle += turn;
        if (angle >= n) angle -= n;
    }
    to[at] = sum;
#else
    complex_t t;
    if (backward) {
        const int v = i % 2 ? n - 1 - i / 2 : i / 2;
        t = from[origin + (long)(v > 0 ? n - v : 0) * cell_step] / n;
    } else {
        const complex_t w = quarter[i];
        t = times(w, from[origin + i * cell_step]);
        t += times((complex_t)(w.x, -w.y), from[origin + (long)(i > 0 ? n - i : 0) * cell_step]);
    }
    const long here = i * along;
    if (divided) {
        const long k = i * (along == column ? 1 : (long)inner * width);
        t.x /= over[line_start(2 * pair, columns, inner, outer, block, width, 1, 0, 0) + k];
        if (second) t.y /= over[line_start(2 * pair + 1, columns, inner, outer, block, width, 1, 0, 0) + k];
    }
    out[a + here] = t.x;
    if (second) out[b + here] = t.y;
#endif
}
