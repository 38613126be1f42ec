"""The step of the model at p = 2 on groups of patches, with a matrix for lam, and the mean of the patches' estimates
                                                             (eq. 25 with values in R^M; Lebrun, Buades, Morel 2013)
For each group, with N members v, their patches a(v) of f0 and b(v) of the guide, and means over the group:

  C = 1/(N - 1) sum_v (b(v) - mean b)(b(v) - mean b)^T,   S = diag(mean over v of the variances of the patch)
  r(v) = S (C + S)^-1 (a(v) - mean a);   a(v) - b(v) if trace C > worst min S
  out(x) = f0(x) - (sum of r over all patches of all groups that cover x) / (number of these patches)

C = 0 if N = 1. Where no patch covers a cell, the result is the guide. (C + S)^-1 is by Gauss-Jordan elimination without
exchanges: the matrix is positive definite, and pivot k is at least S_kk, as C is semidefinite, which is enforced
against rounding.

A block is a box of references, such that blocks with one block between them write no cell in common. So all blocks
whose indices have the same parities run at once, one set of parities (a phase) after the other, and no sum needs
atomics. The order of sums depends on the place of a block only.

CPU: one work item of `estimate` computes and adds one channel of the groups of a block, one after the other, with
vectors of N numbers. GPU: one work item of `estimate` is one channel of one group (32 threads, lanes.py), which leaves
its r in scratch memory, and one work item of `add` adds those of a block.
`average` writes the result, one vertex per work item.
Traffic per group of n members with patches of M cells, and per channel: reads 2 n M values and writes n M sums, and in
its scratch memory, which fits the cache of a core, reads and writes about n M + M^2 numbers a few times; on a GPU it
also writes and reads n M numbers in memory. `average` reads 3 m + 1 numbers per vertex and writes m.
Arithmetic per group and channel: n M^2 for C, 2 M^3 for the inverse, 2 n M^2 for r.
"""

import functools

import warp as wp

from . import lanes as lanes_of

# The group of reference r in channel c: r(v) to Y; X, Y (n rows) and K (M rows) have a pitch of P numbers.
# Rows are computed in tiles of 4, also beyond their end, where the numbers are not used.
_ESTIMATE = """
    struct One { enum { U = 1 }; };
    struct Two { enum { U = 2 }; };
    const int M = s.patch.shape[0], P = s.pitch;
    auto estimate = [&](int r, int c, T* X, T* Y, T* K) {
        T *const S = K + (size_t)s.pitch * s.pitch, *const F = S + s.pitch;  // the diagonal of S; 4 columns of K
        const int n = s.sizes.data[r], rows = (n + 3) / 4;
        const int* member = s.members.data + (size_t)r * s.members.shape[1];
        const long long centre = s.centres.data[r];

        // X = the patches of a plane minus their mean
        auto centred = [&](const T* plane) {
            for (int v = 0; v < n; ++v) {
                const T* at = plane + centre + s.steps.data[member[v]];
                for (int j = lane; j < M; j += LANES)
                    X[v * P + j] = at[s.patch.data[j]];
            }
            WP_GPUREG_SYNC();
            for (int q = lane * N; q < P; q += LANES * N) {
                V mean = V{};
                for (int v = 0; v < n; ++v)
                    mean += load(X + v * P + q);
                mean /= T(n);
                for (int v = 0; v < n; ++v)
                    store(X + v * P + q, load(X + v * P + q) - mean);
            }
            WP_GPUREG_SYNC();
        };
        // 4 rows and U packs of a product: sums over l of left[l step + a across] right[l P + q]
        auto tile = [&](auto width, const T* left, int step, int across, const T* right, int count, V* sum) {
            constexpr int U = decltype(width)::U;
            V s0[U], s1[U], s2[U], s3[U];
            for (int k = 0; k < U; ++k)
                s0[k] = s1[k] = s2[k] = s3[k] = V{};
            for (int l = 0; l < count; ++l) {
                const T* a = left + l * step;
                const T a0 = a[0], a1 = a[across], a2 = a[2 * across], a3 = a[3 * across];
                for (int k = 0; k < U; ++k) {
                    const V x = load(right + l * P + k * N);
                    s0[k] += a0 * x;
                    s1[k] += a1 * x;
                    s2[k] += a2 * x;
                    s3[k] += a3 * x;
                }
            }
            for (int k = 0; k < U; ++k) {
                sum[k] = s0[k];
                sum[U + k] = s1[k];
                sum[2 * U + k] = s2[k];
                sum[3 * U + k] = s3[k];
            }
        };
        const int pairs = (P / N + 1) / 2;  // of packs in a row; the last one may be one pack

        for (int j = lane; j < M; j += LANES) {
            T mean = s.variance;
            if (s.noise.shape[0] > 0) {
                mean = T(0);
                for (int v = 0; v < n; ++v)
                    mean += s.noise.data[centre + s.steps.data[member[v]] + s.patch.data[j]];
                mean /= T(n);
            }
            S[j] = mean;
        }
        centred(s.pilot.data + c * s.plane);
        // the half of C on and above the diagonal, then the other half
        const T share = T(1) / T(n > 2 ? n - 1 : 1);
        for (int job = lane; job < (M + 3) / 4 * pairs; job += LANES) {
            const int i = job / pairs * 4, q = job % pairs * 2 * N;
            if (q + 2 * N <= i)
                continue;
            V sum[8];
            const int U = q + 2 * N <= P ? 2 : 1;
            if (U == 2)
                tile(Two(), X + i, P, 1, X + q, n, sum);
            else
                tile(One(), X + i, P, 1, X + q, n, sum);
            for (int a = 0; a < 4; ++a)
                for (int k = 0; k < U; ++k)
                    store(K + (i + a) * P + q + k * N, sum[a * U + k] * share);
        }
        WP_GPUREG_SYNC();
        // next to a singular matrix: the patches of the guide
        T trace = T(0), least = S[0];
        for (int i = 0; i < M; ++i) {
            trace += K[i * P + i];
            least = S[i] < least ? S[i] : least;
        }
        if (trace > s.worst * least) {
            for (int v = 0; v < n; ++v) {
                const long long at = c * s.plane + centre + s.steps.data[member[v]];
                for (int j = lane; j < M; j += LANES)
                    Y[v * P + j] = s.noisy.data[at + s.patch.data[j]] - s.pilot.data[at + s.patch.data[j]];
            }
            WP_GPUREG_SYNC();
            return;
        }
        for (int i = 1; i < M; ++i)
            for (int j = lane; j < i; j += LANES)
                K[i * P + j] = K[j * P + i];
        for (int i = lane; i < P; i += LANES)
            K[i * P + i] = i < M ? K[i * P + i] + S[i] : T(1);
        WP_GPUREG_SYNC();
        // K = K^-1 in place, 4 pivots at once: first in their own rows, then in all others
        for (int k = 0; k < M; k += 4) {
            T* const pivots = K + k * P;
            for (int i = lane; i < P; i += LANES) {
                T* const at = K + i * P + k;
                const T f0 = at[0], f1 = at[1], f2 = at[2], f3 = at[3];
                T* const f = F + 4 * i;
                f[0] = f0, f[1] = f1, f[2] = f2, f[3] = f3;
                if (i < k || i >= k + 4)
                    at[0] = at[1] = at[2] = at[3] = T(0);
            }
            WP_GPUREG_SYNC();
            for (int a = 0; a < 4; ++a) {
                T* const pivot = pivots + a * P;
                const T p = T(1) / (pivot[k + a] > S[k + a] ? pivot[k + a] : S[k + a]);
                T factors[4];
                for (int b = 0; b < 4; ++b)
                    factors[b] = pivots[b * P + k + a];
                WP_GPUREG_SYNC();
                for (int b = lane; b < 4; b += LANES)
                    pivots[b * P + k + a] = b == a ? T(1) : T(0);
                WP_GPUREG_SYNC();
                for (int q = lane * N; q < P; q += LANES * N) {
                    const V x = load(pivot + q) * p;
                    for (int b = 0; b < 4; ++b)
                        if (b != a)
                            store(pivots + b * P + q, load(pivots + b * P + q) - factors[b] * x);
                    store(pivot + q, x);
                }
                WP_GPUREG_SYNC();
            }
            for (int i = 0; i < M; i += 2) {
                if (i >= k && i < k + 4)
                    continue;
                T *const row = K + i * P, *const next = row + P;
                const T *f = F + 4 * i, f0 = f[0], f1 = f[1], f2 = f[2], f3 = f[3];
                const T g0 = f[4], g1 = f[5], g2 = f[6], g3 = f[7];
                for (int q = lane * N; q < P; q += LANES * N) {
                    const V x0 = load(pivots + q), x1 = load(pivots + P + q), x2 = load(pivots + 2 * P + q),
                            x3 = load(pivots + 3 * P + q);
                    store(row + q, load(row + q) - f0 * x0 - f1 * x1 - f2 * x2 - f3 * x3);
                    store(next + q, load(next + q) - g0 * x0 - g1 * x1 - g2 * x2 - g3 * x3);
                }
            }
            WP_GPUREG_SYNC();
        }
        centred(s.noisy.data + c * s.plane);
        for (int job = lane; job < rows * pairs; job += LANES) {
            const int v = job / pairs * 4, q = job % pairs * 2 * N;
            V sum[8];
            const int U = q + 2 * N <= P ? 2 : 1;
            if (U == 2)
                tile(Two(), X + v * P, 1, P, K + q, M, sum);
            else
                tile(One(), X + v * P, 1, P, K + q, M, sum);
            for (int a = 0; a < 4; ++a)
                for (int k = 0; k < U; ++k)
                    store(Y + (v + a) * P + q + k * N, sum[a * U + k] * load(S + q + k * N));
        }
        WP_GPUREG_SYNC();
    };
"""
_ADD = """
    auto add = [&](int r, int c, const T* Y) {
        const int n = s.sizes.data[r], M = s.patch.shape[0];
        for (int v = 0; v < n; ++v) {
            const long long at = s.centres.data[r] + s.steps.data[s.members.data[(size_t)r * s.members.shape[1] + v]];
            T* const to = s.total.data + c * s.plane + at;
            for (int j = lane; j < M; j += LANES)
                to[s.patch.data[j]] += Y[v * s.pitch + j];
            // the channels of a block run at once: one of them counts
            if (c == 0)
                for (int j = lane; j < M; j += LANES)
                    count.data[at + s.patch.data[j]] += T(1);
            WP_GPUREG_SYNC();
        }
    };
"""
_SCRATCH = """
    const size_t lines = (size_t)(s.members.shape[1] + 3) / 4 * 4;
    const size_t numbers = (2 * lines + s.pitch + 5) * s.pitch;
"""
_BLOCK = """
    T *X = s.scratch.data + item * numbers, *Y = X + lines * P, *K = Y + lines * P;
    const int block = first + item / s.channels, c = item % s.channels;
    for (int i = s.starts.data[block]; i < s.starts.data[block + 1]; ++i)
        if (s.sizes.data[s.order.data[i]] > 0) {
            estimate(s.order.data[i], c, X, Y, K);
            add(s.order.data[i], c, Y);
        }
"""
_GROUP = """
    T *X = s.scratch.data + item * numbers, *Y = X + lines * P, *K = Y + lines * P;
    const int r = s.order.data[s.starts.data[first] + item / s.channels];
    if (s.sizes.data[r] > 0)
        estimate(r, item % s.channels, X, Y, K);
"""
_ADD_BLOCK = """
    const int block = first + item / s.channels, c = item % s.channels;
    for (int i = s.starts.data[block]; i < s.starts.data[block + 1]; ++i) {
        const size_t place = (size_t)(i - s.starts.data[first]) * s.channels + c;
        add(s.order.data[i], c, s.scratch.data + place * numbers + lines * s.pitch);
    }
"""


@functools.cache
def struct(real):
    """Make the struct with the functions, the groups and the patch."""

    @wp.struct
    class Step:
        noisy: wp.array(dtype=real)  # f0: a plane per channel, padded by the radius of the patch
        pilot: wp.array(dtype=real)  # the guide, likewise
        noise: wp.array(dtype=real)  # a plane of the variance, likewise; empty: `variance`
        variance: real
        worst: real  # largest trace of C over the least variance
        channels: wp.int32
        plane: wp.int64  # from a channel to the next
        centres: wp.array(dtype=wp.int32)  # (n_references,): the cells of the references in a plane
        steps: wp.array(dtype=wp.int32)  # (places,): steps to the cells of the window
        patch: wp.array(dtype=wp.int32)  # (M,): steps to the cells of a patch
        members: wp.array2d(dtype=wp.int32)  # (n_references, most): places in the window
        sizes: wp.array(dtype=wp.int32)  # (n_references,)
        order: wp.array(dtype=wp.int32)  # (n_references,): references by phase and block
        starts: wp.array(dtype=wp.int32)  # (blocks + 1,): where a block begins in `order`
        pitch: wp.int32  # P, from a row of the scratch memory to the next
        scratch: wp.array(dtype=real)  # zeros at first
        total: wp.array(dtype=real)  # output too: sums of r, a plane per channel

    return Step


@functools.cache
def _make(real, N, lanes, body):
    Step = struct(real)

    @wp.func_native(lanes_of.source(real, N, lanes, body))
    def work(s: Step, count: wp.array(dtype=real), first: int, item: int, lane: int): ...

    @wp.kernel(module="unique", enable_backward=False)
    def group_step(
        s: Step,
        begin: wp.int32,  # the first block of the launches that share the scratch memory
        first: wp.vec2i,  # the launch's first work item
        # output
        count: wp.array(dtype=real),  # a plane: how many patches cover a cell
    ):
        i = wp.tid()
        work(s, count, begin, first[0] + i // lanes, i % lanes)

    return group_step


@functools.cache
def make(real, N, lanes, whole):
    """Make `estimate`; `whole`: a work item is a block of groups, and adds what it computes."""
    if whole:
        return _make(real, N, lanes, _ESTIMATE + _ADD + _SCRATCH + _BLOCK)
    return _make(real, N, lanes, _ESTIMATE + _SCRATCH + _GROUP)


@functools.cache
def make_add(real, lanes):
    """Make `add`, if a work item of `estimate` is one group."""
    return _make(real, 1, lanes, _ADD + _SCRATCH + _ADD_BLOCK)


@functools.cache
def make_average(real):
    """Make `average`."""
    Step = struct(real)

    @wp.kernel(module="unique", enable_backward=False)
    def average(
        s: Step,
        count: wp.array(dtype=real),
        rows: wp.array(dtype=wp.int32),  # (rows,): where a row of cells begins in a plane
        width: wp.int32,  # cells in a row
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array(dtype=real),  # (n m,): m channels, interleaved
    ):
        i, j = wp.tid()
        row, x = first[0] + i, first[1] + j
        at = wp.int64(rows[row] + x)
        u = wp.int64(row) * wp.int64(width) + wp.int64(x)
        c = wp.int32(0)
        while c < s.channels:
            here = wp.int64(c) * s.plane + at
            value = s.pilot[here]
            if count[at] > real(0.0):
                value = s.noisy[here] - s.total[here] / count[at]
            out[u * wp.int64(s.channels) + wp.int64(c)] = value
            c += 1

    return average
