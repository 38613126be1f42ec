"""Measure noise on the vertices of a graph from the neighbourhood of each vertex: :func:`local_noise`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.components import Components, sorted_medians
from ..graphs.csr import Graph
from .graphs import MEDIAN, averaging

# Averages over neighbours that smooth a map of the noise; after k of them it reaches about sqrt(k) edges.
_SMOOTH = 10

# A value is an impulse if it is beyond all neighbours but one by more than this number of standard deviations of the
# noise there, and than this share of the range of the values.
_FAR, _SHARE = 5.0, 0.1


def row_medians(indptr: npt.NDArray[np.integer], values: FloatArray) -> FloatArray:
    """Return the median of the values of each row of a CSR structure, (n,); NaN for an empty row."""
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    return sorted_medians(values[np.lexsort((values, rows))], indptr)


def ring_medians(graph: Graph, values: FloatArray) -> FloatArray:
    """Return the median of values (n,) over each vertex and its neighbours, (n,)."""
    n = graph.n_vertices
    rows = np.concatenate([graph.edge_rows(), np.arange(n)])
    around = np.concatenate([values[graph.indices], values])
    indptr = graph.indptr + np.arange(n + 1)
    return sorted_medians(around[np.lexsort((around, rows))], indptr)


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


def map_of(graph: Graph, size: FloatArray, M: Any = None) -> FloatArray:
    """Compute a map of the standard deviation (n,) from the absolute values (n,) of samples of normal noise.

    It is the median of medians over neighbours, and smooth: noise in a part of the graph is found in this part, and a
    few far values do not count.
    """
    medians = ring_medians(graph, ring_medians(graph, size)) / MEDIAN
    smooth: FloatArray = np.sqrt(spread(graph, medians**2, _SMOOTH, M))
    return smooth


def local_noise(f: FloatArray, graph: Graph) -> FloatArray:
    """Estimate the standard deviation of white noise at each vertex, (n,), of a function (n, m) smooth on the graph.

    Channels are taken together: the noise of one is the root mean square over all.
    """
    M = averaging(graph)
    growth = twice_growth(graph, M)
    found = np.zeros(graph.n_vertices)
    once = f - M @ f
    twice = np.abs(once - M @ once) / growth[:, None]
    for size in twice.T:
        found += map_of(graph, size, M) ** 2
    sigma: FloatArray = np.sqrt(found / f.shape[1])
    return sigma


def twice_growth(graph: Graph, M: Any) -> FloatArray:
    """Compute the deviation of (I - M)^2 f for white noise f of deviation 1, (n,); infinite without neighbours."""
    from scipy import sparse

    T = sparse.csr_array(sparse.eye_array(graph.n_vertices, format="csr") - M)
    growth = np.sqrt(np.asarray((T @ T).power(2).sum(axis=1)).ravel())
    return np.where(np.diff(graph.indptr) > 0, growth, np.inf)


def impulses(
    f: FloatArray, graph: Graph, parts: Components, sigma: FloatArray
) -> npt.NDArray[np.bool_]:
    """Find vertices whose value (n, m) is far beyond those of their neighbours, (n,) bool; `sigma`, (n,), is the noise.

    Far is more than five standard deviations beyond all neighbours but one, and more than a tenth of the range of the
    values of the component without their outer hundredths. A vertex with fewer than three neighbours is none.
    """
    rows = graph.edge_rows()
    found = np.zeros(graph.n_vertices, bool)
    judged = np.flatnonzero(np.diff(graph.indptr) >= 3)
    for x in f.T:
        around = x[graph.indices]
        around = around[np.lexsort((around, rows))]
        beyond = np.maximum(
            x[judged] - around[graph.indptr[judged + 1] - 2], around[graph.indptr[judged] + 1] - x[judged]
        )
        far = np.maximum(_FAR * sigma, _SHARE * ranges(x, parts)[parts.labels])
        found[judged] |= beyond > far[judged]
    return found


def ranges(x: FloatArray, parts: Components) -> FloatArray:
    """Return the distance of the quantiles of 1 and 99 percent of values (n,) in each component, (c,)."""
    found: FloatArray = parts.quantiles(x, 0.99) - parts.quantiles(x, 0.01)
    return found
