"""Section 5.2 of the paper as literal loops: influence zones, and the plateaus that are their sources.

As in ``paper.py``: a graph is a set of vertices V and a set of directed edges E, a function a dictionary over V.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from paper import Edge, Function, Vertex, neighbours


def pseudo_metric(E: set[Edge], f: list[Function], s: Vertex, V: Iterable[Vertex]) -> dict[Vertex, tuple[float, int]]:
    """mu(s, u) (section 5.2), and the fewest edges of a path that has it, for all u that s has a path to.

    Exact for functions of small integers and one channel, whose sums are.
    """
    best: dict[Vertex, tuple[float, int]] = {s: (0.0, 0)}
    for _ in list(V):  # a best path visits no vertex twice
        for u, v in E:
            if u in best:
                step = math.sqrt(sum((c[v] - c[u]) ** 2 for c in f))
                offer = (best[u][0] + step, best[u][1] + 1)
                if v not in best or offer < best[v]:
                    best[v] = offer
    return best


def influence_zones(
    V: Iterable[Vertex], E: set[Edge], f: list[Function], sources: dict[int, list[Vertex]]
) -> dict[Vertex, tuple[float, int, int]]:
    """mu_S(u), the edges of its path and the number i of its source, Z_mu(s_i, S, V) (section 5.2), where there is one.

    Of sources at the same mu the one with the fewest edges to it, then the smallest i.
    """
    zones: dict[Vertex, tuple[float, int, int]] = {}
    for i, members in sources.items():
        for s in members:
            for u, (mu, edges) in pseudo_metric(E, f, s, V).items():
                if u not in zones or (mu, edges, i) < zones[u]:
                    zones[u] = (mu, edges, i)
    return zones


def regional_extrema(V: Iterable[Vertex], E: set[Edge], f: Function) -> tuple[list[set[Vertex]], list[set[Vertex]]]:
    """Plateaus without a neighbour below, and those without one above."""
    minima, maxima = [], []
    left = set(V)
    while left:
        plateau, edge = set(), [left.pop()]
        while edge:
            u = edge.pop()
            plateau.add(u)
            edge += [v for v in neighbours(E, u) if f[v] == f[u] and v not in plateau]
        left -= plateau
        around = [f[v] - f[u] for u in plateau for v in neighbours(E, u)]
        if all(d >= 0 for d in around):
            minima.append(plateau)
        if all(d <= 0 for d in around):
            maxima.append(plateau)
    return minima, maxima
