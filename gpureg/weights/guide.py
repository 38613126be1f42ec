"""What weights compare, where it is not the data themselves: :func:`guided`, :func:`smoothed`."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..backends import Backend, Weighted
from ..checks import flag, number
from ..doors import door
from ..graphs.grid import AnyGraph, GridGraph
from .base import PatchWeights, Weights, rows_of

# Brightness and two opponent colours, orthonormal but for the share of the colours, which have less detail than noise.
CHROMA = 0.45
OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [0.5, -1, 0.5]]) / np.sqrt(np.array([[3], [2], [1.5]]))
OPPONENT[1:] *= CHROMA

# Standard deviations at which a Gaussian ends.
_TRUNCATE = 4.0


@dataclass(frozen=True, eq=False)
class Compared(Weights):
    """A weight function that is given something else than the data."""

    weights: Weights

    @abstractmethod
    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """What is compared, (n, q), where the data are `f0`, (n, m)."""

    def channels(self, m: int) -> int:
        """Channels q of what is compared, where the data have m."""
        return m

    def on(self, graph: AnyGraph) -> Weights:
        """The weight function it is given to, for a graph."""
        return replace(self, weights=self.weights.on(graph))

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """The graph with weights computed from what is compared."""
        return self.weights.prepare(backend, graph, self.of(graph, f0))

    @property
    def reach(self) -> int:
        """That of the weight function."""
        return self.weights.reach


@dataclass(frozen=True, eq=False)
class Guided(Compared):
    """See :func:`guided`."""

    guide: FloatArray

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """The guide as rows, once it has one for every vertex of the graph."""
        n, shape = graph.n_vertices, self.guide.shape
        grid = graph if isinstance(graph, GridGraph) else graph.grid
        if shape[0] != n and (grid is None or shape[: grid.ndim] != grid.shape):
            also = "" if grid is None else f" or the grid's shape {grid.shape}"
            raise ValueError(f"the guide must have {n} rows, one per vertex,{also} got shape {shape}")
        return self.guide.reshape(n, -1)

    def channels(self, m: int) -> int:
        """The guide's, once it is rows."""
        return int(self.guide.shape[1])

    def on(self, graph: AnyGraph) -> Weights:
        """The guide as rows."""
        return Guided(self.weights.on(graph), self.of(graph, self.guide))

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The weight function's part, with the guide's."""
        weights = self.weights.part(grid, box)
        return None if weights is None else Guided(weights, rows_of(self.of(grid, self.guide), grid, box))


@dataclass(frozen=True, eq=False)
class Smoothed(Compared):
    """See :func:`smoothed`."""

    std: float
    opponent: bool = False

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """The data in opponent colours or their own, smoothed along every axis of the grid."""
        from scipy import ndimage

        grid = graph if isinstance(graph, GridGraph) else graph.grid
        if grid is None:
            raise ValueError("smoothed weights need vertices on a grid; this graph has none")
        f = _in_opponent_colours(f0) if self.opponent else f0
        if self.std == 0:
            return f
        cells = f.reshape(*grid.shape, f.shape[1])
        stds = blur_stds(self.std, grid.spacing, grid.ndim)

        # under a mask too: patches see what stands there, and so does the blur
        channels = [
            ndimage.gaussian_filter(cells[..., c], stds, mode="mirror", truncate=_TRUNCATE) for c in range(f.shape[1])
        ]
        return np.stack(channels, axis=-1).reshape(f.shape)

    @property
    def reach(self) -> int:
        """That of the weight function, and of the Gaussian."""
        return self.weights.reach + int(_TRUNCATE * self.std + 0.5)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """The weight function's part, smoothed likewise."""
        weights = self.weights.part(grid, box)
        return None if weights is None else replace(self, weights=weights)


def _in_opponent_colours(f: FloatArray) -> FloatArray:
    if f.shape[1] != 3:
        raise ValueError(f"opponent colours are made of red, green and blue: 3 channels, got {f.shape[1]}")
    red, green, blue = f.T
    seen = np.empty_like(f)
    for c, (r, g, b) in enumerate(OPPONENT.astype(f.dtype)):
        # not a matrix product, whose order of sums may depend on where a pixel lies
        seen[:, c] = r * red + g * green + b * blue
    return seen


@dataclass(frozen=True, eq=False)
class _Chain(Compared):
    """What the innermost of several is given, through all of those around it."""

    steps: tuple[Compared, ...] = ()

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        for step in self.steps:
            f0 = step.of(graph, f0)
        return f0

    def channels(self, m: int) -> int:
        for step in self.steps:
            m = step.channels(m)
        return m


def patch_weights(weights: object) -> tuple[PatchWeights, Compared | None] | None:
    """Patch weights alone, and what they are given, None where it is the data. None if they are no such weights."""
    steps: list[Compared] = []
    while isinstance(weights, Compared):
        steps.append(weights)
        weights = weights.weights
    if not isinstance(weights, PatchWeights):
        return None
    return weights, _Chain(weights, tuple(steps)) if steps else None


@door
def guided(weights: Weights, guide: npt.ArrayLike) -> Weights:
    """The same weight function, computed from other data than those that are regularized.

    Parameters
    ----------
    weights : Weights
    guide : (n,) or (n, q) float array, on a grid also shape or shape + (q,)
        What the weights compare, one row per vertex, channels last, e.g. a cleaner picture of the same scene.

    Raises
    ------
    TypeError, ValueError
        No weight function, or a guide that is not finite; at use, another number of vertices.
    """
    given = np.asarray(guide)
    if given.dtype.kind not in "biuf":
        raise TypeError(f"the guide must be real numbers, one row per vertex, got {given.dtype}")
    table = given.astype(np.float64)
    if not table.ndim or not table.size or not np.isfinite(table).all():
        raise ValueError(f"the guide must be finite, one row per vertex, got shape {table.shape}")
    return Guided(_expect_weights(weights), table)


@door
def smoothed(weights: Weights, std: float, *, opponent: bool = False) -> Weights:
    """The same weight function on a grid, computed from the data after a Gaussian blur.

    Parameters
    ----------
    weights : Weights
    std : float
        Standard deviation of the Gaussian >= 0, in the smallest cells (fewer of larger ones); it ends at 4 of them.
    opponent : bool, default False
        Compare brightness and, at 0.45, two opponent colours instead of red, green and blue: three channels.

    Raises
    ------
    TypeError, ValueError
        No weight function, or a std that is not >= 0; at use, vertices that are on no grid, or opponent
        colours of other than three channels.

    Notes
    -----
    What is averaged stays sharp; what decides about it is less noisy. Half a pixel of blur does more for nonlocal means
    than a second pass over its result. Of white noise of deviation sigma, sigma (sum k^2)^(d/2) is left by a blur with
    kernel k along d axes: that, not sigma, is the noise that :func:`patch` should be told.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> f0 = np.random.default_rng(7).normal(0, 0.1, (16, 16)) + np.repeat([0.0, 1.0], 8)
    >>> weights = gr.weights.smoothed(gr.weights.patch(1, 0.3, sigma=0.05), 0.6)
    >>> result = gr.regularize(f0, gr.GridGraph((16, 16), 3), weights=weights, lam=2, max_iter=1, backend="numpy")
    >>> bool(np.std(result.value[:, :8]) < 0.03)
    True
    """
    return Smoothed(_expect_weights(weights), number("std", std, low=0), flag("opponent", opponent))


def blur_stds(std: float, spacing: Sequence[float] | None, ndim: int) -> tuple[float, ...]:
    """The blur along each axis, in cells: of as much length along all."""
    return (std,) * ndim if spacing is None else tuple(std * min(spacing) / step for step in spacing)


def blur_norm(std: float, spacing: Sequence[float] | None, ndim: int) -> float:
    """The l2 norm of the blur's kernel: what it leaves of the deviation of white noise."""
    from scipy import ndimage

    norm = 1.0
    for along in blur_stds(std, spacing, ndim):
        if along > 0:
            impulse = np.zeros(2 * int(_TRUNCATE * along + 0.5) + 3)
            impulse[len(impulse) // 2] = 1
            norm *= math.sqrt(float((ndimage.gaussian_filter1d(impulse, along, truncate=_TRUNCATE) ** 2).sum()))
    return norm


def _expect_weights(weights: object) -> Weights:
    if not isinstance(weights, Weights):
        raise TypeError(f"weights must be an object of gpureg.weights, got {type(weights).__name__}")
    return weights
