"""The cells of an image as a function on the grid, and back, with all conversions of types and layouts:

    f_c(u) = (x_c(u)/unit_c - offset_c) factor            make_in
    x_c(u) = (f_c(u) factor + offset_c) unit_c            make_out; integers rounded to the nearest and clipped

One work item: one cell of a row, all channels. Neighbouring work items read and write neighbouring cells.
Traffic per vertex: m cells of the image and m reals. A band of rows is converted at a time.

For a GPU: on a CPU the image and the function are in the same memory, and numpy converts them.
"""

import functools

import warp as wp


@functools.cache
def _scaled(held, units, back):
    """Return the function that divides by the unit of a channel, or with `back` multiplies; without units neither."""
    if not units:

        @wp.func
        def of(value: held, unit: wp.array(dtype=held), c: int) -> held:
            return value

    elif back:

        @wp.func
        def of(value: held, unit: wp.array(dtype=held), c: int) -> held:
            return value * unit[c]

    else:

        @wp.func
        def of(value: held, unit: wp.array(dtype=held), c: int) -> held:
            return value / unit[c]

    return of


@functools.cache
def make_in(real, cell, held, wide, units):
    """Make the kernel from cells of a type; `held` is the type of quotients, `wide` that of the other arithmetic."""
    scaled = _scaled(held, units, False)

    @wp.kernel(module="unique", enable_backward=False)
    def cells_in(
        m: int,  # channels
        width: int,  # cells in a row
        row_step: int,  # numbers of the image from a row to the next, a cell, a channel
        cell_step: int,
        channel_step: int,
        offset: wp.array(dtype=wide),  # (m,)
        unit: wp.array(dtype=held),  # (m,)
        factor: wide,
        x: wp.array(dtype=cell),  # the band of the image
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        f: wp.array(dtype=real),  # the band of the function: m numbers per cell
    ):
        i, j = wp.tid()
        row, column = first[0] + i, first[1] + j
        at, u = row * row_step + column * cell_step, (row * width + column) * m
        c = int(0)
        while c < m:
            value = scaled(held(x[at + c * channel_step]), unit, c)
            f[u + c] = real((wide(value) - offset[c]) * factor)
            c += 1

    return cells_in


@functools.cache
def make_out(real, cell, held, wide, units, limits):
    """Make the kernel to cells of a type; `limits` are the least and the largest integer of it, None for reals."""
    scaled = _scaled(held, units, True)
    if limits is None:

        @wp.func
        def rounded(value: held) -> cell:
            return cell(value)

    else:
        low, high = held(limits[0]), held(limits[1])

        @wp.func
        def rounded(value: held) -> cell:
            return cell(wp.clamp(wp.rint(value), low, high))

    @wp.kernel(module="unique", enable_backward=False)
    def cells_out(
        m: int,  # channels
        width: int,  # cells in a row
        row_step: int,  # numbers of the image from a row to the next, a cell, a channel
        cell_step: int,
        channel_step: int,
        offset: wp.array(dtype=wide),  # (m,)
        unit: wp.array(dtype=held),  # (m,)
        factor: wide,
        f: wp.array(dtype=real),  # the band of the function: m numbers per cell
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        x: wp.array(dtype=cell),  # the band of the image
    ):
        i, j = wp.tid()
        row, column = first[0] + i, first[1] + j
        at, u = row * row_step + column * cell_step, (row * width + column) * m
        c = int(0)
        while c < m:
            value = scaled(held(wide(f[u + c]) * factor + offset[c]), unit, c)
            x[at + c * channel_step] = rounded(value)
            c += 1

    return cells_out
