"""Search for the best parameters of a denoiser without the clean image: :func:`calibrate`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..checks import choice, flag, integer, number
from ..doors import door
from ..noise.white import estimate_noise
from .risk import Denoiser, j_invariance, sure

Method = Literal["sure", "j-invariance"]


@dataclass(frozen=True)
class Trial:
    """One choice of parameters, and its loss."""

    parameters: dict[str, Any]
    loss: float


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration.

    Attributes
    ----------
    parameters : dict
        The best parameters.
    loss : float
        Their loss: with SURE an estimate of the mean squared error, with J-invariance of this error plus sigma^2.
    table : tuple of Trial
        All trials, in order.
    method : {"sure", "j-invariance"}
    sigma : float, array or None
        The standard deviation of the noise for SURE.
    """

    parameters: dict[str, Any]
    loss: float
    table: tuple[Trial, ...]
    method: Method
    sigma: float | npt.NDArray[Any] | None

    def __str__(self) -> str:
        best = ", ".join(f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}" for k, v in self.parameters.items())
        name = "SURE" if self.method == "sure" else "J-invariance"
        return f"{best}: {name} {self.loss:.4g}, the least of {len(self.table)} tried"


@door
def calibrate(
    denoise: Denoiser,
    image: npt.ArrayLike,
    grid: Mapping[str, Sequence[Any]],
    *,
    method: Method = "sure",
    sigma: float | npt.ArrayLike | None = None,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    seed: int = 0,
    stride: int = 4,
    every: bool = False,
    refine: bool = True,
) -> Calibration:
    """Find the best parameters of any denoiser on a grid, from the noisy image alone.

    Parameters
    ----------
    denoise : callable
        ``denoise(image, **parameters)`` returns an array of the image's shape.
    image : array
        The noisy image.
    grid : mapping
        The values to try for the name of each parameter; all combinations are tried.
    method : {"sure", "j-invariance"}, default "sure"
        :func:`sure` for white Gaussian noise, with two calls of the denoiser per combination; :func:`j_invariance` for
        any noise that is independent between pixels, with one call.
    sigma : float or array, optional
        Standard deviation of the noise, for SURE; None estimates it.
    channel_axis : int, optional
        The axis of the channels; None for a grey image.
    mask : bool array, optional
        True where the image counts, in the shape of the image without the channels.
    stride, every, spacing
        As in :func:`j_invariance`.
    seed : int, default 0
        Seed of SURE's random probe, which is the same for all combinations.
    refine : bool, default True
        Try one more combination between the values of the grid: for each parameter of floats whose best value is not
        the first or the last, the vertex of the parabola through the best value and its two neighbours. The scale is
        logarithmic if these values are > 0.

    Returns
    -------
    Calibration

    Raises
    ------
    TypeError, ValueError
        An empty grid, an unknown method; also as :func:`sure` and :func:`j_invariance`.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> from scipy.ndimage import gaussian_filter
    >>> clean = np.sin(np.add.outer(np.arange(96), np.arange(96)) / 8)
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.3, clean.shape)
    >>> found = gr.tuning.calibrate(gaussian_filter, noisy, {"sigma": [0.5, 1.0, 2.0, 4.0]})
    >>> 1.5 < found.parameters["sigma"] < 2.5
    True
    """
    axes = {name: list(values) for name, values in grid.items()}
    if not axes or not all(axes.values()):
        raise ValueError("grid must name one parameter or more, each with one value or more to try")
    choice("method", method, ("sure", "j-invariance"))
    integer("seed", seed, low=0)
    integer("stride", stride, low=2)
    flag("every", every)
    refine = flag("refine", refine)
    loss: Callable[[Denoiser], float]
    noise: float | npt.NDArray[Any] | None = None
    if method == "sure":
        if sigma is None:
            noise = estimate_noise(image, channel_axis=channel_axis, mask=mask)
            if math.isnan(noise):
                raise ValueError('the noise cannot be told: give sigma, or take method="j-invariance"')
        else:
            noise = np.asarray(sigma) if np.ndim(sigma) else number("sigma", sigma, low=0)
        known = noise

        def loss(one: Denoiser) -> float:
            return sure(one, image, known, mask=mask, channel_axis=channel_axis, seed=seed)

    else:

        def loss(one: Denoiser) -> float:
            return j_invariance(
                one, image, stride=stride, every=every, channel_axis=channel_axis, mask=mask, spacing=spacing
            )

    table = {}
    for at in itertools.product(*[range(len(values)) for values in axes.values()]):
        parameters = {name: values[i] for (name, values), i in zip(axes.items(), at, strict=True)}
        table[at] = Trial(parameters, loss(lambda y, chosen=parameters: denoise(y, **chosen)))
    best = min(table, key=lambda at: table[at].loss)
    trials = list(table.values())
    if refine:
        between = dict(table[best].parameters)
        for k, (name, values) in enumerate(axes.items()):
            around = [(*best[:k], best[k] + step, *best[k + 1 :]) for step in (-1, 0, 1)]
            if all(at in table for at in around):
                between[name] = _vertex([values[at[k]] for at in around], [table[at].loss for at in around])
        if between != table[best].parameters:
            trials.append(Trial(between, loss(lambda y: denoise(y, **between))))
    least = min(trials, key=lambda trial: trial.loss)
    return Calibration(least.parameters, least.loss, tuple(trials), method, noise)


def _vertex(at: list[Any], losses: list[float]) -> Any:
    """Return the vertex of the parabola through three losses, the middle one the smallest; the middle if it fails."""
    middle = at[1]
    if not all(isinstance(x, int | float | np.number) and not isinstance(x, bool) for x in at):
        return middle
    if not any(isinstance(x, float | np.floating) for x in at) or not at[0] != at[1] != at[2] != at[0]:
        return middle
    logarithmic = min(at) > 0
    x = np.log(at) if logarithmic else np.asarray(at, np.float64)
    a, b, _ = np.polyfit(x - x[1], losses, 2)
    if not (a > 0 and math.isfinite(b / a)):
        return middle
    vertex = float(np.clip(x[1] - b / (2 * a), x.min(), x.max()))
    return math.exp(vertex) if logarithmic else vertex
