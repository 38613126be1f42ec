"""mu(u) = min over v of mu(v) + length(u, v) (section 5.2): one round towards the energy partition.

Every vertex has its distance mu from the sources and a tag: 2^32 times the number of edges of its path, plus the label
of its source. A vertex takes the smallest (mu(v) + length, tag(v) + hop) of its neighbours, in lexicographic order, if
that is smaller than its own: the least energy, then with hop = 2^32 the fewest edges, then the smallest label. Integers
are exact, so the result after all rounds does not depend on the order of the vertices.

One work item: a block of neighbouring vertices, until none of them changes. It reads the current values of its own
vertices, and those of other blocks from before the round: a path crosses a block in one round, and no work item reads
what another one writes. In the first round it passes the lines down and up, each in both directions, which settles most
vertices if there are many sources; in later rounds it visits the vertices with neighbours in other blocks. Then it
continues from the changed vertices by Dijkstra's algorithm with a heap. There are a few blocks per core of a CPU; a GPU
has influence_zones_gpu.py.
Traffic per vertex: reads and writes 16 bytes; in the first round also reads 4 K lengths and 4 (K + 1) vertices of 16
bytes, mostly from the cache; then the same for each vertex in the heap.

On a grid the length of an edge is stored at the end that comes first, (guard + n) H numbers with -1 in the first
guard H; a length < 0 means no edge, as where it leaves the grid or the mask. A stored graph has one per directed edge.
"""

import functools

import warp as wp


@functools.cache
def struct():
    """Make the struct with the graph, the lengths, and the other arguments of the kernel."""

    @wp.struct
    class Zones:
        n: wp.int32  # number of vertices
        H: wp.int32  # forward neighbours on a grid; 0: a stored graph
        guard: wp.int32  # rows of -1 before the lengths of a grid: the largest jump
        jumps: wp.array(dtype=wp.int32)  # (H,): from a vertex to its forward neighbours
        indptr: wp.array(dtype=wp.int32)  # (n + 1,)
        indices: wp.array(dtype=wp.int32)  # (n_edges,)
        lengths: wp.array(dtype=wp.int32)  # (guard + n) H, or (n_edges,)
        block: wp.int32  # vertices of a block
        line: wp.int32  # vertices of a line
        reach: wp.int32  # vertices to visit at each end of a block; if they cover it: all, in lines
        hop: wp.int64  # what an edge adds to a tag: 2^32, or 0
        mu: wp.array(dtype=wp.int64)  # (n,)
        tag: wp.array(dtype=wp.int64)  # (n,)
        # scratch
        place: wp.array(dtype=wp.int32)  # (n,): 0 before and after
        heap: wp.array(dtype=wp.int32)  # (n,)
        active: wp.array(dtype=wp.int32)  # (tiles,), of a GPU: equal to the round if the tile is active
        # output
        mu_out: wp.array(dtype=wp.int64)  # (n,)
        tag_out: wp.array(dtype=wp.int64)  # (n,)
        active_out: wp.array(dtype=wp.int32)  # (tiles,)

    return Zones


@functools.cache
def edges(grid):
    """Make the functions first, last, neighbour and length of a grid, or of a stored graph.

    The neighbours of u have indices first to last: offsets of a grid, backward ones first, or stored edges.
    """
    Zones = struct()

    @wp.func
    def first(z: Zones, u: int) -> int:
        if wp.static(grid):
            return 0
        return z.indptr[u]

    @wp.func
    def last(z: Zones, u: int) -> int:
        if wp.static(grid):
            return 2 * z.H
        return z.indptr[u + 1]

    @wp.func
    def neighbour(z: Zones, u: int, e: int) -> int:
        if wp.static(grid):
            if e < z.H:
                return u - z.jumps[e]
            return u + z.jumps[e - z.H]
        return z.indices[e]

    @wp.func
    def length(z: Zones, u: int, v: int, e: int) -> int:
        if wp.static(grid):
            if e < z.H:
                return z.lengths[(z.guard + v) * z.H + e]
            return z.lengths[(z.guard + u) * z.H + e - z.H]
        return z.lengths[e]

    return first, last, neighbour, length


@functools.cache
def make(grid):
    """Make the kernel for a grid, or for a stored graph."""
    Zones = struct()
    first, last, neighbour, length = edges(grid)

    @wp.func
    def less(z: Zones, u: int, v: int) -> bool:
        if z.mu_out[u] == z.mu_out[v]:
            return z.tag_out[u] < z.tag_out[v]
        return z.mu_out[u] < z.mu_out[v]

    @wp.func
    def relax(z: Zones, u: int, begin: int, end: int) -> int:
        """Update vertex u from its neighbours; return 1 if it changed."""
        best = z.mu_out[u]
        best_tag = z.tag_out[u]
        moved = int(0)
        for e in range(first(z, u), last(z, u)):
            v = neighbour(z, u, e)
            along = length(z, u, v, e)
            if along >= 0:
                d = wp.int64(0)
                t = wp.int64(0)
                if v >= begin and v < end:
                    d = z.mu_out[v]
                    t = z.tag_out[v]
                else:
                    d = z.mu[v]
                    t = z.tag[v]
                d += wp.int64(along)
                t += z.hop
                if d < best or (d == best and t < best_tag):
                    best = d
                    best_tag = t
                    moved = 1
        if moved == 1:
            z.mu_out[u] = best
            z.tag_out[u] = best_tag
        return moved

    @wp.func
    def passing(z: Zones, u: int, begin: int, end: int) -> int:
        """Update vertex u in a pass over the block; if it changes, mark its neighbours to be visited again."""
        z.place[u] = 0
        moved = relax(z, u, begin, end)
        if moved == 1:
            for e in range(first(z, u), last(z, u)):
                v = neighbour(z, u, e)
                if v >= begin and v < end and length(z, u, v, e) >= 0:
                    z.place[v] = 1
        return moved

    # A min-heap of vertices with four children per node, those of i from 4 i + 1 on. place[u] is 1 + the index of u, 0
    # if it is not in the heap. Four children make it shallow, as its deeper levels are not in the cache.

    @wp.func
    def rise(z: Zones, u: int, at: int, begin: int):
        """Move vertex u up from the free index `at`."""
        i = int(at)
        rising = bool(i > 0)
        while rising:
            parent = (i - 1) / 4
            v = z.heap[begin + parent]
            rising = less(z, u, v)
            if rising:
                z.heap[begin + i] = v
                z.place[v] = i + 1
                i = parent
                rising = i > 0
        z.heap[begin + i] = u
        z.place[u] = i + 1

    @wp.func
    def sink(z: Zones, u: int, size: int, begin: int):
        """Move vertex u down from the free top of a heap of this size."""
        i = int(0)
        sinking = bool(size > 1)
        while sinking:
            child = 4 * i + 1
            least = int(child)
            v = z.heap[begin + child]
            for j in range(child + 1, wp.min(child + 4, size)):
                other = z.heap[begin + j]
                if less(z, other, v):
                    least = j
                    v = other
            sinking = less(z, v, u)
            if sinking:
                z.heap[begin + i] = v
                z.place[v] = i + 1
                i = least
                sinking = 4 * i + 1 < size
        z.heap[begin + i] = u
        z.place[u] = i + 1

    @wp.func
    def sweep(z: Zones, begin: int, end: int) -> int:
        """Pass the lines of a block down and up, each in both directions; return 1 if a vertex changed."""
        moved = int(0)
        lines = (end - begin + z.line - 1) / z.line
        for i in range(2 * lines - 1):
            row = i
            if i >= lines:
                row = 2 * lines - 2 - i
            left = begin + row * z.line
            right = wp.min(left + z.line, end)
            for u in range(left, right):
                moved |= passing(z, u, begin, end)
            for k in range(right - left - 1):
                moved |= passing(z, right - 2 - k, begin, end)
        return moved

    @wp.func
    def settle(z: Zones, begin: int, end: int) -> int:
        """Do one round of a block; return 1 if a vertex changed."""
        moved = int(0)
        size = int(0)
        if 2 * z.reach >= end - begin:
            moved = sweep(z, begin, end)
            for u in range(begin, end):
                if z.place[u] == 1:
                    # only a mark so far: the heap has only vertices before u
                    z.place[u] = 0
                    if relax(z, u, begin, end) == 1:
                        rise(z, u, size, begin)
                        size += 1
        else:
            for i in range(2 * z.reach):
                u = begin + i
                if i >= z.reach:
                    u = end - 2 * z.reach + i
                if relax(z, u, begin, end) == 1:
                    moved = 1
                    rise(z, u, size, begin)
                    size += 1
        while size > 0:
            u = z.heap[begin]
            size -= 1
            z.place[u] = 0
            if size > 0:
                sink(z, z.heap[begin + size], size, begin)
            t = z.tag_out[u] + z.hop
            for e in range(first(z, u), last(z, u)):
                v = neighbour(z, u, e)
                along = length(z, u, v, e)
                if along >= 0 and v >= begin and v < end:
                    d = z.mu_out[u] + wp.int64(along)
                    if d < z.mu_out[v] or (d == z.mu_out[v] and t < z.tag_out[v]):
                        z.mu_out[v] = d
                        z.tag_out[v] = t
                        if z.place[v] > 0:
                            rise(z, v, z.place[v] - 1, begin)
                        else:
                            rise(z, v, size, begin)
                            size += 1
        return moved

    @wp.kernel(module="unique", enable_backward=False)
    def influence_zones(
        z: Zones,
        start: wp.vec2i,  # the launch's first work item, then 0
        # output
        changed: wp.array(dtype=wp.int32),  # one number per work item: whether a vertex of its block changed
    ):
        item = start[0] + wp.tid()
        begin = item * z.block
        end = wp.min(begin + z.block, z.n)
        for u in range(begin, end):
            z.mu_out[u] = z.mu[u]
            z.tag_out[u] = z.tag[u]
        changed[item] = settle(z, begin, end)

    return influence_zones
