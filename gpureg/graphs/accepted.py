"""What public functions take for a graph: ours, sparse matrices of scipy, graphs of networkx."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from .csr import Graph
from .grid import AnyGraph, GridGraph, refuse_grid
from .networkx import from_networkx, without_loops

if TYPE_CHECKING:
    from scipy import sparse

_LIBRARIES = "a sparse matrix of scipy or a graph of networkx"


class NetworkxGraph(Protocol):
    """A graph of networkx, of any of its four classes."""

    @property
    def nodes(self) -> Mapping[Any, Any]:
        """The nodes and their attributes."""

    @property
    def edges(self) -> Any:
        """The edges and their attributes."""

    def is_directed(self) -> bool:
        """Whether edges lead one way."""


GraphLike: TypeAlias = "AnyGraph | sparse.sparray | sparse.spmatrix | NetworkxGraph"
"""What public functions take for a graph."""

StoredLike: TypeAlias = "Graph | sparse.sparray | sparse.spmatrix | NetworkxGraph"
"""The same without grids, for functions that need stored edges."""


def as_graph(graph: GraphLike, *, name: str = "graph", degrees: bool = False) -> AnyGraph:
    """Take a graph as it was given to a public function.

    Parameters
    ----------
    graph : Graph, GridGraph, (n, n) sparse matrix or array of scipy, or graph of networkx
        The first two are returned as they are. A matrix must be symmetric, as :meth:`gpureg.Graph.from_scipy` takes
        it; vertex i of a graph of networkx is the i-th of ``list(graph.nodes)``, as in :func:`gpureg.from_networkx`.
    name : str, default "graph"
        The parameter, for errors.
    degrees : bool, default False
        Whether the degrees of the vertices matter, in which a loop would count. If not, loops, which a diagonal that is
        not 0 stands for, are left out with a UserWarning: they change nothing.

    Returns
    -------
    Graph or GridGraph

    Raises
    ------
    TypeError
        Anything else.
    ValueError
        What is no undirected graph; loops where `degrees` matter.

    Examples
    --------
    >>> from scipy import sparse
    >>> as_graph(sparse.csr_array([[0, 2.0], [2.0, 0]]))
    Graph(2 vertices, 1 undirected edges, weighted)
    """
    if isinstance(graph, Graph | GridGraph):
        return graph
    found = _of_libraries(graph, name, degrees)
    if found is None:
        raise TypeError(f"{name} must be a Graph, a GridGraph, {_LIBRARIES}, got {type(graph).__name__}")
    return found


def as_stored(graph: StoredLike, *, name: str = "graph", degrees: bool = False) -> Graph:
    """Take a graph whose edges are stored, as :func:`as_graph` does.

    Raises
    ------
    TypeError, ValueError
        A GridGraph; otherwise as :func:`as_graph`.
    """
    refuse_grid(name, graph)
    found = graph if isinstance(graph, Graph) else _of_libraries(graph, name, degrees)
    if found is None:
        raise TypeError(f"{name} must be a Graph, {_LIBRARIES}, got {type(graph).__name__}")
    return found


def _of_libraries(graph: Any, name: str, degrees: bool) -> Graph | None:
    """A graph that another library made, None for anything else."""
    # Who has such an object has imported its library.
    matrices, networkx = sys.modules.get("scipy.sparse"), sys.modules.get("networkx")
    if matrices is not None and matrices.issparse(graph):
        return Graph.from_scipy(_without_diagonal(graph, name, degrees))
    if networkx is not None and isinstance(graph, networkx.Graph):
        found, loops = without_loops(graph)
        if loops:
            _leave_out_loops(name, f"{loops} self-loop(s)", degrees)
        return from_networkx(found)
    return None


def _without_diagonal(matrix: Any, name: str, degrees: bool) -> Any:
    """A sparse matrix as COO without the entries on its diagonal."""
    from scipy import sparse

    coo = sparse.coo_array(matrix)
    loops = coo.row == coo.col if coo.ndim == 2 and coo.shape[0] == coo.shape[1] else np.zeros(coo.nnz, bool)
    if not loops.any():
        return coo
    count = int(np.count_nonzero(coo.data[loops]))
    if count:
        _leave_out_loops(name, f"{count} number(s) other than 0 on its diagonal", degrees)
    return sparse.coo_array((coo.data[~loops], (coo.row[~loops], coo.col[~loops])), shape=coo.shape)


def _leave_out_loops(name: str, found: str, degrees: bool) -> None:
    """Warn that loops are left out; ValueError where degrees matter."""
    if degrees:
        raise ValueError(
            f"{name} has {found}: self-loops are not allowed here, where they would count in the degrees; leave them "
            "out (of a scipy matrix: A.setdiag(0); of a networkx graph: g.remove_edges_from(nx.selfloop_edges(g)))"
        )
    warnings.warn(
        f"{name} has {found}, left out: an edge from a vertex to itself changes nothing",
        UserWarning,
        stacklevel=_levels_to_caller(),
    )


def _levels_to_caller() -> int:
    """The `stacklevel` of a warning that points at the code that called gpureg, from the function that asks."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "gpureg":
        level, frame = level + 1, frame.f_back
    return level
