"""The equations of Bougleux, Elmoataz and Melkemi (2009) as literal loops: the truth for the numpy backend.

Nothing here is fast, and nothing here knows gpureg. A graph is a set of vertices V and a set of directed edges E,
(u, v) in E with (v, u); weights w and gamma are dictionaries over E; a function f is a dictionary over V; a function of
m channels is a list of m of these. Only ``math`` is used.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Hashable, Iterable

Vertex = Hashable
Edge = tuple[Vertex, Vertex]
Function = dict[Vertex, float]


def neighbours(E: Iterable[Edge], u: Vertex) -> list[Vertex]:
    """All v with v ~ u (section 2.1)."""
    return sorted(b for (a, b) in E if a == u)


def degree(E: set[Edge], w: dict[Edge, float], u: Vertex) -> float:
    """delta_w(u), the sum of the weights around u (section 2.1)."""
    total = 0.0
    for v in neighbours(E, u):
        total += w[u, v]
    return total


def gamma_sqrt(E: set[Edge], w: dict[Edge, float]) -> dict[Edge, float]:
    """gamma = sqrt(w), the choice of section 5."""
    return {(u, v): math.sqrt(w[u, v]) for (u, v) in E}


def gamma_combinatorial(E: set[Edge], w: dict[Edge, float]) -> dict[Edge, float]:
    """gamma_1 = sqrt(w/2) (Table I)."""
    return {(u, v): math.sqrt(w[u, v] / 2) for (u, v) in E}


def gamma_normalized(E: set[Edge], w: dict[Edge, float]) -> dict[Edge, float]:
    """gamma_2(u, v) = sqrt(w/(2 delta_w(u))) (Table I)."""
    return {(u, v): math.sqrt(w[u, v] / (2 * degree(E, w, u))) if w[u, v] else 0.0 for (u, v) in E}


def gamma_degree(E: set[Edge], w: dict[Edge, float]) -> dict[Edge, float]:
    """gamma(u, v) = sqrt(w/delta_w(u)), whose gradient norm is a mean over the neighbours."""
    return {(u, v): math.sqrt(w[u, v] / degree(E, w, u)) if w[u, v] else 0.0 for (u, v) in E}


def difference(gamma: dict[Edge, float], f: Function, u: Vertex, v: Vertex) -> float:
    """d_w(f)(u, v) (eq. 4)."""
    return gamma[v, u] * f[v] - gamma[u, v] * f[u]


def adjoint(E: set[Edge], gamma: dict[Edge, float], H: dict[Edge, float], u: Vertex) -> float:
    """d_w*(H)(u) (eq. 7)."""
    total = 0.0
    for v in neighbours(E, u):
        total += gamma[u, v] * (H[v, u] - H[u, v])
    return total


def local_variation(E: set[Edge], gamma: dict[Edge, float], f: Function, u: Vertex) -> float:
    """|grad_w f(u)| (eq. 9)."""
    total = 0.0
    for v in neighbours(E, u):
        total += difference(gamma, f, u, v) ** 2
    return math.sqrt(total)


def smoothed_norm(E: set[Edge], gamma: dict[Edge, float], f: Function, u: Vertex, eps: float) -> float:
    """|grad_w f(u)|_eps (eq. 15)."""
    return math.sqrt(local_variation(E, gamma, f, u) ** 2 + eps**2)


def multidimensional_norm(
    E: set[Edge], gamma: dict[Edge, float], fs: list[Function], u: Vertex, eps: float = 0.0
) -> float:
    """The gradient norm that m channels share (section 5.1), smoothed as in eq. 15."""
    total = 0.0
    for f in fs:
        total += local_variation(E, gamma, f, u) ** 2
    return math.sqrt(total + eps**2)


def norms(
    V: Iterable[Vertex], E: set[Edge], gamma: dict[Edge, float], fs: list[Function], eps: float, coupled: bool
) -> list[Function]:
    """For each channel the function |grad_w f|_eps; the same one for all channels if they are coupled."""
    if coupled:
        shared = {u: multidimensional_norm(E, gamma, fs, u, eps) for u in V}
        return [shared for _ in fs]
    return [{u: smoothed_norm(E, gamma, f, u, eps) for u in V} for f in fs]


def edge_norms(
    E: set[Edge], gamma: dict[Edge, float], fs: list[Function], eps: float, coupled: bool
) -> list[dict[Edge, float]]:
    """For each channel |d_w(f)(u, v)| of every edge, smoothed; the root of the sum of squares if coupled."""
    alone = [{(u, v): difference(gamma, f, u, v) ** 2 for (u, v) in E} for f in fs]
    if coupled:
        shared = {e: math.sqrt(sum(square[e] for square in alone) + eps**2) for e in E}
        return [shared for _ in fs]
    return [{e: math.sqrt(square[e] + eps**2) for e in E} for square in alone]


def lp_norm(E: set[Edge], norm: dict[Edge, float], u: Vertex, p: float) -> float:
    """|grad_w f(u)|_p, given the norms of the edges (eq. 10)."""
    total = 0.0
    for v in neighbours(E, u):
        total += norm[u, v] ** p
    return total ** (1 / p)


def edge_p_laplace(
    E: set[Edge], gamma: dict[Edge, float], f: Function, u: Vertex, p: float, norm: dict[Edge, float]
) -> float:
    """The derivative of eq. 30 at u, given the norms of the edges."""
    total = 0.0
    for v in neighbours(E, u):
        total += gamma[u, v] * norm[u, v] ** (p - 2) * (gamma[u, v] * f[u] - gamma[v, u] * f[v])
    return total


def edge_dirichlet_energy(E: set[Edge], gamma: dict[Edge, float], norm: dict[Edge, float], p: float) -> float:
    """Eq. 30, given the norms of the edges; an edge whose gamma is 0 both ways is none."""
    total = 0.0
    for u, v in E:
        if gamma[u, v] or gamma[v, u]:
            total += norm[u, v] ** p
    return total / (2 * p)


def p_laplace(E: set[Edge], gamma: dict[Edge, float], f: Function, u: Vertex, p: float, norm: Function) -> float:
    """Delta_w^p f(u), given the gradient norms (eq. 12)."""
    total = 0.0
    for v in neighbours(E, u):
        flow = gamma[u, v] * f[u] - gamma[v, u] * f[v]
        total += gamma[u, v] * (norm[u] ** (p - 2) + norm[v] ** (p - 2)) * flow
    return total


def dirichlet_energy(V: Iterable[Vertex], norm: Function, p: float) -> float:
    """R_G^p(f), given the gradient norms (eq. 20)."""
    total = 0.0
    for u in V:
        total += norm[u] ** p
    return total / p


def energy(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    fs: list[Function],
    f0s: list[Function],
    lam: Function,
    p: float,
    eps: float,
    coupled: bool,
    edge: bool = False,
) -> float:
    """What is minimised (eq. 19), with eq. 20 over the smoothed norms (eq. 15), or with eq. 30 if `edge`.

    Coupled channels have one term R, otherwise each has its own. lam is a function here; a pinned vertex (lam infinite)
    has f = f0 and adds nothing.
    """
    V = list(V)
    total = 0.0
    if edge:
        on_edges = edge_norms(E, gamma, fs, eps, coupled)
        for edge_norm in on_edges[:1] if coupled else on_edges:
            total += edge_dirichlet_energy(E, gamma, edge_norm, p)
    else:
        found = norms(V, E, gamma, fs, eps, coupled)
        for norm in found[:1] if coupled else found:
            total += dirichlet_energy(V, norm, p)
    for f, f0 in zip(fs, f0s, strict=True):
        for u in V:
            if not math.isinf(lam[u]):
                total += lam[u] / 2 * (f[u] - f0[u]) ** 2
    return total


def jacobi_step(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    fs: list[Function],
    f0s: list[Function],
    lam: Function,
    p: float,
    eps: float,
    coupled: bool,
    theta: float = 1.0,
    edge: bool = False,
) -> list[Function]:
    """One Gauss-Jacobi step (eq. 25; with gamma = sqrt(w), eq. 31); with the edge norm of eq. 30 if `edge`.

    What the paper leaves open: lam is a function; a pinned vertex (lam infinite) and one whose denominator is 0 (lam 0
    and no weight around it) keep f0; theta moves only that share of the way.
    """
    V = list(V)
    found = norms(V, E, gamma, fs, eps, coupled)
    on_edges = edge_norms(E, gamma, fs, eps, coupled)
    results = []
    for f, f0, norm, edge_norm in zip(fs, f0s, found, on_edges, strict=True):
        new = {}
        for u in V:
            if math.isinf(lam[u]):
                new[u] = f0[u]
                continue
            numerator, denominator = lam[u] * f0[u], lam[u]
            for v in neighbours(E, u):
                both = edge_norm[u, v] ** (p - 2) if edge else norm[v] ** (p - 2) + norm[u] ** (p - 2)
                alpha = gamma[u, v] ** 2 * both
                beta = gamma[u, v] * gamma[v, u] * both
                numerator += beta * f[v]
                denominator += alpha
            if denominator == 0:
                new[u] = f0[u]
            else:
                new[u] = f[u] + theta * (numerator / denominator - f[u])
        results.append(new)
    return results


def euler_step(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    fs: list[Function],
    f0s: list[Function],
    lam: Function,
    tau: Function,
    p: float,
    eps: float,
    coupled: bool,
    edge: bool = False,
) -> list[Function]:
    """One explicit Euler step (eq. 24); lam and tau are functions, a pinned vertex (lam infinite) keeps f0."""
    V = list(V)
    found = norms(V, E, gamma, fs, eps, coupled)
    on_edges = edge_norms(E, gamma, fs, eps, coupled)
    results = []
    for f, f0, norm, edge_norm in zip(fs, f0s, found, on_edges, strict=True):
        new = {}
        for u in V:
            if math.isinf(lam[u]):
                new[u] = f0[u]
                continue
            slope = edge_p_laplace(E, gamma, f, u, p, edge_norm) if edge else p_laplace(E, gamma, f, u, p, norm)
            new[u] = f[u] + tau[u] * (lam[u] * (f0[u] - f[u]) - slope)
        results.append(new)
    return results


# Pixels: vertices are tuples of coordinates (section 5.2)


def chebyshev(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """The largest difference of a coordinate."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def euclidean(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """The straight distance."""
    return math.sqrt(sum((x - y) ** 2 for x, y in zip(a, b, strict=True)))


def cityblock(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """The sum of the differences of all coordinates."""
    return sum(abs(x - y) for x, y in zip(a, b, strict=True))


METRICS: dict[str, Callable[[tuple[float, ...], tuple[float, ...]], float]] = {
    "chebyshev": chebyshev,
    "euclidean": euclidean,
    "cityblock": cityblock,
}


def pixels(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """All pixels, row by row."""
    return list(itertools.product(*(range(size) for size in shape)))


def k_neighbourhood(
    V: Iterable[tuple[int, ...]],
    u: tuple[int, ...],
    k: float,
    metric: str,
    spacing: tuple[float, ...] | None = None,
) -> set[tuple[int, ...]]:
    """N_k(u) (section 5.2): all other vertices at a distance of at most k, pixels being `spacing` apart."""

    def place(a: tuple[int, ...]) -> tuple[float, ...]:
        return tuple(float(x) for x in a) if spacing is None else tuple(x * s for x, s in zip(a, spacing, strict=True))

    # a distance of exactly k counts, whatever rounding does to 3 * 0.1 <= 0.3
    return {v for v in V if v != u and METRICS[metric](place(u), place(v)) <= k * (1 + 1e-12)}


def k_graph(V: Iterable[tuple[int, ...]], k: float, metric: str, spacing: tuple[float, ...] | None = None) -> set[Edge]:
    """The edges of G_k."""
    V = list(V)
    return {(u, v) for u in V for v in k_neighbourhood(V, u, k, metric, spacing)}


def reflect(i: int, size: int) -> int:
    """The pixel that stands in for i outside 0..size-1: mirrored at the edge pixel's centre, as often as it takes."""
    if size == 1:
        return 0
    while not 0 <= i < size:
        i = -i if i < 0 else 2 * (size - 1) - i
    return i


def w1(u: tuple[int, ...], v: tuple[int, ...], f0s: list[Function], sigma_space: float, sigma_value: float) -> float:
    """The weight of the bilateral filter (section 5.2)."""
    space = sum((a - b) ** 2 for a, b in zip(u, v, strict=True))
    value = sum((f0[u] - f0[v]) ** 2 for f0 in f0s)
    return math.exp(-space / sigma_space**2) * math.exp(-value / sigma_value**2)


def flat_patch(radius: int, ndim: int) -> dict[tuple[int, ...], float]:
    """g = 1 on the square patch."""
    return {j: 1.0 for j in itertools.product(range(-radius, radius + 1), repeat=ndim)}


def gaussian_patch(radius: int, ndim: int, a: float) -> dict[tuple[int, ...], float]:
    """g_a, a Gaussian of standard deviation a over the square patch, that sums to 1."""
    g = {j: math.exp(-sum(x * x for x in j) / (2 * a * a)) for j in flat_patch(radius, ndim)}
    total = sum(g.values())
    return {j: value / total for j, value in g.items()}


def rho(
    u: tuple[int, ...],
    v: tuple[int, ...],
    f0s: list[Function],
    shape: tuple[int, ...],
    g: dict[tuple[int, ...], float],
) -> float:
    """The distance of the patches around u and v (section 5.2); patches are filled by reflection at the border."""

    def at(f0: Function, pixel: tuple[int, ...], j: tuple[int, ...]) -> float:
        return f0[tuple(reflect(x + d, size) for x, d, size in zip(pixel, j, shape, strict=True))]

    total = 0.0
    for j, g_j in g.items():
        for f0 in f0s:
            total += g_j * (at(f0, u, j) - at(f0, v, j)) ** 2
    return total


def w2(
    u: tuple[int, ...],
    v: tuple[int, ...],
    f0s: list[Function],
    shape: tuple[int, ...],
    g: dict[tuple[int, ...], float],
    h: float,
) -> float:
    """The weight of nonlocal means (section 5.2)."""
    return math.exp(-rho(u, v, f0s, shape, g) / h**2)
