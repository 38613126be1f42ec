"""Describe the noise of an image: :func:`describe_noise`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..doors import door
from .channels import Groups, groups
from .measure import State
from .photon import PhotonNoise
from .survey import Channel, Survey, survey, worst
from .white import check_channel_axis

# Texture energy over sigma^2 from which texture is taken for noise, and shares that are said.
_TEXTURE, _CLIPPED, _SAID = 0.09, 0.01, 0.001
# Least variance of a dark pixel, as a share of sigma^2.
_DARKEST = 0.05


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel.

    Attributes
    ----------
    state : {"measured", "no noise", "cannot tell"}
    why : str
        Reason of the state, if it is not "measured".
    sigma : float
        Standard deviation of the noise between neighbouring pixels, in the image's units; NaN if it cannot be told. If
        it grows with the signal, that of the smoothest tenth of the pixels.
    relative_error : float
        Standard error of `sigma`, relative to it.
    grows : bool
        Whether the variance grows with the signal, as that of photons: variance = gain * value + level.
    gain, level : float
        The line that fits best, in the image's units and their square, also if it does not grow beyond doubt; 0 if none
        could be fitted.
    dark : float
        Brightness of the darkest 0.1 percent, from which the line is used.
    impulses : float
        Share of the pixels that are impulses. It is meant seriously only if `has_impulses`.
    has_impulses, salt_and_pepper : bool
        Whether impulses are noise, not fine detail, and whether they lie at the extremes of the range.
    correlated : bool
        Whether the noise of neighbouring pixels is alike, as in a blurred or enlarged image. `sigma` is too small then.
    long_sigma : float
        Standard deviation of the noise from pixels 6 apart; close to the noise if it is correlated.
    blur : float
        Standard deviation, in pixels, of a Gaussian blur that would make white noise as correlated; 0 if it is not.
    period : int
        2 if values of every second row or column are alike (a Bayer mosaic), 8 for the blocks of a JPEG, 0 for none.
    stripe_rows, stripe_columns : float
        Standard deviation of the offsets of whole rows and columns, in the image's units; 0 unless they are certain.
    rayleigh : bool
        Whether it looks like the noise of a magnitude (Rician), as in magnetic resonance images.
    clipped_low, clipped_high : float
        Shares of the pixels with the smallest and the largest value.
    flat, repeated : float
        Shares of the pixels in areas of exactly equal values, and with values that many pixels have.
    texture : float
        Energy of the gradient over sigma^2 where the noise was measured; from 0.09 on sigma is an upper bound.
    """

    state: State
    why: str
    sigma: float
    relative_error: float
    grows: bool
    gain: float
    level: float
    dark: float
    impulses: float
    has_impulses: bool
    salt_and_pepper: bool
    correlated: bool
    long_sigma: float
    blur: float
    period: int
    stripe_rows: float
    stripe_columns: float
    rayleigh: bool
    clipped_low: float
    clipped_high: float
    flat: float
    repeated: float
    texture: float

    @property
    def level_to_remove(self) -> float:
        """The standard deviation to denoise with: `long_sigma` for correlated noise, otherwise `sigma`."""
        return max(self.sigma, self.long_sigma) if self.correlated else self.sigma

    def photon(self, *, certain: bool = True) -> PhotonNoise | None:
        """Return the growth with the signal as :class:`PhotonNoise` from the darkest pixels on.

        None if it does not grow; with ``certain=False`` only if no line that grows could be fitted. The read noise is
        at least 0.22 of `sigma`, since a line that is too steep would leave dark pixels as they are.
        """
        if not self.gain > 0 or (certain and not self.grows):
            return None
        least = _DARKEST * self.sigma**2
        return PhotonNoise(self.gain, math.sqrt(max(self.gain * self.dark + self.level, least)), self.dark)

    def says(self) -> Iterator[str]:
        """Yield sentences about the noise of the channel."""
        if self.state == "cannot tell":
            yield f"the noise cannot be told: {self.why}"
            return
        if self.state == "no noise":
            yield f"no noise was found: {self.why}"
            return
        error = f"{100 * self.relative_error:.2g} %"
        yield f"standard deviation {self.sigma:.4g}, standard error {error}"
        if self.grows:
            yield f"its variance grows with the value, {self.gain:.4g} x value {self.level:+.4g}, as that of photons"
        if self.has_impulses:
            kind = "salt and pepper" if self.salt_and_pepper else "impulses"
            yield f"{100 * self.impulses:.2g} % of the pixels are {kind}"
        if self.correlated:
            yield (
                f"neighbouring pixels are alike, as after a blur of {self.blur:.2g} pixels; pixels 6 apart give "
                f"{self.long_sigma:.4g}"
            )
        if self.period == 2:
            yield "every second row or column is alike, as in the mosaic of a colour sensor"
        if self.period == 8:
            yield "blocks of 8 x 8 pixels stand out, as after JPEG compression"
        for name, size in (("rows", self.stripe_rows), ("columns", self.stripe_columns)):
            if size:
                yield f"whole {name} are offset, with a standard deviation of {size:.4g}"
        if self.rayleigh:
            yield "it looks like the noise of a magnitude (Rician), which is never negative"
        if self.clipped_low > _CLIPPED or self.clipped_high > _CLIPPED:
            yield (
                f"{100 * self.clipped_low:.2g} % of the pixels have the smallest value and "
                f"{100 * self.clipped_high:.2g} % the largest: if these are clipped, there is less noise there"
            )
        if self.texture > _TEXTURE and not self.correlated:
            yield "texture is everywhere, so that the standard deviation is an upper bound"

    def left_out(self) -> Iterator[str]:
        """Yield sentences about the pixels that were left out of the measurement."""
        if self.flat > _SAID:
            yield f"{100 * self.flat:.3g} % of the pixels lie in areas of equal values and were left out"
        if self.repeated > _SAID:
            yield f"{100 * self.repeated:.3g} % of the pixels have values that many have, and were left out"


@dataclass(frozen=True)
class NoiseReport:
    """What the noise of an image is, from :func:`describe_noise`; ``print(report)`` says it in words.

    Attributes
    ----------
    channels : tuple of ChannelNoise
        One per channel; one for a grey image.
    covariance : tuple of tuples of float, or None
        Covariance of the noise between the channels, (m, m); None for one channel or if it cannot be told.
    groups : tuple of tuples of int
        The channels that are better denoised together.
    same : tuple of int
        For each channel the first channel with exactly the same values.
    spans : tuple of (low, high)
        The range of each channel where there is noise, from a smoothed copy; NaN if unknown.
    """

    channels: tuple[ChannelNoise, ...]
    covariance: tuple[tuple[float, ...], ...] | None
    groups: Groups
    same: tuple[int, ...]
    spans: tuple[tuple[float, float], ...] = ()

    @property
    def state(self) -> State:
        """Whether noise was measured in any channel, "no noise" was found in all, or it cannot be told."""
        return worst([channel.state for channel in self.channels])

    @property
    def sigma(self) -> tuple[float, ...]:
        """Standard deviation of the noise of each channel; NaN where it cannot be told."""
        return tuple(channel.sigma for channel in self.channels)

    @property
    def correlation(self) -> float:
        """The largest correlation of the noise of two different channels; 0 for one channel."""
        if self.covariance is None:
            return 0.0
        covariance = np.array(self.covariance)
        deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        matrix = covariance / deviation / deviation[:, None]
        return float(np.abs(matrix - np.diag(np.diag(matrix))).max())

    def warnings(self) -> tuple[str, ...]:
        """Return a sentence for each kind of noise that :func:`gpureg.denoise_image` cannot remove, with what to do."""
        found: list[str] = []

        def any_says(test: Any) -> bool:
            return any(test(channel) for channel in self.channels if channel.state == "measured")

        if any_says(lambda c: c.correlated):
            found.append(
                "the noise of neighbouring pixels is correlated (blurred, enlarged or compressed): sigma was taken "
                "from pixels 6 apart, and much of the noise stays; denoise before resampling, or give sigma"
            )
        if any_says(lambda c: c.period == 2):
            found.append(
                "every second row or column is alike, as in the mosaic of a colour sensor: denoise the four images "
                "image[i::2, j::2] as channels, or develop the mosaic first"
            )
        if any_says(lambda c: c.period == 8):
            found.append("blocks of 8 x 8 pixels from JPEG compression stand out and stay: use the uncompressed image")
        if any_says(lambda c: c.stripe_rows or c.stripe_columns):
            found.append(
                "whole rows or columns are offset, and these stripes stay: subtract the offset of each line first, "
                "e.g. the median of its difference from a smoothed image"
            )
        if any_says(lambda c: c.rayleigh):
            found.append(
                "the noise looks Rician (a magnitude image): its mean in dark regions is not 0, and that bias stays"
            )
        return tuple(found)

    def as_json(self) -> dict[str, Any]:
        """Return the report as numbers, texts, lists and dicts; NaN is None."""
        return {
            "state": self.state,
            "channels": [
                {name: None if isinstance(x, float) and not math.isfinite(x) else x for name, x in asdict(c).items()}
                for c in self.channels
            ],
            "covariance": None if self.covariance is None else [list(row) for row in self.covariance],
            "groups": [list(group) for group in self.groups],
            "warnings": list(self.warnings()),
        }

    def lines(self) -> list[str]:
        """Return the report in words, a sentence a line."""
        found = []
        for index, channel in enumerate(self.channels):
            name = "noise" if len(self.channels) == 1 else f"channel {index}"
            if self.same[index] != index:
                found.append(f"{name}: the same values as channel {self.same[index]}")
                continue
            sentences = [*channel.says(), *channel.left_out()]
            found += [f"{name}: {sentence}" for sentence in sentences]
        if len(self.channels) > 1:
            if self.covariance is not None:
                found.append(f"the largest correlation of the noise of two channels is {self.correlation:.2f}")
            together = [" and ".join(map(str, group)) for group in self.groups if len(group) > 1]
            if together:
                found.append(f"channels better denoised together: {'; '.join(together)}")
            else:
                found.append("each channel is better denoised by itself")
        return found + [f"note: {sentence}" for sentence in self.warnings()]

    def __str__(self) -> str:
        return "\n".join(self.lines())


@door
def describe_noise(
    image: npt.ArrayLike,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
) -> NoiseReport:
    """Describe the noise of an image: how strong it is in each channel, and whether it is white.

    Parameters
    ----------
    image : array of two or more axes, not counting channels
        As in :func:`estimate_noise`.
    channel_axis : int, optional
        Axis of the channels; None for a grey image.
    mask : bool array, optional
        True at the pixels to use; NaN is allowed at the others.

    Returns
    -------
    NoiseReport
        ``print(report)`` says it in words. A channel whose noise cannot be told has the state "cannot tell" and a sigma
        of NaN.

    Raises
    ------
    TypeError, ValueError
        As :func:`estimate_noise`.

    Notes
    -----
    The standard deviation is that of :func:`estimate_noise`. Growth with the signal: a line through the variances of 24
    classes of brightness, as in :func:`estimate_photon_noise`. Correlation and mosaics: second differences
    x[i - k] - 2 x[i] + x[i + k] have the same variance for every step k if the noise is white. Stripes: means of
    second differences across the lines, over six pieces of a line, are correlated. JPEG: steps between neighbours are
    larger at one of eight phases. Impulses: pixels further than five sigma from the median of their neighbourhood and
    from most neighbours, if they are in smooth windows too. These tests need planes of 32 x 32 pixels; in a volume
    they are made in planes. On 25 photographs with white noise of sigma 5 to 40 at most 2 percent of the reports named
    something that is not there. A blur of less than half a pixel and a JPEG of quality 90 or more are not seen.

    Channels are compared by the covariance of their noise and by the directions of their edges. They are better
    denoised together if the noise is independent and of similar strength, and the edges are the same.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.add.outer(np.arange(128.0), np.arange(128.0)) / 4 + np.random.default_rng(7).normal(0, 5, (128, 128))
    >>> print(describe_noise(image))
    noise: standard deviation 4.658, standard error 3.5 %
    """
    check_channel_axis(image, channel_axis)
    return report_of(survey(image, channel_axis, mask))


def report_of(found: Survey) -> NoiseReport:
    """Return the report of a survey."""
    same = tuple(i if channel.same_as is None else channel.same_as for i, channel in enumerate(found.channels))
    relations = found.relations
    own = [i for i, first in enumerate(same) if i == first]
    grouped: Groups = tuple((i,) for i in own)
    if relations is not None:
        levels = [_channel(found.channels[i]).level_to_remove for i in range(len(same))]
        grouped = groups(relations, levels, len(same))
        grouped = tuple(kept for group in grouped if (kept := tuple(i for i in group if i in own)))
    covariance = None if relations is None else tuple(map(tuple, relations.covariance.tolist()))
    spans = tuple(channel.span for channel in found.channels)
    return NoiseReport(tuple(map(_channel, found.channels)), covariance, grouped, same, spans)


def _channel(channel: Channel) -> ChannelNoise:
    """Return the noise of a channel from its measures."""
    sigma, growth = channel.sigma, channel.growth
    grows = growth is not None and growth.is_certain and channel.state == "measured"
    stripes = channel.says("stripes")
    periodic = channel.says("periodic")
    return ChannelNoise(
        state=channel.state,
        why=channel.why,
        sigma=sigma,
        relative_error=channel.relative_error,
        grows=grows,
        gain=0.0 if growth is None else growth.slope,
        level=0.0 if growth is None else growth.level,
        dark=0.0 if growth is None else growth.dark,
        impulses=channel.share("impulses"),
        has_impulses=channel.says("impulses") or channel.share("lone") > 0.5,
        salt_and_pepper=channel.share("salt") > 0.5,
        correlated=channel.says("correlated"),
        long_sigma=channel.mean("long_sigma"),
        blur=channel.mean("blur"),
        period=2 if periodic else 8 if channel.says("blocks") else 0,
        stripe_rows=channel.mean("stripe_rows") * sigma if stripes else 0.0,
        stripe_columns=channel.mean("stripe_columns") * sigma if stripes else 0.0,
        rayleigh=channel.says("rayleigh"),
        clipped_low=channel.share("clipped_low"),
        clipped_high=channel.share("clipped_high"),
        flat=channel.share("flat"),
        repeated=channel.share("repeated"),
        texture=float(np.median([part.texture for part in channel.told])) if channel.told else math.nan,
    )
