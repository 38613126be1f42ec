"""Filters whose parameters follow from the noise: :func:`by_noise`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..doors import warn
from ..model.result import Interrupted
from ..noise.report import NoiseReport
from .noise import Noise, Sigma, levels_of, noise_of
from .prepare import relative_noise, replaced
from .raster import Raster


@dataclass(frozen=True, eq=False)
class Treated:
    """Channels that are filtered together, and their noise.

    Attributes
    ----------
    raster : Raster
        The channels, with impulses replaced by the median of their neighbours.
    level : float or array of the image's pixels
        Root mean square noise over the channels.
    lost : bool array of the image's pixels, or None
        True where all channels have an impulse, so that there are no data.
    """

    raster: Raster
    level: float | npt.NDArray[np.float64]
    lost: npt.NDArray[np.bool_] | None = None

    def lam(self, lam: float | npt.ArrayLike) -> float | npt.ArrayLike:
        """Return the fidelity, 0 where there are no data."""
        return lam if self.lost is None or not self.lost.any() else np.where(self.lost, 0.0, np.asarray(lam))


def say(report: NoiseReport) -> None:
    """Warn of noise that cannot be removed or told."""
    for sentence in report.warnings():
        warn(sentence)
    for index, channel in enumerate(report.channels):
        if channel.state == "cannot tell":
            which = "" if len(report.channels) == 1 else f" of channel {index}"
            warn(f"the noise{which} cannot be told ({channel.why}), and no noise is removed: give sigma")


def level_of(raster: Raster, noise: Noise) -> float | npt.NDArray[np.float64]:
    """Return the root mean square noise over the channels, one number or one per pixel."""
    profile = noise.combined()
    if profile is not None:
        return noise.level * profile.reshape(raster.shape)
    if noise.photon is None or noise.sigmas is None or noise.level == 0:
        return noise.level
    return noise.level * relative_noise(raster, raster.cells, noise.photon, noise.sigmas, noise.sigmas)


def by_noise(
    raster: Raster, sigma: Sigma | None, guided: bool, run: Callable[[Treated], npt.NDArray[Any]]
) -> npt.NDArray[Any]:
    """Filter an image with parameters from its noise: channels together only where that is better.

    Parameters
    ----------
    raster : Raster
    sigma : float, numbers, map, "photon", NoiseReport, PhotonNoise or None
        The noise, as in :func:`gpureg.denoise_image`; None estimates it.
    guided : bool
        Whether a guide is compared: then all channels with noise are filtered together.
    run : callable
        Filters channels; returns an image of their shape and type.

    Returns
    -------
    array
        In the shape and type of the image; channels without noise are unchanged.
    """
    noise = noise_of(raster, sigma, needed=True)
    if noise.report is not None and noise.estimated:
        say(noise.report)
    everything = tuple(range(raster.channels))
    groups, same = ((everything,), everything) if len(everything) == 1 else noise.groups(raster, guided=guided)
    image = raster.values.copy()
    cells = _channels_last(image, raster)

    def put(group: tuple[int, ...], found: npt.NDArray[Any]) -> None:
        cells[..., list(group)] = _channels_last(found, raster)

    def finish() -> npt.NDArray[Any]:
        for channel, first in enumerate(same):
            if channel != first:
                cells[..., channel] = cells[..., first]
        return image

    for group in groups:
        part = raster if group == everything else raster.only(group)
        own = levels_of(part, noise.of(group))
        if own.without(part) is not None and not any(own.impulses):
            continue
        treated = _treated(part, own)
        try:
            put(group, treated.raster.values if own.level == 0 else run(treated))
        except Interrupted as interruption:
            put(group, interruption.result.value)
            raise Interrupted(replace(interruption.result, value=finish())) from None
    return finish()


def _treated(raster: Raster, noise: Noise) -> Treated:
    """Replace the impulses of channels, and find the noise of each pixel."""
    if not any(rule is not None for rule in noise.impulses):
        return Treated(raster, level_of(raster, noise))
    pixels, hit = replaced(raster, raster.cells, noise.impulses)
    values = pixels[..., 0] if raster.channel_axis is None else np.moveaxis(pixels, -1, raster.channel_axis)
    clean = Raster(values, raster.inside, raster.channel_axis)
    return Treated(clean, level_of(clean, noise), np.asarray(hit.all(axis=-1)))


def _channels_last(image: npt.NDArray[Any], raster: Raster) -> npt.NDArray[Any]:
    """Return a view of an image with the channels last."""
    return image[..., None] if raster.channel_axis is None else np.moveaxis(image, raster.channel_axis, -1)
