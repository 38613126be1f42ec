"""An image as regions, with their regularization and merging: :class:`Regions` (section 5.2)."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..backends.zones import Labels
from ..checks import flag, integer, number
from ..doors import door
from ..exchange import on_host
from ..images.raster import Raster
from ..model.result import Interrupted, Result
from ..regularization.regularize import regularize
from ..weights import Weights, patch
from .graph import RegionGraph, region_graph
from .options import REGION_MODEL, WEIGHTS, RegionModel
from .values import Model, region_values


@dataclass(frozen=True, eq=False)
class Regions:
    """An image as regions: a partition of its pixels, their graph, and a value for each region.

    Attributes
    ----------
    image : array
        The given image, with any number of axes.
    labels : int32 array
        The region of each pixel, 0..k-1, in the image's shape without channels; -1 outside the mask.
    graph : RegionGraph
        The region adjacency graph, with sizes, borders and centroids.
    models : (k, m) float array
        The model of each region: its mean, its median, or the value of its source.
    values : (k, m) float array
        The models after regularization on the graph; before it, the models.
    model : {"mean", "median", "source"}
        Kind of the models.
    smooth : float
        Standard deviation, in pixels, of the Gaussian smoothing before the partition; 0 means none.
    channel_axis : int or None
        The axis of the image's channels.
    result : Result or None
        Result of the regularization; None before it.
    seconds : dict
        Wall-clock time of each stage.
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
    # labels of the sources' pixels, -1 elsewhere; only for model="source"
    _seeds: Labels | None = field(default=None, repr=False)
    _settings: dict[str, Any] = field(default_factory=dict, repr=False)

    # as arrays of the image's library
    _exchanged: ClassVar[tuple[str, ...]] = ("image", "labels", "models", "values", "result")

    def __repr__(self) -> str:
        return f"Regions({self.n_regions} regions on {tuple(self.image.shape)}, {self.graph.n_edges // 2} borders)"

    @property
    def n_regions(self) -> int:
        """Number of regions, k."""
        return self.graph.n_vertices

    @property
    def percent(self) -> float:
        """Number of regions in percent of the number of their pixels."""
        return 100 * self.n_regions / int((on_host(self.labels, "labels") >= 0).sum())

    @property
    def fine(self) -> npt.NDArray[Any]:
        """The image with the model of each region at its pixels, in the image's dtype."""
        return self.paint(self.models)

    @property
    def value(self) -> npt.NDArray[Any]:
        """The image with the regularized value of each region at its pixels, in the image's dtype."""
        return self.paint(self.values)

    @door(name="Regions.paint")
    def paint(self, values: npt.ArrayLike) -> npt.NDArray[Any]:
        """Return a copy of the image with one value per region; pixels in no region do not change.

        Parameters
        ----------
        values : (k,) or (k, m) array
            One value, or m channels, per region. They are rounded and clipped if the image has an integer type.
        """
        array = np.asarray(values, np.float64)
        array = array[:, None] if array.ndim == 1 else array
        if array.shape != self.models.shape:
            raise ValueError(f"values must have shape {self.models.shape}, got {np.shape(values)}")
        inside = self.labels >= 0
        if self.image.dtype.kind in "iu":
            # rounded once per region, not once per pixel
            limits = np.iinfo(self.image.dtype)
            array = np.clip(np.rint(array), limits.min, limits.max)
        painted = array.astype(self.image.dtype)[self.labels]
        return Raster(self.image, None if inside.all() else inside, self.channel_axis).like(painted)

    @door(name="Regions.random_colours")
    def random_colours(self, seed: int = 0) -> npt.NDArray[np.uint8]:
        """Return the partition with a random colour for each region, (..., 3), black outside the mask.

        Parameters
        ----------
        seed : int, default 0
            The same seed gives the same colours.
        """
        colours = np.random.default_rng(integer("seed", seed, low=0)).integers(
            32, 256, (self.n_regions + 1, 3), dtype=np.uint8
        )
        colours[-1] = 0  # for label -1
        return colours[self.labels]

    @door(name="Regions.regularized", options=REGION_MODEL)
    def regularized(
        self,
        *,
        lam: float | npt.ArrayLike = 0.05,
        update_weights: int | None = None,
        initial: npt.ArrayLike | None = None,
        **options: Unpack[RegionModel],
    ) -> Regions:
        """Regularize the regions' models on their graph.

        Parameters
        ----------
        lam : float or (k,) array, default 0.05
            Fidelity >= 0, one number or one value per region, as in :func:`gpureg.regularize`.
        p, update_weights, initial
            As in :func:`gpureg.regularize`.
        max_iter : int, default 30
            Maximum number of iterations.
        weights : {"similarity", "constant", "border"}, Weights or array, default "similarity"
            "similarity" is w2^0 of the paper, exp(-|f(u) - f(v)|^2 / h^2) of the models. "border" is the length of
            borders to the power of 2/p: with norm="edge" the smoothness is then the smoothness of the whole image. Or
            an object of :mod:`gpureg.weights`, with regions at their centroids, or one value per stored directed edge.
        h : float, optional
            Parameter of "similarity", in the image's units. None means twice the median distance of neighbouring
            models.
        by_size : bool, default False
            Multiply lam by the sizes of regions over their mean, so that all pixels have the same influence.
        gamma, coupled, norm, eps, solver, tol, backend, dtype, memory, callback, progress
            As in :func:`gpureg.regularize`.

        Returns
        -------
        Regions
            With new `values` and `result`.

        Raises
        ------
        ValueError, TypeError, BackendUnavailable, FloatingPointError, Interrupted
            As :func:`gpureg.regularize`; the value of the result of an interrupted run is an image.
        """
        begin = time.perf_counter()
        asked: dict[str, Any] = REGION_MODEL | options
        p, h, by_size = number("p", asked["p"], above=0), asked.pop("h"), flag("by_size", asked.pop("by_size"))
        fidelity: float | npt.ArrayLike = lam
        if by_size:
            assert self.graph.sizes is not None
            fidelity = np.asarray(lam, np.float64) * self.graph.sizes / self.graph.sizes.mean()
        asked["weights"] = _weights(self.graph, self.models, asked["weights"], h, p)
        asked |= {"lam": fidelity, "update_weights": update_weights, "initial": initial}
        try:
            result = regularize(self.models, self.graph, **asked)
        except Interrupted as interruption:
            painted = self.paint(interruption.result.value)
            raise Interrupted(replace(interruption.result, value=painted)) from None
        return replace(
            self,
            values=result.value.astype(np.float64) if result.iterations else self.models,
            result=result,
            seconds={**self.seconds, "regularization": time.perf_counter() - begin},
        )

    @door(name="Regions.merged")
    def merged(self, merge_tol: float) -> Regions:
        """Merge neighbouring regions with nearly equal values: a coarser partition.

        Parameters
        ----------
        merge_tol : float
            Largest distance, in the image's units, of the values of neighbours that are merged. Chains of such
            neighbours become one region.

        Returns
        -------
        Regions
            With the models of the new regions; their values are the means of the old values weighted by size.

        Raises
        ------
        TypeError, ValueError
            A tolerance that is not a number >= 0.
        """
        from scipy import sparse
        from scipy.sparse.csgraph import connected_components

        merge_tol = number("merge_tol", merge_tol, low=0, finite=False)
        begin = time.perf_counter()
        k, graph = self.n_regions, self.graph
        assert graph.sizes is not None
        met = graph.distances(self.values) <= merge_tol
        links = sparse.csr_array((np.ones(int(met.sum()), bool), (graph.edge_rows()[met], graph.indices[met])), (k, k))
        part = connected_components(links, directed=False)[1]
        # numbered in the order of their first regions
        first = np.sort(np.unique(part, return_index=True)[1])
        order = np.empty(len(first), np.int32)
        order[part[first]] = np.arange(len(first))
        joined = order[part]
        labels: Labels = np.append(joined, np.int32(-1))[self.labels]
        seeds = None if self._seeds is None else np.append(joined, np.int32(-1))[self._seeds]
        models = models_of(Raster(self.image, None, self.channel_axis), labels, self.model, seeds, len(first))
        mass = np.bincount(joined, graph.sizes)
        values = np.stack([np.bincount(joined, graph.sizes * v) / mass for v in self.values.T], axis=1)
        coarse = region_graph(labels, **self._settings)
        seconds = {**self.seconds, "merging": time.perf_counter() - begin}
        return replace(self, labels=labels, graph=coarse, models=models, values=values, seconds=seconds, _seeds=seeds)

    @door(name="Regions.hierarchy", options=REGION_MODEL)
    def hierarchy(
        self, *, lam: Sequence[float], merge_tol: float, **options: Unpack[RegionModel]
    ) -> tuple[Regions, ...]:
        """Compute coarser and coarser partitions: regularize and merge for each lam in turn.

        Parameters
        ----------
        lam : sequence of float
            Fidelities >= 0, in decreasing order.
        merge_tol : float
            As in :meth:`merged`.
        **options
            As in :meth:`regularized`; p < 1 makes the values of neighbours equal.

        Returns
        -------
        tuple of Regions
            One per lam. The regions of each partition are unions of regions of the partition before.

        Raises
        ------
        TypeError, ValueError
            Not a list, or a lam that is not smaller than the one before.
        """
        if np.ndim(lam) != 1:
            raise TypeError(f"lam must be a list of numbers, each smaller than the one before, got {lam!r}")
        steps = [number("lam", step, low=0) for step in lam]
        if not steps or any(b >= a for a, b in itertools.pairwise(steps)):
            raise ValueError(f"lam must decrease from one value to the next, got {steps}")
        levels, current = [], self
        for step in steps:
            current = current.regularized(lam=step, **options).merged(merge_tol)
            levels.append(current)
        return tuple(levels)

    @door(name="Regions.plot")
    def plot(self, *, seed: int = 0, path: str | os.PathLike[str] | None = None) -> Any:
        """Draw the image, the partition in random colours, and the images of the models and of the values.

        Parameters
        ----------
        seed : int, default 0
            Seed of the colours.
        path : path, optional
            Image file to write.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ImportError, OSError, ValueError
            As :func:`gpureg.plot.simplification`.
        """
        from ..plot import simplification

        return simplification(
            self.image,
            self.random_colours(seed),
            self.fine,
            self.value,
            path=path,
            spacing=self._settings.get("spacing"),
            caption=f"{self.n_regions} regions, {self.percent:.2g} percent of the pixels",
            channel_axis=self.channel_axis,
        )


def models_of(raster: Raster, labels: Labels, model: Model, seeds: Labels | None, n_regions: int) -> FloatArray:
    """Compute the models of all regions, (k, m)."""
    return region_values(raster.cells, labels, model, sources=seeds, n_regions=n_regions)


def _weights(
    graph: RegionGraph, models: FloatArray, weights: Any, h: float | None, p: float
) -> Weights | npt.ArrayLike | None:
    """Return the weights for :func:`gpureg.regularize`."""
    if not isinstance(weights, str):
        if h is not None:
            raise ValueError("h belongs to weights='similarity'")
        return weights  # type: ignore[no-any-return]
    if h is not None:
        number("h", h, above=0)
    if weights not in WEIGHTS:
        allowed = f"{', '.join(WEIGHTS)}, an object of gpureg.weights or an array"
        raise ValueError(f"weights must be one of {allowed}, got {weights!r}")
    if h is not None and weights != "similarity":
        raise ValueError("h belongs to weights='similarity'")
    if weights == "constant" or not graph.n_edges:
        return None
    if weights == "similarity":
        if h is not None:
            return patch(0, h)
        typical = 2 * float(np.median(graph.distances(models)))
        return patch(0, typical) if typical > 0 else None
    assert graph.borders is not None
    with np.errstate(over="ignore"):
        lengths = graph.borders ** (2 / p)
    if not lengths.max() < np.finfo(np.float32).max ** 0.5:
        raise ValueError(f"borders to the power of 2/p = {2 / p:g} are too large to compute with: take a larger p")
    return lengths
