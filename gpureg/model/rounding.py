"""The rounding of energies and of their lower bounds: :class:`Rounding`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..backends import Array
from ..graphs.grid import GridGraph
from .matrices import undirected_edges
from .on_device import DeviceProblem


@dataclass(frozen=True)
class Rounding:
    """Bounds on the roundings between the energies of the given problem and those that a device computes.

    The terms of the energy are >= 0. Each has 8 roundings, with those of lam and of a weight, those of a sum over the
    edges of a vertex, and those of a power, at most 16 (``kernels/README.md``); the sum over the vertices is in float64
    or compensated. With a gamma divided by degrees these are sums over the edges too.

    A rounding d of the data moves the dual energy of y, a lower bound, by at most sum_u |d*y| |d|. Where lam is finite
    d*y is lam (f0 - f), so that this is at most sqrt(2 energy) times the root of sum_u lam |d|^2, plus half of it
    squared. Where f is pinned, it is at most

        sum over directed edges of |y(u, v)| (gamma_uv |d(u)| + gamma_vu |d(v)|) <= |y|_q a
        a^p = share sum_u (sum_v (gamma_uv |d(u)| + gamma_vu |d(v)|)^2)^(p/2)

    by Hoelder's inequality. Roundings of d*y where lam is 0, multiplied by the width of the box, and of a gamma that is
    given, multiplied by the values, are of the same form. |y|_q^q is at most q (energy + gap) / (1 - 2^(1-q)): the dual
    energy of y/2 is not above the minimum.

    Attributes
    ----------
    p : float
    terms : float
        The relative rounding of the terms.
    fidelity : float
        Root of sum_u lam |d|^2.
    slopes : float
        The number a above.
    """

    p: float
    terms: float
    fidelity: float = 0.0
    slopes: float = 0.0

    @classmethod
    def of(cls, problem: DeviceProblem, f: Array) -> Rounding:
        """Compute the bounds for a problem and a device function, (n, m)."""
        graph, own = problem.problem.graph, problem.problem
        unit = float(np.finfo(problem.backend.dtype).eps) / 2
        edges = len(graph.offsets) if isinstance(graph, GridGraph) else int(np.diff(graph.indptr).max(initial=0))
        # those of s(u): a sum over the edges, and its root
        scaled = 0 if problem.scale is None else 2 if own.gamma == "combinatorial" else edges / 2 + 4
        terms = 24 + own.p / 2 * (edges * problem.channels + 5) + 2 * scaled
        n = graph.n_vertices
        lam = np.broadcast_to(own.lam, (n, 1))[:, 0]
        lost = _lost(problem) if own.data is not None else np.zeros(n)
        if scaled:
            lost += scaled * unit * np.sqrt((own.f0.astype(np.float64) ** 2).sum(axis=1))
        finite = np.isfinite(lam)
        fidelity = math.sqrt(float((np.where(finite, lam, 0.0) * lost**2).sum()))
        moved = np.where(finite, 0.0, lost)
        if problem.scale is not None:
            moved *= problem.scale[:, 0]
        slopes = _slopes(problem, moved + _of_values(problem, f, lam, unit), edges)
        return cls(own.p, terms * unit, fidelity, slopes)

    def __call__(self, energy: float, gap: float) -> float:
        """Bound the roundings at an energy with this gap, in units of the frame."""
        bound = self.terms * energy + math.sqrt(2 * energy) * self.fidelity + self.fidelity**2 / 2
        if not self.slopes or self.p == 1:
            return bound + self.slopes
        q = self.p / (self.p - 1)
        return bound + self.slopes * float((q * (energy + gap) / (1 - 2 ** (1 - q))) ** (1 / q))


def _lost(problem: DeviceProblem) -> FloatArray:
    """Return the rounding of the data in the frame, |d| over the channels, (n,); 0 outside a mask."""
    own = problem.problem
    assert own.data is not None
    lost = (own.data - own.frame.back(own.f0, np.dtype(np.float64))) / own.frame.scale
    lengths: FloatArray = np.sqrt((lost**2).sum(axis=1))
    if isinstance(own.graph, GridGraph) and own.graph.mask is not None:
        lengths = np.where(own.graph.mask.ravel(), lengths, 0.0)
    return np.where(np.broadcast_to(own.lam > 0, (len(lengths), 1))[:, 0], lengths, 0.0)


def _of_values(problem: DeviceProblem, f: Array, lam: FloatArray, unit: float) -> FloatArray:
    """Return the roundings of d*y where lam is 0, and of a given gamma, as those of a value at each vertex, (n,)."""
    backend, graph = problem.backend, problem.weighted.graph
    gamma = problem.problem.gamma
    rounded = not isinstance(gamma, str) and bool((gamma.astype(backend.dtype) != gamma).any())
    values = np.zeros(len(lam))
    if problem.box is not None:
        low, high = (backend.get(graph, end).astype(np.float64) for end in (problem.box.low, problem.box.high))
        values = np.where(lam == 0, 2 * unit * np.sqrt(((high - low) ** 2).sum(axis=1)), 0.0)
    if rounded:
        largest = np.abs(backend.get(graph, f).astype(np.float64))
        if problem.box is not None:
            largest = np.where(lam[:, None] == 0, np.maximum(-low, high), largest)
        values += unit * np.sqrt((largest**2).sum(axis=1))
    return values


def _slopes(problem: DeviceProblem, values: FloatArray, edges: int) -> float:
    """Bound the number a of :class:`Rounding` for values |d|, (n,), at vertices with at most so many edges."""
    largest = float(values.max(initial=0))
    if not largest > 0:
        return 0.0
    backend, graph, p = problem.backend, problem.weighted.graph, problem.p
    square = (values / largest) ** 2
    if problem.weighted.directed:
        e, n = undirected_edges(problem), len(values)
        across = [e.there**2 * square[e.u] + e.back**2 * square[e.v]] * 2
        total = np.bincount(np.concatenate([e.u, e.v]), np.concatenate(across), minlength=n)
    else:
        # sum_v w (d(u)^2 + d(v)^2) from the degree and sum_v 2 w (d(u)^2 - d(v)^2)
        put = backend.put(graph, square[:, None])
        differences = backend.get(graph, backend.gradient(problem.weighted, put, None, None, 0.0)).astype(np.float64)
        degree = backend.get(graph, backend.degree(problem.weighted)).astype(np.float64)
        total = np.maximum(2 * degree * square[:, None] - differences / 2, 0)[:, 0]
    powers = (2 * total) ** (p / 2)
    if problem.edge_norm:
        powers *= max(edges, 1) ** max(1 - p / 2, 0) / 2
    return largest * float(powers.sum() ** (1 / p))
