"""out_q(u) = sum_c matrix[q, c] f_c(u)

One work item: one vertex.
Traffic per vertex: reads m values, writes m_out. The weights are not read.

For a GPU: on a CPU the function is in the memory of the host, and numpy mixes it.
"""

import functools

import warp as wp


@functools.cache
def make(real):
    """Make the kernel."""

    @wp.kernel(module="unique", enable_backward=False)
    def mix(
        m: int,  # channels of f, and of the result
        m_out: int,
        matrix: wp.array2d(dtype=real),  # (m_out, m)
        f: wp.array2d(dtype=real),  # (rows, width m)
        first: wp.vec2i,  # row and x of the launch's first work item
        # output
        out: wp.array2d(dtype=real),  # (rows, width m_out); another array
    ):
        i, j = wp.tid()
        row, k = first[0] + i, first[1] + j
        q = int(0)
        while q < m_out:
            total = matrix[q, 0] * f[row, k * m]
            c = int(1)
            while c < m:
                total += matrix[q, c] * f[row, k * m + c]
                c += 1
            out[row, k * m_out + q] = total
            q += 1

    return mix
