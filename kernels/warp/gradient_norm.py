"""gradient_norm(u) = (|grad_w f(u)|^2 + eps^2)^power,   |grad_w f(u)|^2 = sum_v d_w(f)(u, v)^2
                                                                                  (eq. 9, 15, section 5.1)
With gamma = sqrt(w), d_w(f)(u, v)^2 = w(u, v) |f(v) - f(u)|^2. G = 1: one gradient norm for all M channels; G = M: one
per channel. power = 1/2 gives the local variation, (p - 2)/2 the conductances of the p-Laplacian, p/2 the density of
the energy.

Edge norm: (sum_v (d_w(f)(u, v)^2 + eps^2)^edge_power)^power instead, over the edges whose gamma is not 0; p/2 and 1/p
give the L^p norm of eq. 10.

One work item: one vertex; on a CPU a run of N along the row, on a grid of one channel a pack of N (pack.py).
Traffic per vertex with D neighbours: reads D weights and (D + 1) M values (grid: all but M from the cache; CSR: also D
indices); writes G numbers.
"""

import functools

import warp as wp

from . import pack, reals, squared_gradient

_END = """
    total += eps2;
    T* const to = (T*)out.data + i;
    if (power == T(0.5) || power == T(-0.5)) {
        for (int l = 0; l < N; ++l)
            total[l] = wp::sqrt(total[l]);
        if (power < T(0))
            total = T(1) / total;
    } else if (power == T(0)) {
        total = V{} + T(1);
    } else if (power != T(1)) {
        for (int l = 0; l < N; ++l)
            total[l] = wp::pow(total[l], power);
    }
    __builtin_memcpy(to, &total, sizeof(V));
"""
_FAST = (
    "const T* const F = (const T*)f.data; const V here = load(F + i); V total = V{};",
    "const V d = load(F + i + ahead) - here; total += w * (d * d);",
    _END,
)


@functools.cache
def make(access, M, G, edge_norm, N, packs):
    """Make the kernel for one kind of graph, M channels, G norms of vertices or edges, and runs or packs of N."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    channels = reals.make(real, M, G)
    function, norm, raised = channels.function, channels.norm, channels.raised
    put = reals.writing(norm)
    around = squared_gradient.make(access, M, G, edge_norm)

    @wp.func
    def one(
        graph: Graph,
        f: wp.array2d(dtype=function),
        eps2: real,
        power: real,
        edge_power: real,
        out: wp.array2d(dtype=norm),
        row: int,
        x: int,
    ):
        total = around(graph, f, place(graph, row, x), eps2, edge_power)
        put(out, row, x, raised(total, real(0.0), power))

    @wp.func
    def run(
        graph: Graph,
        f: wp.array2d(dtype=function),
        eps2: real,
        power: real,
        edge_power: real,
        out: wp.array2d(dtype=norm),
        row: int,
        begin: int,
    ):
        x = wp.int32(begin)
        end = wp.min(begin + N, out.shape[1])
        while x < end:
            one(graph, f, eps2, power, edge_power, out, row, x)
            x += 1

    if packs:

        @wp.func_native(pack.source(access, N, *_FAST))
        def fast(
            graph: Graph, f: wp.array2d(dtype=function), eps2: real, power: real, out: wp.array2d(dtype=norm), u: Place
        ): ...

        @wp.func
        def item(
            graph: Graph,
            f: wp.array2d(dtype=function),
            eps2: real,
            power: real,
            edge_power: real,
            out: wp.array2d(dtype=norm),
            row: int,
            x: int,
        ):
            if x >= graph.reach and x + N + graph.reach <= graph.width:
                fast(graph, f, eps2, power, out, place(graph, row, x))
            else:
                run(graph, f, eps2, power, edge_power, out, row, x)

    else:
        item = one if N == 1 else run

    @wp.kernel(module="unique", enable_backward=False)
    def gradient_norm(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        eps2: real,  # eps^2
        power: real,
        edge_power: real,  # read with the edge norm
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=norm),  # G channels
    ):
        i, j = wp.tid()
        item(graph, f, eps2, power, edge_power, out, first[0] + i, (first[1] + j) * N)

    return gradient_norm
