"""What is compared: ours, BM3D or BM4D, and the tuned filters of scikit-image."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import gpureg as gr

from ..model import peer
from . import tuned
from .scenes import PLANES, Image
from .tuned import Settings


@dataclass(frozen=True)
class Noisy:
    """A noisy image with what an oracle knows of it.

    Attributes
    ----------
    values, clean : array
        Of the same shape, in [0, 255].
    sigma : float
        Standard deviation of the noise.
    group : str
        The scene's group.
    """

    values: Image
    clean: Image
    sigma: float
    group: str

    @property
    def channel_axis(self) -> int | None:
        """The axis of the channels; None for grey images and volumes."""
        return 2 if self.group == "colour" else None


def _ours(*, told: bool = False, **options: Any) -> Callable[[Noisy], Image]:
    def denoise(noisy: Noisy) -> Image:
        known: dict[str, Any] = {"sigma": noisy.sigma} if told else {}
        return np.asarray(gr.denoise_image(noisy.values, channel_axis=noisy.channel_axis, **known, **options))

    return denoise


DEFAULT, SINGLE = "ours", "passes=1"
OURS: dict[str, Callable[[Noisy], Image]] = {
    SINGLE: _ours(passes=1),
    "fast": _ours(quality="fast"),
    "balanced": _ours(quality="balanced"),
    "best": _ours(quality="best"),
    "sigma given": _ours(told=True),
    DEFAULT: _ours(),
}
"""The ways to call ``denoise_image``; the one without parameters is judged."""


def bm3d(values: Image, sigma: float) -> Image:
    """BM3D of a grey (y, x) or colour (y, x, 3) picture with noise of this standard deviation."""
    import bm3d as package

    return np.asarray((package.bm3d_rgb if values.ndim == 3 else package.bm3d)(values, sigma))


def bm4d(values: Image, sigma: float) -> Image:
    """BM4D of a volume or series (z or t, y, x) with noise of this standard deviation."""
    import bm4d as package

    return np.asarray(package.bm4d(values, sigma))


REFERENCES = ("BM3D", "BM4D")
PEERS = (*REFERENCES, *tuned.FILTERS)


def takes(who: str, group: str) -> bool:
    """Whether a peer is installed and made for the images of a group."""
    if who in REFERENCES:
        return (who == "BM4D") == (group in PLANES) and peer(who.lower()) is not None
    return group not in PLANES and tuned.installed(who)


def settings_of(who: str, noisy: Noisy) -> Settings:
    """The best settings of a peer; the references have none but sigma."""
    return {} if who in REFERENCES else tuned.tuned(who, noisy.clean, noisy.values, noisy.sigma)


def apply(who: str, noisy: Noisy, settings: Settings) -> tuple[Image, float]:
    """What a method makes of an image, and the seconds of the call."""
    begin = time.perf_counter()
    if who in OURS:
        value = OURS[who](noisy)
    elif who in REFERENCES:
        value = (bm3d if who == "BM3D" else bm4d)(noisy.values, noisy.sigma)
    else:
        value = tuned.apply(who, noisy.values, noisy.sigma, settings)
    return value, time.perf_counter() - begin
