"""A weighted graph on the host: its edges with both values of gamma, and the difference operator as a sparse matrix."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import FloatArray, IntArray
from ..backends import Array
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from .on_device import DeviceProblem

if TYPE_CHECKING:
    import numpy.typing as npt
    from scipy.sparse import csc_array, csr_array


@dataclass(frozen=True)
class Edges:
    """Each edge (u, v) once, with u < v.

    Attributes
    ----------
    u, v : (E,) int array
        Its ends.
    there, back : (E,) float array
        gamma(u, v) and gamma(v, u), in the caller's variable f.
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


def undirected_edges(problem: DeviceProblem, wanted: npt.NDArray[np.bool_] | None = None) -> Edges:
    """Return the edges of a problem; with `wanted`, (n,), only those with at least one end wanted."""
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
    if problem.scale is not None:
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


@dataclass(frozen=True)
class Difference:
    """d_w (eq. 4) as a matrix.

    Attributes
    ----------
    matrix : (D, n) sparse array
        One row per directed edge whose gamma is not 0.
    adjoint : (n, D) sparse array
        Its transpose.
    start : (D,) int array
        The vertex at which each edge starts.
    place : (D,) int array
        Its position in a host function on the directed edges.
    edges : Edges
        The undirected edges: row k is (u, v) of edge k, row E + k its opposite.
    """

    matrix: csr_array
    adjoint: csc_array
    start: IntArray
    place: IntArray
    edges: Edges

    @classmethod
    def of(cls, problem: DeviceProblem) -> Difference:
        """Make the difference of a problem, for functions in the caller's variable f."""
        from scipy.sparse import csr_array

        e = undirected_edges(problem)
        e = e[(e.there > 0) | (e.back > 0)]
        start, end = np.concatenate([e.u, e.v]), np.concatenate([e.v, e.u])
        own, other = np.concatenate([e.there, e.back]), np.concatenate([e.back, e.there])
        # each row has two entries: no sorting needed
        values, columns = np.stack([other, -own], axis=1).ravel(), np.stack([end, start], axis=1).ravel()
        shape = (len(start), problem.weighted.graph.n_vertices)
        matrix = csr_array((values, columns, np.arange(0, len(columns) + 1, 2)), shape=shape)
        return cls(matrix, matrix.T, start, np.concatenate([e.place, e.place_back]), e)

    def laplacian(self, c: FloatArray, diagonal: FloatArray) -> csr_array:
        """Compute the matrix d* c d plus a diagonal, (n,), for a conductance c of each directed edge, (D,)."""
        from scipy.sparse import csr_array

        e, n = self.edges, self.matrix.shape[1]
        both = c[: len(e.u)] + c[len(e.u) :]
        own = np.bincount(e.u, e.there**2 * both, minlength=n) + np.bincount(e.v, e.back**2 * both, minlength=n)
        across = -e.there * e.back * both
        order, indices, indptr = self._pattern
        return csr_array((np.concatenate([own + diagonal, across, across])[order], indices, indptr), shape=(n, n))

    @functools.cached_property
    def _pattern(self) -> tuple[IntArray, IntArray, IntArray]:
        """The order, indices and indptr of a Laplacian's entries: vertices, then edges, then opposite edges."""
        from scipy.sparse import coo_array

        e, n = self.edges, self.matrix.shape[1]
        vertices, numbers = np.arange(n), np.arange(n + 2 * len(e.u))
        rows, columns = np.concatenate([vertices, e.u, e.v]), np.concatenate([vertices, e.v, e.u])
        pattern = coo_array((numbers, (rows, columns)), shape=(n, n)).tocsr()
        return pattern.data, pattern.indices, pattern.indptr

    def on_device(self, problem: DeviceProblem, y: FloatArray) -> Array:
        """Put a function on these edges, (D, m), on the device; it is 0 on all other edges."""
        graph = problem.weighted.graph
        shape = (len(graph.offsets), *graph.shape) if isinstance(graph, GridGraph) else (graph.n_edges,)
        values = np.zeros((math.prod(shape), y.shape[1]))
        values[self.place] = y
        return problem.backend.put_edges(graph, values.reshape(*shape, y.shape[1]))
