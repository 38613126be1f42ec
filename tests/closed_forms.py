"""Minimisers that are known in closed form: what a certificate has to stand up to.

The energy is 1/p sum |grad f|^p + lam/2 |f - f0|^2 with gamma = sqrt(w); "edge" is eq. 30. A row is a problem and its
minimiser; only one number of it is looked for, by brentq where p asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.fft import dctn, idctn
from scipy.optimize import brentq

import gpureg as gr
from gpureg.arrays import FloatArray

P = (1.0, 1.2, 1.5, 2.0, 3.0, 6.0)


@dataclass(frozen=True)
class Known:
    """A problem and its minimiser."""

    name: str
    graph: gr.Graph | gr.GridGraph
    f0: FloatArray
    lam: float
    p: float
    best: FloatArray
    extra: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.name}, p = {self.p:g}"

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of `regularize` besides data and graph."""
        return {"lam": self.lam, "p": self.p, **self.extra}


def root(pull: Callable[[float], float], push: Callable[[float], float], size: float) -> float:
    """The d in 0..size at which a falling pull meets a rising push; 0 where the push is ahead from the beginning."""
    if pull(0.0) <= push(1e-300):
        return 0.0
    return float(brentq(lambda d: push(max(d, 1e-300)) - pull(d), 0.0, size, xtol=1e-16, rtol=1e-15))


def edge(p: float, norm: str = "vertex", w: float = 0.7, lam: float = 3.0, d0: float = 2.0) -> Known:
    """K2: c w^(p/2) d^(p - 1) = lam/2 (d0 - d), c = 2 ends with the vertex norm, 1 with the edge norm."""
    c = 2.0 if norm == "vertex" else 1.0
    d = root(lambda d: lam / 2 * (d0 - d), lambda d: c * w ** (p / 2) * d ** (p - 1), d0)
    graph = gr.Graph.from_edges([[0, 1]], [w])
    best = d0 / 2 + np.array([-d / 2, d / 2])
    return Known(f"one edge, {norm} norm", graph, np.array([0.0, d0]), lam, p, best, {"norm": norm})


def star(p: float, n: int = 5, w: float = 0.8, lam: float = 9.0, d0: float = 2.0) -> Known:
    """The n leaves equal: (n^(p/2) + n) w^(p/2) d^(p - 1) = lam n/(n + 1) (d0 - d)."""
    d = root(lambda d: lam * n / (n + 1) * (d0 - d), lambda d: (n ** (p / 2) + n) * w ** (p / 2) * d ** (p - 1), d0)
    graph = gr.Graph.from_edges([[0, k] for k in range(1, n + 1)], np.full(n, w))
    mean = d0 / (n + 1)
    best = np.array([mean + d * n / (n + 1), *[mean - d / (n + 1)] * n])
    return Known("star", graph, np.array([d0, *[0.0] * n]), lam, p, best)


def complete(p: float, k: int = 2, n: int = 7, w: float = 0.5, lam: float = 11.0, d0: float = 2.0) -> Known:
    """K_n, k vertices at d0 and the others at 0: the slopes of either kind are sqrt(w (n - k)) d and sqrt(w k) d."""

    def push(d: float) -> float:
        return (k * (w * (n - k)) ** (p / 2) + (n - k) * (w * k) ** (p / 2)) * d ** (p - 1)

    d = root(lambda d: lam * k * (n - k) / n * (d0 - d), push, d0)
    u, v = np.triu_indices(n, 1)
    graph = gr.Graph.from_edges(np.stack([u, v], axis=1), np.full(len(u), w))
    mean = k * d0 / n
    best = np.where(np.arange(n) < k, mean + d * (n - k) / n, mean - d * k / n)
    return Known("complete graph", graph, np.where(np.arange(n) < k, d0, 0.0), lam, p, best)


def solid(name: str, p: float, lam: float, rho0: float = 3.0) -> Known:
    """L f0 = mu f0 and |grad f0| the same everywhere: f0 scaled, lam (rho0 - rho) = (2 mu)^(p/2) rho^(p - 1)."""
    if name == "polygon":
        angle = 2 * np.pi * np.arange(12) / 12
        points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        mu, edges = 4 * math.sin(math.pi / 12) ** 2, [[k, (k + 1) % 12] for k in range(12)]
    else:
        points = _solids()[name]
        points = points / np.linalg.norm(points[0])
        distance = np.linalg.norm(points[:, None] - points, axis=-1)
        shortest = distance[distance > 1e-9].min()
        edges = np.argwhere(np.triu(np.abs(distance - shortest) < 1e-9)).tolist()
        mu = {"tetrahedron": 4, "cube": 2, "octahedron": 4, "icosahedron": 5 - 5**0.5, "dodecahedron": 3 - 5**0.5}[name]
    rho = root(lambda r: lam * (rho0 - r), lambda r: (2 * mu) ** (p / 2) * r ** (p - 1), rho0)
    return Known(name, gr.Graph.from_edges(edges), rho0 * points, lam, p, rho * points)


def _solids() -> dict[str, FloatArray]:
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], float)
    golden = (1 + 5**0.5) / 2
    flat = np.array([[0, a, b * golden] for a in (-1, 1) for b in (-1, 1)])
    steep = np.array([[0, a / golden, b * golden] for a in (-1, 1) for b in (-1, 1)])
    return {
        "tetrahedron": signs[signs.prod(axis=1) > 0],
        "cube": signs,
        "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
        "icosahedron": np.concatenate([np.roll(flat, k, axis=1) for k in range(3)]),
        "dodecahedron": np.concatenate([signs, *(np.roll(steep, k, axis=1) for k in range(3))]),
    }


def cosines(lam: float = 0.2, shape: tuple[int, int] = (9, 14)) -> Known:
    """p = 2 on G_0: DCT-II."""
    f0 = np.random.default_rng(3).random(shape)
    waves = [2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in shape]
    best = idctn(dctn(f0) * lam / (lam + 2 * (waves[0][:, None] + waves[1])))
    # as a stored graph, which knows nothing of cosines
    graph = gr.GridGraph(shape, 1, "cityblock").to_graph()
    return Known("cosines", graph, f0.ravel(), lam, 2.0, best.ravel())


def plateaus(n1: int = 13, n2: int = 7, lam: float = 0.6) -> Known:
    """1-D total variation (eq. 30, p = 1): each plateau moves by 1/(lam n_i)."""
    f0 = np.repeat([0.0, 2.0], [n1, n2])
    best = np.repeat([1 / (lam * n1), 2 - 1 / (lam * n2)], [n1, n2])
    return Known("plateaus", gr.GridGraph(n1 + n2), f0, lam, 1.0, best, {"norm": "edge"})


def met(lam: float = 0.05) -> Known:
    """Little data: a constant, the mean, where p = 1 and lam is below what holds the plateaus apart."""
    f0 = np.repeat([0.0, 2.0], [13, 7])
    return Known("plateaus that meet", gr.GridGraph(20), f0, lam, 1.0, np.full(20, 0.7), {"norm": "edge"})


def every() -> Iterator[Known]:
    """All of them."""
    for p in P:
        yield edge(p)
        yield edge(p, "edge")
        yield star(p)
        yield complete(p)
        yield solid("polygon", p, 1.7)
        yield solid("icosahedron", p, 6.0)
    for name in ("tetrahedron", "cube", "octahedron", "dodecahedron"):
        yield solid(name, 1.0, 2.5)
        yield solid(name, 3.0, 2.5)
    yield cosines()
    yield plateaus()
    yield met()


def taut_string(y: FloatArray, half_width: float) -> FloatArray:
    """What minimises |x - y|^2/2 + half_width sum |x(k + 1) - x(k)|: the slopes of the shortest way through a tube.

    By its definition, knot by knot: from the last knot the furthest point that a straight line reaches inside the tube
    around the sums of y, whose ends are fixed. O(n^2), and short.
    """
    n = len(y)
    middle = np.concatenate([[0.0], np.cumsum(y)])
    low, high = middle - half_width, middle + half_width
    low[[0, -1]] = high[[0, -1]] = middle[[0, -1]]
    x, at, height = np.empty(n), 0, 0.0
    while at < n:
        least, most, low_at, high_at = -np.inf, np.inf, at, at
        knot, slope = n, 0.0
        for k in range(at + 1, n + 1):
            below, above = (low[k] - height) / (k - at), (high[k] - height) / (k - at)
            if below > most:  # the tube has turned up: the string bends around its upper edge
                knot, slope = high_at, most
                break
            if above < least:
                knot, slope = low_at, least
                break
            if below >= least:
                least, low_at = below, k
            if above <= most:
                most, high_at = above, k
        else:
            slope = least  # both bounds meet at the fixed end
        x[at:knot] = slope
        height, at = height + slope * (knot - at), knot
    return x
