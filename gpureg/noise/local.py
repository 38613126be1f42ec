"""Measure noise on the vertices of a graph from the neighbourhood of each vertex: :func:`local_noise`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..graphs.components import Components
from ..graphs.csr import Graph
from .graphs import MEDIAN, averaging

# Averages over neighbours that smooth a map of the noise; after k of them it reaches about sqrt(k) edges.
_SMOOTH = 5

# The variance of the median of d values is about this number over d times that of one, for d from 3 to 8.
_MEDIAN_OF = 1.3

# A value is an impulse if it is beyond all neighbours but one by more than this number of standard deviations of the
# noise there, and than this share of the range of the values.
_FAR, _SHARE = 5.0, 0.1

# Passes in which impulses are found, each with fewer of them among the neighbours.
_PASSES = 3

# Noise of one strength varies in a map of it by this factor.
_EVEN = 2.0


def rows_by_length(indptr: npt.NDArray[np.integer]) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield the rows of a CSR structure with k > 0 entries, (r,), and where these are, (r, k), for each k there is."""
    number = np.diff(indptr)
    for k in np.unique(number[number > 0]):
        rows = np.flatnonzero(number == k)
        yield rows, indptr[rows][:, None] + np.arange(k)


def middles(values: FloatArray) -> FloatArray:
    """Return the medians of the rows of values (r, k), which are sorted, (r,)."""
    k = values.shape[1]
    medians: FloatArray = (values[:, (k - 1) // 2] + values[:, k // 2]) / 2
    return medians


def row_noise(indptr: npt.NDArray[np.integer], size: FloatArray) -> FloatArray:
    """Estimate the deviation of normal noise from the absolute values `size` in each row, (n,); infinite if empty.

    It is the largest of the smaller third of k values, over its expected value: where up to two thirds are shape, as
    around creases, it is still noise.
    """
    from scipy.special import ndtri

    noise = np.full(len(indptr) - 1, np.inf)
    for rows, at in rows_by_length(indptr):
        k = at.shape[1]
        i = (k - 1) // 3
        noise[rows] = np.sort(size[at], axis=1)[:, i] / ndtri(0.5 + (i + 1) / (2 * k + 2))
    return noise


def row_medians(indptr: npt.NDArray[np.integer], values: FloatArray) -> FloatArray:
    """Return the median of the values of each row of a CSR structure, (n,); NaN for an empty row."""
    medians = np.full(len(indptr) - 1, np.nan)
    for rows, at in rows_by_length(indptr):
        medians[rows] = middles(np.sort(values[at], axis=1))
    return medians


def ring_medians(graph: Graph, values: FloatArray) -> FloatArray:
    """Return the median of values (n,) over each vertex and its neighbours, (n,)."""
    medians = values.copy()
    for rows, at in rows_by_length(graph.indptr):
        around = np.concatenate([values[graph.indices[at]], values[rows, None]], axis=1)
        around.sort(axis=1)
        medians[rows] = middles(around)
    return medians


def spread(graph: Graph, values: FloatArray, times: int, M: Any = None) -> FloatArray:
    """Replace values (n,) or (n, m) that often by the mean of a vertex and the mean of its neighbours.

    A vertex without neighbours keeps its value. `M` is :func:`gpureg.noise.graphs.averaging` of the graph, if known.
    """
    M = averaging(graph) if M is None else M
    alone = np.diff(graph.indptr) == 0
    x = values
    for _ in range(times):
        x = (x + M @ x) / 2
    if alone.any():
        x[alone] = values[alone]
    return x


def neighbour_medians(f: FloatArray, graph: Graph) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the median of a function (n,) over the neighbours of each vertex, and their second extremes, (n,) each.

    The last two are the second smallest and the second largest value of the neighbours; a vertex with fewer than two
    neighbours gets its own value.
    """
    median, low, high = f.copy(), f.copy(), f.copy()
    for rows, at in rows_by_length(graph.indptr):
        if at.shape[1] > 1:
            around = np.sort(f[graph.indices[at]], axis=1)
            median[rows], low[rows], high[rows] = middles(around), around[:, 1], around[:, -2]
    return median, low, high


def local_noise(f: FloatArray, graph: Graph) -> FloatArray:
    """Estimate the standard deviation of white noise at each vertex, (n,), of a function (n, m) smooth on the graph.

    Two samples of the noise are compared: (I - M)^2 f with the mean M over neighbours, which is 0 for smooth functions,
    and the distance from the median of the neighbours, which is 0 also at steps. Each is divided by its value for white
    noise; the smaller median around a vertex counts, so that noise in a part of the graph is found in this part. The
    noise of several channels is their root mean square.
    """
    M = averaging(graph)
    growth, degree = twice_growth(graph, M), np.maximum(np.diff(graph.indptr), 1)
    squares = np.zeros(graph.n_vertices)
    for x in f.T:
        once = x - M @ x
        smooth = np.abs(once - M @ once) / growth
        steps = np.abs(x - neighbour_medians(x, graph)[0]) / np.sqrt(1 + _MEDIAN_OF / degree)
        medians = [ring_medians(graph, ring_medians(graph, size)) for size in (smooth, steps)]
        squares += (np.minimum(*medians) / MEDIAN) ** 2
    sigma: FloatArray = np.sqrt(spread(graph, squares / f.shape[1], _SMOOTH, M))
    return sigma


def twice_growth(graph: Graph, M: Any) -> FloatArray:
    """Compute the deviation of (I - M)^2 f for white noise f of deviation 1, (n,); infinite without neighbours."""
    from scipy import sparse

    T = sparse.csr_array(sparse.eye_array(graph.n_vertices, format="csr") - M)
    growth = np.sqrt(np.asarray((T @ T).power(2).sum(axis=1)).ravel())
    return np.where(np.diff(graph.indptr) > 0, growth, np.inf)


def without_impulses(f: FloatArray, graph: Graph, parts: Components) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find vertices whose value (n, m) is far beyond those of their neighbours.

    Far is more than five standard deviations of the noise around beyond all neighbours but one, and more than a tenth
    of the range of the values of the component without their outer hundredths. A vertex with fewer than three
    neighbours is none. The noise is the usual distance from the median of the neighbours.

    Returns
    -------
    values : (n, m) float array
        The values, with impulses at the median of their neighbours.
    impulses : (n,) bool array
    """
    found = np.zeros(graph.n_vertices, bool)
    several = np.diff(graph.indptr) >= 3
    repaired = f.copy()
    for x, y in zip(f.T, repaired.T, strict=True):
        least = _SHARE * ranges(x, parts)[parts.labels]
        for _ in range(_PASSES):
            median, low, high = neighbour_medians(y, graph)
            usual = ring_medians(graph, ring_medians(graph, np.abs(y - median))) / MEDIAN
            far = several & (np.maximum(x - high, low - x) > np.maximum(_FAR * usual, least))
            y[:] = np.where(far, median, x)
        found |= far
    return np.where(found[:, None], repaired, f), found


def settled(sigma: FloatArray, parts: Components) -> FloatArray:
    """Give the vertices of a component with strong noise one value, in a map (n,) of the noise; NaN stays.

    Strong is at least half of the 90 percent quantile; the value is the median of these. Less than a factor of two is
    chance in a map, and one number is more exact; weaker noise in other parts keeps its map.
    """
    filled = np.nan_to_num(sigma)
    strong = filled >= parts.quantiles(filled, 0.9)[parts.labels] / _EVEN
    levels = parts.medians(filled[strong], parts.labels[strong])
    return np.where(strong & ~np.isnan(sigma), levels[parts.labels], sigma)


def ranges(x: FloatArray, parts: Components) -> FloatArray:
    """Return the distance of the quantiles of 1 and 99 percent of values (n,) in each component, (c,)."""
    found: FloatArray = parts.quantiles(x, 0.99) - parts.quantiles(x, 0.01)
    return found
