"""Packs: N neighbouring cells of a grid row at once, for one channel, as vectors of a CPU.

A primitive with a `fast` path uses it if no neighbour of the pack leaves its row; otherwise it computes the cells one
by one, a `run`. The fast paths are C++, as clang has operators for its vectors, but does not always vectorise loops
over a Warp vector.
"""

import warp as wp

# The beginning of a fast path at the vertex `u`: types, and a loop over the neighbours that adds to the `SUMS`.
# In the loop, w is the pack of weights, i the index of the first cell in a function, ahead the step to its neighbour.
_BEGIN = """
    typedef %(T)s T;
    enum { N = %(N)d, LEADING = %(leading)d };
    typedef T V __attribute__((vector_size(N * sizeof(T))));
    auto load = [](const T* from) -> V { V x; __builtin_memcpy(&x, from, sizeof(V)); return x; };
    const long long width = graph.width, H = graph.H, row = u.c[0], x = u.c[1], i = row * width + x;
    SUMS
    for (int e = 0; e < 2 * H; ++e) {
        const auto o = graph.offsets.data[e];
        bool there = (unsigned)(u.c[0] + o.c[0]) < (unsigned)graph.n_rows;
        for (int a = 0; a < LEADING; ++a)
            there = there && (unsigned)(u.c[2 + a] + o.c[2 + a]) < (unsigned)graph.sizes.c[a];
        if (!there)
            continue;
        const long long ahead = o.c[0] * width + o.c[1];
        %(weight)s
        BODY
    }
"""
_WEIGHT = """
        // stored at u when the edge leads forward, at v when it leads back
        const V w = load(graph.weights.data + (e >= H ? (row * H + e - H) * width + x
                                                      : ((row + o.c[0]) * H + H - 1 - e) * width + x + o.c[1]));
"""


def possible(access, M):
    """Check whether there is a fast path for this graph and M channels; the edge norm has none."""
    return access.pack is not None and M == 1


def source(access, N, sums, body, end):
    """Return C++ that declares `sums`, adds to them in `body` for each neighbour, and uses them in `end`."""
    leading, weighted = access.pack
    begin = _BEGIN % {
        "T": "double" if access.real == wp.float64 else "float",
        "N": N,
        "leading": leading,
        "weight": _WEIGHT if weighted else "const V w = V{} + T(1);",
    }
    return begin.replace("SUMS", sums).replace("BODY", body) + end
