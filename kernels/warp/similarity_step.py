"""One sweep of the Gauss-Jacobi process at p = 2 on a grid, with weights that are never stored    (eq. 25, section 5.2)

  out(u) = (lam f0(u) + sum_v 2 w(u, v) f(v)) / (lam + sum_v 2 w(u, v))
  w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |guide(u + j) - guide(v + j)|^2
  with A, a weight is the sum of these over the pairs (u - j, v - j), |j| <= A along each axis

With `largest`, lam is in units of the largest weight around u.
Where lam is infinite, or the denominator is at most `smallest`, out = f0.
The patches compare the Q channels of the guide, which is f or other data on the same grid.

One work item: a block of cells (strip.py).
Traffic per vertex: M + Q values, f0, `inside` and lam, the rest from the cache; writes M numbers.
Arithmetic per edge: as strip.py, an exp, and 2 + 2 M operations.
"""

import functools

import warp as wp

from . import reals, strip

_BEGIN = """
    enum { M = %(M)d, LARGEST = %(largest)d };
    V total[S * B], pull[S * B * M], heaviest[LARGEST ? S * B : 1];
    for (int i = 0; i < S * B; ++i)
        total[i] = heaviest[LARGEST ? i : 0] = V{};
    for (int i = 0; i < S * B * M; ++i)
        pull[i] = V{};
"""
_BODY = """
        for (int y = from; y < until; ++y) {
            weights(y);
            const T* there = f.data + centre0 + y * p.pitch + ahead;
            WP_GPUREG_UNROLL
            for (int pack = 0; pack < B; ++pack) {
                const int i = (ONE_ROW ? 0 : y) * B + pack;
                total[i] += w[pack];
                if (LARGEST) {
                    V& most = heaviest[LARGEST ? i : 0];
                    most = w[pack] > most ? w[pack] : most;
                }
                for (int c = 0; c < M; ++c)
                    pull[i * M + c] += w[pack] * WP_GPUREG_LOAD(there + c * p.plane + pack * N);
            }
        }
"""
_END = """
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < columns; ++x) {
            const int i = ONE_ROW && B * N == 1 ? 0 : y * B + x / N, l = N == 1 ? 0 : x % N;
            const long long u = cell0 + (long long)y * width + x;
            const T given = LAM, unit = LARGEST ? ((const T*)&heaviest[LARGEST ? i : 0])[l] : T(1);
            const T fidelity = wp::isinf(given) ? given : given * unit;
            const T denominator = fidelity + T(2) * ((const T*)&total[i])[l];
            const bool moves = denominator > smallest && !wp::isinf(fidelity);
            for (int c = 0; c < M; ++c) {
                const T data = ((const T*)f0.data)[u * M + c];
                const T moved = (fidelity * data + T(2) * ((const T*)&pull[i * M + c])[l]) / denominator;
                ((T*)out.data)[u * M + c] = moves ? moved : data;
            }
        }
"""


@functools.cache
def make(real, M, lam_array, largest, form):
    """Make the kernel for M channels and patches and blocks of a form (`strip.source`)."""
    Patches, function = strip.struct(real), reals.vector(real, M)
    lam_type = wp.array2d(dtype=reals.vector(real, 1)) if lam_array else real
    smallest = reals.smallest(real)
    begin = _BEGIN % {"M": M, "largest": int(largest)}
    end = _END.replace("LAM", "((const T*)lam.data)[u]" if lam_array else "lam")

    @wp.func_native(strip.source(real, form, begin=begin, body=_BODY, end=end))
    def step(
        p: Patches,
        f: wp.array(dtype=real),
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        smallest: real,
        out: wp.array2d(dtype=function),
        strip: int,
        block: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def similarity_step(
        p: Patches,
        f: wp.array(dtype=real),  # M planes of padded rows, as those of `p`
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        first: wp.vec2i,  # strip and block of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, j = wp.tid()
        step(p, f, f0, lam, smallest, out, first[0] + i, first[1] + j)

    return similarity_step
