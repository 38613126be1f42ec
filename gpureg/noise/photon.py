"""Estimate noise that grows with the signal (photon noise)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..checks import number
from ..doors import door
from .blocks import AT_LEAST, SMOOTHEST, blocks, measured, smoothest, top
from .white import check_channel_axis

# Number of classes of brightness in which photon noise is measured, and of fits of their line.
_CLASSES, _FITS = 48, 30


@dataclass(frozen=True)
class PhotonNoise:
    """Noise with the variance ``gain * (mean - offset) + read_noise**2``.

    Attributes
    ----------
    gain : float
        Image units per detected photon, >= 0.
    read_noise : float
        Standard deviation of the noise without light, in the image's units; 0 if the fitted variance is negative.
    offset : float
        The image's value without light.
    """

    gain: float
    read_noise: float
    offset: float = 0.0

    def sigma(self, mean: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return the standard deviation of the noise at each expected value; below `offset` it is the read noise.

        Give a smoothed image: at noisy values, pixels that are dark by chance would get too little noise.
        """
        light = np.maximum(np.asarray(mean, np.float64) - self.offset, 0)
        return np.sqrt(self.gain * light + self.read_noise**2)


@door
def estimate_photon_noise(
    image: npt.ArrayLike,
    *,
    offset: float = 0.0,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
) -> PhotonNoise:
    """Estimate the gain and the read noise of a camera from one image.

    Parameters
    ----------
    image : array
        As in :func:`estimate_noise`; after subtraction of `offset` its values must be proportional to the light.
    offset : float, default 0
        The image's value without light; it is 100 for many scientific cameras.
    channel_axis : int, optional
        Axis of the channels, which share one gain.
    mask : bool array, optional
        True at the pixels to use.

    Returns
    -------
    PhotonNoise
        Its ``sigma(smoothed)`` is a map of one standard deviation per pixel. The gain is 0 if the noise does not grow
        with the light, that is, if it is white.

    Raises
    ------
    TypeError, ValueError
        As :func:`estimate_noise`; also an image with fewer than 200 pixels to measure, or of one brightness only.

    Notes
    -----
    The photon transfer line (Janesick, Photon Transfer, 2007) is::

        variance = gain (mean - offset) + read_noise^2.

    Mean and variance (from Immerkaer's response) are measured in classes of brightness, where texture is weakest. The
    line is fitted to them with weights from the scatter (the variance of a variance of n samples is 2/n of its square)
    and Huber's weights for outliers. Its value at `offset` is read_noise^2, an extrapolation for images without dark
    regions. Saturated pixels are left out. If the camera clips at 0, its zeros look like pixels without noise.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(7)
    >>> light = np.add.outer(np.linspace(5, 150, 200), np.linspace(5, 50, 200))
    >>> image = 100 + 2.0 * rng.poisson(light) + rng.normal(0, 6, light.shape)
    >>> found = estimate_photon_noise(image, offset=100)
    >>> round(found.gain, 1), round(found.read_noise)
    (2.0, 6)
    """
    offset = number("offset", offset)
    check_channel_axis(image, channel_axis)
    parts = []
    for channel in blocks(image, channel_axis, mask):
        for block, kept in channel:
            for part in measured(block, kept, (math.inf, top(block, kept))):
                valid = part.valid
                parts.append(np.stack([part.smooth[valid], part.response[valid] ** 2, part.texture[valid]]))
    mean, square, texture = np.concatenate(parts, axis=1) if parts else np.empty((3, 0))
    if mean.size < AT_LEAST:
        raise ValueError(f"{mean.size} pixels are left to measure, at least {AT_LEAST} are needed: use a larger image")
    means, variances, counts = _classes(mean, square, texture)
    if len(means) < 2:
        raise ValueError("the image has one brightness only, which does not say how noise grows with the light")
    gain, level = _line(means, variances, counts)
    return PhotonNoise(gain, math.sqrt(max(level + gain * offset, 0.0)), float(offset))


def _classes(
    mean: npt.NDArray[np.float64], square: npt.NDArray[np.float64], texture: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], ...]:
    """Return mean, variance and number of pixels, (k,) each, of classes of brightness, where texture is weakest."""
    # Equal steps of the square root, in which photon noise is constant.
    root = np.sqrt(mean - mean.min())
    edges = np.linspace(0, root.max(), _CLASSES + 1)[1:-1]
    of = np.searchsorted(edges, root, side="right")
    found = []
    for each in range(_CLASSES):
        members = np.flatnonzero(of == each)
        if members.size >= AT_LEAST:
            chosen = members[smoothest(texture[members], 2 * SMOOTHEST)]
            found.append((mean[chosen].mean(), square[chosen].mean(), float(chosen.size)))
    return tuple(np.array(found).reshape(-1, 3).T)


def _line(
    means: npt.NDArray[np.float64], variances: npt.NDArray[np.float64], counts: npt.NDArray[np.float64]
) -> tuple[float, float]:
    """Fit the photon transfer line robustly to classes of brightness; return its slope >= 0 and its level."""
    weights = np.ones(len(means))
    slope = level = 0.0
    for _ in range(_FITS):
        slope, level = np.polyfit(means, variances, 1, w=np.sqrt(weights)).tolist()
        if slope < 0:
            slope, level = 0.0, float(np.average(variances, weights=weights))
        model = np.maximum(slope * means + level, 1e-3 * variances.max() + np.finfo(float).tiny)
        scatter = model * np.sqrt(2 / counts)
        off = np.abs(variances - model) / scatter
        spread = max(1.0, float(np.median(off)) / 0.6744897501960817)
        weights = np.minimum(1, 1.345 * spread / np.maximum(off, 1e-12)) / scatter**2
    return float(slope), float(level)
