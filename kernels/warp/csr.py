"""The neighbours of a vertex in a stored (CSR) graph, under the same names as in grid.py:

  Graph                      the struct with the graph, the first argument of kernels
  Place                      the vector type of a vertex u; u[0], u[1] is its index in a function
  place(graph, row, x)       the vertex of this work item
  begin(graph, u), end(graph, u)   the range of its edges e
  neighbour(graph, u, e)     the vertex v at the other end
  exists(graph, v)           whether the vertex exists (always true here)
  edge(graph, u, e, v)       the edge for gamma.py: w(u, v), 1 in a graph without weights, or both values of gamma
  edge_at(u, e)              the three indices of the edge (u, v) in a function on the edges
  opposite_at(graph, v, e)   those of (v, u)

Functions on vertices are (rows, width) arrays of vectors, here with one row. Indices of a Warp array have 32 bits, so a
graph must have less than 2^31 directed edges.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from . import gamma, reals


@dataclass(frozen=True, eq=False)
class Access:
    """The names above, for one kind of graph."""

    real: Any
    Graph: Any
    Place: Any
    place: Any
    begin: Any
    end: Any
    neighbour: Any
    exists: Any
    edge: Any
    edge_at: Any
    opposite_at: Any
    Edge: Any
    directed: bool
    pack: Any = None  # for pack.py, on a grid: number of leading axes, and whether there are weights


@functools.cache
def struct(real):
    """Make the struct with the graph."""

    @wp.struct
    class Csr:
        indptr: wp.array(dtype=wp.int32)  # (n + 1,)
        indices: wp.array(dtype=wp.int32)  # (n_edges,)
        weights: wp.array(dtype=real)  # (n_edges,), one per directed edge: w or gamma; read if there are any
        mirror: wp.array(dtype=wp.int32)  # (n_edges,): the index of (v, u); read with gamma, and by adjoint

    return Csr


@functools.cache
def make(real, form):
    """Make the names above for edges of one `form`: "unit" (weights of 1), "weights" or "gamma"."""
    Graph, Place = struct(real), wp.vec2i
    Edge = gamma.edge(real, form == "gamma")
    number_at, index_at = reals.reading(real, 1), reals.reading(wp.int32, 1)

    @wp.func
    def place(graph: Graph, row: int, x: int) -> Place:
        return Place(row, x)

    @wp.func
    def begin(graph: Graph, u: Place) -> int:
        return index_at(graph.indptr, u[1])

    @wp.func
    def end(graph: Graph, u: Place) -> int:
        return index_at(graph.indptr, u[1] + 1)

    @wp.func
    def neighbour(graph: Graph, u: Place, e: int) -> Place:
        return Place(0, index_at(graph.indices, e))

    @wp.func
    def exists(graph: Graph, v: Place) -> bool:
        return True

    if form == "gamma":

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> Edge:
            return Edge(number_at(graph.weights, e), number_at(graph.weights, index_at(graph.mirror, e)))

    elif form == "weights":

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            return number_at(graph.weights, e)

    else:

        @wp.func
        def edge(graph: Graph, u: Place, e: int, v: Place) -> real:
            return real(1.0)

    @wp.func
    def edge_at(u: Place, e: int) -> wp.vec3i:
        return wp.vec3i(0, 0, e)

    @wp.func
    def opposite_at(graph: Graph, v: Place, e: int) -> wp.vec3i:
        return wp.vec3i(0, 0, index_at(graph.mirror, e))

    return Access(
        real, Graph, Place, place, begin, end, neighbour, exists, edge, edge_at, opposite_at, Edge, form == "gamma"
    )
