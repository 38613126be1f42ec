"""scikit-image's filters of pictures, tuned by an oracle: the true PSNR, for each picture and each sigma anew.

They are told the true sigma where they take one; every other parameter is chosen by coordinate ascent on the grids
below. The bilateral filter gets the picture raised to positive values and replicated borders; nonlocal means in slow
mode is tuned on the 256 x 256 pixels of the picture's middle, the others on the whole. Wavelet shrinkage (with
PyWavelets; plain, and averaged over 16 shifts) is told too, but is no filter of this kind: it is not part of "best of
scikit-image".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..model import peer
from .scenes import Image, psnr

Settings = dict[str, Any]

# Side of the part on which a slow filter is tuned.
MIDDLE = 256


def climb(grid: Mapping[str, Sequence[Any]], quality: Callable[[Settings], float]) -> Settings:
    """Coordinate ascent on a grid, from its middle: neighbours along each axis in turn, until none is better."""
    axes = {name: list(values) for name, values in grid.items()}
    at = {name: len(values) // 2 for name, values in axes.items()}
    known: dict[tuple[int, ...], float] = {}

    def look(place: Mapping[str, int]) -> float:
        key = tuple(place.values())
        if key not in known:
            known[key] = quality({name: axes[name][k] for name, k in place.items()})
        return known[key]

    improved = True
    while improved:
        improved = False
        for name in axes:
            for step in (1, -1):
                while 0 <= at[name] + step < len(axes[name]):
                    there = {**at, name: at[name] + step}
                    if look(there) <= look(at):
                        break
                    at, improved = there, True
    return {name: axes[name][k] for name, k in at.items()}


Filter = Callable[..., Image]
"""Of the noisy picture in [0, 1], its noise, its channel axis, and settings."""


def _nl_means(noisy: Image, sigma: float, axis: int | None, *, slow: bool = False, h: float, **sizes: int) -> Image:
    from skimage.restoration import denoise_nl_means

    return denoise_nl_means(noisy, h=h * sigma, sigma=sigma, fast_mode=not slow, channel_axis=axis, **sizes)


def _slow_nl_means(noisy: Image, sigma: float, axis: int | None, **settings: Any) -> Image:
    return _nl_means(noisy, sigma, axis, slow=True, **settings)


def _tv_chambolle(noisy: Image, sigma: float, axis: int | None, *, weight: float) -> Image:
    from skimage.restoration import denoise_tv_chambolle

    return denoise_tv_chambolle(noisy, weight * sigma, eps=1e-5, max_num_iter=500, channel_axis=axis)


def _tv_bregman(noisy: Image, sigma: float, axis: int | None, *, weight: float) -> Image:
    from skimage.restoration import denoise_tv_bregman

    return denoise_tv_bregman(noisy, weight / sigma, eps=1e-4, channel_axis=axis)


def _bilateral(noisy: Image, sigma: float, axis: int | None, *, sigma_color: float, sigma_spatial: float) -> Image:
    from skimage.restoration import denoise_bilateral

    raised = 0.01 - float(noisy.min())
    settings = dict(sigma_color=sigma_color * sigma, sigma_spatial=sigma_spatial, mode="edge", channel_axis=axis)
    return denoise_bilateral(noisy + raised, **settings) - raised


def _wavelet(noisy: Image, sigma: float, axis: int | None, *, method: str, share: float, wavelet: str) -> Image:
    from skimage.restoration import denoise_wavelet

    settings = dict(method=method, sigma=share * sigma, wavelet=wavelet, channel_axis=axis)
    return denoise_wavelet(noisy, convert2ycbcr=axis is not None, rescale_sigma=True, **settings)


def _shifted_wavelet(noisy: Image, sigma: float, axis: int | None, **settings: Any) -> Image:
    from skimage.restoration import cycle_spin

    def denoise(image: Image) -> Image:
        return _wavelet(image, sigma, axis, **settings)

    return cycle_spin(noisy, denoise, max_shifts=3, channel_axis=axis, workers=1)


def _steps(low: float, ratio: float, count: int) -> list[float]:
    return [round(low * ratio**k, 4) for k in range(count)]


# h, weight (that of Bregman: 1/weight) and sigma_color are in sigma.
_NL_MEANS = {"patch_size": [3, 5, 7, 9], "patch_distance": [4, 6, 8, 11], "h": _steps(0.3, 1.08, 21)}
_WAVELET = {
    "method": ["VisuShrink", "BayesShrink"],
    "wavelet": ["db1", "db2", "sym4", "sym8"],
    "share": _steps(0.4, 1.16, 13),
}
FILTERS: dict[str, tuple[Filter, Mapping[str, Sequence[Any]]]] = {
    "nl_means fast": (_nl_means, _NL_MEANS),
    "tv_chambolle": (_tv_chambolle, {"weight": _steps(0.2, 1.1, 28)}),
    "tv_bregman": (_tv_bregman, {"weight": _steps(0.3, 1.15, 24)}),
    "bilateral": (
        _bilateral,
        {"sigma_spatial": [0.7, 1.0, 1.4, 2.0, 2.8, 4.0], "sigma_color": _steps(0.5, 1.25, 16)},
    ),
    "wavelet": (_wavelet, _WAVELET),
    "wavelet, shifts": (_shifted_wavelet, _WAVELET),
    "nl_means slow": (_slow_nl_means, _NL_MEANS),
}
"""Every filter of scikit-image with what it may choose from; the slow ones last."""

SLOW = {"nl_means slow"}
OTHER_KIND = {"wavelet", "wavelet, shifts"}
JUDGED = tuple(who for who in FILTERS if who not in OTHER_KIND)


def apply(who: str, noisy: Image, sigma: float, settings: Settings) -> Image:
    """What a filter makes of a noisy picture, grey (y, x) or colour (y, x, 3), in [0, 255]."""
    return 255 * FILTERS[who][0](noisy / 255, sigma / 255, 2 if noisy.ndim == 3 else None, **settings)


def tuned(who: str, clean: Image, noisy: Image, sigma: float) -> Settings:
    """The settings that give the best PSNR; those of a slow filter on the middle of the picture."""
    middle = tuple(
        slice(max(0, (side - MIDDLE) // 2), max(0, (side - MIDDLE) // 2) + MIDDLE) if who in SLOW else slice(None)
        for side in clean.shape[:2]
    )
    return climb(FILTERS[who][1], lambda settings: psnr(apply(who, noisy[middle], sigma, settings), clean[middle]))


def installed(who: str) -> bool:
    """Whether what a filter needs is there."""
    return peer("skimage") is not None and (who not in OTHER_KIND or peer("pywt") is not None)
