"""Bounds on a minimiser, which a certificate needs where lam is 0, and constants for components without data.

A box [low, high] per vertex and channel that holds a minimiser bounds the energy from below for every y on the edges
(`docs/mathematics.md`, section 2a). There are two:

- gamma symmetric: the range of the data in the component of the graph, per channel. The projection on it raises no
  |f(v) - f(u)|, and not the fidelity, as the data lie in it. With gamma = sqrt(w) s(u) the same holds for s f, which is
  the device's variable. The values of f0 where lam is 0 do not count.
- any other gamma: constants have a gradient, so that a minimiser can leave the range of the data. It lies where no edge
  alone has more energy than any one function.

A component without data has no unique minimiser: with a symmetric gamma any constant minimises, otherwise 0 does.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..backends import Array, Box
from ..doors import outside
from ..graphs.components import Components
from ..graphs.grid import GridGraph
from ..model.matrices import Edges, undirected_edges
from ..model.on_device import DeviceProblem, put_lam

# Rounds in which bounds pass along all edges, after those along a tree of shortest paths.
_ROUNDS = 8
# Relative rounding of an energy and of sums along a path, generously.
_SLACK = 1e-3
# Channels whose constants a sentence lists.
_LISTED = 4


@dataclass(frozen=True)
class _Parts:
    """The components of a problem, and which of them have data.

    Attributes
    ----------
    components : Components
    data : (n,) bool array
        Whether lam > 0 at a vertex.
    lone : (n,) bool array
        Whether the component of a vertex has no data.
    """

    components: Components
    data: npt.NDArray[np.bool_]
    lone: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, problem: DeviceProblem, edges: Edges) -> _Parts:
        n = problem.weighted.graph.n_vertices
        joined = (edges.there > 0) & (edges.back > 0)
        data = np.broadcast_to(problem.problem.lam > 0, (n, 1))[:, 0]
        components = Components.of_edges(n, edges.u[joined], edges.v[joined])
        return cls(components, data, components.without(data))


def with_box(problem: DeviceProblem) -> DeviceProblem:
    """Return the problem with a box if it is needed, and with components without data pinned to a constant.

    There f0 is the constant and lam is infinite. At other vertices with lam = 0, f0 becomes its nearest value in the
    box. The energy is the same. A RuntimeWarning names the constants.
    """
    lam = problem.problem.lam
    if np.min(lam, initial=np.inf) > 0:
        return problem
    edges = undirected_edges(problem)
    parts = _Parts.of(problem, edges)
    backend, graph = problem.backend, problem.weighted.graph
    f0 = backend.get(graph, problem.f0)
    symmetric = isinstance(problem.problem.gamma, str) or bool((edges.there == edges.back).all())
    constant = _middle(problem, f0, parts.data) if symmetric else np.zeros(problem.channels, f0.dtype)
    f0[parts.lone] = constant
    known = parts.data | parts.lone
    low, high = _data_box(parts.components, f0, known) if symmetric else _energy_box(problem, edges, parts, f0)
    low, high = np.where(parts.lone[:, None], constant, low), np.where(parts.lone[:, None], constant, high)
    f0 = np.where(known[:, None], f0, np.clip(f0, low, high))
    host = np.where(parts.data[:, None], problem.problem.f0, f0 if problem.scale is None else f0 / problem.scale)
    data, own = problem.problem.data, problem.problem
    if data is not None:
        data = np.where(parts.lone[:, None], own.frame.back(host, data.dtype), data)
    fidelity = np.where(parts.lone[:, None], np.inf, np.broadcast_to(lam, (len(f0), 1)))
    own = replace(own, f0=host.astype(own.f0.dtype), lam=fidelity, data=data)
    said = _said(problem, parts, constant, symmetric)
    if said:
        warnings.warn(said, RuntimeWarning, stacklevel=outside())
    return replace(
        problem,
        problem=own,
        f0=backend.put(graph, f0),
        lam=put_lam(own, backend, problem.scale),
        box=None if known.all() else Box(backend.put(graph, low), backend.put(graph, high)),
        without_data=said,
    )


def inside(problem: DeviceProblem, f: Array) -> tuple[Array, bool]:
    """Return a start in the box, (n, m), and whether it is one of the caller's own, another function than f0.

    It is `f`, clipped, and the data where lam is infinite. Instead of f0 it is f0 with the middle of the box where lam
    is 0, so that f0 does not matter there.
    """
    backend, graph, lam = problem.backend, problem.weighted.graph, problem.problem.lam
    if problem.box is None and not np.isinf(lam).any():
        return f, backend.max_change(graph, f, problem.f0) > 0
    host, f0 = backend.get(graph, f), backend.get(graph, problem.f0)
    if problem.box is None:
        start = middle = np.where(np.isinf(lam), f0, host)
    else:
        low, high = backend.get(graph, problem.box.low), backend.get(graph, problem.box.high)
        start = np.where(np.isinf(lam), f0, np.clip(host, low, high))
        middle = np.where(lam == 0, low / 2 + high / 2, f0)
    own = not np.array_equal(start, f0)
    return backend.put(graph, start if own else middle), own


def _middle(problem: DeviceProblem, f0: FloatArray, data: npt.NDArray[np.bool_]) -> FloatArray:
    """Return the middle of the range of the data, per channel (m,); without any, 0 in the data's units."""
    graph, frame = problem.weighted.graph, problem.problem.frame
    if isinstance(graph, GridGraph) and graph.mask is not None:
        data = data & graph.mask.ravel()
    if not data.any():
        zero: FloatArray = frame.into(np.zeros((1, problem.channels)), f0.dtype)[0]
        return zero
    middle: FloatArray = f0[data].min(axis=0) / 2 + f0[data].max(axis=0) / 2
    return middle


def _data_box(components: Components, f0: FloatArray, known: npt.NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest value of f0, (n, m), over the known vertices of each component, (n, m)."""
    labels, values = components.labels[known], f0[known]
    order = np.argsort(labels, kind="stable")
    start = np.searchsorted(labels[order], np.arange(components.count))
    ordered = values[order]
    return (
        np.minimum.reduceat(ordered, start, axis=0)[components.labels],
        np.maximum.reduceat(ordered, start, axis=0)[components.labels],
    )


def _energy_box(problem: DeviceProblem, edges: Edges, parts: _Parts, f0: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound a minimiser where gamma is not symmetric, from the energy E of some function; low and high, (n, m).

    At data |f - f0| <= sqrt(2 E / lam). Along an edge |gamma_vu f(v) - gamma_uv f(u)| <= T, so that

        |f(v)| <= (T + gamma_uv |f(u)|) / gamma_vu,    T = (p E)^(1/p),  (p E / 2)^(1/p) with the vertex norm
    """
    n, lam = len(f0), np.broadcast_to(problem.problem.lam, (len(f0), 1))
    energy = _some_energy(problem, parts, f0)
    T = (problem.p * energy * (1.0 if problem.edge_norm else 0.5)) ** (1 / problem.p)
    with np.errstate(divide="ignore"):
        reach = np.where(parts.data[:, None], np.sqrt(2 * energy / lam), np.inf)
    most = np.where(parts.data[:, None], np.abs(f0.astype(np.float64)) + reach, np.inf)
    most[parts.lone] = 0
    # (start, end) of each directed edge: the bound at the end is offset + factor * that at the start
    start, end = np.concatenate([edges.u, edges.v]), np.concatenate([edges.v, edges.u])
    before, after = np.concatenate([edges.there, edges.back]), np.concatenate([edges.back, edges.there])
    single = (before == 0) & (after > 0)
    np.minimum.at(most, end[single], (T / after[single])[:, None])
    both = (before > 0) & (after > 0)
    start, end, factor, offset = start[both], end[both], (before / np.where(after > 0, after, 1))[both], T / after[both]
    if np.isinf(most).any() and len(start):
        most = np.minimum(most, _along_tree(n, start, end, factor, offset, most))
    for _ in range(_ROUNDS):
        np.minimum.at(most, end, offset[:, None] + factor[:, None] * most[start])
    most = most * (1 + _SLACK)
    return np.maximum(-most, f0 - reach).astype(f0.dtype), np.minimum(most, f0 + reach).astype(f0.dtype)


def _some_energy(problem: DeviceProblem, parts: _Parts, f0: FloatArray) -> float:
    """Return the smallest energy of a few functions that are f0 at data, with its rounding."""
    backend, graph = problem.backend, problem.weighted.graph
    fillings = [np.zeros(f0.shape[1]), _middle(problem, f0, parts.data)]
    at = [np.where(parts.data[:, None], f0, filling).astype(f0.dtype) for filling in fillings]
    return min(problem.energy(backend.put(graph, f)) for f in at) * (1 + _SLACK)


def _along_tree(
    n: int, start: IntArray, end: IntArray, factor: FloatArray, offset: FloatArray, most: FloatArray
) -> FloatArray:
    """Pass bounds, (n, m), from where they are finite along a tree of shortest paths; infinite where it has no path.

    The maps x -> offset + factor x of the edges of a path are joined by doubling.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    sources = np.flatnonzero(np.isfinite(most).all(axis=1))
    lengths = np.maximum(offset, np.finfo(np.float64).tiny)
    first = np.maximum(most[sources].mean(axis=1), np.finfo(np.float64).tiny)
    # one more vertex, from which all sources are as far as their bound
    rows, columns = np.concatenate([start, np.full(len(sources), n)]), np.concatenate([end, sources])
    A = csr_array((np.concatenate([lengths, first]), (rows, columns)), shape=(n + 1, n + 1))
    _, before = dijkstra(A, indices=np.array(n), return_predecessors=True)
    parent = before[:n].astype(np.int64)
    inside = (parent >= 0) & (parent < n)
    own = np.arange(n)
    number = start.astype(np.int64) * n + end
    order = np.argsort(number)
    at = order[np.searchsorted(number[order], parent[inside] * n + own[inside])]
    a, b = np.zeros(n), np.ones(n)
    a[inside], b[inside] = offset[at], factor[at]
    up = np.where(inside, parent, own)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(max(1, math.ceil(math.log2(max(n, 2))))):
            if (up[up] == up).all():
                break
            a, b, up = a + b * a[up], b * b[up], up[up]
        found = a[:, None] + b[:, None] * most[up]
    reached: FloatArray = np.where(np.isfinite(found), found, np.inf)
    return reached


def _said(problem: DeviceProblem, parts: _Parts, constant: FloatArray, symmetric: bool) -> str:
    """Say which vertices have no data and what they are set to; empty if there are none."""
    graph, frame = problem.weighted.graph, problem.problem.frame
    lone = parts.lone
    if isinstance(graph, GridGraph) and graph.mask is not None:
        lone = lone & graph.mask.ravel()
    count = int(lone.sum())
    if not count:
        return ""
    where = len(np.unique(parts.components.labels[lone]))
    who = f"{count} {'vertex' if count == 1 else 'vertices'} in {where} component{'s'[: where > 1]} without data"
    if not symmetric:
        return f"{who} set to 0, which has the least energy there"
    scale = problem.scale
    uniform = scale is None or problem.problem.gamma == "combinatorial"
    if scale is not None and uniform:
        constant = constant / scale[0]
    values = [f"{x:.6g}" for x in frame.back(constant[None].astype(np.float64), np.dtype(np.float64))[0, :_LISTED]]
    listed = ", ".join(values) + (", ..." if len(constant) > _LISTED else "")
    how = "" if uniform else " divided by s(u), where gamma(u, v) = sqrt(w) s(u)"
    why = "the middle of the data's range" if parts.data.any() else "as there are no data at all"
    return f"{who} set to the constant {listed}{how} ({why}): any constant has the least energy there"
