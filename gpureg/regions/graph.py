"""The region adjacency graph of a label image: :func:`region_graph` (section 5.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, unmasked
from ..checks import choice, integer
from ..doors import door
from ..graphs.csr import Graph
from ..graphs.edges import Metric, checked_spacing
from ..graphs.grid import GridGraph
from ..graphs.of_shapes import ring_graph

METRICS: tuple[Metric, ...] = ("cityblock", "chebyshev")

# Labels are counted in an array up to the largest one, if that is below 4 times the number of cells or below 65536.
_SPARSE, _FEW = 4, 1 << 16


@dataclass(frozen=True, eq=False, repr=False)
class RegionGraph(Graph):
    """The region adjacency graph (RAG) of a label image: a :class:`Graph` with attributes of the regions.

    Attributes
    ----------
    sizes : (n,) float array
        Size of each region: the number of its cells times the volume of a cell.
    borders : (n_edges,) float array
        Length (in a volume: area) of the common border, one per stored directed edge. It is 0 if regions meet only at
        corners, or are neighbours of neighbours.
    labels : (n,) int array
        Label of each region in the label image.
    positions : (n, d) float array
        Centroids of the regions, in units of the spacing.
    """

    sizes: FloatArray | None = None
    borders: FloatArray | None = None
    labels: IntArray | None = None

    def __post_init__(self) -> None:
        given = np.array(self.indices)
        super().__post_init__()
        if self.borders is not None and not np.array_equal(given, self.indices):
            raise ValueError("indices must rise within each row where borders are given in their order")
        n = self.n_vertices
        usual = {"sizes": np.ones(n), "borders": np.zeros(self.n_edges), "labels": np.arange(n)}
        for name, default in usual.items():
            values = getattr(self, name)
            array = default if values is None else np.array(values, default.dtype)
            if array.shape != default.shape:
                raise ValueError(f"{name} must have shape {default.shape}, got {array.shape}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        return f"RegionGraph({self.n_vertices} regions, {self.n_edges // 2} borders)"

    def distances(self, values: npt.ArrayLike) -> FloatArray:
        """Compute the Euclidean distance between the values of neighbouring regions, one per stored directed edge.

        Parameters
        ----------
        values : (n,) or (n, m) array
            One value, or m channels, per region, as returned by :func:`gpureg.region_values`.
        """
        array = np.asarray(values, np.float64)
        if array.ndim not in (1, 2) or len(array) != self.n_vertices:
            raise ValueError(
                f"values must have one value or one row for each of {self.n_vertices} regions, got {array.shape}"
            )
        array = array.reshape(len(array), -1)
        difference = array[self.indices] - array[self.edge_rows()]
        distance: FloatArray = np.sqrt((difference**2).sum(axis=1))
        return distance


@door
def region_graph(
    labels: npt.ArrayLike,
    *,
    metric: Metric = "cityblock",
    background: int | None = None,
    spacing: Sequence[float] | None = None,
    rings: int = 1,
) -> RegionGraph:
    """Make the graph of the regions of a label image.

    Parameters
    ----------
    labels : int array
        Label image, e.g. of scikit-image, with any number of axes. Each label >= 0 is a region, connected or not;
        labels may have gaps. Cells with labels below 0 are in no region.
    metric : {"cityblock", "chebyshev"}, default "cityblock"
        Cells are neighbours across faces (the paper's G_0), or also across corners (G_1).
    background : int, optional
        Another label that is not a region, such as 0 for watershed lines.
    spacing : sequence of float, optional
        Size of a cell along each axis; None means 1. Sizes, borders and centroids are in its units.
    rings : int, default 1
        Regions up to this number of steps apart are neighbours too (:func:`gpureg.ring_graph`), with borders of 0.

    Returns
    -------
    RegionGraph
        A graph without weights, whose vertices are the regions in the order of their labels. For labels 0..k-1, as
        from :func:`gpureg.energy_partition`, vertex i is region i, and ``values[labels]`` is the image of the values.

    Raises
    ------
    TypeError, ValueError
        Labels that are not integers, no region, an unknown metric, wrong spacing or rings.

    Notes
    -----
    Two regions are joined if a cell of one has a neighbour in the other (section 5.2). The length of a border is the
    sum of the areas of its faces; with unit spacing it is the number of pairs of neighbouring pixels across it.

    Examples
    --------
    >>> import gpureg as gr
    >>> rag = gr.region_graph([[0, 0, 1], [0, 2, 1]])
    >>> rag
    RegionGraph(3 regions, 3 borders)
    >>> rag.sizes, rag.borders
    (array([3., 2., 1.]), array([1., 2., 1., 1., 2., 1.]))
    """
    image = unmasked(labels, "labels")
    if image.dtype.kind not in "iu":
        raise TypeError(f"labels must be integers, got {image.dtype}")
    if not image.ndim or not image.size:
        raise ValueError(f"labels must be an image of one cell or more, got shape {image.shape}")
    choice("metric", metric, METRICS)
    if background is not None:
        integer("background", background)
    rings = integer("rings", rings, low=1)
    sides = np.array(checked_spacing(spacing, image.ndim) or (1.0,) * image.ndim)
    offsets = GridGraph(image.shape, 1, metric).forward_offsets  # the neighbours do not depend on the spacing
    numbers, index = _numbered(image, background)
    k = len(numbers)
    keys, areas = [], []
    for step in offsets:
        along = np.flatnonzero(step)
        area = float(np.prod(np.delete(sides, along))) if len(along) == 1 else 0.0
        found, count = _crossings(index, step, k)
        keys.append(found)
        areas.append(count * area)
    edges = _runs(np.concatenate([np.empty(0, np.int64), *keys]))[0]
    shared = np.zeros(len(edges))
    for found, area_of in zip(keys, areas, strict=True):
        shared[np.searchsorted(edges, found)] += area_of
    indptr, indices, borders = _both_ways(edges, shared, k)
    sizes, centroids = _measured(index, sides, k)
    plain = RegionGraph(indptr, indices, None, centroids, None, sizes, borders, numbers)
    if rings == 1:
        return plain
    wide = ring_graph(plain, rings)
    far = np.zeros(wide.n_edges)
    place = np.searchsorted(wide.edge_rows() * k + wide.indices, plain.edge_rows() * k + plain.indices)
    far[place] = borders
    return RegionGraph(wide.indptr, wide.indices, None, centroids, None, sizes, far, numbers)


def _numbered(image: npt.NDArray[Any], background: int | None) -> tuple[IntArray, IntArray]:
    """Return the labels of the regions in rising order, and the image of their indices, -1 for no region."""
    none = image < 0 if image.dtype.kind == "i" else np.zeros(image.shape, bool)
    if background is not None:
        none |= image == background
    holed = bool(none.any())
    valid = image[~none] if holed else image.reshape(-1)
    if not len(valid):
        raise ValueError("labels has no region: every cell is below 0 or background")
    largest = int(valid.max())
    if largest < max(_SPARSE * image.size, _FEW):
        present = np.bincount(valid.astype(np.intp, copy=False)) > 0
        numbers = np.flatnonzero(present)
        if len(numbers) == len(present) and not holed:
            return numbers, image.astype(np.int32, copy=False)
        places = (np.cumsum(present) - 1)[valid.astype(np.intp, copy=False)]
    else:
        distinct, places = np.unique(valid, return_inverse=True)
        numbers = distinct.astype(np.int64)
    index = np.full(image.shape, -1, np.int32)
    index[~none] = places
    return numbers, index


def _crossings(index: IntArray, step: IntArray, k: int) -> tuple[IntArray, IntArray]:
    """Return keys a k + b of the pairs of regions a < b with cells one step apart, and the number of these cells."""
    start, end = GridGraph(index.shape).ends(step)
    u, v = index[start], index[end]
    across = u != v
    u, v = u[across], v[across]
    low, high = np.minimum(u, v), np.maximum(u, v)
    whole = low >= 0
    if not whole.all():
        low, high = low[whole], high[whole]
    keys = low * np.int64(k) + high
    return _runs(keys)


def _runs(keys: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct keys in rising order, and their counts; sort the array in place.

    np.unique uses hashes, which takes ten times as long for millions of keys.
    """
    keys.sort()
    new = np.ones(len(keys), bool)
    np.not_equal(keys[1:], keys[:-1], out=new[1:])
    first = np.flatnonzero(new)
    return keys[first], np.diff(first, append=len(keys))


def _both_ways(keys: IntArray, values: FloatArray, k: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Convert undirected edges, sorted keys a k + b with a < b, and their values to CSR with both directions."""
    from scipy import sparse

    low, high = keys // k, keys % k
    indptr = np.concatenate([[0], np.cumsum(np.bincount(low, minlength=k))])
    upper = sparse.csr_array((np.arange(1, len(keys) + 1), high, indptr), shape=(k, k))
    both = upper + upper.T.tocsr()
    both.sort_indices()
    return both.indptr, both.indices, values[both.data - 1]


def _measured(index: IntArray, sides: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Compute the sizes (k,) and centroids (k, d) of the regions."""
    flat = index.reshape(-1) + 1  # 0: no region
    counts = np.bincount(flat, minlength=k + 1)[1:]
    centroids = np.empty((k, index.ndim))
    for axis, side in enumerate(sides):
        along = np.arange(index.shape[axis], dtype=np.float64).reshape(
            [-1 if a == axis else 1 for a in range(index.ndim)]
        )
        weights = np.broadcast_to(along, index.shape).reshape(-1)
        centroids[:, axis] = side * np.bincount(flat, weights, minlength=k + 1)[1:] / counts
    return counts * float(np.prod(sides)), centroids
