/* The sums of the changes around each cell, from what group_step_gpu.cl has written for a range of references.
 *
 * One work item: one cell x. It adds the tiles of the references around x in their order to what `sums` has, so the
 * result does not depend on the ranges, nor on the part of a grid; no atomics.
 * Traffic per cell: the sums read and written, about (2 (W + P) + 1)^2/step^2 numbers of the tiles per channel, and
 * (2 W + 1)^2/step^2 bytes of the marks.
 */
#include "group_tile.cl"

/* The first reference along an axis at x - radius or after it. */
#define FIRST(x, radius, step) (max(0, (x) - (radius) + (step) - 1) / (step))

/* Loops over the references (k, j, i) of the range that are at most these radii from the cell (z, y, x). */
#define REFERENCES_AROUND(rz, ry, rx)                                                                  \
    for (int k = FIRST(z, rz, steps.z); k < counts.z && REFERENCE(k, z) <= z + (rz); ++k)              \
        for (int j = max(FIRST(y, ry, steps.y), first / counts.x - k * counts.y);                      \
             j < counts.y && REFERENCE(j, y) <= y + (ry) && (k * counts.y + j) * counts.x < last; ++j) \
            for (int i = FIRST(x, rx, steps.x); i < counts.x && REFERENCE(i, x) <= x + (rx); ++i)

__kernel void group_gather(
    LATTICE_ARGS,
    const int4 from, /* the cell of the launch's first work item */
    const int first, /* references of the tiles: first, ..., last - 1 */
    const int last,
    __global const real *tiles,          /* (last - first, channels, TILE) */
    __global const uchar *marks,         /* (last - first, PLACES) */
    __global const int *sizes_of_groups, /* (references,) */
    /* output */
    __global real *sums, /* `channels` planes; added to */
    __global real *uses) /* one plane, at the first cell of a patch: how often it is a member; added to */
{
    const int x = from.x + (int)get_global_id(0), y = from.y + (int)get_global_id(1);
    const int z = from.z + (int)get_global_id(2);
    if (x >= sizes.x) return;
    int count = 0;
    REFERENCES_AROUND(WZ, WY, WX)
    {
        const int reference = (k * counts.y + j) * counts.x + i;
        if (reference < first || reference >= last || sizes_of_groups[reference] == 0) continue;
        const int row = (z - REFERENCE(k, z) + WZ) * (2 * WY + 1) + y - REFERENCE(j, y) + WY;
        count += marks[(long)(reference - first) * PLACES + row * SIDE + x - REFERENCE(i, x) + WX];
    }
    uses[PLACE(z, y, x)] += (real)count;
    for (int c = 0; c < channels; ++c) {
        const long at = PLACE(z + PZ, y + PY, x + PX) + c * plane;
        real sum = sums[at];
        REFERENCES_AROUND(WZ + PZ, WY + PY, WX + PX)
        {
            const int reference = (k * counts.y + j) * counts.x + i;
            if (reference < first || reference >= last || sizes_of_groups[reference] == 0) continue;
            const int row = (z - REFERENCE(k, z) + WZ + PZ) * TILE_Y + y - REFERENCE(j, y) + WY + PY;
            const int cell = row * TILE_X + x - REFERENCE(i, x) + WX + PX;
            sum += tiles[((long)(reference - first) * channels + c) * TILE + cell];
        }
        sums[at] = sum;
    }
}
