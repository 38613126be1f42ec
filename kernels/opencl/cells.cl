/* The cells of an image as a function on the grid, and back, with all conversions of types and layouts:
 *
 *     f_c(u) = (x_c(u)/unit_c - offset_c) factor            cells_in   (OUT is not defined)
 *     x_c(u) = (f_c(u) factor + offset_c) unit_c            with OUT; integers rounded to the nearest and clipped
 *
 * One work item: one cell of a row, all channels. Neighbouring work items read and write neighbouring cells.
 * Traffic per vertex: m cells of the image and m reals. A band of rows is converted at a time.
 *
 * Build options:
 *   -DCELL=uchar|...   type of the image's numbers; -DHALF_CELLS float16; -DINTEGER_CELLS the type is an integer
 *   -DHELD=float|double  the type that holds the image: quotients and products by units are rounded to it
 *   -DWIDE=float|double  the type of the other arithmetic
 *   -DOFFSETS          subtract the offsets, or add them; without, they are 0 and not read
 *   -DUNITS            divide by units; without, they are 1 and not read
 */
#include "reals.cl"

#ifndef CELL
#define CELL float
#endif
#ifndef HELD
#define HELD float
#endif
#ifndef WIDE
#define WIDE float
#endif

#ifdef HALF_CELLS
typedef ushort cell_t;
#define READ(p, i) vload_half(i, (__global const half *)(p))
#define WRITE(p, i, x) vstore_half_rte(x, i, (__global half *)(p))
#else
typedef CELL cell_t;
#define READ(p, i) ((p)[i])
#ifdef INTEGER_CELLS
#define WRITE(p, i, x) ((p)[i] = CONCATENATE(CONCATENATE(convert_, CELL), _sat_rte)(x))
#else
#define WRITE(p, i, x) ((p)[i] = (CELL)(x))
#endif
#endif

#ifdef OFFSETS
#define OFFSET(c) offset[c]
#else
#define OFFSET(c) 0
#endif

#ifdef OUT
#define CELLS __global cell_t *
#define END width
#define FUNCTION __global const real *
#else
#define CELLS __global const cell_t *
#define END pitch
#define FUNCTION __global real *
#endif

__kernel void cells(
    const int m,         /* channels */
    const int width,     /* cells in a row */
    const int n_rows,    /* of the band */
    const long first,    /* row of the function with which the band begins */
    const long row_step, /* numbers of the image from a row to the next, a cell, a channel */
    const long cell_step,
    const long channel_step,
    const long pitch, /* the layout of functions, see grid.cl */
    const long plane,
    const long guard,
    __global const WIDE *offset, /* (m,); read with OFFSETS */
    __global const HELD *unit,   /* (m,); read with UNITS */
    const WIDE factor,
    CELLS x,    /* the band of the image */
    FUNCTION f) /* m channels */
{
    const int column = (int)get_global_id(0);
    const long row = get_global_id(1);
    if (column >= END || row >= n_rows) return;
    const long u = guard + (first + row) * pitch + column, at = row * row_step + column * cell_step;
#ifndef OUT
    if (column >= width) { /* the rest of a row of the function is 0 */
        for (int c = 0; c < m; ++c) f[u + c * plane] = 0;
        return;
    }
#endif
    for (int c = 0; c < m; ++c) {
#ifdef OUT
        HELD value = (HELD)((WIDE)f[u + c * plane] * factor + OFFSET(c));
#ifdef UNITS
        value *= unit[c];
#endif
        WRITE(x, at + c * channel_step, value);
#else
        HELD value = (HELD)READ(x, at + c * channel_step);
#ifdef UNITS
        value /= unit[c];
#endif
        f[u + c * plane] = (real)(((WIDE)value - OFFSET(c)) * factor);
#endif
    }
}
