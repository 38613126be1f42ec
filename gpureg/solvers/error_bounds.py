"""Bounds on the distance of a function from the minimiser, from its gap.

With e = f - f*, sum_u lam(u) |e(u)|^2 <= 2 gap. Where lam is 0, e is bounded along paths from the data: the energy is
uniformly convex in df for p > 1. For all vectors a and b

    |b|^p/p >= |a|^p/p + |a|^(p-2) <a, b - a> + |b - a|^p / (p (2^(p-1) - 1))                            (p >= 2)
    |b|^p/p >= |a|^p/p + |a|^(p-2) <a, b - a> + (p - 1)/2 |b - a|^2 / (|a| + |b|)^(2-p)                  (1 < p < 2)

also for a and b with eps as one more entry, so that the sum of |de|^p is at most

    S = p (2^(p-1) - 1) gap,      S = (2 gap/(p - 1))^(p/2) (2 (p P(f))^(1/p))^(p (2-p)/2)

and by Hoelder's inequality |e(u)| <= |e(v)| + l^(1/q) S^(1/p) for a path from v to u of length l, the sum of gamma^-q
over its edges, with 1/p + 1/q = 1. This needs gamma(u, v) = gamma(v, u), at least in the device's variable.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray
from ..model.matrices import Edges, undirected_edges
from ..model.on_device import DeviceProblem

STRONG = "sqrt(2 gap / min lam), because the energy is strongly convex in f."
_PATHS = "From the gap along the shortest paths from the data, because the energy is uniformly convex in df."
_MANY = "There is none: for p = 1 with lam = 0 at some vertices there can be many minimisers."
_SKEW = "There is none: where lam is 0, none is known for a gamma(u, v) other than gamma(v, u)."
_FAR = "There is none: the powers of the weights along the paths from the data overflow."


def error_bound(problem: DeviceProblem, gap: float, energy: float) -> tuple[float | None, str]:
    """Bound the Euclidean distance over all values, in units of the frame, or None; and say how, or why there is none.

    `energy` is that of the function.
    """
    lam = np.broadcast_to(problem.problem.lam, (problem.weighted.graph.n_vertices, 1))[:, 0]
    if np.min(lam, initial=np.inf) > 0:
        return math.sqrt(2 * gap / float(np.min(lam, initial=np.inf))), STRONG
    if problem.p == 1:
        return None, _MANY
    edges = undirected_edges(problem, scaled=False)
    if not np.array_equal(edges.there, edges.back):
        return None, _SKEW
    scale, gamma = 1.0 if problem.scale is None else problem.scale[:, 0], edges.there
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        own = np.sqrt(2 * gap / (lam / scale**2))
        each = _along_paths(edges, gamma, own, problem.p, _spread(problem.p, gap, energy)) / scale
        data = lam > 0
        least = float(np.min(lam[data]))
        bound = min(math.sqrt(float((each**2).sum())), math.sqrt(2 * gap / least + float((each[~data] ** 2).sum())))
    return (bound, _PATHS) if math.isfinite(bound) else (None, _FAR)


def _spread(p: float, gap: float, energy: float) -> float:
    """Return S^(1/p): a bound on the p-norm of the difference of e."""
    if p >= 2:
        return float((p * (2 ** (p - 1) - 1) * gap) ** (1 / p))
    return math.sqrt(2 * gap / (p - 1)) * float((2 * (p * energy) ** (1 / p)) ** ((2 - p) / 2))


def _along_paths(edges: Edges, gamma: FloatArray, own: FloatArray, p: float, spread: float) -> FloatArray:
    """Bound |e| at each vertex, (n,), by `own`, infinite without data, and from the data along paths."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    n, q, unit = len(own), p / (p - 1), float(gamma.max(initial=0)) or 1.0
    lengths = (gamma / unit) ** -q
    usable = (gamma > 0) & np.isfinite(lengths)
    u, v, lengths = edges.u[usable], edges.v[usable], lengths[usable]
    A = csr_array((np.concatenate([lengths, lengths]), (np.concatenate([u, v]), np.concatenate([v, u]))), shape=(n, n))
    best = own
    # from the vertices that are pinned, and from all data
    for start in (np.flatnonzero(own == 0), np.flatnonzero(np.isfinite(own))):
        if len(start):
            far, _, source = dijkstra(A, indices=start, min_only=True, return_predecessors=True)
            begun = np.where(source >= 0, own[np.maximum(source, 0)], np.inf)
            best = np.minimum(best, begun + spread * far ** (1 / q) / unit)
    return best
