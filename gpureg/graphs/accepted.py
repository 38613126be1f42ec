"""Types of graphs that public functions accept: those of gpureg, sparse matrices of scipy, graphs of networkx."""

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
    """A graph of networkx, of one of its four classes."""

    @property
    def nodes(self) -> Mapping[Any, Any]:
        """The nodes and their attributes."""

    @property
    def edges(self) -> Any:
        """The edges and their attributes."""

    def is_directed(self) -> bool:
        """Return whether edges are directed."""


GraphLike: TypeAlias = "AnyGraph | sparse.sparray | sparse.spmatrix | NetworkxGraph"
"""The types of graphs that public functions accept."""

StoredLike: TypeAlias = "Graph | sparse.sparray | sparse.spmatrix | NetworkxGraph"
"""The same types without grids, for functions that need stored edges."""


def as_graph(graph: GraphLike, *, name: str = "graph", degrees: bool = False) -> AnyGraph:
    """Convert the argument of a public function to a graph.

    Parameters
    ----------
    graph : Graph, GridGraph, (n, n) sparse matrix or array of scipy, or graph of networkx
        The first two are returned unchanged. A matrix must be symmetric, see :meth:`gpureg.Graph.from_scipy`. Vertex i
        of a graph of networkx is ``list(graph.nodes)[i]``, see :func:`gpureg.from_networkx`.
    name : str, default "graph"
        Name of the parameter, for error messages.
    degrees : bool, default False
        Whether the function uses the degrees of the vertices, which depend on loops. If not, loops (nonzero diagonal
        entries of a matrix) have no effect and are removed with a UserWarning.

    Returns
    -------
    Graph or GridGraph

    Raises
    ------
    TypeError
        Another type.
    ValueError
        A graph that is not undirected; loops if `degrees` is True.

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
    """Convert the argument of a public function to a graph with stored edges, see :func:`as_graph`.

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
    """Convert a graph of another library; None for other types."""
    # Where such an object exists, its library is already imported.
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
    """Convert a sparse matrix to COO, without the entries on its diagonal."""
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
    """Warn that loops are left out; raise a ValueError if degrees are used."""
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
    """Return the `stacklevel` of the code that called gpureg, for a warning in the calling function."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "gpureg":
        level, frame = level + 1, frame.f_back
    return level
