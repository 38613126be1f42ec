"""A weighted graph on the host: its edges with both values of gamma."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray, IntArray
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from .on_device import DeviceProblem

if TYPE_CHECKING:
    import numpy.typing as npt


@dataclass(frozen=True)
class Edges:
    """Each edge (u, v) once, with u < v.

    Attributes
    ----------
    u, v : (E,) int array
        Its ends.
    there, back : (E,) float array
        gamma(u, v) and gamma(v, u), in the caller's variable f or in that of the device.
    place, place_back : (E,) int array
        Positions of (u, v) and (v, u) in a host function on the directed edges, flattened over all axes but the last.
    """

    u: IntArray
    v: IntArray
    there: FloatArray
    back: FloatArray
    place: IntArray
    place_back: IntArray

    def __getitem__(self, chosen: npt.NDArray[np.bool_]) -> Edges:
        return Edges(*(getattr(self, column.name)[chosen] for column in fields(self)))


def undirected_edges(
    problem: DeviceProblem, wanted: npt.NDArray[np.bool_] | None = None, *, scaled: bool = True
) -> Edges:
    """Return the edges of a problem; with `wanted`, (n,), only those with at least one end wanted.

    Unless `scaled`, gamma is that of the device's variable, without the factor s(u).
    """
    graph, given = problem.weighted.graph, problem.host_gamma()
    if given is not None and problem.weighted.directed:
        given = given[..., 0]
    edges = _stored(graph, wanted) if isinstance(graph, Graph) else _of_grid(graph, wanted)
    if given is None:
        there = back = np.ones(len(edges.u))
    else:
        values = given.reshape(-1).astype(np.float64)
        if problem.weighted.directed:
            there, back = values[edges.place], values[edges.place_back]
        else:
            first = 0 if isinstance(graph, Graph) else graph.half_window * graph.n_vertices  # only the forward half
            there = back = np.sqrt(values[edges.place - first])
    if scaled and problem.scale is not None:
        there, back = there * problem.scale[edges.u, 0], back * problem.scale[edges.v, 0]
    return replace(edges, there=there, back=back)


def _stored(graph: Graph, wanted: npt.NDArray[np.bool_] | None) -> Edges:
    rows = graph.edge_rows()
    forward = rows < graph.indices
    if wanted is not None:
        forward &= wanted[rows] | wanted[graph.indices]
    place = np.flatnonzero(forward)
    u, v = rows[forward], graph.indices[forward].astype(np.int64)
    numbers = rows * graph.n_vertices + graph.indices  # sorted, as the rows are
    none = np.empty(0)
    return Edges(u, v, none, none, place, np.searchsorted(numbers, v * graph.n_vertices + u))


def _of_grid(grid: GridGraph, wanted: npt.NDArray[np.bool_] | None) -> Edges:
    n, H = grid.n_vertices, grid.half_window
    vertices = np.arange(n).reshape(grid.shape)
    cells = None if wanted is None else wanted.reshape(grid.shape)
    found = [np.empty((4, 0), np.int64)]
    for plane, step in enumerate(grid.forward_offsets):
        start, end = grid.ends(step)
        u, v = vertices[start], vertices[end]
        near = np.ones(u.shape, bool) if cells is None else cells[start] | cells[end]
        u, v = u[near], v[near]
        found.append(np.stack([u, v, (H + plane) * n + u, (H - 1 - plane) * n + v]))
    u, v, place, place_back = np.concatenate(found, axis=1)
    none = np.empty(0)
    return Edges(u, v, none, none, place, place_back)
