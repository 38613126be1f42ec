"""What is denoised: pictures, volumes and a series with values in [0, 255], and the noise that is added."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gpureg.files.pictures import read_picture

from ..model import NEEDS_DATA, data, peer
from . import synthetic

Image = npt.NDArray[np.float64]

SIGMAS = (10, 20, 40)
SEEDS = 3

# Weights of red, green and blue in a grey picture (ITU-R BT.709), as scikit-image has them.
GREY = (0.2125, 0.7154, 0.0721)


@dataclass(frozen=True)
class Scene:
    """A clean image.

    Attributes
    ----------
    group : {"grey", "colour", "others", "volumes", "series"}
        The first two are the pictures of the README; the second is colour, axes (y, x, 3).
    source : str or callable
        A file of the test data, or a function that makes the image.
    seeds : int
        Draws of noise at most: a volume has the pixels of four pictures, and one is enough.
    """

    group: str
    source: str | Callable[[], Image]
    seeds: int = 1_000_000

    def clean(self) -> Image:
        """The image without noise."""
        return _read(self.source) if isinstance(self.source, str) else self.source()

    @property
    def missing(self) -> str:
        """What is not there that the image needs; empty where all is."""
        if isinstance(self.source, str):
            return "" if data("images", self.source) else NEEDS_DATA
        if self.group == "others":
            return "" if peer("skimage") else "it needs scikit-image"
        if self.group == "series":
            return "" if all(data("images", file) for file in _SERIES) else NEEDS_DATA
        return ""


def _read(file: str) -> Image:
    path: Path | None = data("images", file)
    if path is None:
        raise FileNotFoundError(f"no picture {file}: {NEEDS_DATA}")
    return np.asarray(read_picture(path).pixels, np.float64)


def _of_scikit_image(name: str) -> Image:
    from skimage import data as pictures

    return np.asarray(getattr(pictures, name)(), np.float64)


_SERIES = ("kodim08.png", "camera.png")


def _series() -> Image:
    moving, other = (_read(file) for file in _SERIES)
    return synthetic.series(np.rint(moving @ GREY), other)


SCENES: dict[str, Scene] = {
    "camera": Scene("grey", "camera.png"),
    "house": Scene("grey", "set12_02_house.png"),
    "coins": Scene("grey", "coins.png"),
    "brick": Scene("grey", "brick.png"),
    "astronaut": Scene("colour", "astronaut.png"),
    "kodim08": Scene("colour", "kodim08.png"),
    "kodim19": Scene("colour", "kodim19.png"),
    "bsd68_003": Scene("grey", "bsd68_003.png"),
    "bsd68_033": Scene("grey", "bsd68_033.png"),
    "bsd68_044": Scene("grey", "bsd68_044.png"),
    **{name: Scene("others", functools.partial(_of_scikit_image, name)) for name in ("text", "page", "cell", "moon")},
    "head": Scene("volumes", synthetic.head, seeds=1),
    "filaments": Scene("volumes", synthetic.filaments, seeds=1),
    "moving": Scene("series", _series),
}
README = ("grey", "colour")
PLANES = ("volumes", "series")


def picture(name: str) -> Image:
    """One of the scenes without noise."""
    return SCENES[name].clean()


def noisy_of(clean: Image, sigma: float, seed: int = 0) -> Image:
    """The image with its noise."""
    return clean + np.random.default_rng(seed).standard_normal(clean.shape) * sigma


def psnr(value: Image, clean: Image, span: float = 255) -> float:
    """Peak signal-to-noise ratio in dB, of a range of `span`."""
    return 10 * math.log10(span**2 / float(np.mean((value - clean) ** 2)))
