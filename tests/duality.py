"""What certified solvers ask of a device, as literal loops: vectors, residuals, and the dual problem by bisection.

As in ``paper.py``: E is a set of directed edges, gamma a dictionary over E, a function f one over V, a function H on
the edges one over E, and m channels are a list of m of these. No derivative of phi is inverted in closed form here: the
prox and the conjugate are found by halving an interval, which knows no case of p or eps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from paper import Edge, Function, Vertex, adjoint, difference, edge_p_laplace, neighbours, p_laplace

EdgeFunction = dict[Edge, float]

# of an interval whose width is that of the number sought or a few times that: 2^-64 of it is left
HALVINGS = 64


def phi(t: float, p: float, eps: float) -> float:
    """What the energy sums, as a function of a norm (eq. 15 and 20)."""
    return (t**2 + eps**2) ** (p / 2) / p


def slope(t: float, p: float, eps: float) -> float:
    """phi'(t), 0 at 0, where the subgradient of p = 1 without eps is all of 0..1."""
    return t * (t**2 + eps**2) ** ((p - 2) / 2) if t > 0 else 0.0


def root(rising: Callable[[float], float], above: float) -> float:
    """The zero of a rising function in 0..above; 0 if it is positive right from there."""
    low, high = 0.0, above
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if rising(middle) < 0 else (low, middle)
    return (low + high) / 2


def shrunk(r: float, sigma: float, share: float, p: float, eps: float) -> float:
    """The length of what minimises |x - z|^2/2 + sigma (share phi)*(|x|), for |z| = r.

    With t = (share phi)*'(|x|), hence |x| = share phi'(t), that is |x| + sigma t = r.
    """
    t = root(lambda t: sigma * t + share * slope(t, p, eps) - r, r / sigma)
    return r - sigma * t


def conjugate(s: float, share: float, p: float, eps: float) -> float:
    """(share phi)*(s), the supremum of s t - share phi(t) over t >= 0."""
    if p == 1 and s >= share:
        return 0.0 if s == share else math.inf
    above = 1.0
    while share * slope(above, p, eps) < s:
        above *= 2
    t = root(lambda t: share * slope(t, p, eps) - s, above)
    return s * t - share * phi(t, p, eps)


def lengths(V: Iterable[Vertex], E: set[Edge], H: list[EdgeFunction], coupled: bool, edge: bool) -> list[dict]:
    """For each channel |H(u, .)| under u, or with `edge` |H(u, v)| under (u, v); one for all channels if coupled."""
    found = []
    for group in [H] if coupled else [[one] for one in H]:
        if edge:
            found.append({e: math.sqrt(sum(one[e] ** 2 for one in group)) for e in E})
        else:
            found.append(
                {u: math.sqrt(sum(one[u, v] ** 2 for one in group for v in neighbours(E, u))) for u in V},
            )
    return found * len(H) if coupled else found


def dot(V: Iterable[Vertex], xs: list[Function], ys: list[Function], over: list[Function]) -> float:
    """The sum of a(u) b(u) / over(u), without the terms where `over` is infinite."""
    total = 0.0
    for a, b, o in zip(xs, ys, over, strict=True):
        for u in V:
            if not math.isinf(o[u]):
                total += a[u] * b[u] / o[u]
    return total


def combine(
    V: Iterable[Vertex], a: float, xs: list[Function], b: float, ys: list[Function], over: list[Function]
) -> list[Function]:
    """A x + b y / over, without the second term where `over` is infinite."""
    V = list(V)
    return [
        {u: a * x[u] if math.isinf(o[u]) else a * x[u] + b * y[u] / o[u] for u in V}
        for x, y, o in zip(xs, ys, over, strict=True)
    ]


def gradient(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    fs: list[Function],
    f0s: list[Function] | None,
    lam: Function,
    p: float,
    norms: list[dict],
    edge: bool,
) -> list[Function]:
    """The derivative of the energy (eq. 19 with eq. 20 or 30), given the norms; None in the place of f0 is 0."""
    V = list(V)
    results = []
    for channel, (f, norm) in enumerate(zip(fs, norms, strict=True)):
        new = {}
        for u in V:
            if math.isinf(lam[u]):
                new[u] = 0.0
                continue
            laplace = (edge_p_laplace if edge else p_laplace)(E, gamma, f, u, p, norm)
            new[u] = lam[u] * (f[u] - (0.0 if f0s is None else f0s[channel][u])) + laplace
        results.append(new)
    return results


def extrapolated(
    E: set[Edge],
    gamma: dict[Edge, float],
    ys: list[EdgeFunction],
    befores: list[EdgeFunction],
    fs: list[Function],
    f_befores: list[Function],
    beta: float,
    sigma: float,
) -> list[EdgeFunction]:
    """Z, where a dual step starts: y and f beyond where they came from, and a way up the gradient."""
    results = []
    for y, before, f, f_before in zip(ys, befores, fs, f_befores, strict=True):
        beyond = {u: f[u] + beta * (f[u] - f_before[u]) for u in f}
        results.append({e: y[e] + beta * (y[e] - before[e]) + sigma * difference(gamma, beyond, *e) for e in E})
    return results


def prox(
    V: Iterable[Vertex],
    E: set[Edge],
    zs: list[EdgeFunction],
    sigma: float,
    p: float,
    eps: float,
    coupled: bool,
    edge: bool,
) -> list[EdgeFunction]:
    """What minimises |x - z|^2/2 + sigma sum phi*(|x(u, .)|), or with `edge` sum (phi/2)*(|x(u, v)|)."""
    share = 0.5 if edge else 1.0
    results = []
    for z, length in zip(zs, lengths(V, E, zs, coupled, edge), strict=True):
        new = {}
        for u, v in E:
            r = length[u, v] if edge else length[u]
            new[u, v] = z[u, v] * shrunk(r, sigma, share, p, eps) / r if r else 0.0
        results.append(new)
    return results


def primal(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    ys: list[EdgeFunction],
    f0s: list[Function],
    lam: Function,
) -> list[Function]:
    """F0 - d*y / lam, f0 where lam is infinite."""
    V = list(V)
    return [
        {u: f0[u] if math.isinf(lam[u]) else f0[u] - adjoint(E, gamma, y, u) / lam[u] for u in V}
        for y, f0 in zip(ys, f0s, strict=True)
    ]


def conjugates(
    V: Iterable[Vertex], E: set[Edge], ys: list[EdgeFunction], p: float, eps: float, coupled: bool, edge: bool
) -> float:
    """Sum of phi*(|y(u, .)|) over the vertices, or with `edge` of (phi/2)*(|y(u, v)|) over the edges."""
    found = lengths(V, E, ys, coupled, edge)
    share = 0.5 if edge else 1.0
    return sum(conjugate(s, share, p, eps) for length in (found[:1] if coupled else found) for s in length.values())


def dual_energy(
    V: Iterable[Vertex],
    E: set[Edge],
    gamma: dict[Edge, float],
    ys: list[EdgeFunction],
    f0s: list[Function],
    lam: Function,
    p: float,
    eps: float,
    coupled: bool,
    edge: bool,
) -> float:
    """What is maximised: no energy is below it. A pinned vertex adds only d*y f0.

    As in the energy, an edge whose gamma is 0 both ways is none.
    """
    V = list(V)
    there = {(u, v) for u, v in E if gamma[u, v] or gamma[v, u]}
    total = -conjugates(V, there, ys, p, eps, coupled, edge)
    for y, f0 in zip(ys, f0s, strict=True):
        for u in V:
            pull = adjoint(E, gamma, y, u)
            total += pull * f0[u]
            if not math.isinf(lam[u]):
                total -= pull**2 / (2 * lam[u])
    return total
