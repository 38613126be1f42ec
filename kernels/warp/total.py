"""total = the sum of the parts of a long sum, or the largest one

The second stage of dot, energy, duality_gap and max_change. The result stays on the device: the next kernel can read
it, and the host only needs to at a check.

One work item: on a CPU all parts. On a GPU one block of GROUP threads: each adds every GROUP-th part, then all of them
by a tree in shared memory. No atomics: the same bits on every run.
Traffic per part: reads 1 number; writes 1 in total.
"""

import functools

import warp as wp

GROUP = 256
"""Threads of the block on a GPU."""

# %s: how two numbers x and y become one
_TREE = """
#ifdef __CUDA_ARCH__
    __shared__ double parts[%(group)d];
    const int l = threadIdx.x;
    parts[l] = own;
    __syncthreads();
    for (int step = %(group)d / 2; step > 0; step /= 2) {
        if (l < step) {
            const double x = parts[l], y = parts[l + step];
            parts[l] = %(both)s;
        }
        __syncthreads();
    }
    return parts[0];
#else
    return own;
#endif
"""


@functools.cache
def make(real, maximum):
    """Make the kernel for parts of type `real`, for their maximum or their sum."""

    @wp.func_native(_TREE % {"group": GROUP, "both": "x > y ? x : y" if maximum else "x + y"})
    def over_group(own: wp.float64) -> wp.float64: ...

    @wp.func_native("return a.data[i];")
    def at_index(a: wp.array2d(dtype=real), i: int) -> real: ...

    @wp.func
    def every(parts: wp.array2d(dtype=real), begin: int, stride: int) -> wp.float64:
        own = wp.float64(0.0)
        i = int(begin)
        n = parts.shape[0] * parts.shape[1]
        while i < n:
            part = wp.float64(at_index(parts, i))
            if wp.static(maximum):
                own = wp.max(own, part)
            else:
                own += part
            i += stride
        return own

    @wp.kernel(module="unique", enable_backward=False)
    def total(
        parts: wp.array2d(dtype=real),  # (rows, segments)
        threads: int,  # of the block: 1 on a CPU, GROUP on a GPU
        at: int,
        first: wp.vec2i,  # not used: there is one launch
        # output
        out: wp.array(dtype=wp.float64),  # the number `at`
    ):
        _, thread = wp.tid()
        whole = over_group(every(parts, thread, threads))
        if thread == 0:
            out[at] = whole

    return total
