"""Weighted graphs in compressed sparse row form (:class:`Graph`).

A graph is checked when it is made, and is read-only. Edges are undirected, each is stored in both directions, and there
are no self-loops (section 2.1 of the paper).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, frozen, integers
from ..checks import integer
from ..doors import door
from ..exchange import on_host
from .checked import checked_positions, checked_rows
from .edges import Symmetrize, check_symmetrize, check_weights, symmetrized

if TYPE_CHECKING:
    from scipy import sparse

    from .grid import GridGraph


@dataclass(frozen=True, eq=False)
class Graph:
    """A weighted undirected graph in compressed sparse row (CSR) form.

    Parameters
    ----------
    indptr : (n + 1,) int array
        Row pointers: the neighbours of vertex u are ``indices[indptr[u]:indptr[u + 1]]``.
    indices : (n_edges,) int array
        Neighbours. Each undirected edge appears twice, once from each end. Rows are sorted, and `weights` with them.
    weights : (n_edges,) float array, optional
        One finite weight >= 0 per stored directed edge, the same in both directions. None means 1 everywhere.
    positions : (n, d) float array, optional
        Coordinates of the vertices, needed by spatial weights such as ``weights.bilateral``.
    grid : GridGraph, optional
        The grid with the same vertices (row-major), needed by patch weights of radius > 0.

    Raises
    ------
    TypeError
        Indices that are not integers, weights that are not real.
    ValueError
        An asymmetric graph, a self-loop, a repeated edge, a negative or non-finite weight, shapes that do not match.

    Examples
    --------
    A path of three vertices:

    >>> graph = Graph([0, 1, 3, 4], [1, 0, 2, 1])
    >>> graph.n_vertices, graph.n_edges
    (3, 4)
    >>> graph.degree()
    array([1., 2., 1.])
    """

    indptr: IntArray
    indices: IntArray
    weights: FloatArray | None = None
    positions: FloatArray | None = None
    grid: GridGraph | None = None

    @door(name="Graph")
    def __post_init__(self) -> None:
        given = {name: on_host(getattr(self, name), name) for name in ("indptr", "indices", "weights", "positions")}
        indptr, indices, weights = checked_rows(given["indptr"], given["indices"], given["weights"])
        n = len(indptr) - 1
        positions = checked_positions(given["positions"], n)
        if self.grid is not None and self.grid.n_vertices != n:
            raise ValueError(f"the grid has {self.grid.n_vertices} vertices, the graph {n}")
        narrow = np.int32 if n < 2**31 else np.int64
        object.__setattr__(self, "indptr", frozen(indptr))
        object.__setattr__(self, "indices", frozen(indices.astype(narrow)))
        object.__setattr__(self, "weights", None if weights is None else frozen(weights))
        object.__setattr__(self, "positions", None if positions is None else frozen(positions))

    def __repr__(self) -> str:
        weighted = "unweighted" if self.weights is None else "weighted"
        return f"Graph({self.n_vertices} vertices, {self.n_edges // 2} undirected edges, {weighted})"

    @classmethod
    def trusted(cls, indptr: IntArray, indices: IntArray, weights: FloatArray) -> Self:
        """Make a graph of arrays that were computed here and need no checks; they become read-only."""
        made = object.__new__(cls)
        values = {"indptr": indptr.astype(np.int64, copy=False), "indices": indices, "weights": weights}
        for name, value in values.items():
            object.__setattr__(made, name, frozen(value))
        for name in ("positions", "grid"):
            object.__setattr__(made, name, None)
        return made

    @classmethod
    @door(name="Graph.from_edges")
    def from_edges(
        cls,
        edges: npt.ArrayLike,
        weights: npt.ArrayLike | None = None,
        *,
        n_vertices: int | None = None,
        positions: npt.ArrayLike | None = None,
        symmetrize: Symmetrize | None = None,
    ) -> Self:
        """Make a graph from a list of undirected edges, each given once; with `symmetrize`, from any list of edges.

        Parameters
        ----------
        edges : (E, 2) or (2, E) int array
            Pairs of vertices, one per row; or two rows with the first and the second vertices. A (2, 2) array has one
            pair per row.
        weights : (E,) float array, optional
            One weight per undirected edge; None means 1 everywhere.
        n_vertices : int, optional
            Number of vertices; None means the largest index plus one.
        positions : (n, d) float array, optional
            Coordinates of the vertices.
        symmetrize : {"max", "mean", "mutual"}, optional
            How directed and repeated edges are joined. With None an edge that is listed twice, in any direction, is an
            error. Otherwise all edges between u and v, in both directions, become one edge. "max" uses the largest
            weight; "mean" half the sum, where a missing direction counts 0; "mutual" the smallest weight, and no edge
            if a direction is missing. Edges without weights count 1; if the result is 1 everywhere, the graph has no
            weights.

        Raises
        ------
        TypeError, ValueError
            As the class; also an edge that is listed twice if `symmetrize` is None.

        Examples
        --------
        >>> Graph.from_edges([[0, 1], [1, 2]], [1.0, 0.5]).to_scipy().toarray()
        array([[0. , 1. , 0. ],
               [1. , 0. , 0.5],
               [0. , 0.5, 0. ]])

        Directed edges, one without an opposite:

        >>> directed, weights = [[0, 1], [1, 0], [1, 2]], [1.0, 3.0, 0.5]
        >>> for how in ("max", "mean", "mutual"):
        ...     W = Graph.from_edges(directed, weights, n_vertices=3, symmetrize=how).to_scipy()
        ...     print(how, W[0, 1], W[1, 2])
        max 3.0 0.5
        mean 2.0 0.25
        mutual 1.0 0.0
        """
        check_symmetrize(symmetrize)
        pairs = np.asarray(edges)
        pairs = integers("edges", pairs.reshape(0, 2) if pairs.size == 0 else pairs, 2).astype(np.int64)
        if 2 not in pairs.shape:
            raise ValueError(f"edges must have shape (E, 2) or (2, E), got {pairs.shape}")
        if pairs.shape[1] != 2:
            pairs = pairs.T
        if n_vertices is not None:
            integer("n_vertices", n_vertices, low=1)
        n = int(pairs.max()) + 1 if n_vertices is None and len(pairs) else n_vertices
        if n is None or n < 1:
            raise ValueError("a graph without edges needs n_vertices >= 1")
        if len(pairs) and (pairs.min() < 0 or pairs.max() >= n):
            raise ValueError(f"edges must join vertices 0..{n - 1}, got {pairs.min()}..{pairs.max()}")
        once = None if weights is None else check_weights(weights, (len(pairs),), "one per undirected edge")
        if symmetrize is not None and len(pairs):
            pairs, once = symmetrized(pairs, once, symmetrize)
        rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
        columns = np.concatenate([pairs[:, 1], pairs[:, 0]])
        order = np.lexsort((columns, rows))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
        values = None if once is None else np.concatenate([once, once])[order]
        return cls(indptr, columns[order], values, None if positions is None else np.asarray(positions))

    def to_edges(self) -> tuple[IntArray, FloatArray | None]:
        """List each undirected edge once, in the form for :meth:`from_edges` (with ``n_vertices``).

        Returns
        -------
        edges : (E, 2) int array
            Pairs of vertices, the smaller first, in the order of the rows.
        weights : (E,) float array or None
            One weight per undirected edge; None if the graph has no weights.

        Examples
        --------
        >>> Graph.from_edges([[2, 0], [1, 2]], [1.0, 0.5]).to_edges()
        (array([[0, 2],
               [1, 2]]), array([1. , 0.5]))
        """
        rows = self.edge_rows()
        once = rows < self.indices
        edges = np.stack([rows[once], self.indices[once]], axis=1).astype(np.int64)
        return edges, None if self.weights is None else self.weights[once]

    @classmethod
    @door(name="Graph.from_scipy")
    def from_scipy(
        cls, matrix: Any, *, symmetrize: Symmetrize | None = None, positions: npt.ArrayLike | None = None
    ) -> Self:
        """Make a graph from its weight matrix W, a sparse matrix; explicit zeros are edges.

        Parameters
        ----------
        matrix : (n, n) sparse array or matrix
            Of any format; also a dense array, in which zeros are not edges.
        symmetrize : {"max", "mean", "mutual"}, optional
            How to join entries if the matrix A is not symmetric or has duplicate entries (in COO format), which is an
            error with None. Of all entries at (u, v) and (v, u), "max" uses the largest; "mean" half the sum, as in
            ``(A + A.T) / 2``; "mutual" the smallest, and no edge if (u, v) or (v, u) has no entry.
        positions : (n, d) float array, optional
            Coordinates of the vertices.

        Raises
        ------
        TypeError
            Not a matrix; complex entries.
        ValueError
            A matrix that is not square, or has diagonal entries (also explicit zeros), negative or non-finite entries;
            without `symmetrize` also a matrix that is not symmetric or has duplicate entries.

        Examples
        --------
        >>> from scipy import sparse
        >>> Graph.from_scipy(sparse.csr_array([[0, 2.0], [2.0, 0]]))
        Graph(2 vertices, 1 undirected edges, weighted)
        >>> Graph.from_scipy(sparse.csr_array([[0, 2.0], [0, 0]]), symmetrize="mean").weights
        array([1., 1.])
        """
        from scipy import sparse

        check_symmetrize(symmetrize)
        try:
            # Not CSR: scipy adds duplicate entries when it converts COO to CSR.
            coo = sparse.coo_array(matrix)
        except (TypeError, ValueError) as error:
            given = type(matrix).__name__
            raise TypeError(f"matrix must be a scipy sparse array or a square array, got {given}") from error
        if coo.ndim != 2 or coo.shape[0] != coo.shape[1]:
            raise ValueError(f"the matrix must be square, got shape {coo.shape}")
        rows, columns, n = coo.row.astype(np.int64), coo.col.astype(np.int64), coo.shape[0]
        data = coo.data.astype(np.float64) if coo.data.dtype.kind in "biu" else coo.data
        if symmetrize is not None:
            pairs = np.stack([rows, columns], axis=1)
            return cls.from_edges(pairs, data, n_vertices=n, positions=positions, symmetrize=symmetrize)
        order = np.argsort(rows, kind="stable")
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
        return cls(indptr, columns[order], data[order], None if positions is None else np.asarray(positions))

    def to_scipy(self) -> sparse.csr_array:
        """Convert to the weight matrix W, an (n, n) ``scipy.sparse.csr_array``."""
        from scipy import sparse

        data = np.ones(self.n_edges) if self.weights is None else self.weights.copy()
        # scipy uses the wider of the two types for both, which makes every product slower.
        kind = self.indices.dtype if self.n_edges < 2**31 else np.int64
        indices, indptr = self.indices.astype(kind), self.indptr.astype(kind)
        return sparse.csr_array((data, indices, indptr), shape=(self.n_vertices,) * 2)

    @property
    def n_vertices(self) -> int:
        """Number of vertices."""
        return len(self.indptr) - 1

    @property
    def n_edges(self) -> int:
        """Number of stored directed edges, twice the number of undirected ones."""
        return len(self.indices)

    def degree(self) -> FloatArray:
        """Compute the sum of the weights at each vertex, (n,): delta_w of section 2.1."""
        values = np.ones(self.n_edges) if self.weights is None else self.weights
        total: FloatArray = np.zeros(self.n_vertices, np.float64)
        total += np.bincount(self.edge_rows(), weights=values, minlength=self.n_vertices)
        return total

    def edge_rows(self) -> IntArray:
        """Return the start vertex of each stored directed edge, (n_edges,)."""
        return np.repeat(np.arange(self.n_vertices), np.diff(self.indptr))
