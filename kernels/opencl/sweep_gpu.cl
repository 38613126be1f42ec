/* One sweep of the Gauss-Jacobi process with its conductances, fused over a tile of a grid, for a GPU
 *                                                                                          (eq. 9, 15, 25, 31)
 *   g(u)   = (|grad_w f(u)|^2 + eps^2)^power,   power = (p - 2)/2
 *   J(u)   = (lam f0(u) + sum_v w (g(u) + g(v)) f(v)) / (lam + sum_v w (g(u) + g(v)))
 *   out(u) = f(u) + theta (J(u) - f(u))
 *
 * For gamma = sqrt(w) and the vertex norm, on two axes, with neighbours that are at most one cell away on each axis. f
 * and w are read once and g is never written to memory; the two kernels read f twice, and write and read g.
 *
 * A work group has a tile of TX x (TY S) cells, of which two on each side are its halo: g is computed one cell into the
 * halo. f and g are exchanged through local memory. Within a column a work item has its neighbours in registers.
 * Operations are explicit (no contraction), so that each cell gets the same bits wherever it lies in its tile: parts
 * of an image give the same bits as the whole image.
 *
 * One work item: S cells of a column. With one gradient norm per channel the third index of a work group is the channel
 * (M = 1), as channels do not depend on each other.
 * Traffic per vertex: reads H weights, 2 M values and lam; writes M numbers; the halo is read from the cache.
 *   -DM=1|2|3|4   -DTY=4   -DS=8   -DPOWER=-0.5f (power, if it is compiled in: p = 1)
 */
#ifndef GRID
#define GRID
#endif
#undef N
#define N 1
#include "grid.cl"

#ifndef M
#define M 1
#endif
#ifndef WINDOW
#define WINDOW 4
#endif

#define TX 64
#ifndef TY
#define TY 4
#endif
#ifndef S
#define S 8
#endif
#define ROWS (TY * S)
#define HALO 2
#define PITCH (TX + 2) /* of a tile with a rim of one cell, which nothing that is written depends on */
#define PLANE ((ROWS + 2) * PITCH)

#ifndef POWER
#define POWER power
#endif

#pragma OPENCL FP_CONTRACT OFF

#define INLINE static inline __attribute__((always_inline))
#define EACH_ROW _Pragma("unroll") for (int y = 0; y < S; ++y)
#define EACH_CHANNEL _Pragma("unroll") for (int c = 0; c < M; ++c)

/* A number at the neighbour of cell y of a column: in a register, or in local memory from `at` on. */
#define IN_COLUMN (step == 0 && y + row_jump >= 0 && y + row_jump < S)
#define OF_NEIGHBOUR(own, at) (IN_COLUMN ? (own)[IN_COLUMN ? y + row_jump : 0] : (at)[(y + row_jump) * PITCH + step])

/* Whether cell y exists; `inner`: all cells of the tile and their neighbours do. */
#define EXISTS (inner || (column && row >= 0 && row < n_rows))
#define CELL_PLACE             \
    const int row = first + y; \
    const long u = guard + (long)row * pitch + x;
/* Cell y of a column in memory, from its first one on; a 32-bit index makes addresses one instruction each. */
#define IN_MEMORY(column, c) ((column)[(c) * plane + y * (int)pitch])

/* x^POWER for x >= 0. */
INLINE real powered(const real x, const real power) { return POWER == (real)-0.5 ? rsqrt(x) : raise(x, POWER); }

/* Compute the gradient norms of a column, 0 outside the grid. */
INLINE void gradient_column(
    GRAPH_ARGS,
    const int x,
    const int first,
    const bool inner,
    const bool column,
    real (*here)[S],
    __local const real *tile,
    const real eps2,
    const real power,
    real *norms)
{
    const bool inner_columns = inner, inner_rows = inner;
    EACH_ROW
    {
        CELL_PLACE
        real sum = 0;
        if (EXISTS) {
            NEIGHBOURS
                EACH_CHANNEL
                {
                    const real d = OF_NEIGHBOUR(here[c], tile + c * PLANE) - here[c][y];
                    sum = fma(w * d, d, sum);
                }
            END
        }
        norms[y] = EXISTS ? powered(sum + eps2, power) : 0;
    }
}

/* Update the cells of a column that are not in the halo; j is the row of its first cell in the tile. f0, lams and out
 * begin there. */
INLINE void update_column(
    GRAPH_ARGS,
    const int x,
    const int first,
    const int j,
    const bool inner,
    const bool column,
    real (*here)[S],
    __local const real *tile,
    const real *norms,
    __local const real *norm_tile,
    __global const real *f0,
    __global const real *lams,
    const real lam_,
    const real theta,
    __global real *out)
{
    const bool inner_columns = inner, inner_rows = inner;
    EACH_ROW
    {
        CELL_PLACE
        if ((y >= HALO || j > 0) && (y < S - HALO || j + S < ROWS) && EXISTS) {
            real total = 0, sum[M];
            EACH_CHANNEL sum[c] = 0;
            NEIGHBOURS
                const real conductance = w * (norms[y] + OF_NEIGHBOUR(norms, norm_tile));
                total += conductance;
                EACH_CHANNEL sum[c] = fma(conductance, OF_NEIGHBOUR(here[c], tile + c * PLANE), sum[c]);
            END
#ifdef LAM_ARRAY
            const real lam = IN_MEMORY(lams, 0);
#else
            const real lam = lam_;
#endif
            const real denominator = lam + total;
            const bool keeps_data = isinf(lam) || !(denominator > SMALLEST);
            EACH_CHANNEL
            {
                const real data = IN_MEMORY(f0, c);
                const real plain = fma(lam, data, sum[c]) / denominator;
                const real moved = fma(theta, plain - here[c][y], here[c][y]);
                IN_MEMORY(out, c) = keeps_data ? data : (theta == (real)1 ? plain : moved);
            }
        }
    }
}

__kernel __attribute__((reqd_work_group_size(TX, TY, 1))) void sweep_gpu(
    GRAPH_ARGS,
    __global const real *f,    /* M channels */
    __global const real *f0,   /* M channels */
    const real power,          /* (p - 2)/2; read without POWER */
    const real eps2,           /* eps^2 */
    __global const real *lams, /* 1 channel; read with LAM_ARRAY */
    const real lam_,           /* read without LAM_ARRAY */
    const real theta,
    /* output */
    __global real *out) /* M channels; not f */
{
    __local real tile[M * PLANE], norm_tile[PLANE];
    const int i = get_local_id(0), j = get_local_id(1) * S, l = get_local_id(1) * TX + i;
    const int left = (int)get_group_id(0) * (TX - 2 * HALO) - HALO;
    const int top = (int)get_group_id(1) * (ROWS - 2 * HALO) - HALO;
    const bool inner = left > 0 && top > 0 && left + TX < width && top + ROWS < n_rows;
    const int x = left + i, first = top + j;
    const bool column = x >= 0 && x < width;
    const long channel = (long)get_group_id(2) * plane;
    const long corner = guard + (long)first * pitch + x;
    f += channel + corner, f0 += channel + corner, out += channel + corner;
#ifdef LAM_ARRAY
    lams += corner;
#endif

    /* the rim: rows, then columns */
    if (l < PITCH) {
        EACH_CHANNEL tile[c * PLANE + l] = tile[c * PLANE + PLANE - PITCH + l] = 0;
        norm_tile[l] = norm_tile[PLANE - PITCH + l] = 0;
    } else if (l - PITCH < ROWS) {
        const int at = (l - PITCH + 1) * PITCH;
        EACH_CHANNEL tile[c * PLANE + at] = tile[c * PLANE + at + PITCH - 1] = 0;
        norm_tile[at] = norm_tile[at + PITCH - 1] = 0;
    }
    __local real *its_tile = tile + (j + 1) * PITCH + i + 1, *its_norms = norm_tile + (j + 1) * PITCH + i + 1;
    real here[M][S], norms[S];
    EACH_ROW
    {
        const int row = first + y;
        EACH_CHANNEL
        {
            here[c][y] = EXISTS ? IN_MEMORY(f, c) : 0;
            its_tile[c * PLANE + y * PITCH] = here[c][y];
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (inner)
        gradient_column(GRAPH, x, first, true, true, here, its_tile, eps2, power, norms);
    else
        gradient_column(GRAPH, x, first, false, column, here, its_tile, eps2, power, norms);
    EACH_ROW its_norms[y * PITCH] = norms[y];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i < HALO || i >= TX - HALO) return;
    if (inner)
        update_column(GRAPH, x, first, j, true, true, here, its_tile, norms, its_norms, f0, lams, lam_, theta, out);
    else
        update_column(GRAPH, x, first, j, false, column, here, its_tile, norms, its_norms, f0, lams, lam_, theta, out);
}
