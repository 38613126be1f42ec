/* mu(u) = min over v of mu(v) + length(u, v) (section 5.2): one round on a GPU.
 *
 * influence_zones.cl explains mu, tag and hop. A tile is WIDE x HIGH vertices: of the last axis of a grid and of all others in row-major order, or neighbouring
 * vertices of a stored graph. One work group: a tile, a work item a vertex. It takes the neighbours in other tiles from
 * before the round; those in its tile it takes from local memory, again and again until nothing in the tile changes. So
 * a path crosses a tile in one round, and no work item reads what another group writes.
 *
 * Only active tiles have work: those in which a vertex, or a neighbour of a vertex, changed in the round before. A work
 * item that changes its vertex writes round + 1 to the tiles of its neighbours and to its own; all write the same number
 * there. In all other tiles both pairs of (mu, tag) have the same values, as the last round there changed nothing. All
 * tiles are active in the first round.
 *
 * Traffic per vertex of an active tile with K neighbours: reads and writes 16 bytes; reads 4 K lengths, and 16 bytes for
 * each neighbour in another tile. The other tiles: 4 bytes a tile.
 *
 * Lengths are as in influence_zones.cl.
 */
#ifndef INDEX
#define INDEX int
#endif
#ifndef H
#define H 2
#endif
#ifndef WIDE
#define WIDE 32
#endif
#ifndef HIGH
#define HIGH 8
#endif
#define TILE (WIDE * HIGH)

/* clang-format off */
#ifdef GRID
#define EDGES_ARGS                                                                                                    \
    const long guard,                  /* rows of -1 before vertex 0: the largest jump */                             \
    __global const int *steps,         /* (H, 2): rows and columns to the forward neighbours */                       \
    __global const int *lengths        /* (guard + n, H) */

/* A loop over the neighbours v of u at `column` and `row` of the tile, with the length of the edge. */
#define NEIGHBOURS                                                                                                    \
    for (int k = 0; k < 2 * H; ++k) {                                                                                 \
        const int h = k < H ? k : k - H, sign = k < H ? -1 : 1;                                                       \
        const int down = sign * steps[2 * h], along = sign * steps[2 * h + 1];                                        \
        const long v = u + down * width + along;                                                                      \
        const int length = lengths[(guard + (k < H ? v : u)) * H + h];                                                \
        if (length < 0) continue;                                                                                     \
        const int at_column = column + along, at_row = row + down;                                                    \
        const bool within = at_column >= 0 && at_column < WIDE && at_row >= 0 && at_row < HIGH;
#define PLACE (at_row * WIDE + at_column)
#define TILE_OF_NEIGHBOUR ((y + down) / HIGH * get_num_groups(0) + (x + along) / WIDE)
#else
#define EDGES_ARGS                                                                                                    \
    __global const long *indptr,       /* (n + 1,) */                                                                 \
    __global const INDEX *indices,     /* (n_edges,) */                                                               \
    __global const int *lengths        /* (n_edges,) */
#define NEIGHBOURS                                                                                                    \
    for (long e = indptr[u]; e < indptr[u + 1]; ++e) {                                                                \
        const long v = indices[e];                                                                                    \
        const int length = lengths[e];                                                                                \
        if (length < 0) continue;                                                                                     \
        const bool within = v / TILE == tile;
#define PLACE ((int)(v % TILE))
#define TILE_OF_NEIGHBOUR (v / TILE)
#endif
#define END }
/* clang-format on */

/* Take a path of this distance and tag if it is the least so far. */
#define TAKE(mu_v, tag_v)                                  \
    {                                                      \
        const long d = (mu_v) + length, t = (tag_v) + hop; \
        if (d < best || (d == best && t < best_tag)) {     \
            best = d;                                      \
            best_tag = t;                                  \
            moved = true;                                  \
        }                                                  \
    }

__kernel __attribute__((reqd_work_group_size(WIDE, HIGH, 1))) void influence_zones_gpu(
    const long width,  /* vertices of a row: the last axis of a grid, or all of a stored graph */
    const long height, /* rows; 1 for a stored graph */
    EDGES_ARGS,
    const long hop,             /* what an edge adds to a tag: 2^32, or 0 */
    const int round,            /* from 1 on */
    __global const long *mu,    /* (n,) */
    __global const long *tag,   /* (n,) */
    __global const int *active, /* (tiles,): equal to round if the tile is active */
    /* output */
    __global long *mu_out,    /* (n,) */
    __global long *tag_out,   /* (n,) */
    __global int *active_out, /* (tiles,) */
    __global int *changed)    /* (1,): the last round that changed a vertex */
{
    __local long near_mu[TILE], near_tag[TILE];
    __local int some[2];
    const long tile = (long)get_group_id(1) * get_num_groups(0) + get_group_id(0);
    const int column = get_local_id(0), row = get_local_id(1), own = row * WIDE + column;
    const long x = get_global_id(0), y = get_global_id(1);
    /* all work items of a group pass the same barriers */
    const bool there = x < width && y < height && active[tile] == round;
    const long u = there ? y * width + x : 0;
    const long before = mu[u], tag_before = tag[u];
    long best = before, best_tag = tag_before;
    bool moved = false;
    if (there) {
        NEIGHBOURS
            if (!within) TAKE(mu[v], tag[v])
        END
    }
    near_mu[own] = best;
    near_tag[own] = best_tag;
    if (own < 2) some[own] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int turn = 0, moving = 1; moving; turn ^= 1) {
        moved = false;
        if (there) {
            NEIGHBOURS
                if (within) TAKE(near_mu[PLACE], near_tag[PLACE])
            END
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (moved) {
            near_mu[own] = best;
            near_tag[own] = best_tag;
            some[turn] = 1;
        }
        if (own == 0) some[turn ^ 1] = 0; /* all have read it, before the last barrier */
        barrier(CLK_LOCAL_MEM_FENCE);
        moving = some[turn];
    }
    if (!there) return;
    mu_out[u] = best;
    tag_out[u] = best_tag;
    if (best == before && best_tag == tag_before) return;
    *changed = round;
    active_out[tile] = round + 1;
    NEIGHBOURS
        if (!within) active_out[TILE_OF_NEIGHBOUR] = round + 1;
    END
}
