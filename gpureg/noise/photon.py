"""Estimate noise that grows with the signal (photon noise)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..checks import number
from ..doors import door
from .blocks import blocks, channels_of
from .survey import measured_with_growth
from .white import check_channel_axis


@door
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

    Raises
    ------
    TypeError, ValueError
        Not numbers, not finite, or a gain or a read noise below 0.
    """

    gain: float
    read_noise: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        number("gain", self.gain, low=0)
        number("read_noise", self.read_noise, low=0)
        number("offset", self.offset)

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

    To denoise, they are not needed: :func:`gpureg.denoise_image` finds the growth of the noise, without an offset.

    Parameters
    ----------
    image : array
        As in :func:`estimate_noise`; after subtraction of `offset` its values must be proportional to the light.
    offset : float, default 0
        The image's value without light; it is 100 for many scientific cameras. Without it the read noise means nothing.
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
        As :func:`estimate_noise`; also an image with fewer than 2400 pixels to measure, or of one brightness only.

    Notes
    -----
    The photon transfer line (Janesick, Photon Transfer, 2007) is::

        variance = gain (mean - offset) + read_noise^2.

    Mean and variance (from Immerkaer's response) are measured in 24 classes of brightness with equal numbers of pixels,
    each where texture is weakest. The line is fitted to them with weights from the scatter and Huber's weights for
    outliers. Its value at `offset` is read_noise^2, an extrapolation for images without dark regions. Areas of equal
    values, impulses and the surroundings of clipped values are left out.

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
    channels, inside = channels_of(image, channel_axis, mask)
    passed = measured_with_growth([block for c in channels for part in blocks(c, inside) for block in part])
    found = passed.growth
    if found is None:
        fields = [part.fields for part in passed.parts if part.fields is not None]
        pixels = sum(int(np.count_nonzero(each.valid)) for each in fields)
        raise ValueError(
            f"{pixels} pixels are left to measure: at least 2400 of several brightnesses are needed, not in areas of "
            "equal values and not clipped"
        )
    gain, level = (found.slope, found.level) if found.slope > 0 else (0.0, found.mean_variance)
    return PhotonNoise(gain, math.sqrt(max(level + gain * offset, 0.0)), float(offset))
