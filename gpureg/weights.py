"""Weight functions w(u, v): how alike two vertices are (section 5.2 and figures 5 to 8 of the paper).

A weight function is an object that, given a backend, a graph and the data, puts weights on the device. Those of the
form s(u, v) exp(-patch distance) derive from :class:`PatchWeights` and are computed there; any other derives from
:class:`EdgeWeights` and says in numpy what the weight between arrays of vertices is. To add one: a class, a function
below it, and a row in ``tests/test_weights.py``.
"""

from __future__ import annotations

import math
import weakref
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from .backends import Backend, PatchForm, Storage, Weighted
from .graph import FloatArray, Graph, GridGraph, IntArray, check_weights

__all__ = [
    "EdgeWeights",
    "Weights",
    "bilateral",
    "constant",
    "gaussian",
    "guided",
    "half",
    "inverse_distance",
    "patch",
    "recomputed",
]

AnyGraph = Graph | GridGraph


class Weights(ABC):
    """A weight function."""

    @property
    def reach(self) -> int:
        """Cells around its two vertices that a weight looks at."""
        return 0

    @abstractmethod
    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with these weights, computed from the data `f0` (n, m), on the backend's device."""

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The weight function that gives a part of the grid the weights it has in the whole, to the bit.

        None where there is no such function: weights that may know all vertices by their numbers.
        """
        return None


def _rows_of(table: FloatArray, grid: GridGraph, box: tuple[slice, ...]) -> FloatArray:
    """The rows of a table that belong to the vertices of a part of the grid."""
    return table.reshape(*grid.shape, table.shape[-1])[box].reshape(-1, table.shape[-1])


class PatchWeights(Weights):
    """A weight function of the form s(u, v) exp(-patch distance), computed on the device."""

    @abstractmethod
    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """These weights on a graph, between data of so many channels, as a backend of this type takes them."""

    @property
    def storage(self) -> Storage:
        """In which form the device holds the weights."""
        return "full"

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with these weights, on the backend's device."""
        form = self.form(graph, f0.shape[1], backend.dtype)
        return backend.patch_distance(graph, f0, form, storage=self.storage)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself: it knows steps between vertices, not their places."""
        return self


class EdgeWeights(Weights):
    """A weight function computed in numpy, an array of edges at a time.

    Attributes
    ----------
    reads_data : bool
        Whether the weights depend on the data f0. Where they do not, a stored graph's are computed once: those of the
        last such function are kept for as long as the graph lives.
    """

    reads_data: ClassVar[bool] = True

    @abstractmethod
    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights of the edges from vertices `u` to vertices `v`, both (k,); symmetric in u and v."""

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with these weights, on the backend's device."""
        if isinstance(graph, Graph):
            return backend.prepare(graph, self._of_stored(graph, f0))
        half = np.zeros((graph.half_window, *graph.shape), backend.dtype)
        vertices = np.arange(graph.n_vertices).reshape(graph.shape)
        for plane, step in zip(half, graph.forward_offsets, strict=True):
            start, end = graph.ends(step)
            plane[start] = self.between(graph, f0, vertices[start].ravel(), vertices[end].ravel()).reshape(
                vertices[start].shape
            )
        if graph.mask is not None:
            half[graph.unit_half_weights() == 0] = 0
        return backend.prepare(graph, check_weights(half, half.shape, "one per pair"))

    def _of_stored(self, graph: Graph, f0: FloatArray) -> FloatArray:
        kept = None if self.reads_data else _last.get(graph)
        if kept is not None and kept[0] == self:
            return kept[1]
        values = self.between(graph, f0, graph.edge_rows(), graph.indices)
        values = check_weights(values, (graph.n_edges,), "one per directed edge")
        if not self.reads_data:
            values.flags.writeable = False  # so that a backend may keep its copy
            _last[graph] = (self, values)
        return values


# The last weight function of each stored graph that does not read the data, and its weights.
_last: weakref.WeakKeyDictionary[Graph, tuple[EdgeWeights, FloatArray]] = weakref.WeakKeyDictionary()


def _squared_distances(points: FloatArray, u: IntArray, v: IntArray, unit: float = 1.0) -> FloatArray:
    """|points(u) - points(v)|^2 in units of `unit`, (k,)."""
    total, steps, ends = np.zeros((3, len(u)))
    u, v = u.astype(np.intp, copy=False), v.astype(np.intp, copy=False)
    # A coordinate at a time, into the same arrays: to gather rows of a few numbers takes numpy four times as long.
    for x in np.ascontiguousarray(points.T, np.float64):
        # in range: these are vertices; "clip" spares numpy a copy of its output
        np.take(x, v, out=steps, mode="clip")
        np.take(x, u, out=ends, mode="clip")
        steps -= ends
        steps /= unit  # before the square, which would be 0 of a tiny unit
        steps *= steps
        total += steps
    return total


def _positions(graph: Graph) -> FloatArray:
    """Coordinates of the vertices, (n, d)."""
    if graph.positions is None:
        raise ValueError("these weights need the vertices' coordinates: give the graph positions=(n, d)")
    return graph.positions


def _squared_lengths(graph: AnyGraph, u: IntArray, v: IntArray) -> FloatArray:
    """|u - v|^2 in the units of the grid's spacing or the graph's positions, (k,)."""
    if isinstance(graph, Graph):
        return _squared_distances(_positions(graph), u, v)
    cells = np.stack(np.unravel_index(u, graph.shape)) - np.stack(np.unravel_index(v, graph.shape))
    lengths: FloatArray = ((cells.T * np.array(graph.spacing or (1.0,) * graph.ndim)) ** 2).sum(axis=-1)
    return lengths


def _positive(name: str, value: float, *, infinite: bool = False) -> float:
    if not isinstance(value, int | float | np.floating | np.integer) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number, got {type(value).__name__}")
    if not value > 0 or (math.isinf(value) and not infinite):
        raise ValueError(f"{name} must be > 0{'' if infinite else ' and finite'}, got {value}")
    return float(value)


@dataclass(frozen=True, eq=False)
class PerVertex:
    """A parameter with a value of its own at every vertex, (n,)."""

    values: FloatArray

    @property
    def middle(self) -> float:
        """A typical value."""
        return float(np.median(self.values))

    def __format__(self, spec: str) -> str:
        return "a map"

    def on(self, graph: AnyGraph, name: str) -> FloatArray:
        """The values, once there is one for every vertex of the graph."""
        if len(self.values) != graph.n_vertices:
            raise ValueError(
                f"{name} must be a number or hold {graph.n_vertices} values, one per vertex; got {len(self.values)}"
            )
        return self.values

    def part(self, grid: GridGraph, box: tuple[slice, ...], name: str) -> PerVertex:
        """The values of a part of the grid."""
        return PerVertex(_rows_of(self.on(grid, name)[:, None], grid, box)[:, 0])


Parameter = float | PerVertex


def _parameter(name: str, value: float | npt.ArrayLike, *, infinite: bool = False, zero: bool = False) -> Parameter:
    """A number > 0 (or 0, or infinite), or one per vertex."""
    if np.ndim(value) > 0:
        values = np.array(value, dtype=np.float64).ravel()
        low = values >= 0 if zero else values > 0
        if not (low.all() and np.isfinite(values).all()):
            raise ValueError(f"a map of {name} must be finite and {'>= 0' if zero else '> 0'} everywhere")
        return PerVertex(values)
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise TypeError(f"{name} must be a number, or one per vertex, got {value!r}")
    if zero and not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be finite and >= 0, got {value}")
    return float(value) if zero else _positive(name, float(value), infinite=infinite)


def _share(name: str, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise TypeError(f"{name} must be a number, got {value!r}")
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must lie in 0..1, got {value}")
    return float(value)


def _part(parameter: Parameter, grid: GridGraph, box: tuple[slice, ...], name: str) -> Parameter:
    return parameter.part(grid, box, name) if isinstance(parameter, PerVertex) else parameter


def _strengths(parameter: Parameter, graph: AnyGraph, name: str) -> tuple[float, FloatArray | None]:
    """A bandwidth as one number, and what each vertex multiplies its inverse by: h(u) h(v) in the place of h^2."""
    if not isinstance(parameter, PerVertex):
        return parameter, None
    return parameter.middle, parameter.middle / parameter.on(graph, name)


def _maps(graph: AnyGraph, taken: FloatArray | None, strength: FloatArray | None) -> FloatArray | None:
    """The maps of a :class:`PatchForm`."""
    if taken is None and strength is None:
        return None
    n = graph.n_vertices
    columns = (np.zeros(n) if taken is None else taken, np.ones(n) if strength is None else strength)
    return np.stack(columns, axis=-1)


def _nearness(graph: AnyGraph, sigma: float) -> FloatArray | None:
    """exp(-|u - v|^2 / sigma^2), per forward offset of a grid or per directed edge; None for an infinite sigma."""
    if math.isinf(sigma):
        return None
    if isinstance(graph, GridGraph):
        steps = graph.forward_offsets * np.array(graph.spacing or (1.0,) * graph.ndim)
        # divided first: the square of a tiny sigma would be 0
        squares: FloatArray = ((steps / sigma) ** 2).sum(axis=1)
    else:
        squares = _squared_distances(_positions(graph), graph.edge_rows(), graph.indices, sigma)
    near: FloatArray = np.exp(-squares)
    return near


def _inverse_square(sigma: float, dtype: npt.DTypeLike) -> float:
    """1/sigma^2, at most the largest number of the type: infinity times a distance of 0 is no number."""
    with np.errstate(over="ignore", divide="ignore"):
        return float(min(np.float64(sigma) ** -2, np.finfo(np.dtype(dtype)).max))


@dataclass(frozen=True)
class Constant(Weights):
    """See :func:`constant`."""

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with weight 1 on every edge."""
        if isinstance(graph, Graph) and graph.weights is not None:
            return backend.prepare(graph, np.ones(graph.n_edges, backend.dtype))
        return backend.prepare(graph, None)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself."""
        return self


@dataclass(frozen=True)
class Bilateral(PatchWeights):
    """See :func:`bilateral`."""

    sigma_space: float
    sigma_value: Parameter

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, with the part of its map."""
        return replace(self, sigma_value=_part(self.sigma_value, grid, box, "sigma_value"))

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """The weights w1: patches of one vertex."""
        spatial = _nearness(graph, self.sigma_space)
        sigma, strength = _strengths(self.sigma_value, graph, "sigma_value")
        return PatchForm(np.ones(1), 0.0, _inverse_square(sigma, dtype), spatial, _maps(graph, None, strength))


@dataclass(frozen=True)
class Patch(PatchWeights):
    """See :func:`patch`."""

    radius: int
    h: Parameter
    sigma: Parameter = 0.0
    a: float | None = None
    cut: float = 0.0
    sigma_space: float = math.inf

    @property
    def reach(self) -> int:
        """The patch's radius."""
        return self.radius

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, with the part of its maps."""
        return replace(self, h=_part(self.h, grid, box, "h"), sigma=_part(self.sigma, grid, box, "sigma"))

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """The weights w2."""
        steps = np.arange(-self.radius, self.radius + 1)
        profile = np.ones(len(steps)) if self.a is None else np.exp(-(steps**2) / (2 * self.a**2))
        if self.a is not None:
            profile = profile / profile.sum()
        ndim = graph.ndim if isinstance(graph, GridGraph) else 1 if graph.grid is None else graph.grid.ndim
        samples = channels * profile.sum() ** ndim
        h, strength = _strengths(self.h, graph, "h")
        if isinstance(self.sigma, PerVertex):
            taken, shift = self.sigma.on(graph, "sigma") ** 2 * samples, 0.0
        else:
            taken, shift = None, 2 * self.sigma**2 * samples
        maps, spatial = _maps(graph, taken, strength), _nearness(graph, self.sigma_space)
        return PatchForm(profile, shift, _inverse_square(h, dtype), spatial, maps, self.cut)


@dataclass(frozen=True)
class Held(PatchWeights):
    """See :func:`half` and :func:`recomputed`."""

    weights: PatchWeights
    how: Storage

    @property
    def storage(self) -> Storage:
        """In which form the device holds the weights."""
        return self.how

    @property
    def reach(self) -> int:
        """That of the weight function."""
        return self.weights.reach

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """That of the weight function."""
        return self.weights.form(graph, channels, dtype)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The weight function's part, held likewise."""
        weights = self.weights.part(grid, box)
        return replace(self, weights=weights) if isinstance(weights, PatchWeights) else None


@dataclass(frozen=True)
class InverseDistance(EdgeWeights):
    """See :func:`inverse_distance`."""

    reads_data = False
    power: float

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights |u - v|^-power."""
        distance = np.sqrt(_squared_lengths(graph, u, v))
        if distance.size and not distance.min() > 0:
            k = int(np.argmin(distance))
            raise ValueError(f"vertices {u[k]} and {v[k]} lie on the same point: 1/distance has no value there")
        weights: FloatArray = distance**-self.power
        return weights

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, where coordinates are whole numbers; the roundings of others would depend on the place."""
        return self if grid.spacing is None else None


@dataclass(frozen=True, eq=False)
class Gaussian(EdgeWeights):
    """See :func:`gaussian`."""

    reads_data = False
    features: FloatArray
    sigma: float

    def _of(self, graph: AnyGraph) -> FloatArray:
        if len(self.features) != graph.n_vertices:
            raise ValueError(f"features must have {graph.n_vertices} rows, one per vertex, got {len(self.features)}")
        return self.features

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The features of the part."""
        return Gaussian(_rows_of(self._of(grid), grid, box), self.sigma)

    def between(self, graph: AnyGraph, f0: FloatArray, u: IntArray, v: IntArray) -> FloatArray:
        """Weights exp(-|features(u) - features(v)|^2 / sigma^2)."""
        weights: FloatArray = np.exp(-_squared_distances(self._of(graph), u, v) / self.sigma**2)
        return weights


@dataclass(frozen=True, eq=False)
class Guided(Weights):
    """See :func:`guided`."""

    weights: Weights
    guide: FloatArray

    def of(self, graph: AnyGraph) -> FloatArray:
        """The guide, once it has a row for every vertex of the graph."""
        if len(self.guide) != graph.n_vertices:
            raise ValueError(f"the guide must have {graph.n_vertices} rows, one per vertex, got {len(self.guide)}")
        return self.guide

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with weights computed from the guide."""
        return self.weights.prepare(backend, graph, self.of(graph))

    @property
    def reach(self) -> int:
        """That of the weight function."""
        return self.weights.reach

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The weight function's part, with the guide's."""
        weights = self.weights.part(grid, box)
        return None if weights is None else Guided(weights, _rows_of(self.of(grid), grid, box))


def patch_weights(weights: object) -> tuple[PatchWeights, Guided | None] | None:
    """Patch weights without their guide, and with it, None where they compare the data. None if they are no such."""
    guided = None
    while isinstance(weights, Guided):
        guided, weights = weights, weights.weights
    return (weights, guided) if isinstance(weights, PatchWeights) else None


def constant() -> Weights:
    """Weight 1 on every edge: the unweighted graph."""
    return Constant()


def bilateral(sigma_space: float, sigma_value: float | npt.ArrayLike) -> Weights:
    """Bilateral weights w1: near in space and alike in value.

    Parameters
    ----------
    sigma_space : float
        sigma_P > 0, in the units of the grid's spacing or the graph's positions; infinity leaves the spatial factor
        out.
    sigma_value : float or (n,) array
        sigma_X > 0, in the data's units; infinity leaves the factor of the values out. With one value per vertex
        sigma_X(u) sigma_X(v) takes the place of sigma_X^2.

    Raises
    ------
    TypeError, ValueError
        A sigma that is not a number > 0; at use, a map for another number of vertices.

    Notes
    -----
    w1(u, v) = exp(-|u - v|^2 / sigma_P^2) exp(-|f0(u) - f0(v)|^2 / sigma_X^2), section 5.2 of the paper. There is no
    factor 1/2: sigma_P and sigma_X are sqrt(2) times those of the usual bilateral filter (OpenCV's, scikit-image's).

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1).T
    >>> weights = gr.weights.bilateral(2.0, 0.1)
    >>> gr.regularize(step, gr.GridGraph(8), weights=weights, backend="numpy").value[:, 0].round(3)
    array([0., 0., 0., 0., 1., 1., 1., 1.], dtype=float32)
    """
    return Bilateral(
        _positive("sigma_space", sigma_space, infinite=True), _parameter("sigma_value", sigma_value, infinite=True)
    )


def patch(
    radius: int,
    h: float | npt.ArrayLike,
    *,
    sigma: float | npt.ArrayLike = 0.0,
    a: float | None = None,
    cut: float = 0.0,
    sigma_space: float = math.inf,
) -> Weights:
    """Nonlocal weights w2: alike in the values of a patch around each vertex.

    Parameters
    ----------
    radius : int
        k' >= 0 of the patch of side 2 k' + 1. Radius 0 compares the data of the vertices alone and serves any graph; a
        larger one needs vertices on a grid. Over the border a patch is filled by reflection without the edge cell.
    h : float or (n,) array
        Filtering parameter > 0: in the data's units times the square root of the sum of g. With one value per vertex
        h(u) h(v) takes the place of h^2, so that the weights stay symmetric.
    sigma : float or (n,) array, default 0
        Standard deviation of the noise: 2 sigma^2 is taken off the distance per sample and channel, what is negative
        counts as 0. With one value per vertex it is sigma(u)^2 + sigma(v)^2.
    a : float, optional
        Standard deviation of the Gaussian g_a over the patch, which sums to 1, in cells. None gives the flat patch:
        g = 1.
    cut : float, default 0
        Weights below it count as 0: some filters drop what is unlike altogether (OpenCV's 0.001, scikit-image's
        exp(-5)).
    sigma_space : float, default infinity
        sigma_P of a further factor exp(-|u - v|^2 / sigma_P^2), as in :func:`bilateral`: neighbours further away count
        less, however alike. Infinity leaves it out.

    Raises
    ------
    TypeError, ValueError
        A radius that is not an integer >= 0, h or a not > 0, sigma < 0, cut not in 0..1; at use, a map for another
        number of vertices.

    Notes
    -----
    w2(u, v) = exp(-rho(u, v) / h^2) with rho(u, v) = sum_j g(j) |f0(u + j) - f0(v + j)|^2, section 5.2 of the paper.
    For a flat patch of s cells and C channels, the nonlocal means of scikit-image and OpenCV with parameter H is
    h^2 = C s H^2.
    """
    if not isinstance(radius, int | np.integer) or isinstance(radius, bool):
        raise TypeError(f"the patch's radius must be an integer, got {radius!r}")
    if radius < 0:
        raise ValueError(f"the patch's radius must be >= 0, got {radius}")
    return Patch(
        int(radius),
        _parameter("h", h),
        _parameter("sigma", sigma, zero=True),
        None if a is None else _positive("a", a),
        _share("cut", cut),
        _positive("sigma_space", sigma_space, infinite=True),
    )


def inverse_distance(power: float = 2) -> Weights:
    """Weights 1/|u - v|^power between the positions of the vertices (figure 6 of the paper, with power 2).

    Raises
    ------
    TypeError, ValueError
        A power that is not a number > 0; at use, vertices without positions, or two that lie on the same point.
    """
    return InverseDistance(_positive("power", power))


def gaussian(features: npt.ArrayLike, sigma: float) -> Weights:
    """Weights exp(-|F(u) - F(v)|^2 / sigma^2) between feature vectors of the vertices.

    Parameters
    ----------
    features : (n,) or (n, q) float array
        One feature vector per vertex.
    sigma : float
        Standard deviation (without a factor 1/2) > 0, in the features' units.

    Raises
    ------
    TypeError, ValueError
        Features that are not finite numbers, or a sigma that is not > 0; at use, another number of vertices.
    """
    table: Any = np.array(features, dtype=np.float64)
    table = table.reshape(len(table), -1) if table.ndim else table
    if table.ndim != 2 or not np.isfinite(table).all():
        raise ValueError(f"features must be finite, one row per vertex, got shape {table.shape}")
    return Gaussian(table, _positive("sigma", sigma))


def _patch_weights_for(weights: Weights, what: str) -> PatchWeights:
    if not isinstance(weights, PatchWeights) or isinstance(weights, Held):
        hint = f"; put the guide around it: guided({what}(...), guide)" if isinstance(weights, Guided) else ""
        raise TypeError(f"{what} takes bilateral or patch weights, got {type(weights).__name__}{hint}")
    return weights


def half(weights: Weights) -> Weights:
    """The same weights on a grid, stored in float16: half the memory, and half of what a sweep has to read.

    Parameters
    ----------
    weights : Weights
        Of :func:`bilateral` or :func:`patch`.

    Raises
    ------
    TypeError
        Other weights.
    BackendUnavailable
        At use: a stored graph, or Warp.

    Notes
    -----
    A weight is off by at most 2^-11 of its size (2^-25 where it is below 2^-14). A sweep is a quotient of two sums of
    w (g(u) + g(v)), whose g = |grad f|^(p - 2) moves by |p - 2|/2 times as much: its result moves by at most
    (2 + |p - 2|) 2^-11 of the range of f over the neighbours and the data, 1.5e-3 of it for p = 1.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1).T
    >>> weights = gr.weights.half(gr.weights.bilateral(2.0, 0.7))
    >>> gr.regularize(step, gr.GridGraph(8), weights=weights, max_iter=1, backend="numpy").value[2:6, 0].round(3)
    array([0.   , 0.073, 0.927, 1.   ], dtype=float32)
    """
    return Held(_patch_weights_for(weights, "half"), "half")


def recomputed(weights: Weights) -> Weights:
    """The same bilateral weights on a grid, computed anew at each use: nothing is stored per edge.

    Parameters
    ----------
    weights : Weights
        Of :func:`bilateral`, or of :func:`patch` with radius 0.

    Raises
    ------
    TypeError
        Other weights.
    BackendUnavailable
        At use: a stored graph, patches of more than one cell, or Warp.

    Notes
    -----
    The numbers are those of the stored weights; on numpy, the oracle, they are stored. On OpenCL a job then needs a few
    functions on the vertices and no more, whatever its window.
    """
    return Held(_patch_weights_for(weights, "recomputed"), "none")


def guided(weights: Weights, guide: npt.ArrayLike) -> Weights:
    """The same weight function, computed from other data than those that are regularized.

    Parameters
    ----------
    weights : Weights
    guide : (n,) or (n, q) float array
        What the weights compare, one row per vertex, e.g. a cleaner picture of the same scene.

    Raises
    ------
    TypeError, ValueError
        No weight function, or a guide that is not finite; at use, another number of vertices.
    """
    if not isinstance(weights, Weights):
        raise TypeError(f"weights must be an object of gpureg.weights, got {type(weights).__name__}")
    table: Any = np.array(guide, dtype=np.float64)
    table = table.reshape(len(table), -1) if table.ndim else table
    if table.ndim != 2 or not np.isfinite(table).all():
        raise ValueError(f"the guide must be finite, one row per vertex, got shape {table.shape}")
    return Guided(weights, table)
