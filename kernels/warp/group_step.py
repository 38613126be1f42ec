"""The step of the model at p = 2 on groups of patches, with a matrix for lam, and the mean of the patches' estimates
                                                             (eq. 25 with values in R^M; Lebrun, Buades, Morel 2013)
For each group, with N members v, their patches a(v) of f0 and b(v) of the guide, and means over the group:

  C = 1/(N - 1) sum_v (b(v) - mean b)(b(v) - mean b)^T,   S = diag(mean over v of the variances of the patch)
  r(v) = S (C + S)^-1 (a(v) - mean a);   a(v) - b(v) if trace C > worst min S
  out(x) = f0(x) - (sum of r over all patches of all groups that cover x) / (number of these patches)

C = 0 if N = 1. Where no patch covers a cell, the result is the guide. C + S = U^T U, Z = U^-1, and
r = S Z Z^T (a(v) - mean a): see triangles.py.

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
Arithmetic per group and channel: n M^2 for C, M^3/3 for U and as much for Z, 2 n M^2 for r.
"""

import functools

import warp as wp

from . import lanes as lanes_of
from . import triangles

# The group of reference r in channel c: r(v) to X; X, Y (n rows) and K, Z (M rows) have a pitch of P numbers.
_SIZES = """
    const int M = s.patch.shape[0], P = s.pitch;
"""
_ESTIMATE = """
    const size_t square = (size_t)P * P;
    auto estimate = [&](int r, int c, T* X, T* Y, T* K) {
        // Z; the diagonal of S; room of `factor`
        T *const Z = K + square, *const S = Z + square, *const F = S + P;
        const int n = s.sizes.data[r];
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
        // K = C, on and above the diagonal
        const T share = T(1) / T(n > 2 ? n - 1 : 1);
        for (int job = lane; job < (M + 3) / 4 * across; job += LANES) {
            const int i = job / across * 4, q = job % across * wide;
            if (q + wide <= i)
                continue;
            V sum[8] = {};
            multiply(q, X + i, P, 1, X, n, sum);
            for (int a = 0; a < 4; ++a)
                for (int k = 0; k < packs(q); ++k)
                    store(K + (i + a) * P + q + k * N, sum[2 * a + k] * share);
        }
        WP_GPUREG_SYNC();
        // next to a singular matrix: the patches of the guide
        T trace = T(0), least = S[0];
        for (int j = 0; j < M; ++j) {
            trace += K[j * P + j];
            least = S[j] < least ? S[j] : least;
        }
        if (trace > s.worst * least) {
            for (int v = 0; v < n; ++v) {
                const long long at = c * s.plane + centre + s.steps.data[member[v]];
                for (int j = lane; j < M; j += LANES)
                    X[v * P + j] = s.noisy.data[at + s.patch.data[j]] - s.pilot.data[at + s.patch.data[j]];
            }
            WP_GPUREG_SYNC();
            return;
        }
        WP_GPUREG_SYNC();
        factor(K, Z, S, F);
        centred(s.noisy.data + c * s.plane);
        solve(X, n, Y, K, Z, S);
    };
"""
_ADD = """
    auto add = [&](int r, int c, const T* X) {
        const int n = s.sizes.data[r], M = s.patch.shape[0];
        for (int v = 0; v < n; ++v) {
            const long long at = s.centres.data[r] + s.steps.data[s.members.data[(size_t)r * s.members.shape[1] + v]];
            T* const to = s.total.data + c * s.plane + at;
            for (int j = lane; j < M; j += LANES)
                to[s.patch.data[j]] += X[v * s.pitch + j];
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
    const size_t numbers = (2 * lines + 2 * s.pitch + 5) * s.pitch;
"""
_BLOCK = """
    T *X = s.scratch.data + item * numbers, *Y = X + lines * P, *K = Y + lines * P;
    const int block = first + item / s.channels, c = item % s.channels;
    for (int i = s.starts.data[block]; i < s.starts.data[block + 1]; ++i)
        if (s.sizes.data[s.order.data[i]] > 0) {
            estimate(s.order.data[i], c, X, Y, K);
            add(s.order.data[i], c, X);
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
        add(s.order.data[i], c, s.scratch.data + place * numbers);
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
        return _make(real, N, lanes, _SIZES + triangles.SOURCE + _ESTIMATE + _ADD + _SCRATCH + _BLOCK)
    return _make(real, N, lanes, _SIZES + triangles.SOURCE + _ESTIMATE + _SCRATCH + _GROUP)


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
