"""Choice of the fidelity lam of a denoiser."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from ..noise.white import gradient_to_noise
from .principle import explained, match
from .risk import Inside, Values, j_invariance, sure

LamMethod = Literal["discrepancy", "sure", "j-invariance"]
LAM_METHODS: tuple[LamMethod, ...] = get_args(LamMethod)

# The minimum of a loss is searched within this factor of the first lam, with this precision in log lam. If it is at the
# end of the interval, the search is repeated up to this number of times.
_FACTOR, _PRECISION, _TIMES = 6.0, 0.1, 3


def lam_rule(
    image: npt.NDArray[Any],
    sigma: float,
    p: float,
    *,
    channel_axis: int | None = None,
    mask: npt.ArrayLike | None = None,
    local: bool = True,
) -> float:
    """Return lam by the rule in the notes of :func:`gpureg.plan_denoising`; it is less reliable without `local`."""
    scale: float = 2.2 * float(sigma) ** (float(p) - 2)
    if not local:
        return scale
    inside = None if mask is None else np.asarray(mask)
    steps: float = gradient_to_noise(image, sigma, channel_axis=channel_axis, mask=inside)
    channels, ndim = (1, image.ndim) if channel_axis is None else (image.shape[channel_axis], image.ndim - 1)
    # below 0.3 the error of sigma dominates
    detail: float = max(0.3, math.sqrt(2) * steps) ** min(p, 0.4 * p**2)
    # factors for coupled channels and for the number of axes
    return float(scale * detail * channels ** (p / 2 - 1) * (ndim / 2) ** (p / 2))


def choose_lam(
    method: LamMethod,
    denoise: Callable[[Values, float], npt.NDArray[Any]],
    pixels: Values,
    *,
    sigma: float,
    start: float,
    data_range: float,
    inside: Inside = None,
) -> tuple[float, str]:
    """Choose lam for ``denoise(pixels, lam)``, with a description of the search.

    Parameters
    ----------
    method : {"discrepancy", "sure", "j-invariance"}
    denoise : callable
    pixels : (..., m) float array
        The noisy image, with the channels last.
    sigma : float
        Standard deviation of the noise.
    start : float
        First value of lam.
    data_range : float
        Range for the PSNR in the description.
    inside : (...) bool array, optional
        The pixels that count.
    """
    if method == "discrepancy":
        known = pixels if inside is None else pixels[inside]

        def ratio(lam: float) -> float:
            value = denoise(pixels, lam)
            taken = (value if inside is None else value[inside]).astype(np.float64) - known
            return float(np.mean(taken**2)) / sigma**2

        lam, reached, evaluations = match(ratio, start)
        return lam, explained(reached, evaluations)
    if method == "sure":
        lam, loss, evaluations = least(
            lambda lam: sure(lambda y: denoise(y, lam), pixels, sigma, mask=inside, channel_axis=-1), start
        )
        error, name = loss, "SURE"
    else:
        lam, loss, evaluations = least(
            lambda lam: j_invariance(lambda y: denoise(y, lam), pixels, mask=inside, channel_axis=-1), start
        )
        error, name = loss - sigma**2, "J-invariance"
    return lam, f"{name}: {_in_words(error, sigma, data_range)}, {evaluations} evaluations"


def _in_words(error: float, sigma: float, data_range: float) -> str:
    """Describe an estimated mean squared error."""
    if not error > 0:
        return "estimated error not above 0"
    psnr, gain = (10 * math.log10(energy / error) for energy in (data_range**2, sigma**2))
    return f"estimated PSNR {psnr:.2f} dB of {data_range:.4g}, {gain:+.2f} dB on the noisy image"


def least(loss: Callable[[float], float], start: float) -> tuple[float, float, int]:
    """Return the number near `start` with the smallest loss, this loss, and the number of evaluations."""
    from scipy import optimize

    middle, reach = math.log(start), math.log(_FACTOR)
    found: dict[float, float] = {}

    def at(x: float) -> float:
        found[x] = loss(math.exp(x))
        return found[x]

    best = middle
    for _ in range(_TIMES):
        bounds = (middle - reach, middle + reach)
        optimize.minimize_scalar(at, bounds=bounds, method="bounded", options={"xatol": _PRECISION})
        best = min(found, key=lambda x: found[x])
        if abs(best - middle) < reach - 2 * _PRECISION:
            break
        middle = best
    return math.exp(best), found[best], len(found)
