"""The neighbours of a vertex on an implicit grid, under the same names as in csr.py, which explains them.

A row is a line of cells along the last axis; functions are (n_rows, width) arrays. An edge e is the index of its
offset: the 2 H offsets are in lexicographic order, the last H are forward, the opposite of e is 2 H - 1 - e. A vertex
is the vector (row, x), on three axes or more followed by the row's coordinates along the leading axes. An offset is the
difference of two vertices. Every neighbour is checked against the bounds, so there is no padding.

Weights are stored once per pair of vertices, for the forward half of the window, interleaved by row so that a sweep
reads them in order: (n_rows, H, width), 0 where an edge leaves the grid. Functions on the edges (also gamma) have the
same layout for the whole window: (n_rows, 2 H, width).
"""

import functools

import warp as wp

from . import gamma, reals
from .csr import Access


@functools.cache
def places(ndim):
    """Make the vector type of a vertex, and that of the sizes of the leading axes."""
    leading = ndim - 1 if ndim > 2 else 0
    return (
        wp.types.vector(length=2 + leading, dtype=wp.int32),
        wp.types.vector(length=max(leading, 1), dtype=wp.int32),
    )


@functools.cache
def struct(real, ndim, stored="full"):
    """Make the struct with the graph; `stored`: its weights, "full", "half", or (channels, masked) to compute them."""
    Place, Sizes = places(ndim)
    weight = wp.float16 if stored == "half" else real
    channels = sum(stored) if isinstance(stored, tuple) else 1

    @wp.struct
    class Grid:
        n_rows: wp.int32
        width: wp.int32  # cells in a row
        reach: wp.int32  # largest offset along a row
        H: wp.int32  # forward offsets, half the window
        sizes: Sizes  # of the leading axes, on three axes or more
        offsets: wp.array(dtype=Place)  # (2 H,)
        weights: wp.array3d(dtype=weight)  # (n_rows, H, width), or gamma (n_rows, 2 H, width); read if there are any
        compared: wp.array2d(dtype=reals.vector(real, channels))  # for weights that are not stored; mask: last channel
        nearness: wp.array(dtype=real)  # (H,): their spatial factors
        shift: real
        scale: real

    return Grid


@functools.cache
def make(real, ndim, form):
    """Make the names of csr.py for a grid of `ndim` axes and one `form` of edges.

    It is "unit", "weights", "gamma", "half" for weights in float16, or (channels, masked) for weights between single
    cells, which are computed from a function of so many channels at each use: as patch_distance.py, with maps and a cut
    left out.
    """
    computed = isinstance(form, tuple)
    Graph, (Place, _) = struct(real, ndim, form if computed or form == "half" else "full"), places(ndim)
    Edge = gamma.edge(real, form == "gamma")
    leading = ndim - 1
    offset_at, weight_at = reals.reading(Place, 1), reals.reading(real, 3)

    # `exists` compares unsigned numbers, where negative ones are very large: one comparison checks both bounds.
    if ndim <= 2:

        @wp.func
        def place(graph: Graph, row: int, x: int) -> Place:
            return Place(row, x)

        @wp.func
        def exists(graph: Graph, v: Place) -> bool:
            return wp.uint32(v[0]) < wp.uint32(graph.n_rows) and wp.uint32(v[1]) < wp.uint32(graph.width)

    else:

        @wp.func
        def place(graph: Graph, row: int, x: int) -> Place:
            u = Place()
            u[0] = row
            u[1] = x
            rest = int(row)
            for i in range(leading):
                d = leading - 1 - i
                u[2 + d] = rest % graph.sizes[d]
                rest = rest // graph.sizes[d]
            return u

        @wp.func
        def exists(graph: Graph, v: Place) -> bool:
            inside = wp.uint32(v[1]) < wp.uint32(graph.width)
            for d in range(leading):
                inside = inside and wp.uint32(v[2 + d]) < wp.uint32(graph.sizes[d])
            return inside

    @wp.func
    def begin(graph: Graph, u: Place) -> int:
        return 0

    @wp.func
    def end(graph: Graph, u: Place) -> int:
        return 2 * graph.H

    @wp.func
    def neighbour(graph: Graph, u: Place, e: int) -> Place:
        return u + offset_at(graph.offsets, e)

    if form == "gamma":

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> Edge:
            own = weight_at(graph.weights, u[0], e, u[1])
            return Edge(own, weight_at(graph.weights, v[0], 2 * graph.H - 1 - e, v[1]))

    elif form == "half":
        half_at = reals.reading(wp.float16, 3)

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            if e >= graph.H:
                return real(half_at(graph.weights, u[0], e - graph.H, u[1]))
            return real(half_at(graph.weights, v[0], graph.H - 1 - e, v[1]))

    elif computed:
        channels, masked = form
        compared_at, near_at = reals.reading(reals.vector(real, sum(form))), reals.reading(real, 1)

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            here = compared_at(graph.compared, u[0], u[1])
            there = compared_at(graph.compared, v[0], v[1])
            rho = real(0.0)
            for c in range(channels):
                d = here[c] - there[c]
                rho += d * d
            w = wp.exp(-wp.max(rho - graph.shift, real(0.0)) * graph.scale)
            if wp.static(masked):
                if here[channels] * there[channels] == real(0.0):
                    w = real(0.0)
            return near_at(graph.nearness, wp.max(e - graph.H, graph.H - 1 - e)) * w

    elif form == "weights":
        # Stored at u if the edge is a forward one, otherwise at v.
        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            if e >= graph.H:
                return weight_at(graph.weights, u[0], e - graph.H, u[1])
            return weight_at(graph.weights, v[0], graph.H - 1 - e, v[1])

    else:

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            return real(1.0)

    @wp.func
    def edge_at(u: Place, e: int) -> wp.vec3i:
        return wp.vec3i(u[0], e, u[1])

    @wp.func
    def opposite_at(graph: Graph, v: Place, e: int) -> wp.vec3i:
        return wp.vec3i(v[0], 2 * graph.H - 1 - e, v[1])

    pack = (leading if ndim > 2 else 0, form == "weights") if form in ("unit", "weights") else None
    return Access(
        real,
        Graph,
        Place,
        place,
        begin,
        end,
        neighbour,
        exists,
        edge,
        edge_at,
        opposite_at,
        Edge,
        form == "gamma",
        pack,
    )
