"""The noise of one channel in words and numbers: :class:`ChannelNoise`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .impulses import ImpulseRule
from .measured import State
from .photon import PhotonNoise
from .survey import Channel

# Texture energy over sigma^2 from which texture is taken for noise, and shares that are said.
_TEXTURE, _CLIPPED, _SAID = 0.09, 0.01, 0.001
# Share of the pixels from which all are said to be measured.
_NEARLY_ALL = 0.99
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
    impulse_rule : ImpulseRule or None
        How they are found.
    has_impulses, salt_and_pepper : bool
        Whether impulses are noise, not fine detail, and whether they lie at the extremes of the range.
    correlated : bool
        Whether the noise of neighbouring pixels is alike, as in a blurred or enlarged image. `sigma` is too small then.
    long_sigma : float
        Standard deviation of the noise from pixels 6 apart; closer to the noise than `sigma` if it is correlated, and
        in a mosaic.
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
    pixels, measured : int
        Number of pixels that count, and of those of them that were looked at: large images and series are measured in
        evenly spread parts.
    tested : bool
        Whether the noise could be tested for being white.
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
    impulse_rule: ImpulseRule | None
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
    pixels: int
    measured: int
    tested: bool
    flat: float
    repeated: float
    texture: float

    @property
    def level_to_remove(self) -> float:
        """The standard deviation to denoise with: `long_sigma` for correlated noise and mosaics, otherwise `sigma`."""
        if self.period == 2:
            # pixels 6 apart have the same colour
            return min(self.sigma, self.long_sigma)
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
            yield (
                "every second row or column is alike, as in the mosaic of a colour sensor; pixels 6 apart give "
                f"{self.long_sigma:.4g}"
            )
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
        """Yield sentences about what was left out of the measurement."""
        if self.measured < _NEARLY_ALL * self.pixels:
            yield f"measured in {self.measured} of {self.pixels} pixels, in evenly spread parts"
        if self.state == "measured" and not self.tested:
            yield "too few pixels, or counts that are too rare, to test whether the noise is white"
        if self.flat > _SAID:
            yield f"{100 * self.flat:.3g} % of the pixels lie in areas of equal values and were left out"
        if self.repeated > _SAID:
            yield f"{100 * self.repeated:.3g} % of the pixels have values that many have, and were left out"


def channel_noise(channel: Channel) -> ChannelNoise:
    """Return the noise of a channel from its measures."""
    sigma, growth = channel.sigma, channel.growth
    stripes = channel.says("stripes")
    periodic = channel.says("periodic")
    # the steps between the colours of a mosaic grow with the light too
    grows = growth is not None and growth.is_certain and channel.state == "measured" and not periodic
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
        impulse_rule=next((part.rule for part in channel.parts if part.rule is not None), None),
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
        pixels=channel.pixels,
        measured=sum(part.pixels for part in channel.parts),
        tested=bool(channel.tests),
        flat=channel.share("flat"),
        repeated=channel.share("repeated"),
        texture=float(np.median([part.texture for part in channel.told])) if channel.told else math.nan,
    )
