"""One sweep of the Gauss-Jacobi process with its conductances, fused over a tile of a grid, for a GPU
                                                                                           (eq. 9, 15, 25, 31)
  g(u)   = (|grad_w f(u)|^2 + eps^2)^power,   power = (p - 2)/2
  J(u)   = (lam f0(u) + sum_v w (g(u) + g(v)) f(v)) / (lam + sum_v w (g(u) + g(v)))
  out(u) = f(u) + theta (J(u) - f(u))

For gamma = sqrt(w) and one gradient norm, on two axes, with neighbours that are at most one cell away on each axis. f
and w are read once and g is never written to memory; the two kernels read f twice, and write and read g.

ITEMS threads have a tile of TX x (TY S) cells, of which two on each side are its halo: g is computed one cell into the
halo. f and g are exchanged through shared memory. Within a column a thread has its neighbours in registers. Sums of
products are explicit, so that each cell gets the same bits wherever it lies in its tile.

One work item: a thread, S cells of a column; on a CPU, which tests take for a GPU, a tile, whose threads run one after
the other from one barrier to the next. Traffic per vertex: reads H weights, 2 M values and lam; writes M numbers; the
halo is read from the cache.
"""

import functools

import warp as wp

from . import reals

TX, TY, HALO = 64, 4, 2
ITEMS = TX * TY

_SWEEP = """
#ifdef __CUDA_ARCH__
#define WP_GPUREG_SHARED __shared__
#define WP_GPUREG_SYNC() __syncthreads()
#define WP_GPUREG_EACH
#define WP_GPUREG_OWN
#define WP_GPUREG_FMA fma
    const int l = item %% %(items)d, group = item / %(items)d;
#else
#pragma clang fp contract(off)
#define WP_GPUREG_SHARED
#define WP_GPUREG_SYNC() ((void)0)
#define WP_GPUREG_EACH for (int l = 0; l < ITEMS; ++l)
#define WP_GPUREG_OWN Own& own = owns[l];
#define WP_GPUREG_FMA %(fma)s
    const int group = item;
#endif
#define WP_GPUREG_UNROLL _Pragma("unroll")
    enum { M = %(M)d, S = %(S)d, TX = %(TX)d, TY = %(TY)d, HALO = %(halo)d, ITEMS = TX * TY, ROWS = TY * S };
    enum { PITCH = TX + 2, PLANE = (ROWS + 2) * PITCH };  // of a tile with a rim of one cell
    typedef %(T)s T;
    struct Own { T here[M * S], norms[S]; };
#ifdef __CUDA_ARCH__
    Own own;
#else
    Own owns[ITEMS];
#endif
    WP_GPUREG_SHARED T tile[M * PLANE];
    WP_GPUREG_SHARED T norm_tile[PLANE];
    const int width = graph.width, n_rows = graph.n_rows, across = (width + TX - 2 * HALO - 1) / (TX - 2 * HALO);
    const int left = group %% across * (TX - 2 * HALO) - HALO, top = group / across * (ROWS - 2 * HALO) - HALO;
    auto on_grid = [&](int row, int x) -> bool {
        return (unsigned)row < (unsigned)n_rows && (unsigned)x < (unsigned)width;
    };

    WP_GPUREG_EACH {
        WP_GPUREG_OWN
        const int i = l %% TX, j = l / TX * S, x = left + i;
        // the rim, which nothing that is written depends on: rows, then columns
        if (l < PITCH) {
            for (int c = 0; c < M; ++c)
                tile[c * PLANE + l] = tile[c * PLANE + PLANE - PITCH + l] = T(0);
            norm_tile[l] = norm_tile[PLANE - PITCH + l] = T(0);
        } else if (l - PITCH < ROWS) {
            const int at = (l - PITCH + 1) * PITCH;
            for (int c = 0; c < M; ++c)
                tile[c * PLANE + at] = tile[c * PLANE + at + PITCH - 1] = T(0);
            norm_tile[at] = norm_tile[at + PITCH - 1] = T(0);
        }
        WP_GPUREG_UNROLL
        for (int y = 0; y < S; ++y) {
            const int row = top + j + y;
            const bool there = on_grid(row, x);
            WP_GPUREG_UNROLL
            for (int c = 0; c < M; ++c) {
                const T value = there ? ((const T*)f.data)[((long long)row * width + x) * M + c] : T(0);
                own.here[c * S + y] = value;
                tile[c * PLANE + (j + y + 1) * PITCH + i + 1] = value;
            }
        }
    }
    WP_GPUREG_SYNC();
    WP_GPUREG_EACH {
        WP_GPUREG_OWN
        const int i = l %% TX, j = l / TX * S, x = left + i;
        WP_GPUREG_UNROLL
        for (int y = 0; y < S; ++y) {
            const int row = top + j + y, at = (j + y + 1) * PITCH + i + 1;
            T norm = T(0);
            if (on_grid(row, x)) {
                T sum = T(0);
                %(gradient)s
                sum += eps2;
                norm = power == T(-0.5) ? T(1) / wp::sqrt(sum) : power == T(0.5) ? wp::sqrt(sum) : wp::pow(sum, power);
            }
            own.norms[y] = norm;
            norm_tile[at] = norm;
        }
    }
    WP_GPUREG_SYNC();
    WP_GPUREG_EACH {
        WP_GPUREG_OWN
        const int i = l %% TX, j = l / TX * S, x = left + i;
        WP_GPUREG_UNROLL
        for (int y = 0; y < S; ++y) {
            const int row = top + j + y, at = (j + y + 1) * PITCH + i + 1;
            if (i < HALO || i >= TX - HALO || j + y < HALO || j + y >= ROWS - HALO || !on_grid(row, x))
                continue;
            T total = T(0), sum[M];
            WP_GPUREG_UNROLL
            for (int c = 0; c < M; ++c)
                sum[c] = T(0);
            %(update)s
            const long long u = (long long)row * width + x;
            const T fidelity = %(lam)s, denominator = fidelity + total;
            const bool keeps = wp::isinf(fidelity) || !(denominator > smallest);
            WP_GPUREG_UNROLL
            for (int c = 0; c < M; ++c) {
                const T data = ((const T*)f0.data)[u * M + c], old = own.here[c * S + y];
                const T plain = WP_GPUREG_FMA(fidelity, data, sum[c]) / denominator;
                const T moved = theta == T(1) ? plain : WP_GPUREG_FMA(theta, plain - old, old);
                ((T*)out.data)[u * M + c] = keeps ? data : moved;
            }
        }
    }
#undef WP_GPUREG_SHARED
#undef WP_GPUREG_SYNC
#undef WP_GPUREG_EACH
#undef WP_GPUREG_OWN
#undef WP_GPUREG_FMA
#undef WP_GPUREG_UNROLL
"""
# For the neighbour of a cell `down` rows below and `right` cells to the right; W is its weight.
_GRADIENT = """
                if (on_grid(row + (%(down)d), x + (%(right)d))) {
                    const T w = %(weight)s;
                    WP_GPUREG_UNROLL
                    for (int c = 0; c < M; ++c) {
                        const T d = OF(own.here + c * S, tile + c * PLANE) - own.here[c * S + y];
                        sum = WP_GPUREG_FMA(w * d, d, sum);
                    }
                }
"""
_UPDATE = """
            if (on_grid(row + (%(down)d), x + (%(right)d))) {
                const T w = %(weight)s, conductance = w * (own.norms[y] + OF(own.norms, norm_tile));
                total += conductance;
                WP_GPUREG_UNROLL
                for (int c = 0; c < M; ++c)
                    sum[c] = WP_GPUREG_FMA(conductance, OF(own.here + c * S, tile + c * PLANE), sum[c]);
            }
"""


def _neighbours(source, offsets, weighted):
    """Return C++ for all neighbours of a cell; `offsets` are the forward ones, in lexicographic order."""
    H, parts = len(offsets), []
    for h, (down, right) in enumerate(offsets):
        for sign in (1, -1):
            a, b = sign * down, sign * right
            # stored at the end that comes first
            row, x = ("row", "x") if sign > 0 else (f"(row + ({a}))", f"(x + ({b}))")
            names = {"down": a, "right": b, "weight": "T(1)"}
            if weighted:
                names["weight"] = f"graph.weights.data[((long long){row} * {H} + {h}) * width + {x}]"
            part = source % names
            # in a register, or in shared memory
            inside = f"({b} == 0 && y + ({a}) >= 0 && y + ({a}) < S)"
            for own, shared in (("own.here + c * S", "tile + c * PLANE"), ("own.norms", "norm_tile")):
                there = f"({inside} ? ({own})[{inside} ? y + ({a}) : 0] : ({shared})[at + ({a}) * PITCH + ({b})])"
                part = part.replace(f"OF({own}, {shared})", there)
            parts.append(part)
    return "".join(parts)


@functools.cache
def make(access, M, offsets, weighted, lam_array, S, items):
    """Make the kernel for M channels and these forward offsets; `items`: the threads of a tile on a GPU."""
    real, Graph = access.real, access.Graph
    function = reals.vector(real, M)
    lam_type = wp.array2d(dtype=reals.vector(real, 1)) if lam_array else real
    smallest, double = reals.smallest(real), real == wp.float64
    source = _SWEEP % {
        "M": M,
        "S": S,
        "TX": TX,
        "TY": TY,
        "halo": HALO,
        "items": ITEMS,
        "T": "double" if double else "float",
        "fma": "__builtin_fma" if double else "__builtin_fmaf",
        "gradient": _neighbours(_GRADIENT, offsets, weighted),
        "update": _neighbours(_UPDATE, offsets, weighted),
        "lam": "((const T*)lam.data)[u]" if lam_array else "lam",
    }

    @wp.func_native(source)
    def tile(
        graph: Graph,
        f: wp.array2d(dtype=function),
        f0: wp.array2d(dtype=function),
        power: real,
        eps2: real,
        lam: lam_type,
        theta: real,
        smallest: real,
        out: wp.array2d(dtype=function),
        item: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def sweep(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels
        power: real,  # (p - 2)/2
        eps2: real,  # eps^2
        lam: lam_type,  # a number or 1 channel
        theta: real,
        first: wp.vec2i,  # the launch's first tile
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, thread = wp.tid()
        tile(graph, f, f0, power, eps2, lam, theta, smallest, out, (first[0] + i) * items + thread)

    if items > 1:
        sweep.threads = items  # of a block
    return sweep
