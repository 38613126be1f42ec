"""The nonlocal weights that :func:`gpureg.denoise_image` takes where none are given: a rule from the noise alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..weights import OPPONENT, Weights, blur_norm, patch, smoothed

# The noise beyond which the rule does not go on, in 255ths of the contrast.
_LOUDEST = 60.0


class NonlocalRule(NamedTuple):
    """What the rule chooses.

    Attributes
    ----------
    weights : Weights or array
    lam : float
        Twice the weight of a pixel itself.
    average_radius : int or None
        Radius of the patches whose estimates are averaged, each counted by its weights; None averages none.
    """

    weights: Weights | npt.ArrayLike
    lam: float
    average_radius: int | None


def nonlocal_rule(
    noise: float,
    spread: float,
    channels: int,
    ndim: int,
    spacing: Sequence[float] | None = None,
    profile: npt.NDArray[np.float64] | None = None,
    patch_radius: int | None = None,
) -> NonlocalRule:
    """Choose one step of nonlocal means for an image.

    Parameters
    ----------
    noise : float
        Standard deviation of the noise, in the image's units.
    spread : float
        Contrast of the image, in its units.
    channels, ndim : int
        Of the image; `ndim` is the number of axes of the grid.
    spacing : sequence of float, one per axis, optional
        That of the grid.
    profile : (n,) float array, optional
        What each pixel has of the noise; None means 1 everywhere.
    patch_radius : int, optional
        Radius of the patches; None takes what the Gaussian needs.

    Notes
    -----
    Weights compare a copy of the image blurred by a Gaussian of half a pixel, in RGB as brightness and, at 0.45, two
    opponent colours; patches are Gaussian, of deviation a; what the blur leaves of the noise, and a fifth more, is
    taken off their distances; neighbours further away count less (sigma_space); 3 x 3 patches are averaged by their
    weights. With L the noise in 255ths of the contrast, fitted at L = 5 to 60 on seven grey and three colour
    photographs and on three synthetic volumes and two series, by coordinate descent on the mean PSNR.
    """
    level = min(_LOUDEST, 255 * noise / spread) if spread > 0 else _LOUDEST
    blur, share, own, taken = 0.4 + level / 200, math.sqrt(channels), 0.6 + level / 70, 1.2
    sigma_space = min(4 + level**2 / 130, 15.0)
    average_radius: int | None = 1
    if ndim > 2:
        blur, a, h, own = 0.6, min(0.8, max(0.5, level / 50)), 1.15 - level / 100, 0.75
        sigma_space, average_radius = math.inf, None
        if channels > 1:
            blur, a, h, own, taken = 0.45, 0.5, 1.05 - level / 150, 0.6, 1.1
    elif channels == 1:
        a, h = 0.7 + level / 25, 0.78 - level / 110
    else:
        a, h, own, taken, sigma_space = 0.8, 0.9 - level / 80, 0.6, 1.1, 5 + level / 6
    opponent = channels == 3
    if opponent:
        # a distance in opponent colours has the noise of so many equal channels
        share = math.sqrt((OPPONENT**2).sum())
    h = max(h, 0.34 if channels > 1 else 0.4) * noise * share
    left = noise * math.sqrt(taken / channels) * share * blur_norm(blur, spacing, ndim)
    radius = min(5 if ndim == 2 else 2, math.ceil(1.5 * a)) if patch_radius is None else patch_radius
    shape: float | None = a
    if channels > 1 and ndim == 2:
        # a flat patch of 3 x 3 tells as much in colour: its weights sum to 9
        radius = 1 if patch_radius is None else patch_radius
        shape, h = None, 0.95 * (2 * radius + 1) * h
    sigma_space *= math.sqrt(2) * (1.0 if spacing is None else min(spacing))
    of_each = 1.0 if profile is None else profile
    weights = patch(radius, h * of_each, sigma=left * of_each, patch_sigma=shape, sigma_space=sigma_space)
    return NonlocalRule(smoothed(weights, blur, opponent=opponent), 2 * own, average_radius)
