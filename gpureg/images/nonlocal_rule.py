"""The default nonlocal weights of :func:`gpureg.denoise_image`, chosen from the noise by a rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..weights import OPPONENT, Weights, blur_norm, patch, smoothed

# The largest noise of the rule, in 255ths of the contrast; above it the parameters stay the same.
_LOUDEST = 60.0


class NonlocalRule(NamedTuple):
    """The parameters that the rule chooses.

    Attributes
    ----------
    weights : Weights or array
    lam : float
        Twice the weight of a pixel itself.
    average_radius : int or None
        Radius of the patches whose estimates are averaged with their weights; None means no averaging.
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
    """Choose the parameters of one sweep of nonlocal means for an image.

    Parameters
    ----------
    noise : float
        Standard deviation of the noise, in the image's units.
    spread : float
        Contrast of the image, in its units.
    channels, ndim : int
        Number of channels of the image, and number of axes of the grid.
    spacing : sequence of float, one per axis, optional
        Spacing of the grid.
    profile : (n,) float array, optional
        Noise of each pixel as a multiple of `noise`; None means 1 everywhere.
    patch_radius : int, optional
        Radius of the patches; None means a radius that depends on the standard deviation a of the Gaussian patch.

    Notes
    -----
    The weights compare a copy of the image that is blurred by a Gaussian of about half a pixel; RGB images as
    brightness and two opponent colours times 0.45. Patches are Gaussian, in colour 3 x 3 and flat. The noise left after
    the blur, plus 10 or 20 percent of its variance, is subtracted from their distances. Further neighbours have smaller
    weights (sigma_space), and 3 x 3 patches are averaged with their weights, not in volumes. The formulas use the noise
    L in 255ths of the contrast. They were fitted at L = 5 to 60 by coordinate descent on the mean PSNR, on seven grey
    and three colour photographs, three synthetic volumes and two series.
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
        # a distance in opponent colours has the noise of this number of equal channels
        share = math.sqrt((OPPONENT**2).sum())
    h = max(h, 0.34 if channels > 1 else 0.4) * noise * share
    left = noise * math.sqrt(taken / channels) * share * blur_norm(blur, spacing, ndim)
    radius = min(5 if ndim == 2 else 2, math.ceil(1.5 * a)) if patch_radius is None else patch_radius
    shape: float | None = a
    if channels > 1 and ndim == 2:
        # in colour a flat patch of 3 x 3 is as good; it sums to 9
        radius = 1 if patch_radius is None else patch_radius
        shape, h = None, 0.95 * (2 * radius + 1) * h
    sigma_space *= math.sqrt(2) * (1.0 if spacing is None else min(spacing))
    of_each = 1.0 if profile is None else profile
    weights = patch(radius, h * of_each, sigma=left * of_each, patch_sigma=shape, sigma_space=sigma_space)
    return NonlocalRule(smoothed(weights, blur, opponent=opponent), 2 * own, average_radius)
