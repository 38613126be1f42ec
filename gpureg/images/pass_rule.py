"""Whether passes on groups of patches follow the filter of a plan, and which: :func:`passes_of`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..noise.channel_noise import ChannelNoise
from .course import Course
from .noise import Noise
from .options import Choice
from .passes import AXES, PassNoise, PatchPass, passes_for
from .plan import DenoisePlan
from .raster import Raster

# Pixels that a picture has at least along both axes: in smaller ones a window has too few patches that are alike. On 21
# pieces of photographs passes gain 0.3 to 0.5 dB at 32 x 32, and lose as much at 24 x 24; in volumes they always gain.
_SMALLEST = 32


def expect_passes(asked: Choice, raster: Raster) -> None:
    """Check that passes can be made, if they are asked for.

    Raises
    ------
    ValueError
    """
    count = asked["passes"]
    if count is None or count == 1:
        return
    if asked["guide"] is not None:
        raise ValueError(f"passes={count} does not work with a guide: groups of patches compare the result")
    if asked["max_iter"] == 0:
        raise ValueError(f"passes={count} needs the result of at least one iteration: leave max_iter=0 out")
    if raster.ndim not in AXES:
        raise ValueError(f"passes={count} needs an image of {_either(AXES)} axes, got {raster.ndim}")


def with_passes(
    plan: DenoisePlan, raster: Raster, asked: Choice, course: Course, noise: Noise, channels: Sequence[int]
) -> DenoisePlan:
    """Return the plan with passes on groups of patches, or with the reason why there are none.

    Parameters
    ----------
    plan : DenoisePlan
        Of the filter.
    raster : Raster
        The channels that are denoised together.
    asked : Choice
    course : Course
    noise : Noise
        Of these channels, in the image's units.
    channels : sequence of int
        Which channels of `noise.report` they are.
    """
    passes, why = _passes_of(plan, raster, asked, course, noise, channels)
    plan = replace(plan, reasons={**plan.reasons, "groups": why})
    if not passes:
        return plan
    units = noise.units
    compared = replace(noise, sigmas=(1.0,) * raster.channels) if units is not None else noise
    of_passes = PassNoise(
        level=compared.level,
        frame=raster.frame(units),
        units=() if plan.units else units or (),
        photon=noise.photon or (),
        profile=noise.combined(),
    )
    return replace(plan, passes=passes, noise=of_passes)


def _passes_of(
    plan: DenoisePlan, raster: Raster, asked: Choice, course: Course, noise: Noise, channels: Sequence[int]
) -> tuple[tuple[PatchPass, ...], str]:
    """Return the passes and the reason for them."""
    count, word = asked["passes"], asked["quality"]
    if count == 1:
        return (), "given"
    if plan.max_iter == 0:
        return (), "nothing to do"
    if not noise.level > 0:
        return (), "no noise is known"
    quality = word or "balanced"
    if count is not None:
        return passes_for(quality, count, raster.ndim), "given"
    why_none = _without(raster, asked, course, noise, channels)
    if why_none is not None:
        return (), why_none
    return passes_for(quality, None, raster.ndim), f"quality={word!r}" if word else "default"


def _without(raster: Raster, asked: Choice, course: Course, noise: Noise, channels: Sequence[int]) -> str | None:
    """Return why no passes are made by themselves; None if they are."""
    if raster.ndim not in AXES:
        return f"only for {_either(AXES)} axes"
    by_rule = course.chooses and course.filters and asked["lam"] is None and asked["centre"] is None
    once = asked["max_iter"] in (None, 1) and asked["tol"] is None and course.most is None
    if not (by_rule and once and asked["k"] is None and asked["guide"] is None):
        return "only after one sweep at p = 2 with weights and lam by the rule"
    if raster.ndim == 2 and min(raster.shape) < _SMALLEST and asked["quality"] is None:
        return f"fewer than {_SMALLEST} pixels along an axis; passes=3 makes them"
    if noise.report is not None:
        for i in channels:
            found = _not_white(noise.report.channels[i])
            if found is not None:
                return f"{found}; passes=3 makes them"
    return None


def _not_white(channel: ChannelNoise) -> str | None:
    """Return why patches would keep the noise of a channel as if it were signal; None if its noise is white."""
    if channel.state != "measured":
        return None
    if channel.period == 8:
        # Measured on 48 JPEG files of noisy photographs: where rounding in the file has removed the finest part of the
        # noise, so that neighbours are correlated, passes gain 0.15 dB on average and lose 0.17 at most; where blocks
        # stand out of noise that is white, they lose 0.1 to 0.5.
        return None if channel.correlated else "blocks of a JPEG stand out of strong noise"
    if channel.correlated:
        return "the noise of neighbouring pixels is correlated"
    if channel.period == 2:
        return "every second row or column is alike, as in a mosaic"
    return "whole rows or columns are offset" if channel.stripe_rows or channel.stripe_columns else None


def _either(numbers: Sequence[int]) -> str:
    return " or ".join(map(str, numbers))
