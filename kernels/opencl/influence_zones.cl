/* mu(u) = min over v of mu(v) + length(u, v) (section 5.2): one round towards the energy partition.
 *
 * Every vertex has its distance mu from the sources and a tag: 2^32 times the number of edges of its path, plus the
 * label of its source. A vertex takes the smallest (mu(v) + length, tag(v) + hop) of its neighbours, in lexicographic
 * order, if that is smaller than its own: the least energy, then with hop = 2^32 the fewest edges, then the smallest
 * label. Integers are exact, so the result after all rounds does not depend on the order of the vertices.
 *
 * One work item: a block of neighbouring vertices, until none of them changes. It reads the current values of its own
 * vertices, and those of other blocks from before the round: a path crosses a block in one round, and no work item
 * reads what another one writes. In the first round it passes the lines down and up, each in both directions, which
 * settles most vertices if there are many sources; in later rounds it visits the vertices with neighbours in other
 * blocks. Then it continues from the changed vertices by Dijkstra's algorithm with a heap. There are a few blocks per
 * core of a CPU; a GPU has influence_zones_gpu.cl.
 * Traffic per vertex: reads and writes 16 bytes; in the first round also reads 4 K lengths and 4 (K + 1) vertices of 16
 * bytes, mostly from the cache; then the same for each vertex in the heap.
 *
 * On a grid the length of an edge is stored at the end that comes first, (guard + n, H) with -1 in the first `guard`
 * rows; a length < 0 means no edge, as where it leaves the grid or the mask. A stored graph has one per directed edge.
 */
#ifndef INDEX
#define INDEX int
#endif
#ifndef H
#define H 2
#endif

#ifdef GRID
/* clang-format off */
#define EDGES_ARGS                                                                                                    \
    const long guard,                  /* rows of -1 before vertex 0: the largest jump */                             \
    __global const long *jumps,        /* (H,): from a vertex to its forward neighbours */                            \
    __global const int *lengths        /* (guard + n, H) */
/* clang-format on */
#define EDGES guard, jumps, lengths
/* A loop over the neighbours v of u, with the length of the edge. */
/* clang-format off */
#define NEIGHBOURS                                                                                                    \
    for (int k = 0; k < 2 * H; ++k) {                                                                                 \
        const int h = k < H ? k : k - H;                                                                              \
        const long v = k < H ? u - jumps[h] : u + jumps[h];                                                           \
        const int length = lengths[(guard + (k < H ? v : u)) * H + h];                                                \
        if (length < 0) continue;
/* clang-format on */
#else
/* clang-format off */
#define EDGES_ARGS                                                                                                    \
    __global const long *indptr,       /* (n + 1,) */                                                                 \
    __global const INDEX *indices,     /* (n_edges,) */                                                               \
    __global const int *lengths        /* (n_edges,) */
/* clang-format on */
#define EDGES indptr, indices, lengths
/* clang-format off */
#define NEIGHBOURS                                                                                                    \
    for (long e = indptr[u]; e < indptr[u + 1]; ++e) {                                                                \
        const long v = indices[e];                                                                                    \
        const int length = lengths[e];                                                                                \
        if (length < 0) continue;
/* clang-format on */
#endif
/* clang-format off */
#define END }
/* clang-format on */

#define WITHIN(v) ((v) >= begin && (v) < end)

/* Arguments of the functions below: the block of a work item, and its heap. */
/* clang-format off */
#define BLOCK_ARGS                                                                                                    \
    const long begin,                                                                                                 \
    const long end,                                                                                                   \
    EDGES_ARGS,                                                                                                       \
    const long hop,                                                                                                   \
    __global const long *mu,                                                                                          \
    __global const long *tag,                                                                                         \
    __global long *mu_out,                                                                                            \
    __global long *tag_out
/* clang-format on */
#define BLOCK begin, end, EDGES, hop, mu, tag, mu_out, tag_out
/* clang-format off */
#define HEAP_ARGS                                                                                                     \
    const long begin,                                                                                                 \
    __global const long *mu_out,                                                                                      \
    __global const long *tag_out,                                                                                     \
    __global int *heap,                                                                                               \
    __global int *place
/* clang-format on */
#define HEAP begin, mu_out, tag_out, heap + begin, place

/* Update vertex u from its neighbours; return whether it changed. */
static int relax(const long u, BLOCK_ARGS)
{
    long best = mu_out[u], best_tag = tag_out[u];
    int moved = 0;
    NEIGHBOURS
        const long d = (WITHIN(v) ? mu_out[v] : mu[v]) + length;
        const long t = (WITHIN(v) ? tag_out[v] : tag[v]) + hop;
        if (d < best || (d == best && t < best_tag)) {
            best = d;
            best_tag = t;
            moved = 1;
        }
    END
    if (moved) {
        mu_out[u] = best;
        tag_out[u] = best_tag;
    }
    return moved;
}

#define RELAX(u) relax(u, BLOCK)

/* Update vertex u in a pass over the block; if it changes, mark its neighbours to be visited again. */
static int pass(const long u, BLOCK_ARGS, __global int *place)
{
    place[u] = 0;
    if (!RELAX(u)) return 0;
    NEIGHBOURS
        if (WITHIN(v)) place[v] = 1;
    END
    return 1;
}

#define PASS(u) moved |= pass(u, BLOCK, place)

/* A min-heap of vertices with four children per node, those of i from 4 i + 1 on. place[u] is 1 + the index of u, 0 if
 * it is not in the heap. Four children make it shallow, as its deeper levels are not in the cache. */
#define LESS(u, v) (mu_out[u] < mu_out[v] || (mu_out[u] == mu_out[v] && tag_out[u] < tag_out[v]))

/* Move vertex u up from the free index i. */
static void rise(const long u, int i, HEAP_ARGS)
{
    while (i > 0) {
        const int parent = (i - 1) / 4;
        const long v = begin + heap[parent];
        if (!LESS(u, v)) break;
        heap[i] = heap[parent];
        place[v] = i + 1;
        i = parent;
    }
    heap[i] = (int)(u - begin);
    place[u] = i + 1;
}

/* Move vertex u down from the free top of a heap of this size. */
static void sink(const long u, const int size, HEAP_ARGS)
{
    int i = 0;
    for (;;) {
        const int child = 4 * i + 1, stop = min(child + 4, size);
        if (child >= size) break;
        int least = child;
        long v = begin + heap[child];
        for (int j = child + 1; j < stop; ++j) {
            const long other = begin + heap[j];
            if (LESS(other, v)) {
                least = j;
                v = other;
            }
        }
        if (!LESS(v, u)) break;
        heap[i] = heap[least];
        place[v] = i + 1;
        i = least;
    }
    heap[i] = (int)(u - begin);
    place[u] = i + 1;
}

#define RISE(u, i) rise(u, i, HEAP)
#define SINK(u) sink(u, size, HEAP)

__kernel void influence_zones(
    const long n, /* number of vertices */
    EDGES_ARGS,
    const long block,         /* vertices of a block, less than 2^31 */
    const long line,          /* vertices of a line */
    const long reach,         /* vertices to visit at each end of a block; if they cover it: all, in lines */
    const long hop,           /* what an edge adds to a tag: 2^32, or 0 */
    __global const long *mu,  /* (n,) */
    __global const long *tag, /* (n,) */
    /* scratch */
    __global int *place, /* (n,): 0 before and after */
    __global int *heap,  /* (n,) */
    /* output */
    __global long *mu_out,  /* (n,) */
    __global long *tag_out, /* (n,) */
    __global int *changed)  /* one number per work item: whether a vertex of its block changed */
{
    const long item = get_global_id(0), begin = item * block, end = min(begin + block, n);
    if (begin >= n) return;
    for (long u = begin; u < end; ++u) {
        mu_out[u] = mu[u];
        tag_out[u] = tag[u];
    }
    int moved = 0, size = 0;
    if (2 * reach >= end - begin) {
        for (long first = begin; first < end; first += line) {
            const long last = min(first + line, end);
            for (long u = first; u < last; ++u) PASS(u);
            for (long u = last - 2; u >= first; --u) PASS(u);
        }
        for (long last = end; last > begin + line; last -= line) {
            const long first = max(last - 2 * line, begin);
            for (long u = first; u < last - line; ++u) PASS(u);
            for (long u = last - line - 2; u >= first; --u) PASS(u);
        }
        for (long u = begin; u < end; ++u)
            if (place[u]) {
                place[u] = 0;
                if (RELAX(u)) RISE(u, size++);
            }
    } else {
        for (long i = 0; i < 2 * reach; ++i) {
            const long u = i < reach ? begin + i : end - 2 * reach + i;
            if (RELAX(u)) {
                moved = 1;
                RISE(u, size++);
            }
        }
    }
    while (size > 0) {
        const long u = begin + heap[begin], last = begin + heap[begin + --size];
        place[u] = 0;
        if (size > 0) SINK(last);
        const long from = mu_out[u], from_tag = tag_out[u] + hop;
        NEIGHBOURS
            if (!WITHIN(v)) continue;
            const long d = from + length;
            if (d < mu_out[v] || (d == mu_out[v] && from_tag < tag_out[v])) {
                mu_out[v] = d;
                tag_out[v] = from_tag;
                RISE(v, place[v] ? place[v] - 1 : size++);
            }
        END
    }
    changed[item] = moved;
}
