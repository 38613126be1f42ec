"""Weights that compare other values than the data: :func:`guided`, :func:`smoothed`."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..backends import Array, Backend, Weighted, gaussian_taps
from ..checks import flag, number
from ..doors import door
from ..frame import Frame
from ..graphs.grid import AnyGraph, GridGraph
from .base import PatchWeights, Weights, rows_of

# Brightness and two opponent colours: orthonormal, except for a smaller factor of the colours, which are noisier.
CHROMA = 0.45
OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [0.5, -1, 0.5]]) / np.sqrt(np.array([[3], [2], [1.5]]))
OPPONENT[1:] *= CHROMA

_THREE = "opponent colours are made of red, green and blue: 3 channels, got {}"

# Number of standard deviations at which a Gaussian is cut off.
_TRUNCATE = 4.0


@dataclass(frozen=True, eq=False)
class Compared(Weights):
    """A weight function that compares other values than the data."""

    weights: Weights

    @abstractmethod
    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """Return the compared values, (n, q), for the data `f0`, (n, m)."""

    def on_device(self, backend: Backend, grid: GridGraph, f0: Array) -> Array:
        """Return the compared values as a device function, for device data `f0`."""
        return backend.put(grid, self.of(grid, backend.get(grid, f0)))

    def channels(self, m: int) -> int:
        """Return the number of channels q of the compared values, for data with m channels."""
        return m

    def on(self, graph: AnyGraph) -> Weights:
        """Return it with the inner weight function for a graph."""
        return replace(self, weights=self.weights.on(graph))

    def prepare(self, backend: Backend, graph: AnyGraph, f0: FloatArray) -> Weighted:
        """Compute the weights from the compared values, and return the graph with them on the backend's device."""
        return self.weights.prepare(backend, graph, self.of(graph, f0))

    @property
    def reach(self) -> int:
        """Radius of the inner weight function."""
        return self.weights.reach


@dataclass(frozen=True, eq=False)
class Guided(Compared):
    """See :func:`guided`."""

    guide: FloatArray

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """Return the guide as rows (n, q), after checking that there is one per vertex of the graph."""
        n, shape = graph.n_vertices, self.guide.shape
        grid = graph if isinstance(graph, GridGraph) else graph.grid
        if shape[0] != n and (grid is None or shape[: grid.ndim] != grid.shape):
            also = "" if grid is None else f" or the grid's shape {grid.shape}"
            raise ValueError(f"the guide must have {n} rows, one per vertex,{also} got shape {shape}")
        return self.guide.reshape(n, -1)

    def on_device(self, backend: Backend, grid: GridGraph, f0: Array) -> Array:
        """Return the guide as a device function; the data do not matter."""
        return backend.put(grid, self.of(grid, self.guide))

    def channels(self, m: int) -> int:
        """Return the number of channels of the guide, which must be rows (n, q)."""
        return int(self.guide.shape[1])

    def on(self, graph: AnyGraph) -> Weights:
        """Return the weight function with the guide as rows (n, q)."""
        return Guided(self.weights.on(graph), self.of(graph, self.guide))

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function with the guide in units of its own; it must be rows (n, q)."""
        frame = Frame.of(self.guide)
        weights = self.weights.scaled(frame.scale)
        return None if weights is None else Guided(weights, frame.into(self.guide, self.guide.dtype))

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function with the part of the guide."""
        weights = self.weights.part(grid, box)
        return None if weights is None else Guided(weights, rows_of(self.of(grid, self.guide), grid, box))


@dataclass(frozen=True, eq=False)
class Smoothed(Compared):
    """See :func:`smoothed`."""

    std: float
    opponent: bool = False

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        """Return the smoothed data, (n, m), with `opponent` in opponent colours."""
        from scipy import ndimage

        grid = graph if isinstance(graph, GridGraph) else graph.grid
        if grid is None:
            raise ValueError("smoothed weights need vertices on a grid; this graph has none")
        f = _in_opponent_colours(f0) if self.opponent else f0
        if self.std == 0:
            return f
        cells = f.reshape(*grid.shape, f.shape[1])
        stds = blur_stds(self.std, grid.spacing, grid.ndim)

        # values outside the mask too, as in patches
        channels = [
            ndimage.gaussian_filter(cells[..., c], stds, mode="mirror", truncate=_TRUNCATE) for c in range(f.shape[1])
        ]
        return np.stack(channels, axis=-1).reshape(f.shape)

    def on_device(self, backend: Backend, grid: GridGraph, f0: Array) -> Array:
        """Return the smoothed data as a device function; they do not leave the device."""
        if self.opponent and backend.channels(f0) != 3:
            raise ValueError(_THREE.format(backend.channels(f0)))
        f = backend.mix(grid, f0, OPPONENT) if self.opponent else f0
        stds = blur_stds(self.std, grid.spacing, grid.ndim)
        return backend.blur(grid, f, [gaussian_taps(std, _TRUNCATE) for std in stds]) if self.std else f

    def scaled(self, scale: float) -> Weights | None:
        """Return the weight function with the inner one in the new unit."""
        weights = self.weights.scaled(scale)
        return None if weights is None else replace(self, weights=weights)

    @property
    def reach(self) -> int:
        """Radius of the inner weight function plus that of the Gaussian."""
        return self.weights.reach + int(_TRUNCATE * self.std + 0.5)

    def part(self, grid: GridGraph, box: tuple[slice, ...]) -> Weights | None:
        """Return the weight function with the part of the inner one."""
        weights = self.weights.part(grid, box)
        return None if weights is None else replace(self, weights=weights)


def _in_opponent_colours(f: FloatArray) -> FloatArray:
    if f.shape[1] != 3:
        raise ValueError(_THREE.format(f.shape[1]))
    red, green, blue = f.T
    seen = np.empty_like(f)
    for c, (r, g, b) in enumerate(OPPONENT.astype(f.dtype)):
        # not a matrix product, whose order of summation may depend on the position of a pixel
        seen[:, c] = r * red + g * green + b * blue
    return seen


@dataclass(frozen=True, eq=False)
class _Chain(Compared):
    """Several nested functions as one: the compared values pass through all of them."""

    steps: tuple[Compared, ...] = ()

    def of(self, graph: AnyGraph, f0: FloatArray) -> FloatArray:
        for step in self.steps:
            f0 = step.of(graph, f0)
        return f0

    def on_device(self, backend: Backend, grid: GridGraph, f0: Array) -> Array:
        for step in self.steps:
            f0 = step.on_device(backend, grid, f0)
        return f0

    def channels(self, m: int) -> int:
        for step in self.steps:
            m = step.channels(m)
        return m


def patch_weights(weights: object) -> tuple[PatchWeights, Compared | None] | None:
    """Return the inner patch weights, and what they compare (None for the data); None for other weights."""
    steps: list[Compared] = []
    while isinstance(weights, Compared):
        steps.append(weights)
        weights = weights.weights
    if not isinstance(weights, PatchWeights):
        return None
    return weights, _Chain(weights, tuple(steps)) if steps else None


@door
def guided(weights: Weights, guide: npt.ArrayLike) -> Weights:
    """Return a weight function that compares a guide instead of the data.

    Parameters
    ----------
    weights : Weights
    guide : (n,) or (n, q) float array, on a grid also shape or shape + (q,)
        The compared values, one row per vertex, channels last, e.g. a cleaner image of the same scene.

    Raises
    ------
    TypeError, ValueError
        Not a weight function, or a guide that is not finite; at use, another number of vertices.
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
    """Return a weight function on a grid that compares the data after a Gaussian blur.

    Parameters
    ----------
    weights : Weights
    std : float
        Standard deviation of the Gaussian >= 0, in units of the smallest cell side; it is cut off at 4 std.
    opponent : bool, default False
        Compare brightness and two opponent colours times 0.45 instead of red, green and blue (three channels).

    Raises
    ------
    TypeError, ValueError
        Not a weight function, or a std that is not >= 0; at use, vertices that are not on a grid, or opponent colours
        with a number of channels other than three.

    Notes
    -----
    The averaged values stay sharp, and the weights are less noisy. A blur of half a pixel improves nonlocal means more
    than a second pass over its result. After a blur with kernel k along d axes, white noise of deviation sigma has
    deviation sigma (sum k^2)^(d/2): give this to :func:`patch` as `sigma`.

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
    """Return the standard deviation of the blur along each axis, in cells; in length it is the same for all axes."""
    return (std,) * ndim if spacing is None else tuple(std * min(spacing) / step for step in spacing)


def blur_norm(std: float, spacing: Sequence[float] | None, ndim: int) -> float:
    """Return the l2 norm of the blur's kernel: the factor by which it reduces the deviation of white noise."""
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
