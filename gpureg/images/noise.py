"""How noisy an image is, as far as a plan has to know: :func:`noise_of`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..noise.white import estimate_noise
from .raster import Raster


@dataclass(frozen=True, eq=False)
class Noise:
    """How noisy an image is.

    Attributes
    ----------
    sigma : float or None
        Standard deviation, in the image's units, the root mean square of a map; None where it is not known.
    estimated : bool
        Whether it was estimated: the reason why it is what it is.
    profile : (n,) float array or None
        What each pixel has of it, where it was given as a map.
    """

    sigma: float | None
    estimated: bool = False
    profile: npt.NDArray[np.float64] | None = None

    @property
    def level(self) -> float:
        """The standard deviation, 0 where it is not known."""
        return 0.0 if self.sigma is None else self.sigma

    def found(self, raster: Raster) -> Noise:
        """The noise, estimated where it is not known."""
        if self.sigma is not None:
            return self
        return Noise(estimate_noise(raster.values, channel_axis=raster.channel_axis, mask=raster.inside), True)

    def is_negligible(self, raster: Raster, spread: float) -> bool:
        """Whether there is none, or an estimate below half a grey level of this contrast, what rounding may add."""
        half = 0.5 if raster.values.dtype.kind in "iu" else 0.5 / 255 * spread
        return self.level == 0 or (self.estimated and self.level < half)


def noise_of(raster: Raster, sigma: float | npt.ArrayLike | None, *, needed: bool) -> Noise:
    """The noise of an image: what is given, or where it is `needed` an estimate."""
    if sigma is not None and np.ndim(sigma) > 0:
        mean, profile = _noise_profile(sigma, raster)
        return Noise(mean, profile=profile)
    noise = Noise(None if sigma is None else float(sigma))  # type: ignore[arg-type]
    return noise.found(raster) if needed else noise


def _noise_profile(sigma: npt.ArrayLike, raster: Raster) -> tuple[float, npt.NDArray[np.float64]]:
    """A map of the noise as its root mean square over the mask, and what each pixel has of that, (n,)."""
    values = np.asarray(sigma).astype(np.float64)
    inside = np.ones(raster.shape, bool) if raster.inside is None else raster.inside
    known = values[inside]
    if not (np.isfinite(known).all() and (known >= 0).all()):
        raise ValueError("a map of sigma must be finite and >= 0 wherever a pixel takes part")
    mean = math.sqrt(float(np.mean(known**2))) if known.size else 0.0
    if mean == 0:
        return 0.0, np.ones(values.size)
    # no less than a hundredth: a pixel without any noise would leave the others nothing to be compared with
    profile = np.where(inside, np.maximum(np.where(inside, values, mean) / mean, 0.01), 1.0)
    return mean, profile.ravel()
