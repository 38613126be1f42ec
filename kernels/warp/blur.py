"""out(u) = sum_j taps[|j|] f(u + j e)                         e a step along one axis; j from -r to r

Cells beyond the grid are reflected, without repeating the edge cell. The sum begins with the middle; each pair of cells
at the same distance is added before it is multiplied. This order is the same for all cells.

One work item: one cell, one channel.
Traffic per vertex: reads m values (the 2 r others are in the cache), writes m.

For a GPU: on a CPU the function is in the memory of the host, and SciPy blurs it.
"""

import functools

import warp as wp


@wp.func
def reflected(place: int, size: int) -> int:
    """Return the place of a cell beyond an axis of this size, reflected as often as needed."""
    period = wp.max(2 * (size - 1), 1)
    rest = (place % period + period) % period
    return wp.min(rest, period - rest) * wp.min(size - 1, 1)


@functools.cache
def make(real):
    """Make the kernel."""

    @wp.kernel(module="unique", enable_backward=False)
    def blur(
        m: int,  # channels
        size: int,  # cells along the axis
        rows: int,  # rows of the grid from a cell to the next along the axis; 0 for the last axis
        r: int,  # radius of the kernel
        taps: wp.array(dtype=real),  # (r + 1,)
        f: wp.array2d(dtype=real),  # (rows of the grid, width m)
        first: wp.vec2i,  # row and number of the launch's first work item
        # output
        out: wp.array2d(dtype=real),  # as f; another array
    ):
        i, j = wp.tid()
        row, k = first[0] + i, first[1] + j
        # along the rows a step is m numbers of a row, along another axis whole rows
        down, along, place = rows, int(0), int(0)
        if rows > 0:
            place = row // rows % size
        else:
            place, along = k // m, m
        total = taps[0] * f[row, k]
        d = int(1)
        while d <= r:
            before, after = reflected(place - d, size) - place, reflected(place + d, size) - place
            total += taps[d] * (f[row + before * down, k + before * along] + f[row + after * down, k + after * along])
            d += 1
        out[row, k] = total

    return blur
