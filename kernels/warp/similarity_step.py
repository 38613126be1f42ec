"""One sweep of the Gauss-Jacobi process at p = 2 on a grid, with weights that are never stored    (eq. 25, section 5.2)

  out(u) = (lam f0(u) + sum_v 2 w(u, v) f(v)) / (lam + sum_v 2 w(u, v))
  w(u, v) = s(u, v) exp(-max(rho(u, v) - shift, 0) scale),   rho(u, v) = sum_j g_j |f(u + j) - f(v + j)|^2

With `largest`, lam is in units of the largest weight around u.
Where lam is infinite, or the denominator is at most `smallest`, out = f0.

One work item: a strip of cells (strip.py).
Traffic per vertex: M values of f and f0, `inside` and lam, the rest from the cache; writes M numbers.
Arithmetic per edge: as strip.py, an exp, and 2 + 2 M operations.
"""

import functools

import warp as wp

from . import reals, strip

_BEGIN = """
    enum { LARGEST = %(largest)d };
    V total[S], pull[S * M], heaviest[S];
    for (int y = 0; y < S; ++y)
        total[y] = heaviest[y] = V{};
    for (int i = 0; i < S * M; ++i)
        pull[i] = V{};
"""
_WEIGHTS = """
        for (int y = from; y < until; ++y) {
            const long long v = centre0 + y * p.pitch + ahead;
            const V w = T(2) * similarity(rho[y], k, centre0 + y * p.pitch) * WP_GPUREG_LOAD(p.inside.data + v);
            total[y] += w;
            if (LARGEST)
                heaviest[y] = w > heaviest[y] ? w : heaviest[y];
            for (int c = 0; c < M; ++c)
                pull[y * M + c] += w * WP_GPUREG_LOAD(p.f.data + c * p.plane + v);
        }
"""
_END = """
    for (int y = 0; y < rows; ++y) {
        const T* within = p.inside.data + centre0 + y * p.pitch;
        for (int l = 0; l < columns; ++l) {
            const long long u = cell0 + (long long)y * width + l;
            // a cell outside the mask has no edges
            const T given = LAM, unit = LARGEST ? T(0.5) * ((const T*)&heaviest[y])[l] : T(1);
            const T fidelity = wp::isinf(given) ? given : given * unit, kept = within[l] > T(0) ? T(1) : T(0);
            const T denominator = fidelity + kept * ((const T*)&total[y])[l];
            const bool moves = denominator > smallest && !wp::isinf(fidelity);
            for (int c = 0; c < M; ++c) {
                const T data = ((const T*)f0.data)[u * M + c];
                const T moved = (fidelity * data + kept * ((const T*)&pull[y * M + c])[l]) / denominator;
                ((T*)out.data)[u * M + c] = moves ? moved : data;
            }
        }
    }
"""


@functools.cache
def make(real, ndim, M, R, maps, lam_array, largest, N, S):
    """Make the kernel for a grid of `ndim` axes, M channels, patches of radius R, and packs of N cells on S rows."""
    Patches, function = strip.struct(real), reals.vector(real, M)
    lam_type = wp.array2d(dtype=reals.vector(real, 1)) if lam_array else real
    smallest = reals.smallest(real)
    end = _END.replace("LAM", "((const T*)lam.data)[u]" if lam_array else "lam")

    @wp.func_native(
        strip.source(
            real, ndim, M, R, N, S, maps=maps, begin=_BEGIN % {"largest": int(largest)}, weights=_WEIGHTS, end=end
        )
    )
    def step(
        p: Patches,
        f0: wp.array2d(dtype=function),
        lam: lam_type,
        smallest: real,
        out: wp.array2d(dtype=function),
        strip: int,
        pack: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def similarity_step(
        p: Patches,
        f0: wp.array2d(dtype=function),  # M channels
        lam: lam_type,  # a number or 1 channel
        first: wp.vec2i,  # strip and pack of the launch's first work item
        # output
        out: wp.array2d(dtype=function),  # M channels; not f
    ):
        i, j = wp.tid()
        step(p, f0, lam, smallest, out, first[0] + i, first[1] + j)

    return similarity_step
