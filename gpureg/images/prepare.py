"""Apply to an image what is known of its noise: impulses, growth with the signal, units of the channels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import held_type
from ..noise.blocks import measured_axes
from ..noise.flat import large_flat_areas
from ..noise.impulse_map import impulses_in
from ..noise.impulses import REACH, ImpulseRule
from ..noise.impulses import filled as without_impulses
from ..noise.photon import PhotonNoise
from ..weights import scaled_by
from .guides import filled
from .noise import LEAST
from .passes import PassNoise
from .plan import DenoisePlan
from .raster import Raster

# Standard deviation in pixels of the Gaussian that smooths an image before its noise is read from its values, in a
# plane and in a volume, and the radius of this filter in standard deviations.
_BLUR, _TRUNCATE = {2: 1.5, 3: 1.0}, 4.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """An image that is ready for the model.

    Attributes
    ----------
    plan : DenoisePlan
        The plan for it, with maps of weights and lam.
    cells : (..., m) array
        Its values without impulses, in a type that holds them.
    dtype : dtype
        The type of `pixels`.
    inside : bool array or None
        True where a pixel takes part.
    impulses : int
        Number of values that were replaced.
    profile : float array or None
        Noise of each pixel as a multiple of that of the image, for passes on groups; None for 1.
    """

    plan: DenoisePlan
    cells: npt.NDArray[Any]
    dtype: np.dtype[Any]
    inside: npt.NDArray[np.bool_] | None = None
    impulses: int = 0
    profile: npt.NDArray[np.float64] | None = None

    @functools.cached_property
    def pixels(self) -> npt.NDArray[Any]:
        """The values as real numbers, divided by the units of the channels, (..., m)."""
        values = self.cells.astype(self.dtype, copy=False)
        return values / np.asarray(self.plan.units, self.dtype) if self.plan.units else values

    def back(self, value: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return a result in the image's units."""
        return value * np.asarray(self.plan.units, value.dtype) if self.plan.units else value


def prepared(plan: DenoisePlan, raster: Raster, dtype: npt.DTypeLike | None) -> Prepared:
    """Replace the impulses of an image, and make the maps of the plan; `dtype` is the type to compute in."""
    count, profile, cells = 0, None, raster.cells
    if plan.replaces_impulses:
        cells, hit = replaced(raster, raster.pixels(dtype), plan.impulses)
        count = int(np.count_nonzero(hit))
        lost = hit.all(axis=-1)
        if lost.any() and plan.max_iter > 0:
            plan = replace(plan, lam=np.where(lost, 0.0, np.asarray(plan.lam)))
    if any(line is not None for line in plan.photon) and plan.max_iter > 0:
        profile = _profile(plan, raster, cells, plan.photon)
        plan = _adapted(plan, profile)
    if plan.passes and plan.noise is not None:
        profile = _of_passes(plan, plan.noise, raster, cells, profile)
    inside = raster.inside
    if plan.flat_side and plan.max_iter > 0:
        flat = flat_in_all(raster, plan.flat_side)
        if flat.any():
            inside = ~flat if inside is None else inside & ~flat
    held = held_type(raster.values.dtype, raster.computed_type(dtype))
    return Prepared(plan, cells, held, inside, count, profile if plan.passes else None)


def flat_in_all(raster: Raster, side: int) -> npt.NDArray[np.bool_]:
    """Return the cells in areas of equal values of this side, in all channels."""
    each = (large_flat_areas(raster.cells[..., i], raster.inside, side) for i in range(raster.channels))
    found: npt.NDArray[np.bool_] = np.logical_and.reduce(list(each))
    return found


def replaced(
    raster: Raster, pixels: npt.NDArray[Any], rules: Sequence[ImpulseRule | None]
) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
    """Replace the impulses of each channel by the median of their neighbours.

    Parameters
    ----------
    raster : Raster
        The image, in which impulses are looked for.
    pixels : (..., m) array
        Its values, in which they are replaced.
    rules : sequence of (ImpulseRule or None)
        One per channel.

    Returns
    -------
    (..., m) array, (..., m) bool array
        The new values, and where they are new.
    """
    pixels, hit = pixels.copy(), np.zeros(pixels.shape, bool)
    axes = measured_axes(raster.shape)[-2:]
    for i, rule in enumerate(rules):
        if rule is not None:
            hit[..., i] = impulses_in(raster.cells[..., i], raster.inside, rule)
            pixels[..., i] = without_impulses(pixels[..., i], hit[..., i], axes, raster.inside)
    return pixels, hit


def _profile(
    plan: DenoisePlan, raster: Raster, pixels: npt.NDArray[Any], photon: Sequence[PhotonNoise | None]
) -> npt.NDArray[np.float64]:
    """Return the noise of each pixel where it grows with the signal, as a multiple of that of the image."""
    apart = plan.units or (plan.noise is not None and plan.noise.units)
    levels = (1.0,) * len(plan.sigmas) if apart else plan.sigmas
    return relative_noise(raster, pixels, photon, plan.sigmas, levels)


def _of_passes(
    plan: DenoisePlan,
    noise: PassNoise,
    raster: Raster,
    pixels: npt.NDArray[Any],
    profile: npt.NDArray[np.float64] | None,
) -> npt.NDArray[np.float64] | None:
    """Return the noise of each pixel for the passes; `profile` is that of the filter's plan."""
    if noise.profile is not None:
        return noise.profile.reshape(raster.shape)
    if profile is None and any(line is not None for line in noise.photon):
        return _profile(plan, raster, pixels, noise.photon)
    return profile


def _adapted(plan: DenoisePlan, profile: npt.NDArray[np.float64]) -> DenoisePlan:
    """Return the plan with the noise of each pixel in its weights and, where it is one of the data, its lam."""
    found = scaled_by(plan.weights, profile.ravel())
    if found is not None:
        return replace(plan, weights=found)
    return replace(plan, lam=np.asarray(plan.lam) / profile**2)


def relative_noise(
    raster: Raster,
    pixels: npt.NDArray[Any],
    photon: Sequence[PhotonNoise | None],
    sigmas: Sequence[float],
    levels: Sequence[float],
) -> npt.NDArray[np.float64]:
    """Return the noise of each pixel over that of the image, the root mean square over the channels.

    Parameters
    ----------
    raster : Raster
    pixels : (..., m) array
        Its values without impulses.
    photon, sigmas : sequences
        For each channel how its noise grows, or None, and its root mean square.
    levels : sequence of float
        The noise of each channel in the units in which channels are compared.
    """
    variance = np.zeros(raster.shape, np.float64)
    known = [0.0 if math.isnan(level) else level for level in levels]
    largest = max(known) or 1.0
    shares = [(level / largest) ** 2 for level in known]
    for i, (line, sigma, share) in enumerate(zip(photon, sigmas, shares, strict=True)):
        if share > 0:
            variance += share if line is None else share * (_noise_map(raster, pixels[..., i], line) / sigma) ** 2
    return np.sqrt(np.maximum(variance / (sum(shares) or 1.0), LEAST**2))


def reach_of(plan: DenoisePlan, ndim: int) -> int:
    """Return the distance of the pixels on which the preparation of a pixel depends."""
    blur = _BLUR[2 if ndim < 3 else 3]
    reach = REACH if plan.replaces_impulses else 0
    lines = plan.photon if plan.noise is None else (*plan.photon, *plan.noise.photon)
    if any(line is not None for line in lines):
        reach += 2 * int(_TRUNCATE * blur + 0.5)  # a pixel outside the mask takes the value of the nearest inside
    return reach + plan.flat_side


def _noise_map(raster: Raster, values: npt.NDArray[Any], line: PhotonNoise) -> npt.NDArray[np.float64]:
    """Return the standard deviation of the noise at each pixel, from smoothed values."""
    from scipy import ndimage

    known = values if raster.whole else filled(values[..., None], raster.inside)[..., 0]  # type: ignore[arg-type]
    blur = _BLUR[2 if raster.ndim < 3 else 3]
    # float32 would round values far from 0
    return line.sigma(ndimage.gaussian_filter(known.astype(np.float64), blur, truncate=_TRUNCATE))
