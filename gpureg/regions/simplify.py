"""Image simplification: :func:`simplify_image` (section 5.2, Fig. 4)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Literal, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import unmasked
from ..backends import Chosen
from ..backends.zones import Labels
from ..checks import choice, integer, number
from ..doors import door, outside
from ..frame import spread
from ..graphs.edges import Metric, checked_spacing
from ..graphs.grid import GridGraph
from ..images.guides import filled
from ..images.options import check_run
from ..images.raster import Raster
from . import sources as found_sources
from .graph import METRICS, region_graph
from .options import REGION_MODEL, RegionModel
from .partition import energy_partition
from .regions import Regions, models_of
from .values import MODELS, Model

SourceKind = Literal["extrema", "gradient"]
SOURCES: tuple[SourceKind, ...] = ("extrema", "gradient")

# Standard deviations that are tried, in pixels, and the largest share of regions: the paper removes 90 percent.
SMOOTHING = (0.0, 0.5, 0.75, 1.0, 1.5, 2.0)
ENOUGH = 0.1

# A smoothed copy is rounded to 2^-16 of its spread, so that rounding errors make no extrema in flat parts.
_SMOOTH_BITS = 16


@door(options=REGION_MODEL)
def simplify_image(
    image: npt.ArrayLike | Raster,
    *,
    lam: float = 0.05,
    rings: int = 1,
    sources: SourceKind | int | npt.ArrayLike = "extrema",
    smooth: float | None = None,
    model: Model = "mean",
    metric: Metric = "cityblock",
    compactness: float = 0.0,
    merge_tol: float | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    **options: Unpack[RegionModel],
) -> Regions:
    """Simplify an image or a volume: divide it into regions around its extrema, and regularize the regions.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels. Results and parameters are in its units.
    lam : float, default 0.05
        Fidelity >= 0 of the function on the regions.
    p, weights, h, by_size, max_iter, gamma, coupled
        As in :meth:`Regions.regularized`; ``max_iter=0`` means no regularization.
    rings : int, default 1
        Regions up to this number of steps apart are neighbours.
    sources : {"extrema", "gradient"}, int or array, default "extrema"
        Where the regions start: regional extrema of the intensity (the mean of the channels), or regional minima of the
        gradient norm. An integer means a grid of seeds with this distance in pixels. An array in the shape of the
        pixels has a label >= 0 at the sources, -1 elsewhere, such as a labelling of all pixels by another program. Its
        labels need not begin at 0 nor follow each other: regions are numbered in their order. Labels outside the mask
        are left out.
    smooth : float, optional
        Standard deviation, in pixels, of a Gaussian smoothing before sources and partition are computed; the models are
        computed from the image itself. None means 0 for given sources. For "extrema" and "gradient" it means the first
        of 0, 0.5, 0.75, 1, 1.5 and 2 with at most one region per ten pixels (see `Regions.smooth`).
    model : {"mean", "median", "source"}, default "mean"
        The value of a region before regularization.
    metric : {"cityblock", "chebyshev"}, default "cityblock"
        Pixels are neighbours across edges (the paper's G_0), or also across corners (G_1).
    compactness : float, default 0
        As in :func:`gpureg.energy_partition`: a larger value makes rounder regions.
    merge_tol : float, optional
        Merge regions whose regularized values have at most this distance (:meth:`Regions.merged`).
    mask : bool array, optional
        True where a pixel takes part. The other pixels are in no region and are returned unchanged.
    spacing : sequence of float, optional
        Size of a pixel along each axis, for borders, sizes and centroids; None means 1.
    channel_axis : int, optional
        The axis of the channels; None for a grey image.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`, for the function on the regions.

    Returns
    -------
    Regions
        Its `value` is the simplified image, `fine` the image before regularization, `labels` the partition, `graph` the
        region adjacency graph.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`. Or given sources have no -1, and 0 at more than half of the pixels: it may be
        the background of markers, and is taken for a source.

    Notes
    -----
    This is section 5.2: the energy partition of the extrema, one model for each region, and the process of eq. 25 on
    the region adjacency graph. ``lam=0`` with p = 2, "similarity" and 30 iterations gives Fig. 4.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> image = np.kron([[20, 180], [180, 20]], np.ones((16, 16))).astype(np.uint8)
    >>> found = gr.simplify_image(image, backend="numpy")
    >>> found
    Regions(4 regions on (32, 32), 4 borders)
    >>> bool((found.fine == image).all()), round(found.percent, 2)
    (True, 0.39)
    """
    asked: dict[str, Any] = REGION_MODEL | options
    raster = Raster.of(image, channel_axis, mask)
    check_run(asked)  # type: ignore[arg-type]
    if raster.inside is not None and not raster.inside.any():
        raise ValueError("the mask leaves no pixel: at least one value must be True")
    choice("model", model, MODELS)
    choice("metric", metric, METRICS)
    integer("rings", rings, low=1)
    number("lam", lam, low=0, finite=False)
    if merge_tol is not None:
        number("merge_tol", merge_tol, low=0, finite=False)
    if smooth is not None:
        smooth = number("smooth", smooth, low=0)
    if asked["max_iter"] is not None:
        integer("max_iter", asked["max_iter"], low=0)
    backend = asked["backend"]
    grid = GridGraph(raster.shape, 1, metric, mask=raster.inside)
    checked_spacing(spacing, grid.ndim)
    seconds: dict[str, float] = {}
    with _timed(seconds, "sources"):
        seen, seeds, sigma = _seen(raster.cells, grid, sources, smooth, backend)
    with _timed(seconds, "partition"):
        labels = energy_partition(seen, grid, seeds, compactness=compactness, backend=backend)
    if raster.inside is not None and (labels[raster.inside] < 0).any():
        raise ValueError("the markers reach only a part of the mask: give each connected part a marker")
    with _timed(seconds, "graph"):
        adjacency: dict[str, Any] = {"metric": metric, "spacing": spacing, "rings": rings}
        graph = region_graph(labels, **adjacency)
    with _timed(seconds, "models"):
        own = seeds if model == "source" else None
        models = models_of(raster, labels, model, own, graph.n_vertices)
    fine = Regions(
        raster.values,
        labels,
        graph,
        models,
        models,
        model,
        sigma,
        raster.channel_axis,
        None,
        seconds,
        _seeds=own,
        _settings=adjacency,
    )
    found = fine.regularized(lam=lam, **options)
    return found if merge_tol is None else found.merged(merge_tol)


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    begin = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - begin


def _seen(
    cells: npt.NDArray[Any],
    grid: GridGraph,
    given: SourceKind | int | npt.ArrayLike,
    smooth: float | None,
    backend: Chosen,
) -> tuple[npt.NDArray[Any], Labels, float]:
    """Return the smoothed image for the partition, its sources, and the standard deviation of the smoothing."""
    if isinstance(given, str):
        if given not in SOURCES:
            raise ValueError(f"sources must be one of {', '.join(SOURCES)}, an integer or an array, got {given!r}")
        find = found_sources.extrema if given == "extrema" else found_sources.gradient_minima
        pixels = int(grid.n_vertices if grid.mask is None else grid.mask.sum())
        for sigma in SMOOTHING if smooth is None else (smooth,):
            seen = _smoothed(cells, grid, sigma)
            seeds = find(seen, grid, backend=backend)
            if int(seeds.max()) + 1 <= ENOUGH * pixels:
                break
        return seen, seeds, sigma
    sigma = 0.0 if smooth is None else smooth
    step = isinstance(given, int | np.integer) and not isinstance(given, bool)
    seeds = found_sources.seeds(grid, int(given)) if step else _numbered(given, grid)  # type: ignore[arg-type]
    return _smoothed(cells, grid, sigma), seeds, sigma


def _numbered(given: npt.ArrayLike, grid: GridGraph) -> npt.NDArray[Any]:
    """Return given labels numbered from 0, in their order, -1 elsewhere; anything else as it is, to be refused."""
    labels = unmasked(given, "sources")
    if labels.dtype.kind not in "iu" or labels.shape != grid.shape or (labels < -1).any():
        return labels
    marked = labels >= 0
    if grid.mask is not None:
        marked = marked & grid.mask
    numbers, which = np.unique(labels[marked], return_inverse=True)
    background = marked.all() and len(numbers) > 2 and numbers[0] == 0
    if background and np.count_nonzero(labels == 0) > labels.size / 2:
        warnings.warn(
            "sources are 0 at more than half of the pixels, never -1: 0 is a label like any other, -1 means no source",
            UserWarning,
            stacklevel=outside(),
        )
    numbered = np.full(labels.shape, -1, np.int32)
    numbered[marked] = which
    return numbered


def _smoothed(cells: npt.NDArray[Any], grid: GridGraph, sigma: float) -> npt.NDArray[Any]:
    """Smooth the image by a Gaussian, in float64; pixels outside the mask are replaced by the nearest inside."""
    if sigma == 0:
        return cells
    from scipy import ndimage

    values = cells.astype(np.float64)
    if grid.mask is not None and not grid.mask.all():
        values = filled(values, grid.mask)
    values = ndimage.gaussian_filter(values, (sigma,) * grid.ndim + (0.0,))
    width = spread(values.reshape(-1, values.shape[-1]))
    if width == 0:
        return values
    unit = 2.0 ** (np.frexp(width)[1] - _SMOOTH_BITS)
    rounded: npt.NDArray[Any] = np.rint(values / unit) * unit
    return rounded
