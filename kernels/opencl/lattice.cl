/* The lattice of references of groups of patches, and padded planes of cells, for patch_groups.cl and group_step.cl.
 *
 * A grid has three axes z, y, x here; on two axes z has one cell. A patch has the radii PZ, PY, PX; the window of a group
 * WZ, WY, WX. References are every step-th cell along an axis, and the last one. A plane is padded by the radii of the
 * patch, so that the patch of cell (z, y, x) begins at row z, y and column x of the padded plane. Before and after all
 * planes there are numbers that may be read, for packs that extend beyond the window or a row.
 */
#ifndef LATTICE_CL
#define LATTICE_CL
#include "reals.cl"

#ifndef PX
#define PX 2
#endif
#ifndef PY
#define PY 2
#endif
#ifndef PZ
#define PZ 0
#endif
#ifndef WX
#define WX 10
#endif
#ifndef WY
#define WY 10
#endif
#ifndef WZ
#define WZ 0
#endif

#define ALONE __attribute__((reqd_work_group_size(1, 1, 1)))

#define D (2 * PX + 1)                      /* cells of a line of a patch */
#define LINES ((2 * PZ + 1) * (2 * PY + 1)) /* lines of a patch */
#define M (LINES * D)                       /* cells of a patch */
#define SIDE (2 * WX + 1)                   /* cells of a row of the window */

/* clang-format off */
#define LATTICE_ARGS                                                                                                  \
    const int4 sizes,  /* of the grid: x, y, z */                                                                     \
    const int4 steps,  /* of the references, in cells */                                                              \
    const int4 counts, /* of the references */                                                                        \
    const long plane,  /* from a channel to the next */                                                               \
    const long pitch,  /* from a row of a plane to the next */                                                        \
    const long layer,  /* from a z of a plane to the next */                                                          \
    const long before, /* numbers before the first plane */                                                           \
    const int channels
/* clang-format on */

/* Position of the i-th reference along an axis. */
#define REFERENCE(i, axis) min((i) * steps.axis, sizes.axis - 1)
/* Index in a plane of the first cell of the patch of cell (z, y, x). */
#define PLACE(z, y, x) (before + (long)(z) * layer + (long)(y) * pitch + (x))

#endif
