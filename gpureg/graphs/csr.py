"""Weighted graphs: stored ones (:class:`Graph`, CSR) and implicit grids (:class:`GridGraph`).

Both are frozen and checked once, when they are made. Edges are undirected, each is stored in both directions, and
there are no self-loops (section 2.1 of the paper).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from scipy import sparse
from .arrays import BLOCK_ENTRIES, FloatArray, IntArray, frozen, integers

Metric = Literal["chebyshev", "euclidean", "cityblock"]
METRICS: tuple[Metric, ...] = ("chebyshev", "euclidean", "cityblock")
Symmetrize = Literal["max", "mean", "mutual"]
SYMMETRIZE: tuple[Symmetrize, ...] = ("max", "mean", "mutual")
# The end of every refusal of a directed graph or a repeated edge.
SYMMETRIZE_MENDS = (
    'symmetrize="max", "mean" or "mutual" of Graph.from_edges, Graph.from_scipy, from_networkx and read_graph '
    "mends that"
)


def check_weights(weights: npt.ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """A float copy of ``weights``, after checking shape, finiteness and sign."""
    array = np.array(weights, dtype=np.result_type(np.asarray(weights).dtype, np.float32))
    if array.dtype.kind != "f":
        raise TypeError(f"weights must be real numbers, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"weights must have shape {shape} ({what}), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"weights must be finite, got {array[~np.isfinite(array)][0]}")
    if array.size and array.min() < 0:
        raise ValueError(f"weights must be >= 0, got {array.min()}")
    return array


def checked_spacing(spacing: Sequence[float] | None, ndim: int) -> tuple[float, ...] | None:
    """`spacing` as a tuple of so many finite numbers > 0, or None."""
    if spacing is None:
        return None
    if np.ndim(spacing) != 1:
        raise ValueError(f"spacing must hold {ndim} numbers, one per axis, got {spacing}")
    steps = tuple(float(s) for s in spacing)
    if len(steps) != ndim or not all(math.isfinite(s) and s > 0 for s in steps):
        raise ValueError(f"spacing must hold {ndim} finite numbers > 0, got {spacing}")
    return steps


def check_symmetrize(symmetrize: str | None) -> None:
    """Refuse what is no value of `symmetrize`."""
    if symmetrize is not None and symmetrize not in SYMMETRIZE:
        raise ValueError(f'symmetrize must be None, "max", "mean" or "mutual", got {symmetrize!r}')


def _refuse_loops(rows: IntArray, columns: IntArray) -> None:
    loops = rows == columns
    if loops.any():
        raise ValueError(
            f"self-loops are not allowed, vertex {rows[loops][0]} has one: leave it out "
            f"(of a scipy matrix: A.setdiag(0), then A.eliminate_zeros())"
        )


def _symmetrized(pairs: IntArray, weights: FloatArray | None, how: Symmetrize) -> tuple[IntArray, FloatArray | None]:
    """Directed edges (E, 2), repeated ones among them, as undirected ones, each once; `weights` may be None for 1."""
    _refuse_loops(pairs[:, 0], pairs[:, 1])
    low, high, forward = pairs.min(axis=1), pairs.max(axis=1), pairs[:, 0] < pairs[:, 1]
    # Edges between the same two vertices come to stand together, those that lead forward last.
    order = np.lexsort((forward, high, low))
    low, high, forward = low[order], high[order], forward[order]
    new = np.ones(len(order), bool)
    new[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    starts = np.flatnonzero(new)
    once = np.stack([low[starts], high[starts]], axis=1)
    values = (np.ones(len(order)) if weights is None else weights)[order]
    if how == "max":
        joined = np.maximum.reduceat(values, starts)
    elif how == "mean":
        joined = np.add.reduceat(values, starts) / 2
    else:
        ends = np.append(starts[1:], len(order)) - 1
        mutual = ~forward[starts] & forward[ends]
        once, joined = once[mutual], np.minimum.reduceat(values, starts)[mutual]
    return once, None if weights is None and (joined == 1).all() else joined


def opposite_edges(indptr: IntArray, indices: IntArray) -> IntArray:
    """Where edge (v, u) is stored, for each stored edge (u, v) of a symmetric graph with sorted rows, (n_edges,)."""
    from scipy import sparse

    n = len(indptr) - 1
    numbered = sparse.csr_array((np.arange(len(indices)), indices, indptr), shape=(n, n))
    opposite: IntArray = numbered.T.tocsr().data
    return opposite


@dataclass(frozen=True, eq=False)
class Graph:
    """A weighted undirected graph in compressed sparse row (CSR) form.

    Parameters
    ----------
    indptr : (n + 1,) int array
        Row pointers: the neighbours of vertex u are ``indices[indptr[u]:indptr[u + 1]]``.
    indices : (n_edges,) int array
        Neighbours. Each undirected edge appears twice, once from either end. Rows are sorted on the way in, and
        `weights` with them.
    weights : (n_edges,) float array, optional
        One finite weight >= 0 per stored directed edge, the same in both directions. None means 1 everywhere.
    positions : (n, d) float array, optional
        Coordinates of the vertices; spatial weights such as ``weights.bilateral`` need them.
    grid : GridGraph, optional
        The grid whose vertices these are (row-major); patch weights of radius > 0 need it.

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

    def __post_init__(self) -> None:
        from scipy import sparse

        indptr = integers("indptr", self.indptr, 1).astype(np.int64)
        indices = integers("indices", self.indices, 1).astype(np.int64)
        n, nnz = len(indptr) - 1, len(indices)
        if n < 1:
            raise ValueError("a graph needs at least one vertex: indptr must have n + 1 >= 2 entries")
        if indptr[0] != 0 or indptr[-1] != nnz or (np.diff(indptr) < 0).any():
            raise ValueError(f"indptr must rise from 0 to len(indices) = {nnz} without falling")
        if nnz and (indices.min() < 0 or indices.max() >= n):
            bad = indices[(indices < 0) | (indices >= n)][0]
            raise ValueError(f"indices must lie in 0..{n - 1}, got {bad}")
        weights = None
        if self.weights is not None:
            weights = check_weights(self.weights, (nnz,), "one per stored directed edge")
        rows = np.repeat(np.arange(n), np.diff(indptr))
        if ((indices[1:] <= indices[:-1]) & (rows[1:] == rows[:-1])).any():
            order = np.lexsort((indices, rows))
            indices = indices[order]
            if weights is not None:
                weights = weights[order]
        _refuse_loops(rows, indices)
        repeated = (rows[1:] == rows[:-1]) & (indices[1:] == indices[:-1])
        if repeated.any():
            u, v = rows[1:][repeated][0], indices[1:][repeated][0]
            raise ValueError(f"each edge may be stored once per direction, ({u}, {v}) is repeated: {SYMMETRIZE_MENDS}")
        forward = sparse.csr_array((np.arange(1, nnz + 1), indices, indptr), shape=(n, n))
        backward = forward.T.tocsr()
        backward.sort_indices()
        if not (np.array_equal(backward.indptr, indptr) and np.array_equal(backward.indices, indices)):
            k = int(np.flatnonzero(~np.isin(rows * n + indices, indices * n + rows))[0])
            u, v = rows[k], indices[k]
            raise ValueError(
                f"the graph must be symmetric, every edge stored in both directions: ({u}, {v}) is stored but "
                f"({v}, {u}) is not: {SYMMETRIZE_MENDS}"
            )
        if weights is not None:
            mirrored = weights[backward.data - 1]
            if not np.array_equal(weights, mirrored):
                k = int(np.flatnonzero(weights != mirrored)[0])
                raise ValueError(
                    f"weights must be the same in both directions, edge ({rows[k]}, {indices[k]}) has "
                    f"{weights[k]} one way and {mirrored[k]} the other: {SYMMETRIZE_MENDS}"
                )
        positions = None
        if self.positions is not None:
            positions = np.array(self.positions, dtype=np.float64)
            if positions.ndim != 2 or len(positions) != n or not np.isfinite(positions).all():
                raise ValueError(f"positions must be finite and of shape ({n}, d), got shape {positions.shape}")
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
    def from_edges(
        cls,
        edges: npt.ArrayLike,
        weights: npt.ArrayLike | None = None,
        *,
        n_vertices: int | None = None,
        positions: npt.ArrayLike | None = None,
        symmetrize: Symmetrize | None = None,
    ) -> Self:
        """Graph from a list of undirected edges, each given once; with `symmetrize`, from any list.

        Parameters
        ----------
        edges : (E, 2) int array
            Pairs of vertices.
        weights : (E,) float array, optional
            One weight per undirected edge; None means 1 everywhere.
        n_vertices : int, optional
            Number of vertices; None takes the largest index plus one.
        positions : (n, d) float array, optional
            Coordinates of the vertices.
        symmetrize : {"max", "mean", "mutual"}, optional
            What becomes of directed and repeated edges. None refuses an edge that is listed twice, in whatever
            direction. Otherwise the edges are directed, and all those between u and v, either way, make one:
            "max" takes the largest weight; "mean" half the sum, so that a direction that is missing counts 0 and a
            pair listed both ways gets the mean; "mutual" the smallest, and no edge where a direction is missing.
            Edges without weights count 1, and stay without weights where the outcome is 1 everywhere.

        Raises
        ------
        TypeError, ValueError
            As the class does; also for an edge that is listed twice where `symmetrize` is None.

        Examples
        --------
        >>> Graph.from_edges([[0, 1], [1, 2]], [1.0, 0.5]).to_scipy().toarray()
        array([[0. , 1. , 0. ],
               [1. , 0. , 0.5],
               [0. , 0.5, 0. ]])

        Directed edges, of which one has no counterpart:

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
        if pairs.shape[1] != 2:
            raise ValueError(f"edges must have shape (E, 2), got {pairs.shape}")
        if n_vertices is not None and (isinstance(n_vertices, bool) or not isinstance(n_vertices, int | np.integer)):
            raise TypeError(f"n_vertices must be an integer, got {n_vertices!r}")
        n = int(pairs.max()) + 1 if n_vertices is None and len(pairs) else n_vertices
        if n is None or n < 1:
            raise ValueError("a graph without edges needs n_vertices >= 1")
        if len(pairs) and (pairs.min() < 0 or pairs.max() >= n):
            raise ValueError(f"edges must join vertices 0..{n - 1}, got {pairs.min()}..{pairs.max()}")
        once = None if weights is None else check_weights(weights, (len(pairs),), "one per undirected edge")
        if symmetrize is not None and len(pairs):
            pairs, once = _symmetrized(pairs, once, symmetrize)
        rows = np.concatenate([pairs[:, 0], pairs[:, 1]])
        columns = np.concatenate([pairs[:, 1], pairs[:, 0]])
        order = np.lexsort((columns, rows))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
        values = None if once is None else np.concatenate([once, once])[order]
        return cls(indptr, columns[order], values, None if positions is None else np.asarray(positions))

    def to_edges(self) -> tuple[IntArray, FloatArray | None]:
        """Each undirected edge once: what :meth:`from_edges` takes, with ``n_vertices`` besides.

        Returns
        -------
        edges : (E, 2) int array
            Pairs of vertices, the smaller first, in the order of the rows.
        weights : (E,) float array or None
            One weight per undirected edge; None where all are 1.

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
    def from_scipy(
        cls, matrix: Any, *, symmetrize: Symmetrize | None = None, positions: npt.ArrayLike | None = None
    ) -> Self:
        """Graph whose weight matrix W is the sparse `matrix`; explicit zeros stay edges.

        Parameters
        ----------
        matrix : (n, n) sparse array or matrix
            Of any format; a dense array is taken too, whose zeros are no edges.
        symmetrize : {"max", "mean", "mutual"}, optional
            What becomes of a matrix that is not symmetric or has several entries in one place, as COO may; None
            refuses it. Of all entries at (u, v) and (v, u), "max" takes the largest, "mean" half the sum, which is
            ``(A + A.T) / 2``, and "mutual" the smallest, with no edge where one of the two has none.
        positions : (n, d) float array, optional
            Coordinates of the vertices.

        Raises
        ------
        TypeError
            What scipy makes no matrix of; complex entries.
        ValueError
            A matrix that is not square, that has entries on its diagonal (explicit zeros among them), negative or
            non-finite ones; without `symmetrize` also one that is not symmetric or has several entries in one place.

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
            # Not CSR: on the way from COO to it scipy adds up the entries in one place in silence.
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
        """The weight matrix W as a ``scipy.sparse.csr_array``."""
        from scipy import sparse

        data = np.ones(self.n_edges) if self.weights is None else self.weights.copy()
        # scipy takes the wider of the two types for both, and pays for it in every product.
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
        """Sum of the weights around each vertex, delta_w of section 2.1, shape (n,)."""
        values = np.ones(self.n_edges) if self.weights is None else self.weights
        total: FloatArray = np.zeros(self.n_vertices, np.float64)
        total += np.bincount(self.edge_rows(), weights=values, minlength=self.n_vertices)
        return total

    def edge_rows(self) -> IntArray:
        """The vertex each stored directed edge starts from, shape (n_edges,)."""
        return np.repeat(np.arange(self.n_vertices), np.diff(self.indptr))


@dataclass(frozen=True, eq=False)
class GridGraph:
    """The implicit k-neighbourhood graph of a regular grid; nothing is stored per edge.

    Vertices are the cells of an array of the given shape, in row-major order. Two of them are joined when their
    distance is at most `radius` (the neighbourhood N_k of section 5.2). Vertices exist only inside the grid: at the
    border a window is clipped.

    Parameters
    ----------
    shape : int or sequence of int
        Size of each axis, any number of axes.
    radius : float, default 1
        Reach of the neighbourhood, in the units of `spacing`. Infinity gives the complete graph, for small grids.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        "chebyshev" gives square windows, "euclidean" disks, "cityblock" diamonds; ``radius=1`` with "cityblock" is
        the paper's 4-adjacency graph G_0, with "chebyshev" its 8-adjacency graph G_1.
    spacing : sequence of float, optional
        Distance between cells along each axis; None means 1.
    mask : bool array of the grid's shape, optional
        True where a vertex takes part. The others stay vertices, without an edge.

    Raises
    ------
    TypeError, ValueError
        An empty shape, a radius that reaches no neighbour, an unknown metric, spacing or mask that do not match.

    Examples
    --------
    >>> grid = GridGraph((4, 5), radius=1, metric="cityblock")
    >>> grid.offsets.tolist()
    [[-1, 0], [0, -1], [0, 1], [1, 0]]
    >>> grid.n_vertices, grid.n_edges, grid.to_graph().n_edges
    (20, 62, 62)
    """

    shape: tuple[int, ...]
    radius: float = 1
    metric: Metric = "chebyshev"
    spacing: tuple[float, ...] | None = None
    mask: npt.NDArray[np.bool_] | None = None

    def __init__(
        self,
        shape: int | Sequence[int],
        radius: float = 1,
        metric: Metric = "chebyshev",
        *,
        spacing: Sequence[float] | None = None,
        mask: npt.ArrayLike | None = None,
    ) -> None:
        sizes = tuple(np.atleast_1d(np.asarray(shape)).tolist())
        if not sizes or any(type(s) is not int or s < 1 for s in sizes):
            raise ValueError(f"shape must hold one or more integers >= 1, got {shape}")
        if metric not in METRICS:
            raise ValueError(f"metric must be one of {', '.join(METRICS)}, got {metric!r}")
        steps = checked_spacing(spacing, len(sizes))
        if isinstance(radius, bool) or not isinstance(radius, int | float | np.integer | np.floating):
            raise TypeError(f"radius must be a number, got {radius!r}")
        if not radius >= min(steps or (1.0,)):
            raise ValueError(f"radius must reach the nearest neighbour, got {radius}")
        inside: npt.NDArray[np.bool_] | None = None
        if mask is not None:
            inside = np.array(mask)
            if inside.dtype != np.bool_ or inside.shape != sizes:
                raise ValueError(f"mask must be boolean of shape {sizes}, got {inside.dtype} of shape {inside.shape}")
            frozen(inside)
        for name, value in (("shape", sizes), ("radius", radius), ("metric", metric), ("spacing", steps)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "mask", inside)
        object.__setattr__(self, "_offsets", frozen(self._window()))

    def _window(self) -> IntArray:
        steps = np.array(self.spacing or (1.0,) * len(self.shape))
        # An axis of s cells has no neighbour further than s - 1.
        reach = [int(min(self.radius / d + 1e-9, s - 1)) for d, s in zip(steps, self.shape, strict=True)]
        axes = [np.arange(-r, r + 1) for r in reach]
        offsets = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
        distance = np.abs(offsets) * steps
        if self.metric == "chebyshev":
            length = distance.max(axis=1)
        elif self.metric == "euclidean":
            length = np.sqrt((distance**2).sum(axis=1))
        else:
            length = distance.sum(axis=1)
        kept = (length <= self.radius * (1 + 1e-9)) & (np.abs(offsets).sum(axis=1) > 0)
        window: IntArray = offsets[kept].astype(np.int64)
        return window

    def __repr__(self) -> str:
        masked = "" if self.mask is None else f", {int(self.mask.sum())} cells in the mask"
        return f"GridGraph(shape={self.shape}, radius={self.radius:g}, metric={self.metric!r}{masked})"

    @property
    def offsets(self) -> IntArray:
        """Steps from a vertex to its neighbours, (K, ndim), in lexicographic order.

        The opposite of offset k is offset K - 1 - k; the last K/2 lead forward in row-major order.
        """
        offsets: IntArray = self._offsets  # type: ignore[attr-defined]
        return offsets

    @property
    def half_window(self) -> int:
        """Number of forward offsets, K/2: weights are stored for these alone."""
        return len(self.offsets) // 2

    @property
    def forward_offsets(self) -> IntArray:
        """The forward half of the offsets, (K/2, ndim)."""
        return self.offsets[self.half_window :]

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def n_vertices(self) -> int:
        """Number of vertices, masked ones included."""
        return math.prod(self.shape)

    @property
    def n_edges(self) -> int:
        """Number of directed edges, twice the number of undirected ones."""
        if self.mask is not None:
            return 2 * sum(int(self._inside_mask(step).sum()) for step in self.forward_offsets)
        return sum(math.prod(s - abs(int(o)) for s, o in zip(self.shape, step, strict=True)) for step in self.offsets)

    def ends(self, step: IntArray) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
        """Slices of an array on the grid that select the start and the end of every edge along `step`."""
        pairs = [(int(o), s) for o, s in zip(step, self.shape, strict=True)]
        start = tuple(slice(max(0, -o), s - max(0, o)) for o, s in pairs)
        end = tuple(slice(max(0, o), s - max(0, -o)) for o, s in pairs)
        return start, end

    def _inside_mask(self, step: IntArray) -> npt.NDArray[np.bool_]:
        start, end = self.ends(step)
        assert self.mask is not None
        both: npt.NDArray[np.bool_] = self.mask[start] & self.mask[end]
        return both

    def unit_half_weights(self) -> FloatArray:
        """Weight 1 on every edge as stored once per pair, (K/2, *shape): 0 where an edge leaves grid or mask."""
        half = np.zeros((self.half_window, *self.shape), np.float32)
        for plane, step in zip(half, self.forward_offsets, strict=True):
            start, _ = self.ends(step)
            plane[start] = 1 if self.mask is None else self._inside_mask(step)
        return half

    def _edge_blocks(self) -> Iterator[tuple[IntArray, IntArray, npt.NDArray[np.bool_]]]:
        """Blocks of vertices u (B,), their neighbours v (B, K), and which of these exist (B, K)."""
        offsets, K = self.offsets, max(1, len(self.offsets))
        strides = np.array([math.prod(self.shape[d + 1 :]) for d in range(self.ndim)], np.int64)
        jumps = offsets @ strides
        block = max(1, BLOCK_ENTRIES // (K * self.ndim))
        inside = None if self.mask is None else self.mask.ravel()
        for begin in range(0, self.n_vertices, block):
            u = np.arange(begin, min(begin + block, self.n_vertices))
            there = np.stack(np.unravel_index(u, self.shape), axis=-1)[:, None, :] + offsets[None]
            exists: npt.NDArray[np.bool_] = np.asarray(((there >= 0) & (there < np.array(self.shape))).all(axis=-1))
            v = u[:, None] + jumps[None]
            if inside is not None:
                exists = exists & inside[u][:, None] & inside[np.where(exists, v, 0)]
            yield u, v, exists

    def to_graph(self, half_weights: FloatArray | None = None) -> Graph:
        """The same graph as CSR with row-major vertices, carrying positions (in units of spacing) and the grid.

        Parameters
        ----------
        half_weights : (K/2, *shape) float array, optional
            Weights stored once per pair, as the ``half_weights`` methods give them; None means 1.
        """
        counts, columns = [], []
        for _, v, exists in self._edge_blocks():
            counts.append(exists.sum(axis=1))
            columns.append(v[exists])
        indptr = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
        indices = np.concatenate(columns)
        weights = None if half_weights is None else self.half_to_edges(half_weights)
        steps = np.array(self.spacing or (1.0,) * self.ndim)
        positions = np.stack(np.unravel_index(np.arange(self.n_vertices), self.shape), axis=-1) * steps
        return Graph(indptr, indices, weights, positions, self)

    def half_to_edges(self, half: npt.ArrayLike) -> FloatArray:
        """Weights stored once per pair, (K/2, *shape), as one per directed edge in the order of :meth:`to_graph`."""
        H, n = self.half_window, self.n_vertices
        planes: FloatArray = np.asarray(half)
        if planes.shape != (H, *self.shape):
            raise ValueError(f"half weights must have shape {(H, *self.shape)}, got {planes.shape}")
        flat = planes.reshape(H, n)
        values = []
        for u, v, exists in self._edge_blocks():
            table = np.empty(v.shape, planes.dtype)
            for k in range(2 * H):
                plane = k - H if k >= H else H - 1 - k
                table[:, k] = flat[plane, u if k >= H else np.where(exists[:, k], v[:, k], 0)]
            values.append(table[exists])
        return np.concatenate(values)

    def flat_edges(self, values: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
        """One value per directed edge, given as (n_edges,) or (*shape, K), in the order of :meth:`to_graph`.

        Raises
        ------
        ValueError
            Another shape.
        """
        K, array = len(self.offsets), np.asarray(values)
        if array.shape == (self.n_edges,):
            return array
        if array.shape != (*self.shape, K):
            raise ValueError(
                f"{name} must have shape ({self.n_edges},), one per directed edge in the order of to_graph(), "
                f"or {(*self.shape, K)}, one per offset; got {array.shape}"
            )
        exists = np.concatenate([exists.ravel() for _, _, exists in self._edge_blocks()])
        kept: npt.NDArray[Any] = array.reshape(-1)[exists]
        return kept

    def window_to_edges(self, planes: FloatArray) -> FloatArray:
        """A function on the edges as one plane per offset, (K, *shape, m), in the order of :meth:`to_graph`."""
        K, n = len(self.offsets), self.n_vertices
        flat = planes.reshape(K, n, planes.shape[-1])
        values = [flat[:, u].transpose(1, 0, 2)[exists] for u, _, exists in self._edge_blocks()]
        return np.concatenate(values)

    def edges_to_window(self, values: FloatArray) -> FloatArray:
        """A function on the edges, (n_edges, m), as one plane per offset with 0 where an edge leaves grid or mask."""
        K, n, m = len(self.offsets), self.n_vertices, values.shape[1]
        planes = np.zeros((K, n, m), values.dtype)
        begin = 0
        for u, _, exists in self._edge_blocks():
            table = np.zeros((*exists.shape, m), values.dtype)
            count = int(exists.sum())
            table[exists] = values[begin : begin + count]
            planes[:, u] = table.transpose(1, 0, 2)
            begin += count
        return planes.reshape(K, *self.shape, m)

    def edges_to_half(self, values: npt.ArrayLike) -> FloatArray:
        """One weight per directed edge, as (n_edges,) or (*shape, K), checked and stored once per pair.

        Raises
        ------
        ValueError
            Another shape, a negative or non-finite weight, or two directions that differ.
        """
        H, n = self.half_window, self.n_vertices
        array = self.flat_edges(values, "weights")
        array = check_weights(array, (self.n_edges,), "one per directed edge in the order of to_graph()")
        half = np.zeros((H, n), array.dtype)
        begin = 0
        for u, _, exists in self._edge_blocks():
            table = np.zeros(exists.shape, array.dtype)
            count = int(exists.sum())
            table[exists] = array[begin : begin + count]
            half[:, u] = table[:, H:].T
            begin += count
        if not np.array_equal(self.half_to_edges(half.reshape(H, *self.shape)), array):
            raise ValueError("weights must be the same in both directions of an edge; symmetrise them first")
        return half.reshape(H, *self.shape)


AnyGraph = Graph | GridGraph
