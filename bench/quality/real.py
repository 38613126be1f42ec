"""Noise as cameras make it, beside BM3D and BM4D with their best recipes.

Photon noise, variance = gain x signal + read noise^2: the recipe is the generalized Anscombe transform with the true
gain, read noise and offset, BM3D at sigma 1, and the closed form of the exact unbiased inverse (M. Makitalo and A. Foi,
"Optimal inversion of the generalized Anscombe transformation for Poisson-Gaussian noise", IEEE TIP 22(1), 2013). A
volume goes through BM4D, and plane by plane through BM3D.

A noisy picture saved as JPEG: the recipe is the best of several sigmas by the true PSNR. gpureg runs without
parameters, unless a row says otherwise.
"""

from __future__ import annotations

import functools
import io
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

import gpureg as gr

from ..model import peer
from . import synthetic
from .methods import REFERENCES, bm3d, bm4d
from .report import head, line
from .scenes import SCENES, Image, picture, psnr

GAIN, READ, OFFSET = 3.0, 4.0, 100.0

# The noise below the JPEG, its quality, and the sigmas of which the best counts.
BELOW, QUALITY = 10.0, 75
TOLD = (3.0, 5.0, 7.0, 10.0, 14.0)


def photons(light: Image, seed: int) -> Image:
    """What a camera reads where this many photons are expected."""
    random = np.random.default_rng(seed)
    return OFFSET + GAIN * random.poisson(light) + random.normal(0, READ, light.shape)


def anscombe(values: Image) -> Image:
    """The generalized Anscombe transform: noise of standard deviation 1."""
    return 2 / GAIN * np.sqrt(np.maximum(GAIN * (values - OFFSET) + 3 / 8 * GAIN**2 + READ**2, 0))


def unbiased_inverse(roots: Image) -> Image:
    """The closed form of its exact unbiased inverse."""
    d, a = np.maximum(roots, 0.5), np.sqrt(3 / 2)
    light = d**2 / 4 + a / (4 * d) - 11 / (8 * d**2) + 5 / 8 * a / d**3 - 1 / 8 - (READ / GAIN) ** 2
    return np.asarray(OFFSET + GAIN * np.maximum(light, 0))


def jpeg(values: Image) -> Image:
    """A grey picture after it was saved as JPEG."""
    from PIL import Image as Pictures

    file = io.BytesIO()
    Pictures.fromarray(np.clip(np.rint(values), 0, 255).astype(np.uint8)).save(file, "JPEG", quality=QUALITY)
    return np.asarray(Pictures.open(file), np.float64)


Method = Callable[[Image], Image]


@dataclass(frozen=True)
class Case:
    """A clean image, how it gets its noise from a seed, and who takes part.

    Attributes
    ----------
    clean : callable
        Makes the image.
    noisy : callable
        Of the clean image and a seed.
    span : callable
        The range of PSNR, of the clean image.
    methods : mapping
        By name; several of one name are tried, and the best by the true PSNR counts.
    missing : callable
        What is not there that it needs; empty where all is.
    """

    clean: Callable[[], Image]
    noisy: Callable[[Image, int], Image]
    span: Callable[[Image], float]
    methods: Mapping[str, Mapping[str, Method]]
    missing: Callable[[], str] = lambda: ""


def _ours(**options: Any) -> Method:
    def denoise(noisy: Image) -> Image:
        with warnings.catch_warnings():
            # what a JPEG is warned of is in the documentation
            warnings.simplefilter("ignore", UserWarning)
            return np.asarray(gr.denoise_image(noisy, **options))

    return denoise


def _volume() -> Image:
    """Twelve planes that change slowly, 128 x 128."""
    planes = np.stack([synthetic.microscope(seed)[:128, :128] for seed in range(12)])
    return OFFSET + GAIN * np.asarray(ndimage.gaussian_filter(planes, (2, 0, 0)))


def _plane() -> Image:
    return OFFSET + GAIN * synthetic.microscope(3)[:256, :256]


def _seen(clean: Image, seed: int) -> Image:
    return photons((clean - OFFSET) / GAIN, seed)


def _saved(clean: Image, seed: int) -> Image:
    return jpeg(clean + np.random.default_rng(seed).normal(0, BELOW, clean.shape))


def _by_planes(values: Image, sigma: float) -> Image:
    return np.stack([bm3d(plane, sigma) for plane in values])


def _told(values: Image, sigma: float) -> Image:
    return np.asarray(gr.denoise_image(values, sigma=sigma))


def _through_anscombe(denoise: Callable[[Image, float], Image]) -> Method:
    return lambda noisy: unbiased_inverse(denoise(anscombe(noisy), 1.0))


_NOTHING_TOLD = {"ours": {"": _ours()}, "passes=1": {"": _ours(passes=1)}, "best": {"": _ours(quality="best")}}
_TOLD_PHOTONS = {
    'sigma="photon"': {"": _ours(sigma="photon")},
    "ours told": {"the transform": _through_anscombe(_told)},
}
CASES: dict[str, Case] = {
    "photons, 12 x 128 x 128": Case(
        _volume, _seen, lambda clean: float(np.ptp(clean)),
        {
            **_NOTHING_TOLD, **_TOLD_PHOTONS,
            "BM4D": {"the transform": _through_anscombe(bm4d)},
            "BM3D": {"the transform, plane by plane": _through_anscombe(_by_planes)},
        },
    ),
    "photons, 256 x 256": Case(
        _plane, _seen, lambda clean: float(np.ptp(clean)),
        {**_NOTHING_TOLD, **_TOLD_PHOTONS, "BM3D": {"the transform": _through_anscombe(bm3d)}},
    ),
    "JPEG of camera": Case(
        lambda: picture("camera"), _saved, lambda clean: 255.0,
        {
            **_NOTHING_TOLD, "ours told": {f"sigma {s:g}": _ours(sigma=s) for s in TOLD},
            "BM3D": {f"sigma {s:g}": functools.partial(bm3d, sigma=s) for s in TOLD},
        },
        lambda: SCENES["camera"].missing,
    ),
}  # fmt: skip


def takes_part(who: str, peers: Sequence[str]) -> bool:
    """Whether a method is ours, or a peer that is asked for and installed."""
    return who not in REFERENCES or (who in peers and peer(who.lower()) is not None)


def measure(names: Sequence[str], seeds: int, peers: Sequence[str]) -> list[dict[str, Any]]:
    """Mean PSNR over the draws, and least seconds of one call, of each method in each case that is asked for."""
    rows: list[dict[str, Any]] = []
    for name in names:
        case = CASES[name]
        if why := case.missing():
            print(f"{name}: left out, {why}", file=sys.stderr)
            continue
        clean = case.clean()
        noisy = [case.noisy(clean, seed) for seed in range(seeds)]
        span = case.span(clean)
        rows.append({"case": name, "who": "noisy", "psnr": _mean(noisy, clean, span), "seconds": None, "recipe": ""})
        for who, ways in case.methods.items():
            if not takes_part(who, peers):
                continue
            found = []
            for recipe, denoise in ways.items():
                if who not in REFERENCES:
                    denoise(noisy[0])  # builds kernels
                values, seconds = zip(*(_timed(denoise, image) for image in noisy), strict=True)
                row = {"case": name, "who": who, "psnr": _mean(values, clean, span)}
                found.append({**row, "seconds": min(seconds), "recipe": recipe})
            rows.append(max(found, key=lambda row: row["psnr"]))
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def _mean(values: Any, clean: Image, span: float) -> float:
    return float(np.mean([psnr(value, clean, span) for value in values]))


def _timed(denoise: Method, noisy: Image) -> tuple[Image, float]:
    begin = time.perf_counter()
    value = denoise(noisy)
    return value, time.perf_counter() - begin


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table."""
    lines = ["### Real noise", "", *head(["case", "method", "recipe"], ["PSNR, dB", "ours - it", "seconds"])]
    for row in rows:
        ours = next((r["psnr"] for r in rows if r["case"] == row["case"] and r["who"] == "ours"), None)
        apart = "-" if ours is None or row["who"] == "ours" else f"{ours - row['psnr']:+.2f}"
        seconds = "-" if row["seconds"] is None else f"{row['seconds']:.3g}"
        lines.append(line(row["case"], row["who"], row["recipe"], f"{row['psnr']:.2f}", apart, seconds))
    return "\n".join(lines)
