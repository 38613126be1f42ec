/* Planes of cells around the grid, for kernels that read patches and windows without tests at the border:
 *
 *     out_c(x) = f_c(reflected x)               the cells of the grid and `beyond` more on each side of each axis
 *     out_c(x) = 0 on these                     with ZERO_BEYOND
 *     out_c(x) = 0                              in the rest of a row, before and after these cells
 *
 * Reflection does not repeat the edge cell (numpy's "reflect"); it is done as often as needed.
 *
 * One work item: a pack of N numbers of a row of the result, all channels.
 * Traffic per number of the result: reads one, writes one.
 */
#include "reals.cl"
#include "reflected.cl"

#ifndef NDIM
#define NDIM 2
#endif

__kernel void padded(
    const int m,                /* channels */
    __global const int *sizes,  /* (NDIM,): of the grid's axes */
    __global const int *beyond, /* (NDIM,): cells on each side */
    const long pitch,           /* the layout of functions, see grid.cl */
    const long plane,
    const long guard,
    const int n_rows,       /* rows of a plane of the result */
    const int width,        /* numbers in one of them */
    const int left,         /* numbers before its first cell */
    const long before,      /* numbers before the first plane */
    __global const real *f, /* m channels */
    /* output */
    __global real *out) /* before + m * n_rows * width */
{
    const int x0 = (int)get_global_id(0) * N, row = (int)get_global_id(1);
    if (x0 >= width || row >= n_rows) return;
    long from = 0, step = 1;
    bool within = true;
    for (int a = NDIM - 2, rest = row; a >= 0; --a) {
        const int size = sizes[a], place = rest % (size + 2 * beyond[a]) - beyond[a];
        rest /= size + 2 * beyond[a];
        within = within && place >= 0 && place < size;
        from += reflected(place, size) * step;
        step *= size;
    }
    const int size = sizes[NDIM - 1], first = x0 - left - beyond[NDIM - 1];
    const long u = guard + from * pitch, at = before + (long)row * width + x0;
    for (int c = 0; c < m; ++c) {
        __global const real *of = f + u + c * plane;
        __global real *to = out + at + c * (long)n_rows * width;
#ifdef ZERO_BEYOND
        const bool inner = within && first >= 0 && first + N <= size;
#else
        const bool inner = first >= 0 && first + N <= size;
#endif
        if (inner && x0 + N <= width) {
            STORE(to, 0, LOAD(of, first));
        } else {
            for (int i = 0; i < N && x0 + i < width; ++i) {
                const int place = first + i;
#ifdef ZERO_BEYOND
                const bool known = within && place >= 0 && place < size;
#else
                const bool known = place >= -beyond[NDIM - 1] && place < size + beyond[NDIM - 1];
#endif
                to[i] = known ? of[reflected(place, size)] : (real)0;
            }
        }
    }
}
