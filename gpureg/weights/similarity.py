"""Weights by the likeness of the data: :func:`bilateral` (w1), :func:`patch` (w2), and how a device holds them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..backends import PatchForm, Storage
from ..checks import integer, number
from ..doors import door
from ..graphs.grid import AnyGraph, GridGraph
from .base import Parameter, PatchWeights, PerVertex, Weights, parameter, part_of_parameter
from .distance import nearness
from .guide import Compared


def _strengths(parameter: Parameter, graph: AnyGraph, name: str) -> tuple[float, FloatArray | None]:
    """A bandwidth as one number, and what each vertex multiplies its inverse by: h(u) h(v) instead of h^2."""
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


def _inverse_square(sigma: float, dtype: npt.DTypeLike) -> float:
    """1/sigma^2, at most the largest number of the type: infinity times a distance of 0 is no number."""
    with np.errstate(over="ignore", divide="ignore"):
        return float(min(np.float64(sigma) ** -2, np.finfo(np.dtype(dtype)).max))


@dataclass(frozen=True)
class Bilateral(PatchWeights):
    """See :func:`bilateral`."""

    sigma_space: float
    sigma_value: Parameter

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, with the part of its map."""
        return replace(self, sigma_value=part_of_parameter(self.sigma_value, grid, box, "sigma_value"))

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """The weights w1: patches of one vertex."""
        spatial = nearness(graph, self.sigma_space)
        sigma, strength = _strengths(self.sigma_value, graph, "sigma_value")
        return PatchForm(np.ones(1), 0.0, _inverse_square(sigma, dtype), spatial, _maps(graph, None, strength))


@dataclass(frozen=True)
class Patch(PatchWeights):
    """See :func:`patch`."""

    patch_radius: int
    h: Parameter
    sigma: Parameter = 0.0
    patch_sigma: float | None = None
    cut: float = 0.0
    sigma_space: float = math.inf

    @property
    def reach(self) -> int:
        """The patch's radius."""
        return self.patch_radius

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Itself, with the part of its maps."""
        return replace(
            self, h=part_of_parameter(self.h, grid, box, "h"), sigma=part_of_parameter(self.sigma, grid, box, "sigma")
        )

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """The weights w2."""
        steps = np.arange(-self.patch_radius, self.patch_radius + 1)
        a = self.patch_sigma
        profile = np.ones(len(steps)) if a is None else np.exp(-(steps**2) / (2 * a**2))
        if a is not None:
            profile = profile / profile.sum()
        ndim = graph.ndim if isinstance(graph, GridGraph) else 1 if graph.grid is None else graph.grid.ndim
        samples = channels * profile.sum() ** ndim
        h, strength = _strengths(self.h, graph, "h")
        if isinstance(self.sigma, PerVertex):
            taken, shift = self.sigma.on(graph, "sigma") ** 2 * samples, 0.0
        else:
            taken, shift = None, 2 * self.sigma**2 * samples
        maps, spatial = _maps(graph, taken, strength), nearness(graph, self.sigma_space)
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


@door
def bilateral(sigma_space: float, sigma_value: float | npt.ArrayLike) -> Weights:
    """Bilateral weights w1: near in space and alike in value.

    Parameters
    ----------
    sigma_space : float
        sigma_P > 0, in the units of the grid's spacing or the graph's positions; infinity leaves the spatial factor
        out.
    sigma_value : float or (n,) array
        sigma_X > 0, in the data's units; infinity leaves the factor of the values out. With one value per vertex
        sigma_X(u) sigma_X(v) stands instead of sigma_X^2.

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
        number("sigma_space", sigma_space, above=0, finite=False), parameter("sigma_value", sigma_value, infinite=True)
    )


@door
def patch(
    patch_radius: int,
    h: float | npt.ArrayLike,
    *,
    sigma: float | npt.ArrayLike = 0.0,
    patch_sigma: float | None = None,
    cut: float = 0.0,
    sigma_space: float = math.inf,
) -> Weights:
    """Nonlocal weights w2: alike in the values of a patch around each vertex.

    Parameters
    ----------
    patch_radius : int
        k' >= 0 of the patch of side 2 k' + 1 cells. Radius 0 compares the data of the vertices alone and serves any
        graph; a larger one needs vertices on a grid. Over the border a patch is filled by reflection without the edge
        cell.
    h : float or (n,) array
        Filtering parameter > 0: in the data's units times the square root of the sum of g. With one value per vertex
        h(u) h(v) stands instead of h^2, so that the weights stay symmetric.
    sigma : float or (n,) array, default 0
        Standard deviation of the noise: 2 sigma^2 is taken off the distance per sample and channel, what is negative
        counts as 0. With one value per vertex it is sigma(u)^2 + sigma(v)^2.
    patch_sigma : float, optional
        Standard deviation a > 0 of the Gaussian g_a over the patch, which sums to 1, in cells. None gives the flat
        patch: g = 1.
    cut : float, default 0
        Weights below it count as 0: some filters drop what is unlike altogether (OpenCV's 0.001, scikit-image's
        exp(-5)).
    sigma_space : float, default infinity
        sigma_P of a further factor exp(-|u - v|^2 / sigma_P^2), as in :func:`bilateral`: neighbours further away count
        less, however alike. Infinity leaves it out.

    Raises
    ------
    TypeError, ValueError
        A patch_radius that is not an integer >= 0, h or patch_sigma not > 0, sigma < 0, cut not in 0..1; at use, a map
        for another number of vertices.

    Notes
    -----
    w2(u, v) = exp(-rho(u, v) / h^2) with rho(u, v) = sum_j g(j) |f0(u + j) - f0(v + j)|^2, section 5.2 of the paper.
    For a flat patch of s cells and C channels, the nonlocal means of scikit-image and OpenCV with parameter H is
    h^2 = C s H^2.
    """
    return Patch(
        integer("patch_radius", patch_radius, low=0),
        parameter("h", h),
        parameter("sigma", sigma, zero=True),
        None if patch_sigma is None else number("patch_sigma", patch_sigma, above=0),
        number("cut", cut, low=0, high=1),
        number("sigma_space", sigma_space, above=0, finite=False),
    )


def _patch_weights_for(weights: Weights, what: str) -> PatchWeights:
    if not isinstance(weights, PatchWeights) or isinstance(weights, Held):
        hint = f"; put the guide around it: guided({what}(...), guide)" if isinstance(weights, Compared) else ""
        raise TypeError(f"{what} takes bilateral or patch weights, got {type(weights).__name__}{hint}")
    return weights


@door
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


@door
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
    functions on the vertices, whatever its window.
    """
    return Held(_patch_weights_for(weights, "recomputed"), "none")
