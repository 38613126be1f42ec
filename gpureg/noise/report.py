"""Describe the noise of an image: :func:`describe_noise`."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..doors import door
from .channel_noise import ChannelNoise, channel_noise
from .channels import Groups, groups
from .measured import State
from .survey import Survey, survey, worst
from .white import check_channel_axis


@dataclass(frozen=True)
class NoiseReport:
    """What the noise of an image is, from :func:`describe_noise`; ``print(report)`` says it in words.

    It can be given as `sigma` to :func:`gpureg.denoise_image` and the other filters.

    Attributes
    ----------
    channels : tuple of ChannelNoise
        One per channel; one for a grey image.
    covariance : tuple of tuples of float, or None
        Covariance of the noise between the channels, (m, m); None for one channel or if it cannot be told, NaN for a
        channel without noise or whose noise cannot be told.
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
        """The largest correlation of the noise of two channels with different values; 0 for one channel."""
        own = sorted(set(self.same))
        if self.covariance is None or len(own) < 2:
            return 0.0
        covariance = np.array(self.covariance)[np.ix_(own, own)]
        deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        matrix = covariance / deviation / deviation[:, None]
        return float(np.nanmax(np.abs(matrix - np.diag(np.diag(matrix))), initial=0.0))

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
                "image[i::2, j::2] as channels, or develop the mosaic first (sigma was taken from pixels 6 apart)"
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
                {
                    name: None if isinstance(x, float) and not math.isfinite(x) else x
                    for name, x in asdict(c).items()
                    if name != "impulse_rule"
                }
                for c in self.channels
            ],
            "covariance": None
            if self.covariance is None
            else [[x if math.isfinite(x) else None for x in row] for row in self.covariance],
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
        if len(set(self.same)) > 1:
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
    x[i - k] - 2 x[i] + x[i + k] have the same variance for every step k if the noise is white; those of step 6 give
    ``long_sigma``, in a mosaic from pixels of one colour. Stripes: means of second differences across the lines, over
    six pieces of a line, are correlated. JPEG: steps between neighbours are larger at one of eight phases. Impulses:
    pixels further than five sigma from the median of their neighbourhood and from most neighbours, if they are in
    smooth windows too. These tests need planes of 32 x 32 pixels; in a volume they are made in planes. On 25
    photographs with white noise of sigma 5 to 40 at most 2 percent of the reports named something that is not there. A
    blur of less than half a pixel and a JPEG of quality 90 or more are not seen.

    Channels are compared by the covariance of their noise and by the directions of their edges. They are better
    denoised together if the noise is independent and of similar strength, and the edges are the same.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.add.outer(np.arange(128.0), np.arange(128.0)) / 4 + np.random.default_rng(7).normal(0, 5, (128, 128))
    >>> print(describe_noise(image))
    noise: standard deviation 4.7, standard error 3.5 %
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
        levels = [channel_noise(found.channels[i]).level_to_remove for i in range(len(same))]
        grouped = groups(relations, levels, len(same))
        grouped = tuple(kept for group in grouped if (kept := tuple(i for i in group if i in own)))
    covariance = None if relations is None else tuple(map(tuple, relations.covariance.tolist()))
    spans = tuple(channel.span for channel in found.channels)
    return NoiseReport(tuple(map(channel_noise, found.channels)), covariance, grouped, same, spans)
