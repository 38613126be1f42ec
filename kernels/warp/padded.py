"""planes(c, x) = f(c, r(x)) around a grid, where r reflects at the border without repeating the edge cell

A function with one row of channels per vertex becomes a plane of cells per channel. Along each axis a plane has zeros,
`radius` cells beyond the grid (reflected, or zeros too), the grid, as many cells again, and zeros. So kernels that read
the patches of a window need no check of the border. Without f, the cells of the grid are 1.

One work item: a cell of all planes; on a CPU a row of a plane. Traffic per cell: reads and writes one number a channel.
"""

import functools

import warp as wp

_ROW = """
    typedef %(T)s T;
    const int D = axes.shape[0] / 5;
    const int *sizes = axes.data, *radius = axes.data + D, *before = axes.data + 2 * D, *padded = axes.data + 3 * D;
    const int* strides = axes.data + 4 * D;
    // the place along an axis in f; -1 where it is outside
    auto place = [&](int at, int a) -> int {
        const int x = at - before[a] - radius[a], size = sizes[a];
        if (x >= 0 && x < size)
            return x;
        if (!reflects || x < -radius[a] || x >= size + radius[a])
            return -1;
        const int period = size > 1 ? 2 * (size - 1) : 1, turned = (x < 0 ? -x : x) %% period;
        return size == 1 ? 0 : turned < period - turned ? turned : period - turned;
    };
    const int pitch = padded[D - 1], channels = f.data ? (int)(f.shape[0] / vertices) : 1;
    long long row0 = 0, rest = row, cells = pitch;
    bool there = true;
    for (int a = D - 2; a >= 0; --a) {
        const int at = place((int)(rest %% padded[a]), a);
        there = there && at >= 0;
        row0 += (long long)at * strides[a];
        rest /= padded[a];
        cells *= padded[a];
    }
    for (int c = 0; c < channels; ++c)
        for (int x = begin; x < end; ++x) {
            const int at = there ? place(x, D - 1) : -1;
            out.data[c * cells + row * pitch + x] =
                at < 0 ? T(0) : f.data ? f.data[(row0 + at) * channels + c] : T(1);
        }
"""


@functools.cache
def make(real, rows):
    """Make the kernel; `rows`: a work item is a row."""

    @wp.func_native(_ROW % {"T": "double" if real == wp.float64 else "float"})
    def fill(
        f: wp.array(dtype=real),
        axes: wp.array(dtype=wp.int32),
        vertices: wp.int64,
        reflects: int,
        row: wp.int64,
        begin: int,
        end: int,
        out: wp.array(dtype=real),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def padded(
        f: wp.array(dtype=real),  # (n * m,), or none
        axes: wp.array(
            dtype=wp.int32
        ),  # (5 * axes,): sizes, radii, zeros before, sizes of a plane, vertices to the next
        vertices: wp.int64,  # n
        reflects: wp.int32,
        width: wp.int32,  # of a plane
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array(dtype=real),  # m planes
    ):
        i, j = wp.tid()
        x = first[1] + j
        fill(
            f, axes, vertices, reflects, wp.int64(first[0] + i), wp.where(rows, 0, x), wp.where(rows, width, x + 1), out
        )

    return padded
