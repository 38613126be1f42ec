"""The members of the group of each reference u: the patches of a window that are most like that of u    (section 5.2)

  d(u, v) = sum_j |g(u + j) - g(v + j)|^2 over the cells j of a patch, and all channels
  t = max(n-th smallest d(u, v) over the window, limit level(u)),   members: d(u, v) <= t

Of K > most members, in row-major order, those of rank i with floor((i + 1) most/K) > floor(i most/K) remain.

One work item: one reference. Its distances go to scratch memory. t is exact: numbers >= 0 have the order of their bits
as integers, so that t is found bit by bit, by counting the distances up to a number.
g is one plane of cells per channel, padded by the radius of the patch (numpy's "reflect") and by zeros for the reach of
the window and of a pack: reads need no check of the border, as `inside` is 0 beyond it.
Traffic per reference with P places, patches of M cells and m channels: reads M m values for each place and P `inside`,
all from the cache, reads and writes P distances, and reads them up to 32 times (float64: 64); writes its members.
Arithmetic per reference: 3 P M m operations.
"""

import functools

import warp as wp

from . import lanes as lanes_of

_FIND = """
    enum { U = %(U)d };  // packs at once
    typedef %(B)s B;
    const int r = first + item, M = s.patch.shape[0], lines = s.lines.shape[0];
    const int groups = (s.width + U * N - 1) / (U * N), pitch = groups * U * N;
    const long long centre = s.centres.data[r];
    if (!(s.inside.data[centre] > T(0))) {
        if (lane == 0)
            sizes.data[r] = 0;
        return;
    }
    T* const d = s.scratch.data + (size_t)item * lines * pitch;
    const B largest = %(largest)s, unknown_bits = %(infinity)s;
    auto number = [](B bits) -> T { union { B bits; T x; } same = {bits}; return same.x; };
    const T unknown = number(unknown_bits);

    for (int job = lane; job < lines * groups; job += LANES) {
        const int line = job / groups, x0 = job %% groups * (U * N);
        const long long there = centre + s.lines.data[line] * s.pitch - s.width / 2 + x0;
        V sum[U];
        for (int k = 0; k < U; ++k)
            sum[k] = V{};
        const bool live = s.live.data[centre / s.pitch + s.lines.data[line]] > 0;
        for (int c = 0; live && c < s.channels; ++c) {
            const T *own = s.g.data + c * s.plane + centre, *other = s.g.data + c * s.plane + there;
            for (int j = 0; j < M; ++j) {
                const T value = own[s.patch.data[j]];
                const T* at = other + s.patch.data[j];
                for (int k = 0; k < U; ++k) {
                    const V x = load(at + k * N) - value;
                    sum[k] += x * x;
                }
            }
        }
        T* const to = d + line * pitch + x0;
        for (int k = 0; k < U; ++k)
            store(to + k * N, load(s.inside.data + there + k * N) > T(0) ? sum[k] : V{} + unknown);
        for (int x = s.width - x0 > 0 ? s.width - x0 : 0; x < U * N; ++x)
            to[x] = unknown;
    }
    WP_GPUREG_SYNC();

    auto count = [&](T limit) -> int {
        I sum = I{};
        for (int i = lane * N; i < lines * pitch; i += LANES * N)
            sum += at_most(load(d + i), limit);
        return -total(sum);
    };
    B low = 0, high = largest;
    if (count(number(largest)) > s.nearest)
        while (low < high) {
            const B middle = low + (high - low) / 2;
            const int found = count(number(middle));
            low = found < s.nearest ? middle + 1 : low;
            high = found < s.nearest ? high : middle;
            // no distance lies between the n-th and this number
            if (found == s.nearest)
                break;
        }
    const T alike = s.level.data ? s.limit * s.level.data[centre] : s.limit;
    T limit = number(high) > alike ? number(high) : alike;
    limit = limit < number(largest) ? limit : number(largest);

    const int K = count(limit);
    int rank = 0, size = 0;
    for (int line = 0; line < lines; ++line)
        for (int x0 = 0; x0 < s.width; x0 += LANES) {
            const int x = x0 + lane;
            const bool member = x < s.width && d[line * pitch + x] <= limit;
            const unsigned members_here = WP_GPUREG_BITS(member);
            if (members_here == 0u)
                continue;
            const long long i = rank + WP_GPUREG_COUNT(members_here & before);
            const bool kept = member && (K <= s.most || (i + 1) * s.most / K > i * s.most / K);
            const unsigned kept_here = WP_GPUREG_BITS(kept);
            if (kept)
                members.data[(size_t)r * s.most + size + WP_GPUREG_COUNT(kept_here & before)] = line * s.width + x;
            rank += WP_GPUREG_COUNT(members_here);
            size += WP_GPUREG_COUNT(kept_here);
        }
    if (lane == 0)
        sizes.data[r] = size;
"""


@functools.cache
def struct(real):
    """Make the struct with the guide, the window and the patch."""

    @wp.struct
    class Search:
        g: wp.array(dtype=real)  # a plane of padded rows per channel
        channels: wp.int32
        plane: wp.int64  # from a channel to the next
        pitch: wp.int64  # from a row to the next
        inside: wp.array(dtype=real)  # one plane: 1 on the grid and in its mask, 0 elsewhere
        live: wp.array(dtype=wp.int32)  # (padded rows,): 0 where a row is outside
        centres: wp.array(dtype=wp.int32)  # (n_references,): the cells of the references in a plane
        limit: real  # largest distance of patches that belong to a group
        level: wp.array(dtype=real)  # its factor, a plane as `inside`; empty: 1
        lines: wp.array(dtype=wp.int32)  # lines of the window: steps in padded rows
        width: wp.int32  # cells of such a line
        patch: wp.array(dtype=wp.int32)  # (M,): steps to the cells of a patch
        nearest: wp.int32
        most: wp.int32
        scratch: wp.array(dtype=real)  # the distances of the references of a launch

    return Search


@functools.cache
def make(real, N, U, lanes):
    """Make the kernel for packs of N places, U at once, on a CPU (`lanes` = 1) or a GPU (N = 1)."""
    Search, double = struct(real), real == wp.float64
    names = {
        "U": U,
        "B": "unsigned long long" if double else "unsigned",
        "largest": "0x7fefffffffffffffull" if double else "0x7f7fffffu",
        "infinity": "0x7ff0000000000000ull" if double else "0x7f800000u",
    }

    @wp.func_native(lanes_of.source(real, N, lanes, _FIND % names))
    def find(
        s: Search,
        members: wp.array2d(dtype=wp.int32),
        sizes: wp.array(dtype=wp.int32),
        first: int,
        item: int,
        lane: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def patch_groups(
        s: Search,
        begin: wp.int32,  # the first reference of the launches that share the scratch memory
        members: wp.array2d(dtype=wp.int32),  # output too: (n_references, most), in increasing order
        first: wp.vec2i,  # the launch's first work item
        # output
        sizes: wp.array(dtype=wp.int32),  # (n_references,): 0 outside the mask
    ):
        i = wp.tid()
        find(s, members, sizes, begin, first[0] + i // lanes, i % lanes)

    return patch_groups
