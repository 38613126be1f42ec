"""Conversion of graphs from and to networkx."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..doors import door
from .csr import Graph
from .edges import SYMMETRIZE_MENDS, Symmetrize, check_symmetrize
from .grid import refuse_grid


def _networkx() -> Any:
    try:
        import networkx
    except ImportError as error:
        raise ImportError("networkx is not installed: pip install gpureg[networkx]") from error
    return networkx


@door
def from_networkx(g: Any, *, weight: str | None = "weight", symmetrize: Symmetrize | None = None) -> Graph:
    """Convert a networkx graph of any class; vertex i is ``list(g.nodes)[i]``.

    Parameters
    ----------
    g : networkx.Graph, DiGraph, MultiGraph or MultiDiGraph
        If all nodes have an attribute "pos", these become the positions.
    weight : str or None, default "weight"
        Edge attribute with the weights; an edge without it has weight 1. If no edge has it, or for None, the graph has
        no weights.
    symmetrize : {"max", "mean", "mutual"}, optional
        How directed and parallel edges are joined, as in :meth:`Graph.from_edges`; an edge of an undirected graph
        counts in both directions. With None, parallel edges are an error, and directed edges whose opposite is missing
        or has another weight.

    Raises
    ------
    ImportError
        networkx is not installed.
    TypeError
        Not a networkx graph, a weight that is not a real number.
    ValueError
        Self-loops, weights that are negative or not finite, positions of different lengths; directed and parallel
        edges without `symmetrize`.

    Examples
    --------
    >>> import networkx as nx
    >>> from_networkx(nx.path_graph(["a", "b", "c"]))
    Graph(3 vertices, 2 undirected edges, unweighted)
    >>> from_networkx(nx.DiGraph([("a", "b"), ("b", "c")]), symmetrize="max")
    Graph(3 vertices, 2 undirected edges, unweighted)
    """
    nx = _networkx()
    check_symmetrize(symmetrize)
    if not isinstance(g, nx.Graph):  # the base of all four classes
        raise TypeError(f"g must be a networkx graph, got {type(g).__name__}")
    number = {node: i for i, node in enumerate(g.nodes)}
    if not number:
        raise ValueError("a graph needs at least one vertex, this networkx graph has no nodes")
    ends, values, weighted = [], [], False
    for u, v, attributes in g.edges(data=True):
        if u == v:
            raise ValueError(
                f"self-loops are not allowed, node {u!r} has one: g.remove_edges_from(list(nx.selfloop_edges(g)))"
            )
        value = 1 if weight is None else attributes.get(weight, 1)
        if not isinstance(value, numbers.Real | np.bool_):
            raise TypeError(f"weights must be real numbers, {weight!r} of edge ({u!r}, {v!r}) is {value!r}")
        if not 0 <= float(value) < math.inf:
            raise ValueError(f"weights must be finite and >= 0, {weight!r} of edge ({u!r}, {v!r}) is {value!r}")
        weighted |= weight is not None and weight in attributes
        ends.append((u, v))
        values.append(float(value))
    if symmetrize is None:
        _refuse_unmatched(ends, values, g.is_directed())
    edges = np.array([(number[u], number[v]) for u, v in ends], np.int64).reshape(-1, 2)
    weights = np.array(values) if weighted else None
    if not g.is_directed() and symmetrize is not None:
        edges = np.concatenate([edges, edges[:, ::-1]])
        weights = None if weights is None else np.concatenate([weights, weights])
    # Directed edges that passed the check above are pairs of equal weight: "max" joins each pair.
    how = "max" if symmetrize is None and g.is_directed() else symmetrize
    return Graph.from_edges(edges, weights, n_vertices=len(number), positions=_node_positions(g.nodes), symmetrize=how)


def without_loops(g: Any) -> tuple[Any, int]:
    """Return a networkx graph without its self-loops (a copy if there are any), and their number."""
    nx = _networkx()
    loops = list(nx.selfloop_edges(g, keys=True) if g.is_multigraph() else nx.selfloop_edges(g))
    if loops:
        g = g.copy()
        g.remove_edges_from(loops)
    return g, len(loops)


def _refuse_unmatched(ends: list[tuple[Any, Any]], values: list[float], directed: bool) -> None:
    """Raise a ValueError for parallel edges, and for directed edges without an opposite of the same weight."""
    known: dict[tuple[Any, Any], float] = {}
    for (u, v), value in zip(ends, values, strict=True):
        if (u, v) in known or (not directed and (v, u) in known):
            raise ValueError(f"each edge may be given once, ({u!r}, {v!r}) is repeated: {SYMMETRIZE_MENDS}")
        known[u, v] = value
    if not directed:
        return
    for (u, v), value in known.items():
        if (v, u) not in known:
            raise ValueError(
                f"every edge must lead both ways: ({u!r}, {v!r}) is there but ({v!r}, {u!r}) is not: {SYMMETRIZE_MENDS}"
            )
        if value != known[v, u]:
            raise ValueError(
                f"weights must be the same in both directions, edge ({u!r}, {v!r}) has {value} one way and "
                f"{known[v, u]} the other: {SYMMETRIZE_MENDS}"
            )


def _node_positions(nodes: Mapping[Any, Mapping[str, Any]]) -> FloatArray | None:
    if not all("pos" in attributes for attributes in nodes.values()):
        return None
    try:
        positions = np.array([attributes["pos"] for attributes in nodes.values()], np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError('the node attribute "pos" must hold the same number of coordinates for every node') from error
    if positions.ndim != 2:
        raise ValueError(f'the node attribute "pos" must hold one row of numbers, got shape {positions.shape[1:]}')
    return positions


@door
def to_networkx(graph: Graph) -> Any:
    """Convert a graph to an undirected ``networkx.Graph`` with the nodes 0..n-1.

    Weights, if there are any, become the edge attribute "weight", positions the node attribute "pos", a tuple. All
    numbers are Python numbers.

    Raises
    ------
    ImportError
        networkx is not installed.
    TypeError
        Not a Graph; for a GridGraph give ``grid.to_graph()``.

    Examples
    --------
    >>> to_networkx(Graph.from_edges([[0, 1], [1, 2]], [1.0, 0.5])).edges(data="weight")
    EdgeDataView([(0, 1, 1.0), (1, 2, 0.5)])
    """
    nx = _networkx()
    refuse_grid("graph", graph)
    if not isinstance(graph, Graph):
        raise TypeError(f"graph must be a Graph, got {type(graph).__name__}")
    g = nx.Graph()
    g.add_nodes_from(range(graph.n_vertices))
    if graph.positions is not None:
        nx.set_node_attributes(g, dict(enumerate(map(tuple, graph.positions.tolist()))), "pos")
    rows = graph.edge_rows()
    forward = rows < graph.indices
    ends = rows[forward].tolist(), graph.indices[forward].tolist()
    if graph.weights is None:
        g.add_edges_from(zip(*ends, strict=True))
    else:
        g.add_weighted_edges_from(zip(*ends, graph.weights[forward].tolist(), strict=True))
    return g
