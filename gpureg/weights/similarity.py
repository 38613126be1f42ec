"""Weights from the similarity of the data: :func:`bilateral` (w1), :func:`patch` (w2), and how they are stored."""

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
from .base import Parameter, PatchWeights, PerVertex, Weights, parameter, part_of_parameter, scaled_parameter
from .distance import nearness
from .guide import Compared


def _strengths(parameter: Parameter, graph: AnyGraph, name: str) -> tuple[float, FloatArray | None]:
    """Return a bandwidth h as one number, and the factors h/h(u) of all vertices, (n,), or None if h is constant."""
    if not isinstance(parameter, PerVertex):
        return parameter, None
    return parameter.middle, parameter.middle / parameter.on(graph, name)


def _maps(graph: AnyGraph, taken: FloatArray | None, strength: FloatArray | None) -> FloatArray | None:
    """Return the maps of a :class:`PatchForm`, (n, 2), or None."""
    if taken is None and strength is None:
        return None
    n = graph.n_vertices
    columns = (np.zeros(n) if taken is None else taken, np.ones(n) if strength is None else strength)
    return np.stack(columns, axis=-1)


def _inverse_square(sigma: float, dtype: npt.DTypeLike) -> float:
    """Return 1/sigma^2, at most the largest number of the type, as infinity times a distance of 0 would be NaN."""
    with np.errstate(over="ignore", divide="ignore"):
        return float(min(np.float64(sigma) ** -2, np.finfo(np.dtype(dtype)).max))


@dataclass(frozen=True)
class Bilateral(PatchWeights):
    """See :func:`bilateral`."""

    sigma_space: float
    sigma_value: Parameter

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function with its sigma_value in the new unit."""
        return replace(self, sigma_value=scaled_parameter(self.sigma_value, scale))

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function with the part of its map."""
        return replace(self, sigma_value=part_of_parameter(self.sigma_value, grid, box, "sigma_value"))

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """Return the parameters of the weights w1: patches of one vertex."""
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

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function with its h and sigma in the new unit."""
        return replace(self, h=scaled_parameter(self.h, scale), sigma=scaled_parameter(self.sigma, scale))

    @property
    def reach(self) -> int:
        """Radius of the patch."""
        return self.patch_radius

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function with the part of its maps."""
        return replace(
            self, h=part_of_parameter(self.h, grid, box, "h"), sigma=part_of_parameter(self.sigma, grid, box, "sigma")
        )

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """Return the parameters of the weights w2."""
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
            taken, shift = None, 2 * self.sigma * self.sigma * samples
        maps, spatial = _maps(graph, taken, strength), nearness(graph, self.sigma_space)
        return PatchForm(profile, shift, _inverse_square(h, dtype), spatial, maps, self.cut)


@dataclass(frozen=True)
class Held(PatchWeights):
    """See :func:`half` and :func:`recomputed`."""

    weights: PatchWeights
    how: Storage

    @property
    def storage(self) -> Storage:
        """How the weights are stored on the device."""
        return self.how

    @property
    def reach(self) -> int:
        """Radius of the inner weight function."""
        return self.weights.reach

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function with the inner one in the new unit."""
        weights = self.weights.scaled(scale)
        return replace(self, weights=weights) if isinstance(weights, PatchWeights) else None

    def form(self, graph: AnyGraph, channels: int, dtype: npt.DTypeLike) -> PatchForm:
        """Return the parameters of the inner weight function."""
        return self.weights.form(graph, channels, dtype)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function with the part of the inner one."""
        weights = self.weights.part(grid, box)
        return replace(self, weights=weights) if isinstance(weights, PatchWeights) else None


@door
def bilateral(sigma_space: float, sigma_value: float | npt.ArrayLike) -> Weights:
    """Return bilateral weights w1, which are large for vertices near in space with similar values.

    Parameters
    ----------
    sigma_space : float
        sigma_P > 0, in the units of the grid's spacing or the graph's positions; infinity omits the spatial factor.
    sigma_value : float or (n,) array
        sigma_X > 0, in the data's units; infinity omits the factor of the values. With one value per vertex
        sigma_X(u) sigma_X(v) replaces sigma_X^2.

    Raises
    ------
    TypeError, ValueError
        A sigma that is not a number > 0; at use, a map for another number of vertices.

    Notes
    -----
    w1(u, v) = exp(-|u - v|^2 / sigma_P^2) exp(-|f0(u) - f0(v)|^2 / sigma_X^2), section 5.2 of the paper. There is no
    factor 1/2: sigma_P and sigma_X are sqrt(2) times the values of OpenCV and scikit-image.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1).T
    >>> weights = gr.weights.bilateral(2.0, 0.1)
    >>> gr.regularize(step, gr.GridGraph(8), weights=weights, backend="numpy").value[:, 0].round(3)
    array([0., 0., 0., 0., 1., 1., 1., 1.])
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
    """Return nonlocal weights w2, which are large for vertices with similar patches around them.

    Parameters
    ----------
    patch_radius : int
        k' >= 0 for patches with a side of 2 k' + 1 cells. Radius 0 compares only the data of the two vertices, on any
        graph; a larger radius needs vertices on a grid. Patches that cross the border are filled by reflection without
        the edge cell.
    h : float or (n,) array
        Filtering parameter > 0, in the data's units times the square root of the sum of g. With one value per vertex
        h(u) h(v) replaces h^2, so that the weights are symmetric.
    sigma : float or (n,) array, default 0
        Standard deviation of the noise: 2 sigma^2 is subtracted from the distance per sample and channel; negative
        results become 0. With one value per vertex sigma(u)^2 + sigma(v)^2 replaces 2 sigma^2.
    patch_sigma : float, optional
        Standard deviation a > 0, in cells, of a Gaussian patch g_a that sums to 1. None means a flat patch: g = 1.
    cut : float, default 0
        Weights below this value are set to 0, as in some filters (0.001 in OpenCV, exp(-5) in scikit-image).
    sigma_space : float, default infinity
        sigma_P of another factor exp(-|u - v|^2 / sigma_P^2), as in :func:`bilateral`, which reduces the weights of
        further neighbours. Infinity omits it.

    Raises
    ------
    TypeError, ValueError
        A patch_radius that is not an integer >= 0, h or patch_sigma not > 0, sigma < 0, cut not in 0..1; at use, a map
        for another number of vertices.

    Notes
    -----
    w2(u, v) = exp(-rho(u, v) / h^2) with rho(u, v) = sum_j g(j) |f0(u + j) - f0(v + j)|^2, section 5.2 of the paper.
    For a flat patch of s cells and C channels, the parameter H of scikit-image and OpenCV gives h^2 = C s H^2.
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
    """Return the same weights on a grid, stored in float16, with half the memory and half the memory traffic.

    Parameters
    ----------
    weights : Weights
        From :func:`bilateral` or :func:`patch`.

    Raises
    ------
    TypeError
        Other weights.
    BackendUnavailable
        At use: a stored graph.

    Notes
    -----
    The relative error of a weight is at most 2^-11; below 2^-14 the absolute error is at most 2^-25. A sweep is a
    quotient of two sums of w (g(u) + g(v)), and the relative error of g = |grad f|^(p - 2) is |p - 2|/2 times as large.
    The error of the result is at most (2 + |p - 2|) 2^-11 of the range of f over the neighbours and the data: 1.5e-3 of
    it for p = 1.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1).T
    >>> weights = gr.weights.half(gr.weights.bilateral(2.0, 0.7))
    >>> gr.regularize(step, gr.GridGraph(8), weights=weights, max_iter=1, backend="numpy").value[2:6, 0].round(3)
    array([0.   , 0.073, 0.927, 1.   ])
    """
    return Held(_patch_weights_for(weights, "half"), "half")


@door
def recomputed(weights: Weights) -> Weights:
    """Return the same bilateral weights on a grid, computed at each use instead of stored per edge.

    Parameters
    ----------
    weights : Weights
        From :func:`bilateral`, or from :func:`patch` with radius 0.

    Raises
    ------
    TypeError
        Other weights.
    BackendUnavailable
        At use: a stored graph, or patches of more than one cell.

    Notes
    -----
    The values are equal to stored weights. A job then needs memory only for a few functions on the vertices, for any
    window; on numpy, the reference backend, the weights are stored.
    """
    return Held(_patch_weights_for(weights, "recomputed"), "none")
