"""The door to image simplification: :func:`simplify_image` and :class:`Regions` (section 5.2, Fig. 4)."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from . import sources
from .graph import FloatArray, GridGraph, Metric, checked_spacing
from .partition import energy_partition
from .pixels import as_image, checked, filled
from .region_graph import RegionGraph, region_graph
from .region_values import MODELS, Model, region_values
from .regularization import regularize
from .result import Interrupted, Result
from .solvers import Solver
from .solvers.loop import Callback
from .weights import Weights, patch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Labels = npt.NDArray[np.int32]
SourceKind = Literal["extrema", "gradient"]
WeightKind = Literal["similarity", "constant", "border"]
SOURCES: tuple[SourceKind, ...] = ("extrema", "gradient")
WEIGHTS: tuple[WeightKind, ...] = ("similarity", "constant", "border")

# Standard deviations that are tried, in pixels, and the share of regions that is few enough: the paper's 90 percent.
SMOOTHING = (0.0, 0.5, 0.75, 1.0, 1.5, 2.0)
ENOUGH = 0.1

# A smoothed copy is rounded to 2^-16 of its range, so that what was flat has no extrema of rounding errors.
_SMOOTH_BITS = 16


@dataclass(frozen=True, eq=False)
class Regions:
    """An image as regions: a partition of its pixels, their graph, and a value for each region.

    Attributes
    ----------
    image : array
        The image, as it was given.
    labels : int32 array
        The region of each pixel, 0..k-1, in the image's shape without channels; -1 outside the mask.
    graph : RegionGraph
        The region adjacency graph, with sizes, borders and centroids.
    models : (k, m) float array
        The model of each region: its mean, median, or the value of its source.
    values : (k, m) float array
        The models after regularization on the graph; the models themselves before.
    model : {"mean", "median", "source"}
        What the models are.
    smooth : float
        Standard deviation, in pixels, of the Gaussian that the partition looked through; 0: none.
    channel_axis : int or None
        The axis of the image's channels.
    result : Result or None
        Of the regularization, None before.
    seconds : dict
        Wall-clock time by stage.
    """

    image: npt.NDArray[Any]
    labels: Labels
    graph: RegionGraph
    models: FloatArray
    values: FloatArray
    model: Model
    smooth: float
    channel_axis: int | None
    result: Result | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    # labels of the sources' pixels, -1 elsewhere, where they are the model
    _seeds: Labels | None = field(default=None, repr=False)
    _settings: dict[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return f"Regions({self.n_regions} regions on {self.image.shape}, {self.graph.n_edges // 2} borders)"

    @property
    def n_regions(self) -> int:
        """Number of regions, k."""
        return len(self.models)

    @property
    def percent(self) -> float:
        """Regions in percent of the pixels that are in one: what is left of the information."""
        return 100 * self.n_regions / int((self.labels >= 0).sum())

    @property
    def fine(self) -> npt.NDArray[Any]:
        """The image with each region painted in its model, in the image's dtype."""
        return self.paint(self.models)

    @property
    def value(self) -> npt.NDArray[Any]:
        """The image with each region painted in its regularized value, in the image's dtype."""
        return self.paint(self.values)

    def paint(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """An image like the given one, with each region in a value of its own; pixels in no region stay as they are.

        Parameters
        ----------
        values : (k,) or (k, m) array
            One value per region, or one a channel. Where the image holds integers they are rounded and clipped.
        """
        array = np.asarray(values, np.float64)
        array = array[:, None] if array.ndim == 1 else array
        if array.shape != self.models.shape:
            raise ValueError(f"values must have shape {self.models.shape}, got {np.shape(values)}")
        inside = self.labels >= 0
        if self.image.dtype.kind in "iu":
            # rounded once a region, not once a pixel
            limits = np.iinfo(self.image.dtype)
            array = np.clip(np.rint(array), limits.min, limits.max)
        painted = array.astype(self.image.dtype)[self.labels]
        return as_image(painted, self.image, self.channel_axis, None if inside.all() else inside)

    def random_colours(self, seed: int = 0) -> npt.NDArray[np.uint8]:
        """The partition with a random colour for each region, (..., 3); black outside the mask.

        Parameters
        ----------
        seed : int, default 0
            The same seed gives the same colours.
        """
        colours = np.random.default_rng(seed).integers(32, 256, (self.n_regions + 1, 3), dtype=np.uint8)
        colours[-1] = 0  # where -1 leads
        return colours[self.labels]

    def regularized(
        self,
        *,
        p: float = 2.0,
        lam: float | npt.ArrayLike = 0.05,
        weights: WeightKind | Weights | npt.ArrayLike = "similarity",
        h: float | None = None,
        by_size: bool = False,
        max_iter: int | None = 30,
        **settings: Any,
    ) -> Regions:
        """Regularize the regions' models on their graph.

        Parameters
        ----------
        p, lam, max_iter
            As in :func:`gpureg.regularize`; lam may have one value per region.
        weights : {"similarity", "constant", "border"}, Weights or array, default "similarity"
            "similarity" is w2^0 of the paper, exp(-|f(u) - f(v)|^2 / h^2) of the models. "border" takes the lengths of
            borders to the power of 2/p: with norm="edge" the smoothness is then that of the painted image. Or an object of :mod:`gpureg.weights`, for which regions lie at their centroids, or one value per stored
            directed edge of `graph`.
        h : float, optional
            Of "similarity", in the image's units; None takes twice the median distance of neighbouring models.
        by_size : bool, default False
            Multiply lam by the regions' sizes over their mean: a pixel counts as much in a large region as in a small
            one.
        **settings
            Others of :func:`gpureg.regularize`: norm, gamma, coupled, eps, solver, tol, backend, dtype, callback,
            progress.

        Returns
        -------
        Regions
            With new `values` and `result`.

        Raises
        ------
        ValueError, TypeError, BackendUnavailable, FloatingPointError, Interrupted
            As :func:`gpureg.regularize`; the value of an interrupted run is an image.
        """
        begin = time.perf_counter()
        fidelity: float | npt.ArrayLike = lam
        if by_size:
            assert self.graph.sizes is not None
            fidelity = np.asarray(lam, np.float64) * self.graph.sizes / self.graph.sizes.mean()
        chosen = _weights(self.graph, self.models, weights, h, p)
        try:
            result = regularize(
                self.models, self.graph, p=p, lam=fidelity, weights=chosen, max_iter=max_iter, **settings
            )
        except Interrupted as interruption:
            painted = self.paint(interruption.result.value)
            raise Interrupted(replace(interruption.result, value=painted)) from None
        return replace(
            self,
            values=result.value.astype(np.float64),
            result=result,
            seconds={**self.seconds, "regularization": time.perf_counter() - begin},
        )

    def merged(self, tol: float) -> Regions:
        """Join neighbouring regions whose values have met: a coarser partition.

        Parameters
        ----------
        tol : float
            Values whose distance is at most this, in the image's units, are joined, and what is joined to either.

        Returns
        -------
        Regions
            With the models of the new regions; their values are the means of the old ones by size.

        Raises
        ------
        ValueError
            A tolerance that is no number >= 0.
        """
        from scipy import sparse
        from scipy.sparse.csgraph import connected_components

        if not (isinstance(tol, int | float | np.integer | np.floating) and tol >= 0):
            raise ValueError(f"tol must be a number >= 0, got {tol!r}")
        begin = time.perf_counter()
        k, graph = self.n_regions, self.graph
        assert graph.sizes is not None
        met = graph.distances(self.values) <= tol
        links = sparse.csr_array((np.ones(int(met.sum()), bool), (graph.edge_rows()[met], graph.indices[met])), (k, k))
        part = connected_components(links, directed=False)[1]
        # in the order of their first regions
        first = np.sort(np.unique(part, return_index=True)[1])
        number = np.empty(len(first), np.int32)
        number[part[first]] = np.arange(len(first))
        joined = number[part]
        labels: Labels = np.append(joined, np.int32(-1))[self.labels]
        seeds = None if self._seeds is None else np.append(joined, np.int32(-1))[self._seeds]
        models = _models(self.image, self.channel_axis, labels, self.model, seeds, len(first))
        mass = np.bincount(joined, graph.sizes)
        values = np.stack([np.bincount(joined, graph.sizes * v) / mass for v in self.values.T], axis=1)
        coarse = region_graph(labels, **self._settings)
        seconds = {**self.seconds, "merging": time.perf_counter() - begin}
        return replace(self, labels=labels, graph=coarse, models=models, values=values, seconds=seconds, _seeds=seeds)

    def hierarchy(self, lams: Iterable[float], *, tol: float, **settings: Any) -> tuple[Regions, ...]:
        """Coarser and coarser partitions: regularize with one lam after another, and join what has met each time.

        Parameters
        ----------
        lams : iterable of float
            Fidelities, each smaller than the one before.
        tol : float
            As in :meth:`merged`.
        **settings
            As in :meth:`regularized`; p < 1 makes values meet.

        Returns
        -------
        tuple of Regions
            One per lam. Each partition's regions are unions of those of the one before.

        Raises
        ------
        ValueError
            No lam, or one that is not smaller than the one before.
        """
        steps = [float(lam) for lam in lams]
        if not steps or any(b >= a for a, b in itertools.pairwise(steps)):
            raise ValueError(f"lams must fall, one after another, got {steps}")
        levels, current = [], self
        for lam in steps:
            current = current.regularized(lam=lam, **settings).merged(tol)
            levels.append(current)
        return tuple(levels)

    def plot(self, *, seed: int = 0, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the image, the partition in random colours, and the image painted with models and with values.

        Parameters
        ----------
        seed : int, default 0
            Of the colours.
        path : path, optional
            A picture file to write besides.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ImportError, OSError, ValueError
            As :func:`gpureg.plot.simplification`.
        """
        from .plot import simplification

        return simplification(
            self.image,
            self.random_colours(seed),
            self.fine,
            self.value,
            path=path,
            spacing=self._settings.get("spacing"),
            caption=f"{self.n_regions} regions, {self.percent:.1f} percent of the pixels",
            channel_axis=self.channel_axis,
        )


def simplify_image(
    image: npt.ArrayLike,
    *,
    p: float = 2.0,
    lam: float = 0.05,
    max_iter: int | None = 30,
    tol: float | None = None,
    weights: WeightKind | Weights | npt.ArrayLike = "similarity",
    h: float | None = None,
    norm: str = "vertex",
    gamma: str | npt.ArrayLike = "sqrt",
    coupled: bool = True,
    by_size: bool = False,
    rings: int = 1,
    sources: SourceKind | int | npt.ArrayLike = "extrema",
    smooth: float | None = None,
    model: Model = "mean",
    metric: Metric = "cityblock",
    compactness: float = 0.0,
    merge: float | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    solver: str | Solver = "jacobi",
    eps: float | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
) -> Regions:
    """Simplify an image or a volume: cut it into zones around its extrema, and regularize these instead of pixels.

    Parameters
    ----------
    image : array
        Two or more axes, besides the channels. Values are used as they come, never rescaled.
    p, lam, max_iter, tol, norm, gamma, coupled, solver, eps, backend, dtype, callback, progress
        As in :func:`gpureg.regularize`, for the functions on the regions; ``max_iter=0`` leaves the fine partition.
    weights, h, by_size
        As in :meth:`Regions.regularized`.
    rings : int, default 1
        Regions so many steps apart are neighbours too.
    sources : {"extrema", "gradient"}, int or array, default "extrema"
        Where zones grow from: the regional extrema of the intensity (the mean of the channels), the regional minima of
        the gradient's norm, a grid of seeds so many pixels apart, or markers: labels 0..k-1 at the pixels of the
        sources, -1 elsewhere.
    smooth : float, optional
        Standard deviation, in pixels, of a Gaussian through which sources and partition see the image; the models are
        always of the image itself. None: for extrema and gradient the first of 0, 0.5, 0.75, 1, 1.5 and 2 that leaves
        one region to ten pixels or fewer, which `Regions.smooth` tells; otherwise 0.
    model : {"mean", "median", "source"}, default "mean"
        What a region is painted with.
    metric : {"cityblock", "chebyshev"}, default "cityblock"
        Pixels are neighbours across edges (the paper's G_0), or corners too (G_1).
    compactness : float, default 0
        As in :func:`gpureg.energy_partition`: larger makes rounder zones.
    merge : float, optional
        Join regions whose regularized values are at most so far apart (:meth:`Regions.merged`).
    mask : bool array, optional
        True where a pixel takes part. The others are in no region, and come back as they are.
    spacing : sequence of float, optional
        Size of a pixel along each axis, for borders, sizes and centroids; None means 1.
    channel_axis : int, optional
        The axis of the channels; None for a grey image.

    Returns
    -------
    Regions
        Its `value` is the simplified image, `fine` the one before regularization, `labels` the partition, `graph` the
        region adjacency graph.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Section 5.2: the energy partition of the extrema, one model for each zone, and the process of eq. 25 on the region
    adjacency graph. ``lam=0`` with p = 2, "similarity" and 30 iterations is Fig. 4.

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
    array = checked(image, channel_axis, mask)
    inside = None if mask is None else np.asarray(mask)
    if inside is not None and not inside.any():
        raise ValueError("the mask leaves no pixel: True is where one takes part")
    if model not in MODELS:
        raise ValueError(f"model must be one of {', '.join(MODELS)}, got {model!r}")
    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    grid = GridGraph(cells.shape[:-1], 1, metric, mask=inside)
    checked_spacing(spacing, grid.ndim)
    seconds: dict[str, float] = {}
    with _timed(seconds, "sources"):
        seen, seeds, sigma = _seen(cells, grid, sources, smooth, backend)
    with _timed(seconds, "partition"):
        labels = energy_partition(seen, grid, seeds, compactness=compactness, backend=backend)
    if inside is not None and (labels[inside] < 0).any():
        raise ValueError("the markers reach only a part of the mask: give each of its pieces a marker")
    with _timed(seconds, "graph"):
        adjacency: dict[str, Any] = {"metric": metric, "spacing": spacing, "rings": rings}
        graph = region_graph(labels, **adjacency)
    if graph.n_vertices != int(labels.max()) + 1:
        raise ValueError(f"markers must be numbered 0..k-1, {int(labels.max()) + 1 - graph.n_vertices} are missing")
    with _timed(seconds, "models"):
        kept = seeds if model == "source" else None
        models = _models(array, channel_axis, labels, model, kept, graph.n_vertices)
    fine = Regions(
        array,
        labels,
        graph,
        models,
        models,
        model,
        sigma,
        channel_axis,
        None,
        seconds,
        _seeds=kept,
        _settings=adjacency,
    )
    found = fine.regularized(
        p=p,
        lam=lam,
        weights=weights,
        h=h,
        by_size=by_size,
        max_iter=max_iter,
        tol=tol,
        norm=norm,
        gamma=gamma,
        coupled=coupled,
        solver=solver,
        eps=eps,
        backend=backend,
        dtype=dtype,
        callback=callback,
        progress=progress,
    )
    return found if merge is None else found.merged(merge)


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
    backend: str,
) -> tuple[npt.NDArray[Any], Labels, float]:
    """What the partition looks at, the sources in it, and the standard deviation of the smoothing."""
    if smooth is not None and not (isinstance(smooth, int | float | np.integer | np.floating) and 0 <= smooth < np.inf):
        raise ValueError(f"smooth must be a number >= 0, or None, got {smooth!r}")
    if isinstance(given, str):
        if given not in SOURCES:
            raise ValueError(f"sources must be one of {', '.join(SOURCES)}, an integer or an array, got {given!r}")
        find = sources.extrema if given == "extrema" else sources.gradient_minima
        pixels = int(grid.n_vertices if grid.mask is None else grid.mask.sum())
        for sigma in SMOOTHING if smooth is None else (float(smooth),):
            seen = _smoothed(cells, grid, sigma)
            seeds = find(seen, grid, backend=backend)
            if int(seeds.max()) + 1 <= ENOUGH * pixels:
                break
        return seen, seeds, sigma
    sigma = 0.0 if smooth is None else float(smooth)
    seeds = sources.seeds(grid, int(given)) if isinstance(given, int | np.integer) else np.asarray(given)
    return _smoothed(cells, grid, sigma), seeds, sigma


def _smoothed(cells: npt.NDArray[Any], grid: GridGraph, sigma: float) -> npt.NDArray[Any]:
    """The image through a Gaussian, in float64; pixels outside the mask count as the nearest inside."""
    if sigma == 0:
        return cells
    from scipy import ndimage

    values = cells.astype(np.float64)
    if grid.mask is not None and not grid.mask.all():
        values = filled(values, grid.mask)
    values = ndimage.gaussian_filter(values, (sigma,) * grid.ndim + (0.0,))
    spread = float(np.ptp(values))
    if spread == 0:
        return values
    unit = 2.0 ** (np.frexp(spread)[1] - _SMOOTH_BITS)
    rounded: npt.NDArray[Any] = np.rint(values / unit) * unit
    return rounded


def _models(
    array: npt.NDArray[Any],
    channel_axis: int | None,
    labels: Labels,
    model: Model,
    seeds: Labels | None,
    n_regions: int,
) -> FloatArray:
    """The models of all regions, (k, m)."""
    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    return region_values(cells, labels, model, sources=seeds, n_regions=n_regions)


def _weights(
    graph: RegionGraph, models: FloatArray, weights: Any, h: float | None, p: float
) -> Weights | npt.ArrayLike | None:
    """What :func:`gpureg.regularize` takes."""
    if not isinstance(weights, str):
        if h is not None:
            raise ValueError("h belongs to weights='similarity'")
        return weights  # type: ignore[no-any-return]
    if weights not in WEIGHTS:
        allowed = f"{', '.join(WEIGHTS)}, an object of gpureg.weights or an array"
        raise ValueError(f"weights must be one of {allowed}, got {weights!r}")
    if h is not None and weights != "similarity":
        raise ValueError("h belongs to weights='similarity'")
    if weights == "constant" or not graph.n_edges:
        return None
    if weights == "similarity":
        if h is None:
            h = 2 * float(np.median(graph.distances(models)))
        return patch(0, h) if h > 0 else None
    assert graph.borders is not None
    with np.errstate(over="ignore"):
        lengths = graph.borders ** (2 / p)
    if not lengths.max() < np.finfo(np.float32).max ** 0.5:
        raise ValueError(f"borders to the power of 2/p = {2 / p:g} are too large to compute with: take a larger p")
    return lengths
