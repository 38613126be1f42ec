/* out(u) = sum_j taps[|j|] f(u + j e)                         e a step along one axis; j from -r to r
 *
 * Cells beyond the grid are reflected, without repeating the edge cell. The sum begins with the middle; each pair of
 * cells at the same distance is added before it is multiplied. This order is the same for all cells.
 *
 * One work item: a pack of N cells of a row, all channels. Near an end of a row on the blurred axis a pack is summed
 * one cell at a time.
 * Traffic per vertex: reads m values (the 2 r others are in the cache), writes m.
 */
#include "grid.cl"
#include "reflected.cl"

__kernel void blur(
    GRAPH_ARGS,
    const int m,               /* channels */
    const int size,            /* cells along the axis */
    const int rows,            /* rows of the grid from a cell to the next along the axis; 0 for the last axis */
    const int r,               /* radius of the kernel */
    __global const real *taps, /* (r + 1,) */
    __global const real *f,    /* m channels */
    /* output */
    __global real *out) /* m channels; another buffer than f */
{
    VERTEX
    for (int c = 0; c < m; ++c) {
        __global const real *of = f + c * plane;
        realN sum = taps[0] * LOAD(of, u);
        if (rows > 0) {
            const int place = row / rows % size;
            for (int j = 1; j <= r; ++j) {
                const long before = (long)(reflected(place - j, size) - place) * rows * pitch;
                const long after = (long)(reflected(place + j, size) - place) * rows * pitch;
                sum += taps[j] * (LOAD(of, u + before) + LOAD(of, u + after));
            }
        } else if (x >= r && x + N + r <= width) {
            for (int j = 1; j <= r; ++j) sum += taps[j] * (LOAD(of, u - j) + LOAD(of, u + j));
        } else {
            /* a pack at an end of the row: the lanes one after the other */
            for (int lane_ = 0; lane_ < N; ++lane_) {
                const int place = min(x + lane_, width - 1);
                real one = taps[0] * of[u - x + place];
                for (int j = 1; j <= r; ++j)
                    one += taps[j] * (of[u - x + reflected(place - j, size)] + of[u - x + reflected(place + j, size)]);
                sum = LANES >= lane_ ? (realN)(one) : sum;
            }
        }
        STORE(out, AT(u, c, m), USED(sum));
    }
}
