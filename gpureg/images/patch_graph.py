"""The graph of a grid's most similar patches, for fast nonlocal iterations (section 5.2)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal, Unpack, cast

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, IntArray
from ..backends import Backend, Chosen
from ..checks import choice, integer, number
from ..doors import door
from ..frame import Frame
from ..graphs.csr import Graph
from ..graphs.edges import METRICS, Metric
from ..graphs.grid import GridGraph
from ..model.memory import budget
from ..model.problem import as_function
from ..progress import progress_bar
from ..weights import Patch, Weights, patch, patch_weights
from .guides import filled, guided_by
from .options import ON_PIXELS, OnPixels, check_run
from .raster import Raster

# Number of distances computed at a time.
_TABLE = 1 << 24
# Bytes per distance, with temporary arrays.
_ENTRY = 16

Symmetrize = Literal["max", "mutual"]
SYMMETRIZE: tuple[Symmetrize, ...] = ("max", "mutual")


@door(options=ON_PIXELS)
def patch_graph(
    image: npt.ArrayLike,
    k: int,
    *,
    patch_radius: int = 2,
    patch_sigma: float | None = None,
    radius: float = 10,
    metric: Metric = "chebyshev",
    symmetrize: Symmetrize = "max",
    **options: Unpack[OnPixels],
) -> Graph:
    """Join every pixel to the k pixels of its window whose patches are nearest to its own.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels.
    k : int
        Number of neighbours that each pixel chooses, at least 1; all pixels of a window that has fewer.
    patch_radius, patch_sigma
        The patch, as in :func:`gpureg.weights.patch`.
    radius, metric, spacing, mask, channel_axis
        The window, as in :func:`gpureg.denoise_image`.
    symmetrize : {"max", "mutual"}, default "max"
        "max" joins two pixels if one chose the other, "mutual" only if both did.
    guide : array, optional
        The image that the patches compare instead of `image`, e.g. a cleaner one: of its shape, or with other channels.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. There are no iterations: a callback is never called.

    Returns
    -------
    Graph
        A graph without weights. Its vertices are the pixels in row-major order. It has a grid and positions, so that
        all functions of :mod:`gpureg.weights` can be used on it.

    Raises
    ------
    TypeError, ValueError
        An argument out of its range, or values that are not real and finite.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    These are the k nearest patches of section 5.2. The paper's window of 21 x 21 has 440 edges per pixel; the best ten
    are the most important. The noise's share 2 sigma^2 is not subtracted: it is the same in all distances.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> stripes = np.tile([0.0, 1.0, 2.0], (9, 3))
    >>> graph = gr.patch_graph(stripes, 2, patch_radius=1, radius=3, backend="numpy")
    >>> values = stripes.ravel()
    >>> bool(np.all(values[graph.edge_rows()] == values[graph.indices]))
    True
    """
    asked = cast("OnPixels", ON_PIXELS | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    check_run(asked)
    integer("k", k, low=1)
    number("radius", radius, finite=False)
    choice("metric", metric, METRICS)
    grid = GridGraph(raster.shape, radius, metric, spacing=asked["spacing"], mask=raster.inside)
    f: npt.NDArray[Any] = raster.pixels()
    if raster.inside is not None and not raster.whole:
        f = filled(f, raster.inside)
    weights: Weights = patch(patch_radius, 1.0, patch_sigma=patch_sigma)
    if asked["guide"] is not None:
        weights = guided_by(weights, asked["guide"], grid, asked["channel_axis"])
    return nearest_patches(
        as_function(grid, f, "image"),
        grid,
        weights,
        k,
        symmetrize=symmetrize,
        backend=asked["backend"],
        dtype=asked["dtype"],
        memory=asked["memory"],
        progress=asked["progress"],
    )


def nearest_patches(
    f: FloatArray,
    grid: GridGraph,
    weights: Weights | npt.ArrayLike,
    k: int,
    *,
    symmetrize: Symmetrize = "max",
    backend: Chosen = "auto",
    dtype: npt.DTypeLike | None = None,
    memory: int | None = None,
    progress: bool = False,
) -> Graph:
    """Join the vertices of a grid by the distances of patch weights, as :func:`patch_graph` does.

    Parameters
    ----------
    f : (n, m) array
        The function on the grid that the patches compare.
    grid : GridGraph
    weights : Weights
        Patch weights, with or without a guide.
    k, symmetrize, backend, dtype, memory, progress
        As in :func:`patch_graph`.

    Raises
    ------
    TypeError, ValueError
        A `k` that is not an integer >= 1, weights that are not patch weights, an unknown `symmetrize`.
    """
    k = integer("k", k, low=1)
    choice("symmetrize", symmetrize, SYMMETRIZE)
    found = patch_weights(weights)
    function, guided = (None, None) if found is None else found
    if not isinstance(function, Patch):
        raise ValueError("nearest patches need patch weights: weights=gpureg.weights.patch(...)")
    compared = f if guided is None else guided.of(grid, f)
    # The same patch without noise, maps and cut.
    bare = patch(function.patch_radius, 1.0, patch_sigma=function.patch_sigma)
    device = backends.get(backend, np.float32 if dtype is None else dtype)
    # only the order of the distances counts
    compared = Frame.of(compared).into(compared, device.dtype)
    bands = _bands(grid, min(_TABLE, budget(device, memory).total // _ENTRY))
    rows, columns = [], []
    with progress_bar(progress, len(bands), "bands") as report:
        for done, (first, last) in enumerate(bands, start=1):
            u, v = _nearest(device, grid, compared, bare, k, first, last)
            rows.append(u)
            columns.append(v)
            report(done)
    return _symmetric(grid, np.concatenate(rows), np.concatenate(columns), symmetrize)


def _bands(grid: GridGraph, entries: int) -> list[tuple[int, int]]:
    """Return ranges along the first axis with at most `entries` distances each."""
    per_row = math.prod(grid.shape[1:]) * max(1, len(grid.offsets))
    step = max(1, entries // per_row)
    return [(first, min(first + step, grid.shape[0])) for first in range(0, grid.shape[0], step)]


def _nearest(
    device: Backend, grid: GridGraph, f: FloatArray, weights: Weights, k: int, first: int, last: int
) -> tuple[IntArray, IntArray]:
    """Return the k nearest neighbours of the vertices of a band of rows, as edges (u, v)."""
    found = patch_weights(weights)
    assert found is not None
    reach = int(np.abs(grid.offsets[:, 0]).max(initial=0))
    halo = reach + found[0].reach
    start, end = max(0, first - halo), min(grid.shape[0], last + halo)
    everything = tuple(slice(0, size) for size in grid.shape[1:])
    part = grid.part((slice(start, end), *everything))
    values = f.reshape(*grid.shape, -1)[start:end].reshape(-1, f.shape[1])
    form = replace(found[0].form(part, f.shape[1], device.dtype), scale=None, shift=0.0)
    rho = device.get_weights(device.patch_distance(part, values, form))
    assert rho is not None
    # one row of distances per vertex of the band, infinity where there is no neighbour
    own = slice(first - start, last - start)
    table = np.full((*part.shape, 2 * part.half_window), np.inf, rho.dtype)
    jumps = np.empty(2 * part.half_window, np.int64)
    for h, step in enumerate(part.forward_offsets):
        u, v = part.ends(step)
        distance = rho[h][u]
        if part.mask is not None:
            distance = np.where(part.mask[u] & part.mask[v], distance, np.inf)
        table[..., 2 * h][u] = table[..., 2 * h + 1][v] = distance
        jumps[2 * h], jumps[2 * h + 1] = step @ grid.strides, -(step @ grid.strides)
    distances = table[own].reshape(-1, len(jumps))
    if k < len(jumps):
        chosen = np.argpartition(distances, k - 1, axis=1)[:, :k]
    else:
        chosen = np.broadcast_to(np.arange(len(jumps)), distances.shape)
    there = np.isfinite(np.take_along_axis(distances, chosen, axis=1))
    vertices = np.arange(len(distances)) + first * grid.strides[0]
    neighbours = vertices[:, None] + jumps[chosen]
    return np.repeat(vertices, there.sum(axis=1)), neighbours[there]


def _symmetric(grid: GridGraph, u: IntArray, v: IntArray, symmetrize: Symmetrize) -> Graph:
    from scipy import sparse

    n = grid.n_vertices
    chosen = sparse.csr_array((np.ones(len(u), np.int8), (u, v)), shape=(n, n))
    joined = chosen.maximum(chosen.T) if symmetrize == "max" else chosen.minimum(chosen.T)
    joined = sparse.csr_array(joined)
    joined.eliminate_zeros()
    joined.sort_indices()
    return Graph(joined.indptr, joined.indices, None, grid.positions(), grid)
