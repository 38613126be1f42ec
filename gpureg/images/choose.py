"""Choice of the parameters for a noisy image: :func:`plan_denoising`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from ..doors import door
from ..tuning.fidelity import LamMethod, choose_lam
from ..weights import Bilateral, patch_weights
from .course import Course
from .fidelity import fidelity_of
from .guides import contrast
from .kinds import follow_from_noise, named_weights, weights_of
from .noise import Noise, noise_of
from .options import CHOICE, Choice, check_choice
from .plan import DenoisePlan
from .raster import Raster
from .run import expect_one_sweep, solve
from .window import window_of


@door(options=CHOICE)
def plan_denoising(image: npt.ArrayLike | Raster, **options: Unpack[Choice]) -> DenoisePlan:
    """Choose the parameters of :func:`denoise_image`; given parameters are not changed.

    With a guide, the rule subtracts no noise from the patch distances. The options of a run (solver, backend and so
    on) matter only if `lam` is "discrepancy", "sure" or "j-invariance": these searches denoise the image several times.

    Parameters
    ----------
    image : array
        The noisy image, as in :func:`denoise_image`.
    sigma, p, lam, radius, metric, weights, h, patch_radius, patch_sigma, sigma_space, sigma_value, guide, k, centre
    average_patches, max_iter, mask, spacing, channel_axis
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`denoise_image`.

    Returns
    -------
    DenoisePlan

    Raises
    ------
    TypeError, ValueError
        As :func:`denoise_image`.

    Warns
    -----
    UserWarning
        As :func:`denoise_image`.

    Notes
    -----
    The default is one sweep of nonlocal means (p = 2) over a window of 21 x 21, or 5 x 5 x 5 in a volume. Its weights
    compare a blurred copy of the image, with parameters that depend on the noise
    (:func:`gpureg.images.nonlocal_rule.nonlocal_rule`); if sigma is a map, their h and sigma are maps too.

    With p other than 2, the default is the unweighted graph G_0 of nearest neighbours (p = 1: digital total variation)
    with lam = 2.2 G^(0.4 p^2) sigma^(p - 2). G is the root mean square gradient of the clean image over sigma, at least
    0.3, estimated from the noisy image: more detail makes lam larger. The factor sigma^(p - 2) is the scale law of the
    model. For m coupled channels lam is multiplied by m^(p/2 - 1), along d axes by (d/2)^(p/2). If sigma is a map, lam
    is a map proportional to 1/sigma^2. The rule was fitted on 11 photographs at sigma 5 to 40. On ten of them, at p
    from 0.5 to 2, it is within 0.05 dB of the best lam on average, and within 0.6 dB at worst. lam="sure" is within
    0.01 dB, but needs 8 runs; "discrepancy" smooths too much, by 0.7 dB at p = 1; "j-invariance" needs no white noise.

    With `k` and p other than 2, the default is patches of 7 x 7 over a window of 21 x 21, h = sigma per sample,
    lam = 3.1 sigma^(p - 2) and 4 iterations. These values were good on the camera image at p = 1.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(7).normal(0.5, 0.1, (64, 64))
    >>> plan_denoising(image, p=1, sigma=0.1).describe()
    'constant weights, 4 neighbours; p = 1, lam = 13.59, at most 200 iterations'
    """
    asked = cast("Choice", CHOICE | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    check_choice(asked, raster.shape)
    noise = noise_of(raster, asked["sigma"], needed=follow_from_noise(asked))
    given, why_given = named_weights(asked, noise, raster)
    course = Course.of(asked, given)
    if course.needs_noise:
        noise = noise.found(raster)
    spread = contrast(raster) if course.chooses or course.search is not None else 1.0
    if not (math.isfinite(noise.level) and math.isfinite(spread)):
        raise ValueError("the image's values are too large to tell signal from noise: rescale them")
    idle = course.chooses and noise.is_negligible(raster, spread)
    window, why_window = window_of(
        raster.shape,
        radius=asked["radius"],
        metric=asked["metric"],
        spacing=asked["spacing"],
        local=course.local,
        wide=10.0 if given is None else 7.0,
    )
    rule, why_weights = weights_of(asked, raster, noise, spread, window.spacing, course, given, idle=idle)
    fidelity, why_fidelity = fidelity_of(asked, raster, noise, course, rule.lam, idle=idle)
    why = why_weights | why_fidelity | why_given
    if asked["radius"] is None:
        why["window"] = why_window
    plan = DenoisePlan(
        sigma=noise.sigma,
        estimated=noise.estimated,
        weights=rule.weights,
        radius=window.radius,
        metric=window.metric,
        p=2.0 if asked["p"] is None else float(asked["p"]),
        lam=fidelity.lam,
        max_iter=fidelity.max_iter,
        tol=fidelity.tol,
        eps=asked["eps"],
        spacing=window.spacing,
        window=window.sides,
        average_patches=False if rule.average_radius is None else "weighted",
        average_radius=rule.average_radius,
        k=None if idle else asked["k"],
        reasons=why,
    )
    plan = _with_the_pixel_itself(plan, asked)
    if course.search is None or plan.max_iter == 0:
        return plan
    return _searched(plan, raster, asked, course.search, noise, spread, fidelity.start)


def _with_the_pixel_itself(plan: DenoisePlan, asked: Choice) -> DenoisePlan:
    """Return the plan with the given `average_patches` and `centre`.

    Raises
    ------
    ValueError
        The plan is not one sweep at p = 2, to which these options belong.
    """
    centre, average_patches, reasons = asked["centre"], asked["average_patches"], dict(plan.reasons)
    if average_patches is not None:
        reasons["averaging"] = "given"
        plan = replace(plan, average_patches=average_patches, reasons=reasons)
    if centre is not None:
        plan = replace(plan, centre=centre)
    if centre == "none":
        reasons["lam"] = "the centre is left out, as given"
        plan = replace(plan, lam=0.0, reasons=reasons)
    found = patch_weights(plan.weights)
    if average_patches and found is not None and isinstance(found[0], Bilateral):
        raise ValueError("average_patches needs patch weights, such as weights='patch'")
    if centre is not None or average_patches:
        expect_one_sweep(plan, asked["solver"], "centre" if centre is not None else "average_patches")
    return plan


def _searched(
    plan: DenoisePlan,
    raster: Raster,
    asked: Choice,
    method: LamMethod,
    noise: Noise,
    spread: float,
    start: float,
) -> DenoisePlan:
    """Return the plan with the lam that a search finds."""
    pixels = raster.pixels(asked["dtype"])
    run: dict[str, Any] = {
        "solver": asked["solver"],
        "backend": asked["backend"],
        "memory": asked["memory"],
        "dtype": raster.chosen_type(asked["dtype"]),
    }

    def denoise(y: npt.NDArray[Any], lam: float) -> npt.NDArray[Any]:
        return solve(replace(plan, lam=lam), y, raster.inside, **run).value

    white = 255.0 if raster.values.dtype == np.uint8 else spread
    found, how = choose_lam(
        method, denoise, pixels, sigma=noise.level, start=start, data_range=white, inside=raster.inside
    )
    return replace(plan, lam=found, reasons={**plan.reasons, "lam": how})
