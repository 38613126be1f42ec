"""mu(u) = min over v of mu(v) + length(u, v) (section 5.2): one round on a GPU.

influence_zones.py explains mu, tag and hop. One work item: a vertex, which takes its neighbours from before the round.

Only active tiles have work, TILE neighbouring vertices each: those in which a vertex, or a neighbour of a vertex,
changed in the round before. A work item that changes its vertex writes round + 1 to the tiles of its neighbours and to
its own; all write the same number there. In all other tiles both pairs of (mu, tag) have the same values, as the last
round there changed nothing. All tiles are active in the first round.

Traffic per vertex of an active tile with K neighbours: reads and writes 16 bytes; reads 4 K lengths, and K vertices of
16 bytes, mostly from the cache. The other tiles: 4 bytes a tile.
"""

import functools

import warp as wp

from . import influence_zones

TILE = 64


@functools.cache
def make(grid):
    """Make the kernel for a grid, or for a stored graph."""
    Zones = influence_zones.struct()
    first, last, neighbour, length = influence_zones.edges(grid)

    @wp.kernel(module="unique", enable_backward=False)
    def influence_zones_gpu(
        z: Zones,
        turn: int,  # the round, from 1 on
        start: wp.vec2i,  # the launch's first work item, then 0
        # output
        changed: wp.array(dtype=wp.int32),  # (1,): the last round that changed a vertex
    ):
        u = start[0] + wp.tid()
        if z.active[u / TILE] == turn:
            best = z.mu[u]
            best_tag = z.tag[u]
            moved = bool(False)
            for e in range(first(z, u), last(z, u)):
                v = neighbour(z, u, e)
                along = length(z, u, v, e)
                if along >= 0:
                    d = z.mu[v] + wp.int64(along)
                    t = z.tag[v] + z.hop
                    if d < best or (d == best and t < best_tag):
                        best = d
                        best_tag = t
                        moved = True
            z.mu_out[u] = best
            z.tag_out[u] = best_tag
            if moved:
                changed[0] = turn
                z.active_out[u / TILE] = turn + 1
                for e in range(first(z, u), last(z, u)):
                    v = neighbour(z, u, e)
                    if length(z, u, v, e) >= 0:
                        z.active_out[v / TILE] = turn + 1

    return influence_zones_gpu
