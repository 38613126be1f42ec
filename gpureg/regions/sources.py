"""Sources of an energy partition: regional extrema, minima of the gradient, a grid of seeds (section 5.2)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray
from ..backends import Chosen
from ..backends.zones import Labels
from ..checks import choice, integer
from ..doors import door
from ..frame import Frame
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph
from .partition import flat_zones, step_bands, vertex_values

Kind = Literal["both", "minima", "maxima"]
KINDS: tuple[Kind, ...] = ("both", "minima", "maxima")

Flags = npt.NDArray[np.bool_]


@door
def extrema(f: npt.ArrayLike, graph: GraphLike, *, kind: Kind = "both", backend: Chosen = "auto") -> Labels:
    """Label the regional extrema of a function: flat zones without a lower neighbour, or without a higher one.

    Parameters
    ----------
    f : array
        As in :func:`gpureg.energy_partition`. For several channels their mean is used, the intensity.
    graph : Graph or GridGraph
        Its weights are not used.
    kind : {"both", "minima", "maxima"}, default "both"
    backend : str, default "auto"
        As in :func:`gpureg.regularize`; all backends give the same labels.

    Returns
    -------
    int32 array
        0..k-1 on the k extrema, in the order of their first vertices, -1 elsewhere; the grid's shape, or (n,). Every
        connected part has an extremum; if the function is constant on the part, the extremum is the whole part.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.energy_partition`.

    Notes
    -----
    Extrema are whole plateaus, as in mathematical morphology. A vertex without a higher neighbour is not an extremum if
    another vertex of its plateau has one.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.sources.extrema([3, 3, 1, 2, 2, 5], gr.GridGraph(6), backend="numpy")
    array([ 0,  0,  1, -1, -1,  2], dtype=int32)
    """
    choice("kind", kind, KINDS)
    graph = as_graph(graph)
    values = vertex_values(f, graph)
    if values.shape[1] > 1:
        values = values.mean(axis=1, dtype=np.float64, keepdims=True)
    return _shaped(_regional(values, graph, kind, backends.get(backend, np.float32)), graph)


@door
def gradient_minima(f: npt.ArrayLike, graph: GraphLike, *, backend: Chosen = "auto") -> Labels:
    """Label the regional minima of the gradient norm of a function.

    Parameters
    ----------
    f : array
        As in :func:`gpureg.energy_partition`; the gradient is that of all channels.
    graph : Graph or GridGraph
        Its weights are not used.
    backend : str, default "auto"
        As in :func:`gpureg.regularize`; all backends give the same labels.

    Returns
    -------
    int32 array
        As :func:`extrema`.

    Raises
    ------
    ValueError, TypeError, BackendUnavailable
        As :func:`gpureg.energy_partition`.

    Notes
    -----
    The norm is the square root of the sum of (f(v) - f(u))^2 over the neighbours v of u, eq. 9 with w = 1.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.sources.gradient_minima([0, 0, 0, 4, 9, 9], gr.GridGraph(6), backend="numpy")
    array([ 0,  0, -1, -1, -1,  1], dtype=int32)
    """
    graph = as_graph(graph)
    values = vertex_values(f, graph)
    return _shaped(
        _regional(_squared_gradient(values, graph), graph, "minima", backends.get(backend, np.float32)), graph
    )


@door
def seeds(graph: GridGraph, step: int) -> Labels:
    """Label a grid of seeds: single cells, `step` cells apart along every axis, in the middle of their blocks.

    Parameters
    ----------
    graph : GridGraph
        Seeds outside its mask are left out.
    step : int
        At least 1.

    Returns
    -------
    int32 array
        0..k-1 on the seeds, in row-major order, -1 elsewhere; the grid's shape.

    Raises
    ------
    TypeError, ValueError
        A stored graph, a step that is not an integer >= 1, a mask without a seed.

    Examples
    --------
    >>> import gpureg as gr
    >>> gr.sources.seeds(gr.GridGraph((2, 6)), 3)
    array([[-1, -1, -1, -1, -1, -1],
           [-1,  0, -1, -1,  1, -1]], dtype=int32)
    """
    if not isinstance(graph, GridGraph):
        raise TypeError(f"seeds need a GridGraph, got {type(graph).__name__}")
    step = integer("step", step, low=1)
    seeded: Flags = np.zeros(graph.shape, bool)
    # the middle of each block, or of an axis that is shorter than a block
    seeded[tuple(slice(min(step, size) // 2, None, step) for size in graph.shape)] = True
    if graph.mask is not None:
        seeded &= graph.mask
    count = int(seeded.sum())
    if not count:
        raise ValueError(f"no seed lies inside the mask: take a step smaller than {step}")
    labels: Labels = np.full(graph.shape, -1, np.int32)
    labels[seeded] = np.arange(count)
    return labels


def _shaped(labels: Labels, graph: AnyGraph) -> Labels:
    return labels.reshape(graph.shape) if isinstance(graph, GridGraph) else labels


def _inside(graph: AnyGraph) -> Flags:
    if isinstance(graph, GridGraph) and graph.mask is not None:
        return graph.mask.reshape(-1)
    return np.ones(graph.n_vertices, bool)


def _regional(g: FloatArray, graph: AnyGraph, kind: Kind, device: backends.Backend) -> Labels:
    """Number the flat zones of g, (n, 1), that are extrema; -1 elsewhere."""
    zone = flat_zones(g, graph, device)
    below, above = _neighbours(g.reshape(-1), graph)
    extremal: Flags = np.zeros(len(zone), bool)
    for has, wanted in ((below, "minima"), (above, "maxima")):
        if kind in ("both", wanted):
            free = np.ones(len(zone), bool)
            free[zone[has]] = False
            extremal |= free
    # a zone is identified by its first vertex; zones are numbered in this order
    extremal &= _inside(graph)
    first = extremal & (zone == np.arange(len(zone)))
    number = np.cumsum(first, dtype=np.int32) - np.int32(1)
    labels: Labels = np.where(extremal[zone] & _inside(graph), number[zone], np.int32(-1))
    return labels


def _neighbours(g: FloatArray, graph: AnyGraph) -> tuple[Flags, Flags]:
    """Return whether each vertex has a lower neighbour, and whether it has a higher one, both (n,)."""
    n = graph.n_vertices
    below, above = np.zeros(n, bool), np.zeros(n, bool)
    if isinstance(graph, Graph):
        u, v = graph.edge_rows(), graph.indices
        below[u[g[v] < g[u]]] = True
        above[u[g[v] > g[u]]] = True
        return below, above
    cells, low, high = g.reshape(graph.shape), below.reshape(graph.shape), above.reshape(graph.shape)
    for step in graph.forward_offsets:
        for start, end in step_bands(graph, step):
            rising, falling = cells[start] < cells[end], cells[start] > cells[end]
            if graph.mask is not None:
                both = graph.mask[start] & graph.mask[end]
                rising, falling = rising & both, falling & both
            high[start] |= rising
            low[end] |= rising
            low[start] |= falling
            high[end] |= falling
    return below, above


def _squared_gradient(f: FloatArray, graph: AnyGraph) -> FloatArray:
    """Compute the sum of |f(v) - f(u)|^2 over the neighbours v of each vertex u, (n, 1) in float64."""
    n, m = f.shape
    # only their order counts: squares of very small or large values would be 0 or infinite
    f = Frame.of(f).into(f, np.dtype(np.float64))
    if isinstance(graph, Graph):
        u = graph.edge_rows()
        d = f[graph.indices].astype(np.float64) - f[u]
        summed: FloatArray = np.bincount(u, (d**2).sum(axis=1), n)[:, None].astype(np.float64)
        return summed
    total = np.zeros(graph.shape)
    cells = f.reshape(*graph.shape, m)
    for step in graph.forward_offsets:
        for start, end in step_bands(graph, step):
            square = ((cells[end].astype(np.float64) - cells[start]) ** 2).sum(axis=-1)
            if graph.mask is not None:
                square *= graph.mask[start] & graph.mask[end]
            total[start] += square
            total[end] += square
    return total.reshape(n, 1)
