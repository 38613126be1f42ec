/* The window of a group with the cells of its patches, a tile in local memory, for the kernels of groups on a GPU.
 *
 * Tile cell (z, y, x) is cell (z - WZ, y - WY, x - WX) of the padded plane from the first cell of the patch of the
 * reference, so the patch of a place of the window begins at the tile cell of the same number. Cells beyond the padded
 * plane are 0. Rows have an even number of cells: work items that read runs of an odd number of cells in neighbouring
 * rows then meet in a bank of local memory at most in twos.
 */
#ifndef GROUP_TILE_CL
#define GROUP_TILE_CL
#include "lattice.cl"

/* FAR: for windows without room in local memory, the tiles of a work group are in global memory. */
#ifdef FAR
#define TILE_SPACE __global
#define FENCE (CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE)
#else
#define TILE_SPACE __local
#define FENCE CLK_LOCAL_MEM_FENCE
#endif

#ifndef MOST
#define MOST 80 /* members at most */
#endif
#define DY (2 * PY + 1)
#define ROWS ((2 * WZ + 1) * (2 * WY + 1)) /* of the window */
#define PLACES (ROWS * SIDE)
#define TILE_X ((SIDE + 2 * PX + 1) / 2 * 2)
#define TILE_Y (2 * (WY + PY) + 1)
#define TILE_Z (2 * (WZ + PZ) + 1)
#define TILE (TILE_X * TILE_Y * TILE_Z)

/* Tile cell of the first place of a row of the window, and of a line of a patch from its first cell. */
#define ROW_AT(row) (((row) / (2 * WY + 1) * TILE_Y + (row) % (2 * WY + 1)) * TILE_X)
#define LINE_AT(line) (((line) / DY * TILE_Y + (line) % DY) * TILE_X)

/* Copy the tile whose first cell is (z, y, x) of a padded plane; the work items take turns. */
static inline void load_tile(
    __global const real *plane,
    const int4 sizes,
    const long pitch,
    const long layer,
    const int4 first,
    const int item,
    const int items,
    TILE_SPACE real *tile)
{
    for (int i = item; i < TILE; i += items) {
        const int row = i / TILE_X;
        const int x = first.x + i % TILE_X, y = first.y + row % TILE_Y, z = first.z + row / TILE_Y;
        const bool there =
            x >= 0 && x < sizes.x + 2 * PX && y >= 0 && y < sizes.y + 2 * PY && z >= 0 && z < sizes.z + 2 * PZ;
        tile[i] = there ? plane[(long)z * layer + (long)y * pitch + x] : 0;
    }
}

#endif
