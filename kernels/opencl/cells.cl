/* The cells of an image as a function on the grid, and back, with all conversions of types and layouts:
 *
 *     f_c(u) = (x_c(u)/unit_c - offset_c) factor            without OUT
 *     x_c(u) = (f_c(u) factor + offset_c) unit_c            with OUT; integers rounded to the nearest and clipped
 *
 * One work item: RUN neighbouring cells of a row, all channels. On a GPU RUN is 1, so that neighbouring work items read
 * and write neighbouring cells; on a CPU it is a row, whose loop the compiler turns into packs.
 * Traffic per vertex: m cells of the image and m reals. A band of rows is converted at a time.
 *
 * Build options:
 *   -DRUN=...          cells of a work item
 *   -DSTEP=...         numbers of the image from a cell to the next: 1, or the number of channels
 *   -DCELL=uchar|...   type of the image's numbers; -DHALF_CELLS float16; -DINTEGER_CELLS the type is an integer
 *   -DHELD=float|double  the type that holds the image: quotients and products by units are rounded to it
 *   -DWIDE=float|double  the type of the other arithmetic
 *   -DOFFSETS          subtract the offsets, or add them; without, they are 0 and not read
 *   -DUNITS            divide by units; without, they are 1 and not read
 */
#include "reals.cl"

#ifndef RUN
#define RUN 1
#endif
#ifndef STEP
#define STEP 1
#endif
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

#ifdef UNITS
#define UNIT(c) unit[c]
#define SCALED(x, u) ((x) * (u))
#define DIVIDED(x, u) ((x) / (u))
#else
#define UNIT(c) 1
#define SCALED(x, u) (x)
#define DIVIDED(x, u) (x)
#endif
#ifdef OFFSETS
#define OFFSET(c) offset[c]
#else
#define OFFSET(c) 0
#endif

#ifdef OUT
#define CELLS __global cell_t *restrict
#define END width
#define FUNCTION __global const real *restrict
#else
#define CELLS __global const cell_t *restrict
#define END pitch
#define FUNCTION __global real *restrict
#endif

__kernel void cells(
    const int m,         /* channels */
    const int width,     /* cells in a row */
    const int n_rows,    /* of the band */
    const long first,    /* row of the function with which the band begins */
    const long row_step, /* numbers of the image from a row to the next, and from a channel to the next */
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
    const int begin = (int)get_global_id(0) * RUN, end = min(begin + RUN, (int)END), row = (int)get_global_id(1);
    if (begin >= end || row >= n_rows) return;
    for (int c = 0; c < m; ++c) {
        const WIDE moved = OFFSET(c);
        const HELD in_units = UNIT(c);
        FUNCTION at = f + (guard + (first + row) * pitch + c * plane);
        CELLS from = x + (row * row_step + c * channel_step);
#ifdef OUT
        for (int i = begin; i < end; ++i)
            WRITE(from, (long)i * STEP, SCALED((HELD)((WIDE)at[i] * factor + moved), in_units));
#else
        for (int i = begin; i < min(end, width); ++i)
            at[i] = (real)(((WIDE)DIVIDED((HELD)READ(from, (long)i * STEP), in_units) - moved) * factor);
        /* the rest of a row of the function is 0 */
        for (int i = max(begin, width); i < end; ++i) at[i] = 0;
#endif
    }
}
