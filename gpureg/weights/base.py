"""Base classes of weight functions, and their parameters: numbers, or one number per vertex."""

from __future__ import annotations

import weakref
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray
from ..backends import Backend, PatchForm, Storage, Weighted
from ..checks import number
from ..graphs.csr import Graph
from ..graphs.edges import check_weights
from ..graphs.grid import AnyGraph, GridGraph


class Weights(ABC):
    """A weight function."""

    @property
    def reach(self) -> int:
        """Radius in cells of the data around its two vertices that a weight depends on."""
        return 0

    @abstractmethod
    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """Compute the weights from the data `f0` (n, m), and return the graph with them on the backend's device."""

    def on(self, graph: AnyGraph) -> Weights:
        """Return the weight function with its own data, such as a guide, as one row per vertex of a graph.

        Raises
        ------
        ValueError
            Data that do not fit the graph.
        """
        return self

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function that gives the data divided by `scale`, plus a constant, the same weights.

        None if it is not known, as for other classes: then the weights are computed from the data as they are.
        """
        return None

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function for a part of the grid, with the same weights there, bit for bit.

        None if this is not possible, as for weights that may depend on the numbers of all vertices.
        """
        return None


def rows_of(table: FloatArray, grid: GridGraph, box: tuple[slice, ...]) -> FloatArray:
    """Return the rows of a table (n, q) that belong to a part of the grid."""
    return table.reshape(*grid.shape, table.shape[-1])[box].reshape(-1, table.shape[-1])


class PatchWeights(Weights):
    """A weight function of the form s(u, v) exp(-patch distance), computed on the device."""

    @abstractmethod
    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """Return the parameters of these weights on a graph for a backend of this type."""

    @property
    def storage(self) -> Storage:
        """How the weights are stored on the device."""
        return "full"

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """Compute the weights on the backend's device, and return the graph with them."""
        form = self.form(graph, f0.shape[1], backend.dtype)
        return backend.patch_distance(graph, f0, form, storage=self.storage)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return itself: it depends on steps between vertices, not on their positions."""
        return self


class EdgeWeights(Weights):
    """A weight function computed in numpy, for an array of edges at a time.

    Attributes
    ----------
    reads_data : bool
        Whether the weights depend on the data f0. If not, the weights of the last function on a stored graph are cached
        as long as the graph exists.
    """

    reads_data: ClassVar[bool] = True

    def scaled(self, scale: float) -> Weights | None:
        """Return itself if it does not depend on the data."""
        return None if self.reads_data else self

    @abstractmethod
    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Compute the weights (k,) of the edges from vertices `u` to vertices `v`, both (k,); symmetric in u and v."""

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """Compute the weights, and return the graph with them on the backend's device."""
        if isinstance(graph, Graph):
            values = self._of_stored(graph, f0)
            if values.size and (largest := float(values.max())) > np.finfo(backend.dtype).max:
                raise ValueError(
                    f"the largest weight, {largest:.3g}, is beyond {np.dtype(backend.dtype)}: join vertices at nearly "
                    "the same position, rescale, or use dtype=float64"
                )
            return backend.prepare(graph, values)
        half = np.zeros((graph.half_window, *graph.shape), backend.dtype)
        vertices = np.arange(graph.n_vertices).reshape(graph.shape)
        for plane, step in zip(half, graph.forward_offsets, strict=True):
            start, end = graph.ends(step)
            plane[start] = self.between(graph, f0, vertices[start].ravel(), vertices[end].ravel()).reshape(
                vertices[start].shape
            )
        if graph.mask is not None:
            half[graph.edges.unit_half() == 0] = 0
        return backend.prepare(graph, check_weights(half, half.shape, "one per pair"))

    def _of_stored(self, graph: Graph, f0: FloatArray) -> FloatArray:
        cached = None if self.reads_data else _last.get(graph)
        if cached is not None and cached[0] == self:
            return cached[1]
        values = self.between(graph, f0, graph.edge_rows(), graph.indices)
        values = check_weights(values, (graph.n_edges,), "one per directed edge")
        if not self.reads_data:
            values.flags.writeable = False  # so that a backend may cache its copy
            _last[graph] = (self, values)
        return values


# For each stored graph the last weight function that does not depend on the data, and its weights.
_last: weakref.WeakKeyDictionary[Graph, tuple[EdgeWeights, FloatArray]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class PerVertex:
    """A parameter with one value per vertex.

    Attributes
    ----------
    values : (n,) float array
    middle : float
        Median of the values on the whole graph; it does not change in parts of a grid.
    """

    values: FloatArray
    middle: float

    def __format__(self, spec: str) -> str:
        return "a map"

    def on(self, graph: AnyGraph, name: str) -> FloatArray:
        """Return the values, after checking that there is one per vertex of the graph."""
        if len(self.values) != graph.n_vertices:
            raise ValueError(
                f"{name} must be a number or hold {graph.n_vertices} values, one per vertex; got {len(self.values)}"
            )
        return self.values

    def part(self, grid: GridGraph, box: tuple[slice, ...], name: str) -> PerVertex:
        """Return the parameter for a part of the grid."""
        return replace(self, values=rows_of(self.on(grid, name)[:, None], grid, box)[:, 0])


Parameter = float | PerVertex


def parameter(name: str, value: float | npt.ArrayLike, *, infinite: bool = False, zero: bool = False) -> Parameter:
    """Check a parameter: a number > 0 (with `zero` also 0, with `infinite` also infinity), or one per vertex."""
    if np.ndim(value) > 0:
        given = np.asarray(value)
        if given.dtype.kind not in "biuf":
            raise TypeError(f"{name} must be a number or an array of them, got {given.dtype}")
        values = given.astype(np.float64).ravel()
        low = values >= 0 if zero else values > 0
        if not (low.all() and np.isfinite(values).all()):
            raise ValueError(f"a map of {name} must be finite and {'>= 0' if zero else '> 0'} everywhere")
        return PerVertex(values, float(np.median(values)))
    if zero:
        return number(name, value, low=0)
    return number(name, value, above=0, finite=not infinite)


def part_of_parameter(parameter: Parameter, grid: GridGraph, box: tuple[slice, ...], name: str) -> Parameter:
    """Return a parameter for a part of the grid."""
    return parameter.part(grid, box, name) if isinstance(parameter, PerVertex) else parameter


def scaled_parameter(parameter: Parameter, scale: float) -> Parameter:
    """Return a parameter in the units of the data, for data divided by `scale`, a power of two."""
    if isinstance(parameter, PerVertex):
        return replace(parameter, values=parameter.values / scale, middle=parameter.middle / scale)
    return parameter / scale


AnyWeights = Weights | npt.ArrayLike | None
