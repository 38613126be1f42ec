"""The noise of an image, for a plan: :class:`Noise`, :func:`noise_of`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..checks import number
from ..doors import warn
from ..noise.channels import Groups, groups, relate
from ..noise.impulses import ImpulseRule
from ..noise.photon import PhotonNoise
from ..noise.report import NoiseReport, report_of
from ..noise.survey import measure_channels, root_mean_square, survey
from .raster import Raster

# A map of the noise is at least this share of its root mean square: for a pixel without noise all weights to other
# pixels would be 0.
LEAST = 0.01
# Sigmas of channels that differ by more than this factor, and three standard errors of an estimate, are brought to the
# same scale before they are compared.
_SAME = 1.1

Sigma = float | npt.ArrayLike | Literal["photon"] | NoiseReport | PhotonNoise


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of an image, or of some of its channels.

    Attributes
    ----------
    sigmas : tuple of float, or None
        Standard deviation of each channel in the image's units, of a map the root mean square; None if it is not known.
        NaN in a channel where it cannot be told.
    estimated : bool
        Whether it was estimated.
    profile : (n, m) or (n, 1) float array or None
        Noise of each pixel, in each channel or in all, as a multiple of its sigma, if it was given as a map.
    photon : tuple of (PhotonNoise or None), or None
        For each channel how the noise grows with the signal, if it does.
    impulses : tuple of (ImpulseRule or None)
        For each channel how impulses are found, if they are to be replaced; empty for none.
    report : NoiseReport or None
        What was found, if it was estimated.
    """

    sigmas: tuple[float, ...] | None
    estimated: bool = False
    profile: npt.NDArray[np.float64] | None = None
    photon: tuple[PhotonNoise | None, ...] | None = None
    impulses: tuple[ImpulseRule | None, ...] = ()
    report: NoiseReport | None = None

    @property
    def sigma(self) -> float | None:
        """The root mean square over the channels; None if it is not known, NaN if it cannot be told."""
        if self.sigmas is None:
            return None
        return root_mean_square([sigma for sigma in self.sigmas if not math.isnan(sigma)])

    @property
    def level(self) -> float:
        """The root mean square over the channels, 0 if it is not known or cannot be told."""
        sigma = self.sigma
        return 0.0 if sigma is None or math.isnan(sigma) else sigma

    @property
    def units(self) -> tuple[float, ...] | None:
        """What the channels are divided by before they are compared; None if their noise is nearly the same."""
        known = self.sigmas
        if known is None or len(known) < 2 or not all(sigma > 0 for sigma in known):
            return None
        same = _SAME
        if self.estimated and self.report is not None:
            same += 3 * max(channel.relative_error for channel in self.report.channels)
        return known if max(known) > same * min(known) else None

    def combined(self) -> npt.NDArray[np.float64] | None:
        """Return one profile for all channels, (n,): the root mean square of theirs."""
        if self.profile is None:
            return None
        found: npt.NDArray[np.float64] = np.sqrt(np.mean(self.profile**2, axis=1))
        return found

    def of(self, channels: Sequence[int]) -> Noise:
        """Return the noise of some channels."""
        picked = list(channels)

        def pick(values: tuple[Any, ...] | None) -> Any:
            return values if not values else tuple(values[i] for i in picked)

        profile = self.profile
        if profile is not None and profile.shape[1] > 1:
            profile = profile[:, picked]
        return replace(
            self, sigmas=pick(self.sigmas), profile=profile, photon=pick(self.photon), impulses=pick(self.impulses)
        )

    def found(self, raster: Raster) -> Noise:
        """Return the noise; estimate it if it is not known."""
        if self.sigmas is not None:
            return self
        report = report_of(survey(raster.values, raster.channel_axis, raster.inside))
        return of_report(report, estimated=True)

    def groups(self, raster: Raster, *, guided: bool = False) -> tuple[Groups, tuple[int, ...]]:
        """Return the channels that are better denoised together, and for each channel the first that is equal.

        With a guide all channels with noise are better together, since their own edges are not compared. A report may
        be on another image: its groups are used, but not which channels are equal.
        """
        count = raster.channels
        sigmas = self.sigmas or (self.level,) * count
        if guided:
            noisy = tuple(i for i in range(count) if sigmas[i] > 0)
            silent = tuple((i,) for i in range(count) if i not in noisy)
            return ((noisy,) if noisy else ()) + silent, tuple(range(count))
        if self.report is not None and self.estimated:
            return self.report.groups, self.report.same
        same = tuple(next((j for j in range(i) if self._equal(raster, i, j)), i) for i in range(count))
        if self.report is not None:
            known = {i for group in self.report.groups for i in group}
            grouped = self.report.groups + tuple((i,) for i in range(count) if i not in known)
        else:
            relations = relate(measure_channels(raster.values, raster.channel_axis, raster.inside))
            grouped = groups(relations, [max(sigma, 1e-300) for sigma in sigmas], count)
        kept = tuple(of for group in grouped if (of := tuple(i for i in group if same[i] == i)))
        return kept, same

    def _equal(self, raster: Raster, i: int, j: int) -> bool:
        """Return whether two channels have the same values and the same noise."""
        own = (self.sigmas, self.photon)
        if any(of and of[i] != of[j] for of in own):
            return False
        profile = self.profile
        if profile is not None and profile.shape[1] > 1 and not np.array_equal(profile[:, i], profile[:, j]):
            return False
        return equal_channels(raster, i, j)

    def without(self, raster: Raster) -> str | None:
        """Return why the image needs no denoising, or cannot be denoised; None if there is noise.

        For integers noise is negligible below half a unit: the result is rounded, as the image was.
        """
        states = () if self.report is None else tuple(channel.state for channel in self.report.channels)
        sigma = self.sigma
        if sigma is not None and math.isnan(sigma):
            return "the noise cannot be told"
        if self.level == 0:
            return "no noise was found" if self.estimated or states else "sigma is 0"
        if self.estimated and raster.values.dtype.kind in "iu" and self.level < 0.5:
            return f"noise of sigma = {self.level:.2g} is less than half a unit of the image's integers"
        return None


def equal_channels(raster: Raster, i: int, j: int) -> bool:
    """Return whether two channels have the same values."""
    one, other = raster.cells[..., i], raster.cells[..., j]
    equal_nan = one.dtype.kind == "f"
    # a look at the middle tells nearly always
    middle = len(one) // 2
    return bool(np.array_equal(one[middle], other[middle], equal_nan=equal_nan)) and bool(
        np.array_equal(one, other, equal_nan=equal_nan)
    )


def of_report(report: NoiseReport, *, estimated: bool) -> Noise:
    """Return the noise that a report describes."""
    channels = report.channels
    photon = tuple(channel.photon() for channel in channels)
    return Noise(
        tuple(channel.level_to_remove for channel in channels),
        estimated,
        photon=photon if any(each is not None for each in photon) else None,
        impulses=tuple(channel.impulse_rule if channel.has_impulses else None for channel in channels),
        report=report,
    )


def noise_of(raster: Raster, sigma: Sigma | None, *, needed: bool) -> Noise:
    """Return the given noise of an image, or an estimate if it is `needed`.

    Raises
    ------
    TypeError, ValueError
        A sigma that is none of the allowed kinds, or does not fit the image.
    """
    count = raster.channels
    if sigma is None:
        return Noise(None).found(raster) if needed else Noise(None)
    if isinstance(sigma, NoiseReport):
        if len(sigma.channels) != count:
            raise ValueError(f"sigma is a report on {len(sigma.channels)} channel(s), the image has {count}")
        return of_report(sigma, estimated=False)
    if isinstance(sigma, PhotonNoise):
        return _of_photons(raster, (sigma,) * count)
    if isinstance(sigma, str):
        if sigma != "photon":
            raise ValueError(f'sigma must be a number, numbers, a map, "photon" or a NoiseReport, got {sigma!r}')
        report = report_of(survey(raster.values, raster.channel_axis, raster.inside))
        if any(channel.state == "cannot tell" for channel in report.channels):
            why = next(channel.why for channel in report.channels if channel.state == "cannot tell")
            raise ValueError(f'sigma="photon" needs noise that can be told: {why}')
        found = of_report(report, estimated=True)
        lines = tuple(channel.photon(certain=False) for channel in report.channels)
        return replace(found, photon=lines, sigmas=_levels(raster, lines, found.sigmas or ()))
    if np.ndim(sigma) == 0:
        return Noise((float(sigma),) * count)  # type: ignore[arg-type]
    values = np.asarray(sigma, np.float64)
    if raster.channel_axis is not None and values.shape == (count,):
        if not (np.isfinite(values).all() and (values >= 0).all()):
            raise ValueError(f"sigma must be finite and >= 0 in each channel, got {values.tolist()}")
        return Noise(tuple(values.tolist()))
    return _of_map(raster, values)


def check_sigma(sigma: Any, raster: Raster) -> None:
    """Check the parameter sigma as far as that is possible without a look at the image's values.

    Raises
    ------
    TypeError, ValueError
    """
    if sigma is None or isinstance(sigma, NoiseReport | PhotonNoise):
        return
    if isinstance(sigma, str):
        if sigma != "photon":
            raise ValueError(f'sigma must be a number, numbers, a map, "photon" or a NoiseReport, got {sigma!r}')
        return
    try:
        array = np.asarray(sigma)
    except ValueError:
        raise ValueError("sigma must be a number or an array of them, got rows of different lengths") from None
    if array.ndim == 0:
        number("sigma", array[()] if isinstance(sigma, np.ndarray) else sigma, low=0)
        return
    if array.dtype.kind not in "iuf":
        raise TypeError(f"sigma must be a number or an array of them, got {array.dtype}")
    count = raster.channels
    if raster.channel_axis is not None and array.shape in ((count,), raster.values.shape):
        return
    try:
        fits = np.broadcast_shapes(array.shape, raster.shape) == raster.shape
    except ValueError:
        fits = False
    if not fits:
        each = f", one per channel, shape ({count},)," if raster.channel_axis is not None else ""
        raise ValueError(
            f"sigma must be a number{each} or one value per pixel, a shape that fits {raster.shape}; "
            f"got shape {array.shape}"
        )


def _of_map(raster: Raster, values: npt.NDArray[np.float64]) -> Noise:
    """Return the noise for a map: one value per pixel, or per pixel and channel; axes of length 1 are repeated."""
    count = raster.channels
    if raster.channel_axis is not None and values.shape == raster.values.shape:
        table = np.moveaxis(values, raster.channel_axis, -1).reshape(-1, count)
    else:
        table = np.broadcast_to(values, raster.shape).reshape(-1, 1)
    inside = np.ones(len(table), bool) if raster.inside is None else raster.inside.ravel()
    known = table[inside]
    if not (np.isfinite(known).all() and (known >= 0).all()):
        raise ValueError("a map of sigma must be finite and >= 0 wherever a pixel takes part")
    means = np.sqrt(np.mean(known**2, axis=0)) if known.size else np.zeros(table.shape[1])
    sigmas = tuple(np.broadcast_to(means, (count,)).tolist())
    if not means.all():
        return Noise(sigmas, profile=None)
    filled = np.where(inside[:, None], table, means)
    profile = np.where(inside[:, None], np.maximum(filled / means, LEAST), 1.0)
    return Noise(sigmas, profile=profile)


def _of_photons(raster: Raster, photon: tuple[PhotonNoise | None, ...]) -> Noise:
    """Return the noise for a given line of a camera."""
    levels = _levels(raster, photon, (0.0,) * raster.channels)
    line = photon[0]
    if not any(levels) and line is not None and line.gain > 0 and (raster.inside is None or raster.inside.any()):
        warn(f"no value of the image is above the offset {line.offset:g} of sigma: no noise is removed")
    return Noise(levels, photon=photon)


def _levels(raster: Raster, photon: tuple[PhotonNoise | None, ...], sigmas: tuple[float, ...]) -> tuple[float, ...]:
    """Return the root mean square noise of each channel, that of its line where it has one.

    The outermost thousandths of the values count as those next to them, so that a few outliers do not decide.
    """
    cells = raster.cells
    found = []
    for i, (line, sigma) in enumerate(zip(photon, sigmas, strict=True)):
        values = cells[..., i] if raster.inside is None else cells[..., i][raster.inside]
        some = np.asarray(values).ravel()[:: max(1, values.size // (1 << 20))].astype(np.float64)
        if line is None or not some.size:
            found.append(sigma)
            continue
        sizes = line.sigma(np.clip(some, *np.percentile(some, [0.1, 99.9])))
        most = float(sizes.max())
        found.append(most * math.sqrt(float(np.mean((sizes / most) ** 2))) if most > 0 else 0.0)
    return tuple(found)


def levels_of(raster: Raster, noise: Noise) -> Noise:
    """Return the noise; the sigma of a channel with a line is the root mean square of the line over the image."""
    if noise.photon is None or noise.sigmas is None:
        return noise
    return replace(noise, sigmas=_levels(raster, noise.photon, noise.sigmas))
