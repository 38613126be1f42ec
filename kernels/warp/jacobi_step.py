"""One sweep of the Gauss-Jacobi process                                                       (eq. 25, 31)

  J(u)   = (lam f0(u) + sum_v beta(u, v) f(v)) / (lam + sum_v alpha(u, v))
  out(u) = f(u) + theta (J(u) - f(u))

alpha = gamma(u, v)^2 c(u, v), beta = gamma(u, v) gamma(v, u) c(u, v), c the conductance of the edge (conductance.py).
lam is a number, or one value per vertex. Where lam is infinite, or the denominator is at most `smallest` (lam and all
weights are about 0), out = f0. theta = 1 is the paper's process.

One work item: one vertex; on a CPU a run of N along the row, on a grid of one channel a pack of N (pack.py).
Traffic per vertex with D neighbours: reads D weights, and (D + 2) M values, (D + 1) G conductances (none with the edge
norm) and lam (grid: all but 2 M + G + 1 from the cache; CSR: also D indices); writes M numbers.
"""

import functools

import warp as wp

from . import conductance, gamma, pack, reals

_END = """
    const V data = load((const T*)f0.data + i), fidelity = LAM;
    const V denominator = fidelity + total;
    V moved = (fidelity * data + pull) / denominator;
    if (theta != T(1)) {
        const V old = load(F + i);
        moved = old + theta * (moved - old);
    }
    moved = ((denominator > V{} + smallest) & (fidelity < V{} + T(INFINITY))) ? moved : data;
    __builtin_memcpy((T*)out.data + i, &moved, sizeof(V));
"""


def _fast(kind, lam_array):
    """Return the parts of pack.source."""
    sums = "const T* const F = (const T*)f.data; V pull = V{}, total = V{};"
    body = "const V c = w * T(2); total += c; pull += c * load(F + i + ahead);"
    if kind == "vertex":
        sums += "const T* const C = (const T*)g.data; const V own = load(C + i);"
        body = body.replace("T(2)", "(own + load(C + i + ahead))")
    return sums, body, _END.replace("LAM", "load((const T*)lam.data + i)" if lam_array else "V{} + lam")


@functools.cache
def make(access, M, G, kind, lam_array, N, packs):
    """Make the kernel for one kind of graph, M channels, G conductances of a kind, runs or packs of N."""
    real, Graph, Place, place = access.real, access.Graph, access.Place, access.place
    begin, end, neighbour, exists, edge = access.begin, access.end, access.neighbour, access.exists, access.edge
    channels = reals.make(real, M, G)
    function, norm, scaled = channels.function, channels.norm, channels.scaled
    at, put = reals.reading(function), reals.writing(function)
    of = gamma.make(real, access.directed, M, G)
    difference, hold, pull_of = of.difference, of.hold, of.pull
    conductance_of = conductance.make(access, M, G, kind)
    lam_type, lam_at = reals.per_vertex(real, Place, lam_array)
    last = G - 1
    smallest = reals.smallest(real)

    # The sums of beta(u, v) f(v) and of alpha(u, v).
    @wp.func
    def around(
        graph: Graph,
        f: wp.array2d(dtype=function),
        g: wp.array2d(dtype=norm),
        power: real,
        eps2: real,
        u: Place,
    ):
        here = at(f, u[0], u[1])
        pull = function()
        total = norm()
        i = begin(graph, u)
        last = end(graph, u)
        while i < last:
            v = neighbour(graph, u, i)
            if exists(graph, v):
                e = edge(graph, u, i, v)
                there = at(f, v[0], v[1])
                c = conductance_of(e, difference(e, here, there), g, u, v, power, eps2)
                total += hold(e) * c
                pull += scaled(pull_of(e) * c, there)
            i += 1
        return pull, total

    @wp.func
    def move(old: real, data: real, pull: real, total: real, lam: real, theta: real) -> real:
        denominator = lam + total
        if wp.isinf(lam) or not (denominator > smallest):
            return data
        moved = (lam * data + pull) / denominator
        if theta == real(1.0):
            return moved
        return old + theta * (moved - old)

    @wp.func
    def move_all(old: function, data: function, pull: function, total: norm, lam: real, theta: real) -> function:
        result = function()
        for c in range(M):
            result[c] = move(old[c], data[c], pull[c], total[wp.min(c, last)], lam, theta)
        return result

    @wp.func
    def one(
        graph: Graph,
        f: wp.array2d(dtype=function),
        f0: wp.array2d(dtype=function),
        g: wp.array2d(dtype=norm),
        power: real,
        eps2: real,
        lam: lam_type,
        theta: real,
        out: wp.array2d(dtype=function),
        row: int,
        x: int,
    ):
        u = place(graph, row, x)
        pull, total = around(graph, f, g, power, eps2, u)
        put(out, row, x, move_all(at(f, row, x), at(f0, row, x), pull, total, lam_at(lam, u), theta))

    @wp.func
    def run(
        graph: Graph,
        f: wp.array2d(dtype=function),
        f0: wp.array2d(dtype=function),
        g: wp.array2d(dtype=norm),
        power: real,
        eps2: real,
        lam: lam_type,
        theta: real,
        out: wp.array2d(dtype=function),
        row: int,
        begin: int,
    ):
        x = wp.int32(begin)
        end = wp.min(begin + N, out.shape[1])
        while x < end:
            one(graph, f, f0, g, power, eps2, lam, theta, out, row, x)
            x += 1

    if packs:

        @wp.func_native(pack.source(access, N, *_fast(kind, lam_array)))
        def fast(
            graph: Graph,
            f: wp.array2d(dtype=function),
            f0: wp.array2d(dtype=function),
            g: wp.array2d(dtype=norm),
            lam: lam_type,
            theta: real,
            smallest: real,
            out: wp.array2d(dtype=function),
            u: Place,
        ): ...

        @wp.func
        def item(
            graph: Graph,
            f: wp.array2d(dtype=function),
            f0: wp.array2d(dtype=function),
            g: wp.array2d(dtype=norm),
            power: real,
            eps2: real,
            lam: lam_type,
            theta: real,
            out: wp.array2d(dtype=function),
            row: int,
            x: int,
        ):
            if x >= graph.reach and x + N + graph.reach <= graph.width:
                fast(graph, f, f0, g, lam, theta, smallest, out, place(graph, row, x))
            else:
                run(graph, f, f0, g, power, eps2, lam, theta, out, row, x)

    else:
        item = one if N == 1 else run

    @wp.kernel(module="unique", enable_backward=False)
    def jacobi_step(
        graph: Graph,
        f: wp.array2d(dtype=function),  # M channels
        f0: wp.array2d(dtype=function),  # M channels
        g: wp.array2d(dtype=norm),  # G channels: the conductances; read with kind "vertex"
        power: real,  # (p - 2)/2; read with the edge norm
        eps2: real,  # eps^2; read with the edge norm
        lam: lam_type,  # a number or 1 channel
        theta: real,
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, j = wp.tid()
        item(graph, f, f0, g, power, eps2, lam, theta, out, first[0] + i, (first[1] + j) * N)

    return jacobi_step
