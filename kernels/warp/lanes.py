"""Lanes and vectors for kernels whose work item is more than a vertex: one source for both devices.

On a CPU one thread computes a work item, with vectors of N neighbouring numbers. On a GPU 32 threads of a warp do
(`LANES`), with single numbers, N = 1: each takes every 32nd step of a loop, and waits for the others (WP_GPUREG_SYNC)
before it reads what they wrote. The arithmetic of a number is the same, so the lanes need no atomics.

This is C++, as clang has operators for its vectors, but does not always vectorise loops over a Warp vector.
"""

import warp as wp

LANES = 32
"""Threads of a work item on a GPU."""

_COMMON = """
#ifndef __CUDA_ARCH__
#pragma clang fp contract(fast)  // not Warp's default
#endif
    enum { N = %(N)d, LANES = %(lanes)d };
    typedef %(T)s T;
    const unsigned before = (1u << lane) - 1u;  // the lanes before this one, as bits
"""
# I: the result of a comparison, -1 where it holds; WP_GPUREG_ANY: one bit per lane
_VECTORS = """
#define WP_GPUREG_SYNC() ((void)0)
#define WP_GPUREG_BITS(holds) ((holds) ? 1u : 0u)
#define WP_GPUREG_COUNT(bits) ((int)((bits) & 1u))
    typedef T V __attribute__((vector_size(N * sizeof(T))));
    typedef %(I)s I __attribute__((vector_size(N * sizeof(T))));
    auto load = [](const T* from) -> V { V x; __builtin_memcpy(&x, from, sizeof(V)); return x; };
    auto store = [](T* to, V x) { __builtin_memcpy(to, &x, sizeof(V)); };
    auto at_most = [](V x, T limit) -> I { return x <= V{} + limit; };
    auto total = [](I x) -> int {
        int sum = 0;
        for (int l = 0; l < N; ++l)
            sum += (int)x[l];
        return sum;
    };
"""
_NUMBERS = """
#ifdef __CUDA_ARCH__
#define WP_GPUREG_SYNC() __syncwarp()
#define WP_GPUREG_BITS(holds) __ballot_sync(0xffffffffu, holds)
#define WP_GPUREG_COUNT(bits) __popc(bits)
#else
#define WP_GPUREG_SYNC() ((void)0)
#define WP_GPUREG_BITS(holds) ((holds) ? 1u : 0u)
#define WP_GPUREG_COUNT(bits) ((int)((bits) & 1u))
#endif
    typedef T V;
    typedef int I;
    auto load = [](const T* from) -> V { return *from; };
    auto store = [](T* to, V x) { *to = x; };
    auto at_most = [](V x, T limit) -> I { return x <= limit ? -1 : 0; };
    auto total = [](I x) -> int {
#ifdef __CUDA_ARCH__
        for (int step = LANES / 2; step > 0; step /= 2)
            x += __shfl_xor_sync(0xffffffffu, x, step);
#endif
        return x;
    };
"""
_END = """
#undef WP_GPUREG_SYNC
#undef WP_GPUREG_BITS
#undef WP_GPUREG_COUNT
"""


def source(real, N, lanes, body):
    """Return C++ for lane `lane` of a work item, with vectors of N numbers."""
    double = real == wp.float64
    names = {"N": N, "lanes": lanes, "T": "double" if double else "float", "I": "long long" if double else "int"}
    return (_COMMON + (_VECTORS if N > 1 else _NUMBERS)) % names + body + _END
