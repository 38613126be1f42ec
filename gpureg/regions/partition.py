"""The partition of a graph into the zones of sources: :func:`energy_partition` (section 5.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Literal, overload

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, IntArray, all_finite, unmasked
from ..backends import Chosen
from ..backends.zones import LONGEST, Labels, Lengths
from ..checks import flag, number
from ..doors import door
from ..frame import spread as robust
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph

# Differences are rounded to 2^-24 of the data's range: to the last bit of float32; exact for integers up to 24 bits.
_BITS = 24
# Largest range that counts, in spreads of the data: a length is at most 32 times as long.
_FURTHEST = 1024
# Exponent of the smallest number of float64.
_LEAST = -1074

# Number of cells of a grid whose edge lengths are computed at a time.
_BAND = 1 << 18


@overload
def energy_partition(
    f: npt.ArrayLike,
    graph: GraphLike,
    sources: npt.ArrayLike,
    *,
    compactness: float = ...,
    return_energy: Literal[False] = False,
    backend: Chosen = ...,
) -> Labels: ...
@overload
def energy_partition(
    f: npt.ArrayLike,
    graph: GraphLike,
    sources: npt.ArrayLike,
    *,
    compactness: float = ...,
    return_energy: Literal[True],
    backend: Chosen = ...,
) -> tuple[Labels, FloatArray]: ...
@door
def energy_partition(
    f: npt.ArrayLike,
    graph: GraphLike,
    sources: npt.ArrayLike,
    *,
    compactness: float = 0.0,
    return_energy: bool = False,
    backend: Chosen = "auto",
) -> Labels | tuple[Labels, FloatArray]:
    """Label each vertex with the source from which a path with the smallest variation of f leads to it.

    Parameters
    ----------
    f : array
        The function on the n vertices: (n,) or (n, m); on a :class:`GridGraph` also its shape, or its shape and m.
    graph : Graph or GridGraph
        Its weights are not used.
    sources : int array
        A label >= 0 at the vertices of each source, -1 elsewhere; (n,) or the grid's shape. A source may have any
        number of vertices. :mod:`gpureg.regions.sources` finds sources.
    compactness : float, default 0
        Length that each edge adds to a path, in the units of f, at most 32 times the range of f. A larger value makes
        rounder zones.
    return_energy : bool, default False
        Return the energy too.
    backend : str, default "auto"
        As in :func:`gpureg.regularize`; all backends give the same labels.

    Returns
    -------
    labels : int32 array
        In the shape of `sources`; -1 outside the grid's mask and where no path leads from a source.
    energy : float64 array
        Only with `return_energy`: mu_S, the variation of f along the best path; infinite without a path.

    Raises
    ------
    ValueError, TypeError
        No source, shapes that do not match, labels below -1, sources outside the mask, values that are not finite.
    BackendUnavailable
        As :func:`gpureg.regularize`.

    Notes
    -----
    mu(u, v) is the smallest sum of |f(v_i) - f(v_i+1)| over the paths from u to v, with the Euclidean norm over
    channels. The zone of a source contains the vertices for which this source is the nearest (section 5.2; Arbelaez and
    Cohen, "Energy partitions and image segmentation", 2004). Among sources at the same distance, the one with the
    fewest edges on the path is chosen, then the one with the smallest label. Zones do not overlap, and the zone of a
    connected source is connected. Differences are rounded to 2^-24 of the range of f (at most 1024 times the spread of
    :func:`gpureg.regularize`: longer ones than 32 times that count as much) and added as integers, so that all devices
    give the same zones.

    Examples
    --------
    Two valleys, with a ridge between them:

    >>> import gpureg as gr
    >>> f = [0, 0, 5, 9, 2, 1]
    >>> line = gr.GridGraph(6)
    >>> gr.energy_partition(f, line, [0, -1, -1, -1, -1, 1], return_energy=True, backend="numpy")
    (array([0, 0, 0, 1, 1, 1], dtype=int32), array([0., 0., 5., 8., 1., 0.]))
    """
    graph = as_graph(graph)
    values = vertex_values(f, graph)
    labels = _checked(sources, graph)
    return_energy = flag("return_energy", return_energy)
    lengths, unit = edge_lengths(values, graph, number("compactness", compactness, low=0))
    device = backends.get(backend, np.float32)
    mu, found = device.influence_zones(graph, lengths, labels.reshape(-1).astype(np.int32))
    found = found.reshape(labels.shape)
    if not return_energy:
        return found
    energy: FloatArray = np.where(mu < 0, np.inf, mu * unit).reshape(labels.shape)
    return found, energy


def vertex_values(f: npt.ArrayLike, graph: AnyGraph, name: str = "f") -> FloatArray:
    """Check a function on the vertices, and convert it to a float array (n, m)."""
    array = unmasked(f, name)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must hold integers or real numbers, got {array.dtype}")
    n, shape = graph.n_vertices, graph.shape if isinstance(graph, GridGraph) else None
    if array.shape == (n,) or array.shape == shape:
        array = array.reshape(n, 1)
    elif shape is not None and array.ndim == len(shape) + 1 and array.shape[:-1] == shape:
        array = array.reshape(n, -1)
    if array.ndim != 2 or len(array) != n or not array.shape[1]:
        raise ValueError(
            f"{name} must have one value, or one row of channels, for each of {n} vertices, got shape {array.shape}"
        )
    inside = graph.mask if isinstance(graph, GridGraph) else None
    if inside is not None:
        array = np.where(inside.reshape(n, 1), array, array.dtype.type(0))
    if not all_finite(array):
        raise ValueError(f"{name} must be finite, got NaN or infinity: leave those cells out by the grid's mask")
    # float32 if it represents all values exactly
    narrow = array.dtype.itemsize <= 2 or array.dtype == np.float32
    values: FloatArray = array.astype(np.float32 if narrow else np.float64, copy=False)
    return values


def _checked(sources: npt.ArrayLike, graph: AnyGraph) -> IntArray:
    labels = unmasked(sources, "sources")
    if labels.dtype.kind not in "iu":
        raise TypeError(f"sources must be integers, a label for each source and -1 elsewhere, got {labels.dtype}")
    shapes = [(graph.n_vertices,), *([graph.shape] if isinstance(graph, GridGraph) else [])]
    if labels.shape not in shapes:
        raise ValueError(f"sources must have shape {' or '.join(map(str, shapes))}, got {labels.shape}")
    least, most = int(labels.min()), int(labels.max())
    if least < -1 or most >= 2**31:
        raise ValueError(f"labels of sources must lie in 0..2^31 - 1, or be -1, got {least if least < -1 else most}")
    if most < 0:
        raise ValueError("sources must have a label >= 0 at one vertex at least, got -1 everywhere")
    if isinstance(graph, GridGraph) and graph.mask is not None:
        outside = (labels.reshape(-1) >= 0) & ~graph.mask.reshape(-1)
        if outside.any():
            raise ValueError(f"sources must lie inside the grid's mask, {int(outside.sum())} of their cells do not")
    return labels


def edge_lengths(f: FloatArray, graph: AnyGraph, compactness: float = 0.0) -> tuple[Lengths, float]:
    """Compute the variation of f, (n, m), along each edge as a multiple of a unit, and the unit, a power of two."""
    inside = graph.mask.reshape(-1) if isinstance(graph, GridGraph) and graph.mask is not None else slice(None)
    part = f[inside]
    with np.errstate(over="ignore"):
        spread = part.max(axis=0).astype(np.float64) - part.min(axis=0) if len(part) else np.zeros(1)
    # if f is constant, the length of each edge is the compactness
    reach = math.hypot(*spread.tolist()) or compactness
    if math.isinf(reach):
        raise ValueError(f"the range of f must be below {np.finfo(np.float64).max:.2g}: scale it")
    # a few values far beyond all others do not take their digits
    reach = min(reach, _FURTHEST * typical) if (typical := robust(part)) > 0 else reach
    unit = 2.0 ** max(math.frexp(reach)[1] - _BITS, _LEAST) if reach > 0 else 1.0
    if compactness / unit > LONGEST / 2:
        raise ValueError(
            f"compactness must be at most {LONGEST // 2 * unit:g}, 32 times the range of f, got {compactness:g}"
        )
    toll = round(compactness / unit)

    def length(u: FloatArray, v: FloatArray) -> Lengths:
        # differences above the range of f belong to edges that leave the mask, which are dropped
        d = np.clip((v.astype(np.float64) - u) / unit, -LONGEST, LONGEST)
        variation = np.abs(d[:, 0]) if d.shape[1] == 1 else np.sqrt((d**2).sum(axis=1))
        along: Lengths = np.rint(np.minimum(variation, LONGEST // 2)).astype(np.int32)
        return along + np.int32(toll)

    return along_edges(f, graph, length), unit


def along_edges(f: FloatArray, graph: AnyGraph, length: Callable[[FloatArray, FloatArray], Lengths]) -> Lengths:
    """Compute lengths of edges (u, v) from the values (., m) at their ends; -1 if an edge leaves a grid or its mask."""
    if isinstance(graph, Graph):
        return length(f[graph.edge_rows()], f[graph.indices])
    n, m = f.shape
    out = np.full((n, graph.half_window), -1, np.int32)
    cells, planes = f.reshape(*graph.shape, m), out.reshape(*graph.shape, -1)
    for h, step in enumerate(graph.forward_offsets):
        for start, end in step_bands(graph, step):
            u, v = cells[start], cells[end]
            along = length(u.reshape(-1, m), v.reshape(-1, m)).reshape(u.shape[:-1])
            if graph.mask is not None:
                along = np.where(graph.mask[start] & graph.mask[end], along, np.int32(-1))
            planes[..., h][start] = along
    return out


def step_bands(graph: GridGraph, step: IntArray) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...]]]:
    """Yield slices for both ends of the edges along a step, for bands of the first axis."""
    start, end = graph.ends(step)
    rows = max(1, _BAND // max(1, math.prod(graph.shape[1:])))
    for first in range(start[0].start, start[0].stop, rows):
        last, jump = min(first + rows, start[0].stop), int(step[0])
        yield (slice(first, last), *start[1:]), (slice(first + jump, last + jump), *end[1:])


def flat_zones(f: FloatArray, graph: AnyGraph, device: backends.Backend) -> Labels:
    """Return the first vertex of the flat zone of each vertex, (n,): edges between equal values of f (n, m) join it."""

    def length(u: FloatArray, v: FloatArray) -> Lengths:
        equal = u[:, 0] == v[:, 0] if u.shape[1] == 1 else (u == v).all(axis=1)
        return np.where(equal, np.int32(0), np.int32(-1))

    return device.flat_zones(graph, along_edges(f, graph, length))
