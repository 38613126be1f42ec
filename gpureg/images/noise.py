"""The noise of an image, for a plan: :func:`noise_of`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..noise.white import estimate_noise
from .raster import Raster


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of an image.

    Attributes
    ----------
    sigma : float or None
        Standard deviation in the image's units, of a map the root mean square; None if it is not known.
    estimated : bool
        Whether it was estimated.
    profile : (n,) float array or None
        Noise of each pixel as a multiple of `sigma`, if it was given as a map.
    """

    sigma: float | None
    estimated: bool = False
    profile: npt.NDArray[np.float64] | None = None

    @property
    def level(self) -> float:
        """The standard deviation, 0 if it is not known."""
        return 0.0 if self.sigma is None else self.sigma

    def found(self, raster: Raster) -> Noise:
        """Return the noise; estimate it if it is not known."""
        if self.sigma is not None:
            return self
        return Noise(estimate_noise(raster.values, channel_axis=raster.channel_axis, mask=raster.inside), True)

    def is_negligible(self, raster: Raster, spread: float) -> bool:
        """Return whether it is 0, or estimated below half a grey level of this contrast, as rounding may cause."""
        half = 0.5 if raster.values.dtype.kind in "iu" else 0.5 / 255 * spread
        return self.level == 0 or (self.estimated and self.level < half)


def noise_of(raster: Raster, sigma: float | npt.ArrayLike | None, *, needed: bool) -> Noise:
    """Return the given noise of an image, or an estimate if it is `needed`."""
    if sigma is not None and np.ndim(sigma) > 0:
        mean, profile = _noise_profile(sigma, raster)
        return Noise(mean, profile=profile)
    noise = Noise(None if sigma is None else float(sigma))  # type: ignore[arg-type]
    return noise.found(raster) if needed else noise


def _noise_profile(sigma: npt.ArrayLike, raster: Raster) -> tuple[float, npt.NDArray[np.float64]]:
    """Return the root mean square of a map of the noise over the mask, and the map divided by it, (n,)."""
    values = np.asarray(sigma).astype(np.float64)
    inside = np.ones(raster.shape, bool) if raster.inside is None else raster.inside
    known = values[inside]
    if not (np.isfinite(known).all() and (known >= 0).all()):
        raise ValueError("a map of sigma must be finite and >= 0 wherever a pixel takes part")
    mean = math.sqrt(float(np.mean(known**2))) if known.size else 0.0
    if mean == 0:
        return 0.0, np.ones(values.size)
    # at least 0.01: for a pixel without noise all weights to other pixels would be 0
    profile = np.where(inside, np.maximum(np.where(inside, values, mean) / mean, 0.01), 1.0)
    return mean, profile.ravel()
