"""One sweep at p = 2 on a grid of two axes, with weights that are never stored, as in similarity_step.py, for a GPU
                                                                                                (eq. 25, section 5.2)
  out(u) = (lam f0(u) + sum_v 2 w(u, v) f(v)) / (lam + sum_v 2 w(u, v))
  w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |guide(u + j) - guide(v + j)|^2
  with A, a weight is the sum of these over the pairs (u - j, v - j), |j| <= A along each axis

ITEMS threads have a block of S rows of COLUMNS cells. For one offset of the window, thread l
  down    squares the differences of column l of the cells of all patches, which it has in registers, and of a column of
          a tile in shared memory; it adds them down the patches, and writes the sums to shared memory;
  along   adds these sums along the rows, for S/4 rows of 4 neighbouring cells, and takes the weights; with A also those
          of A cells around, which it adds.
One barrier lies between the two, as the sums have two places in turn. The tile has the rows of v for one dy, and CHUNK
steps dx. The values f(v) of a thread's pairs move by one cell from one dx to the next: it reads one per row.
The functions are in planes (padded.py). All terms of a distance are >= 0 and none is subtracted again; the order of a
sum does not depend on where its cell is in a block.

One work item: a thread; on a CPU, which tests take for a GPU, a block, whose threads run one after the other from one
barrier to the next. Traffic per vertex: reads M + Q values, lam and f0, and for each dy Q IR WIDE/(S COLUMNS) values,
mostly from the cache; writes M numbers.
"""

import functools

import warp as wp

from . import reals, strip

ITEMS, CHUNK = 128, 24

_DEVICE = """
#ifdef __CUDA_ARCH__
#define WP_GPUREG_SHARED __shared__
#define WP_GPUREG_SYNC() __syncthreads()
#define WP_GPUREG_EACH
    const int l = item %% ITEMS, group = item / ITEMS;
#else
#define WP_GPUREG_SHARED
#define WP_GPUREG_SYNC() ((void)0)
#define WP_GPUREG_EACH for (int l = 0; l < ITEMS; ++l)
    const int group = item;
#endif
#define WP_GPUREG_UNROLL _Pragma("unroll")
"""
_STEP = """
    enum { S = %(S)d, Q = %(Q)d, M = %(M)d, R = %(R)d, A = %(A)d, MAPS = %(maps)d, LARGEST = %(largest)d };
    enum { ITEMS = %(items)d, CHUNK = %(chunk)d, E = R + A, SIDE = 2 * R + 1 };
    enum { COLUMNS = (ITEMS - 2 * E) / 4 * 4, LANES = ITEMS / 4 };  // cells of a row of a block; threads of a row
    enum { G = S / 4, CELLS = 4 * G };                              // rows and cells of a thread
    enum { VR = S + 2 * A, IR = S + 2 * E, WIDE = ITEMS + CHUNK };  // rows of sums; rows and cells of a tile
    enum { NW = 4 + 2 * A, NV = (NW + 2 * R + 3) / 4 * 4 };         // weights of a row; sums for them
    typedef %(T)s T;
    struct alignas(4 * sizeof(T) < 16 ? 4 * sizeof(T) : 16) Four { T x[4]; };
    %(device)s
    struct Own {
        T near[Q * IR], far[M * CELLS], total[CELLS], pull[M * CELLS], heaviest[LARGEST ? CELLS : 1];
    };
#ifdef __CUDA_ARCH__
    Own own;
#define WP_GPUREG_OWN
#else
    Own owns[ITEMS];
#define WP_GPUREG_OWN Own& own = owns[l];
#endif
    WP_GPUREG_SHARED T tile[Q * IR * WIDE];
    WP_GPUREG_SHARED alignas(16) T sums[2 * VR * ITEMS + 16];
    const int height = p.sizes.data[0], width = p.sizes.data[1], blocks = (width + COLUMNS - 1) / COLUMNS;
    const int X0 = group %% blocks * COLUMNS, Y0 = group / blocks * S;
    // the index in a plane of a cell; rows beyond the plane are those at its border, which no result depends on
    auto index = [&](int y, int x) -> long long {
        const int row = y + R < 0 ? 0 : y + R >= height + 2 * R ? height + 2 * R - 1 : y + R;
        return row * p.pitch + p.left + R + x;
    };
    T g[SIDE];
    WP_GPUREG_UNROLL
    for (int j = 0; j < SIDE; ++j)
        g[j] = p.profile.data[j];
    // the sum over a patch along one axis
    auto over = [&](const T* a) -> T { return %(over)s; };

    WP_GPUREG_EACH {
        WP_GPUREG_OWN
        WP_GPUREG_UNROLL
        for (int q = 0; q < IR; ++q) {
            const long long at = index(Y0 - E + q, X0 - E + l);
            WP_GPUREG_UNROLL
            for (int c = 0; c < Q; ++c)
                own.near[c * IR + q] = p.f.data[c * p.plane + at];
        }
        WP_GPUREG_UNROLL
        for (int i = 0; i < CELLS; ++i) {
            own.total[i] = own.heaviest[LARGEST ? i : 0] = T(0);
            WP_GPUREG_UNROLL
            for (int c = 0; c < M; ++c)
                own.pull[c * CELLS + i] = T(0);
        }
    }
    int half = 0;
    for (int dy = -reach_y; dy <= reach_y; ++dy)
        for (int first = -reach_x; first <= reach_x; first += CHUNK) {
            const int steps = reach_x - first + 1 < CHUNK ? reach_x - first + 1 : CHUNK;
            WP_GPUREG_SYNC();
            WP_GPUREG_EACH {
                for (int q = 0; q < IR; ++q) {
                    const long long at = index(Y0 - E + q + dy, X0 - E + first);
                    for (int c = 0; c < Q; ++c)
                        for (int i = l; i < ITEMS + steps - 1; i += ITEMS)
                            tile[(c * IR + q) * WIDE + i] = p.f.data[c * p.plane + at + i];
                }
            }
            WP_GPUREG_SYNC();
            WP_GPUREG_EACH {
                WP_GPUREG_OWN
                const int x0 = X0 + l %% LANES * 4, y0 = Y0 + l / LANES * G;
                WP_GPUREG_UNROLL
                for (int y = 0; y < G; ++y) {
                    const T* at = f.data + index(y0 + y + dy, x0 + first);
                    WP_GPUREG_UNROLL
                    for (int c = 0; c < M; ++c)
                        WP_GPUREG_UNROLL
                        for (int i = 1; i < 4; ++i)
                            own.far[c * CELLS + 4 * y + i] = at[c * p.plane + i - 1];
                }
            }
            for (int step = 0; step < steps; ++step) {
                const int dx = first + step;
                const T s = table.data[(dy + reach_y) * (2 * reach_x + 1) + dx + reach_x];
                WP_GPUREG_EACH {
                    WP_GPUREG_OWN
                    const int x0 = X0 + l %% LANES * 4, y0 = Y0 + l / LANES * G;
                    WP_GPUREG_UNROLL
                    for (int y = 0; y < G; ++y) {
                        const T* at = f.data + index(y0 + y + dy, x0 + dx + 3);
                        WP_GPUREG_UNROLL
                        for (int c = 0; c < M; ++c) {
                            T* const row = own.far + c * CELLS + 4 * y;
                            row[0] = row[1];
                            row[1] = row[2];
                            row[2] = row[3];
                            row[3] = at[c * p.plane];
                        }
                    }
                }
                if (s == T(0))  // not in the window
                    continue;
                half = 1 - half;  // by the offsets done: with that of dx, one left out would give the same half twice
                T* const of_offset = sums + half * VR * ITEMS;
                WP_GPUREG_EACH {
                    WP_GPUREG_OWN
                    const T* other = tile + step + l;
                    T square[IR];
                    WP_GPUREG_UNROLL
                    for (int q = 0; q < IR; ++q) {
                        square[q] = T(0);
                        WP_GPUREG_UNROLL
                        for (int c = 0; c < Q; ++c) {
                            const T d = own.near[c * IR + q] - other[(c * IR + q) * WIDE];
                            square[q] = c == 0 ? d * d : square[q] + d * d;
                        }
                    }
                    WP_GPUREG_UNROLL
                    for (int q = 0; q < VR; ++q)
                        of_offset[q * ITEMS + l] = over(square + q);
                }
                WP_GPUREG_SYNC();
                WP_GPUREG_EACH {
                    WP_GPUREG_OWN
                    const int lane = l %% LANES, row = l / LANES * G, x0 = X0 + 4 * lane, y0 = Y0 + row;
                    if (4 * lane < COLUMNS) {
                        // whether both ends of a pair are on the grid and in its mask
                        auto there = [&](int y, int x) -> bool {
                            const bool on = (unsigned)y < (unsigned)height && (unsigned)(y + dy) < (unsigned)height &&
                                            (unsigned)x < (unsigned)width && (unsigned)(x + dx) < (unsigned)width;
                            return on && (!p.masked || (p.inside.data[index(y, x)] > T(0) &&
                                                        p.inside.data[index(y + dy, x + dx)] > T(0)));
                        };
                        T across[(G + 2 * A) * 4];
                        WP_GPUREG_UNROLL
                        for (int y = 0; y < G + 2 * A; ++y) {
                            T a[NV], w[NW];
                            WP_GPUREG_UNROLL
                            for (int i = 0; i < NV; i += 4) {
                                const Four four = *(const Four*)(of_offset + (row + y) * ITEMS + 4 * lane + i);
                                WP_GPUREG_UNROLL
                                for (int j = 0; j < 4; ++j)
                                    a[i + j] = four.x[j];
                            }
                            WP_GPUREG_UNROLL
                            for (int i = 0; i < NW; ++i) {
                                const int u_y = y0 - A + y, u_x = x0 - A + i;
                                T kept = over(a + i) - p.shift, strength = p.scale;
                                if (MAPS) {
                                    const T* at_u = p.maps.data + index(u_y, u_x);
                                    const T* at_v = p.maps.data + index(u_y + dy, u_x + dx);
                                    kept -= at_u[0] + at_v[0];
                                    strength *= at_u[p.plane] * at_v[p.plane];
                                }
                                const T similar = wp::exp(-((kept > T(0) ? kept : T(0)) * strength));
                                w[i] = there(u_y, u_x) && similar >= p.cut ? s * similar : T(0);
                            }
                            WP_GPUREG_UNROLL
                            for (int i = 0; i < 4; ++i) {
                                T sum = w[i];
                                WP_GPUREG_UNROLL
                                for (int j = 1; j <= 2 * A; ++j)
                                    sum += w[i + j];
                                across[4 * y + i] = sum;
                            }
                        }
                        WP_GPUREG_UNROLL
                        for (int i = 0; i < CELLS; ++i) {
                            T w = across[i];
                            WP_GPUREG_UNROLL
                            for (int j = 1; j <= 2 * A; ++j)
                                w += across[i + 4 * j];
                            if (A > 0 && !there(y0 + i / 4, x0 + i %% 4))
                                w = T(0);
                            own.total[i] += w;
                            if (LARGEST) {
                                T& most = own.heaviest[LARGEST ? i : 0];
                                most = w > most ? w : most;
                            }
                            WP_GPUREG_UNROLL
                            for (int c = 0; c < M; ++c)
                                own.pull[c * CELLS + i] += w * own.far[c * CELLS + i];
                        }
                    }
                }
            }
        }
    WP_GPUREG_EACH {
        WP_GPUREG_OWN
        const int lane = l %% LANES, x0 = X0 + 4 * lane, y0 = Y0 + l / LANES * G;
        WP_GPUREG_UNROLL
        for (int i = 0; i < CELLS; ++i) {
            const int x = x0 + i %% 4, y = y0 + i / 4;
            if (4 * lane >= COLUMNS || x >= width || y >= height)
                continue;
            const long long u = (long long)y * width + x;
            const T given = %(lam)s, unit = LARGEST ? own.heaviest[LARGEST ? i : 0] : T(1);
            const T fidelity = wp::isinf(given) ? given : given * unit;
            const T denominator = fidelity + T(2) * own.total[i];
            const bool moves = denominator > smallest && !wp::isinf(fidelity);
            WP_GPUREG_UNROLL
            for (int c = 0; c < M; ++c) {
                const T data = ((const T*)f0.data)[u * M + c];
                const T moved = (fidelity * data + T(2) * own.pull[c * CELLS + i]) / denominator;
                ((T*)out.data)[u * M + c] = moves ? moved : data;
            }
        }
    }
#undef WP_GPUREG_SHARED
#undef WP_GPUREG_SYNC
#undef WP_GPUREG_EACH
#undef WP_GPUREG_OWN
#undef WP_GPUREG_UNROLL
"""


def _over(R, flat):
    """Return C++ for the sum over a patch along one axis; of a flat one by halves, which neighbours share."""

    def run(at, length):
        return f"a[{at}]" if length == 1 else f"({run(at, length // 2)} + {run(at + length // 2, length // 2)})"

    side, at, runs = 2 * R + 1, 0, []
    for length in (8, 4, 2, 1) if flat else (1,):
        while side - at >= length:
            runs.append(run(at, length) if flat else f"g[{at}] * a[{at}]")
            at += length
    return " + ".join(runs)


@functools.cache
def make(real, M, lam_array, largest, form, items):
    """Make the kernel for M channels; `form` is (Q, R, A, flat, maps, S); `items`: the threads of a block on a GPU."""
    Patches, function = strip.struct(real), reals.vector(real, M)
    lam_type = wp.array2d(dtype=reals.vector(real, 1)) if lam_array else real
    smallest = reals.smallest(real)
    names = dict(zip(("Q", "R", "A", "flat", "maps", "S"), map(int, form), strict=True))
    source = _STEP % {
        **names,
        "M": M,
        "largest": int(largest),
        "items": ITEMS,
        "chunk": CHUNK,
        "T": "double" if real == wp.float64 else "float",
        "device": _DEVICE % {},
        "over": _over(names["R"], names["flat"]),
        "lam": "((const T*)lam.data)[u]" if lam_array else "lam",
    }

    @wp.func_native(source)
    def step(
        p: Patches,
        f: wp.array(dtype=real),
        table: wp.array(dtype=real),
        reach_y: int,
        reach_x: int,
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        smallest: real,
        out: wp.array2d(dtype=function),
        item: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def similarity_step(
        p: Patches,  # without the window
        f: wp.array(dtype=real),  # M planes of padded rows, as those of `p`
        table: wp.array(dtype=real),  # (2 reach + 1 along each axis): s, 0 outside of the window
        reach: wp.vec2i,
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        first: wp.vec2i,  # the launch's first block
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, thread = wp.tid()
        step(p, f, table, reach[0], reach[1], f0, lam, smallest, out, (first[0] + i) * items + thread)

    if items > 1:
        similarity_step.threads = items  # of a block
    return similarity_step
