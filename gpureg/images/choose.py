"""Choice of the parameters for a noisy image: :func:`plan_denoising`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from ..doors import door, warn
from ..graphs.grid import GridGraph
from ..noise.flat import large_side
from ..tuning.fidelity import LamMethod, choose_lam
from ..weights import Bilateral, patch_weights
from .by_noise import say
from .course import Course
from .fidelity import fidelity_of
from .guides import contrast
from .kinds import follow_from_noise, named_weights, weights_of
from .noise import Noise, levels_of, noise_of
from .options import CHOICE, Choice, check_choice
from .pass_rule import expect_passes, with_passes
from .plan import DenoisePlan
from .prepare import flat_in_all, prepared
from .raster import Raster
from .run import expect_one_sweep, solve
from .window import window_of

# Noise of an image of integers above this is more than rounding.
_ROUNDING = 0.32
# Areas of equal values are left out if they have more than this share.
_FLAT = 0.01
# Only above this share they may be all of an image.
_MAY_BE_ALL = 0.9


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
    average_patches, max_iter, passes, quality, mask, spacing, channel_axis
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
    (:func:`gpureg.images.nonlocal_rule.nonlocal_rule`); if sigma is a map, their h and sigma are maps too. Two passes
    on groups of similar patches follow; the plan has them in `passes`, and `explain` the reason where there are none:
    noise that is not white, a picture of fewer than 32 pixels along an axis, parameters that make another filter. What
    the passes do and cost, and what else is done about the noise, is in the notes of :func:`denoise_image`; the plan
    has the latter in `photon`, `impulses`, `flat_side` and `groups`.

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
    check_choice(asked, raster)
    if raster.thin_axes and _may_squeeze(asked):
        asked, raster = _squeezed(asked, raster), raster.without_thin_axes()
    expect_passes(asked, raster)
    noise = noise_of(raster, asked["sigma"], needed=follow_from_noise(asked))
    given, _ = named_weights(asked, noise, raster)
    course = Course.of(asked, given)
    # sigma="photon" is measured even if nothing depends on it
    if course.needs_noise:
        noise = noise.found(raster)
    if noise.report is not None and noise.estimated:
        say(noise.report)
    if raster.channels > 1 and _depends_on_noise(asked, course):
        groups, same = noise.groups(raster, guided=asked["guide"] is not None)
        if len(groups) > 1 or len(set(same)) < len(same):
            plans = tuple((group, _plan(raster.only(group), asked, noise.of(group), group)) for group in groups)
            first = plans[0][1]
            return replace(
                first, sigma=noise.sigma, sigmas=noise.sigmas or (), groups=plans, same=same, report=noise.report
            )
    return _plan(raster, asked, noise)


def each_channel(raster: Raster, **options: Unpack[Choice]) -> DenoisePlan:
    """Return a plan that denoises each channel by itself, also where they are better together."""
    count = raster.channels
    sigma = options.get("sigma")
    each = [sigma] * count
    if isinstance(sigma, np.ndarray | Sequence) and not isinstance(sigma, str) and np.shape(sigma) == (count,):
        each = list(sigma)
    plans = []
    for i, one in enumerate(each):
        own: Any = {**options, "sigma": one}
        plans.append(plan_denoising(raster.only((i,)), **cast("Choice", own)))
    levels = tuple(math.nan if plan.sigma is None else plan.sigma for plan in plans)
    known = [level for level in levels if not math.isnan(level)]
    total = math.sqrt(sum(level**2 for level in known) / len(known)) if known else None
    groups = tuple(((i,), plan) for i, plan in enumerate(plans))
    return replace(plans[0], sigma=total, sigmas=levels, groups=groups, same=tuple(range(count)), report=None)


def _flat_side(raster: Raster, share: float) -> int:
    """Return the side of large areas of equal values that are left out; 0 if there is nothing else in the image."""
    side = max(large_side(raster.cells[..., i], raster.inside) for i in range(raster.channels))
    # the share is an estimate, and cheaper
    return 0 if share > _MAY_BE_ALL and flat_in_all(raster, side).all() else side


def _may_squeeze(asked: Choice) -> bool:
    """Return whether axes of length 1 may be left out: nothing is given that has the shape or the sides of the grid."""
    return (
        asked["guide"] is None
        and asked["h"] is None
        and (asked["weights"] is None or isinstance(asked["weights"], str))
    )


def _squeezed(asked: Choice, raster: Raster) -> Choice:
    """Return the options for the image without its thin axes."""
    changed: dict[str, Any] = {}
    thin, inner = raster.thin_axes, raster.without_thin_axes()
    if asked["spacing"] is not None:
        # also a check of the given spacing
        sizes = GridGraph(raster.shape, max(asked["spacing"], default=1.0), spacing=asked["spacing"]).spacing or ()
        changed["spacing"] = tuple(size for axis, size in enumerate(sizes) if axis not in thin)
    lam, sigma = asked["lam"], asked["sigma"]
    if lam is not None and not isinstance(lam, str) and np.ndim(lam) > 0:
        changed["lam"] = np.reshape(lam, inner.shape)
    if isinstance(sigma, np.ndarray | Sequence) and not isinstance(sigma, str):
        values = np.asarray(sigma)
        if raster.channel_axis is not None and values.shape == raster.values.shape:
            changed["sigma"] = np.moveaxis(values, raster.channel_axis, -1).reshape(inner.values.shape)
        elif values.ndim > 0 and (raster.channel_axis is None or values.shape != (raster.channels,)):
            changed["sigma"] = np.broadcast_to(values, raster.shape).reshape(inner.shape)
    return cast("Choice", {**asked, **changed})


def _depends_on_noise(asked: Choice, course: Course) -> bool:
    """Return whether the parameters come from the noise, so that the channels may be denoised by themselves."""
    weights = asked["weights"]
    by_rule = weights is None or isinstance(weights, str)
    plain = asked["lam"] is None or isinstance(asked["lam"], str) or course.chooses
    return by_rule and plain and (course.needs_noise or follow_from_noise(asked))


def _plan(raster: Raster, asked: Choice, noise: Noise, group: tuple[int, ...] = ()) -> DenoisePlan:
    """Return the plan for channels that are denoised together; a `group` of channels without noise stays as it is.

    `group` are those of the image's channels that `raster` and `noise` have; empty for all.
    """
    noise = levels_of(raster, noise)
    # the values of a guide are not in the units of the noise
    units = noise.units if asked["guide"] is None else None
    own = replace(noise, sigmas=(1.0,) * raster.channels) if units is not None else noise
    given, why_given = named_weights(asked, own, raster)
    course = Course.of(asked, given)
    if not course.chooses and not follow_from_noise(asked) and asked["lam"] is not None:
        units, own = None, noise
    why_idle = noise.without(raster) if course.chooses or (bool(group) and noise.level == 0) else None
    idle = why_idle is not None
    if idle and noise.estimated and why_idle is not None and noise.level > _ROUNDING:
        warn(f"{why_idle}: it is returned as it is; give it as floating-point numbers to denoise it")
    spread, flat = 1.0, 0.0
    if not idle and asked["max_iter"] != 0 and (course.chooses or course.search is not None):
        spread, flat = contrast(raster, noise, units)
    if not (math.isfinite(noise.level) and math.isfinite(spread)):
        raise ValueError("the image's values are too large to tell signal from noise: rescale them")
    window, why_window = window_of(
        raster.shape,
        radius=asked["radius"],
        metric=asked["metric"],
        spacing=asked["spacing"],
        local=course.local,
        wide=10.0 if given is None else 7.0,
    )
    rule, why_weights = weights_of(asked, raster, own, spread, window.spacing, course, given, idle=idle)
    fidelity, why_fidelity = fidelity_of(asked, raster, own, course, rule.lam, idle=idle, units=units)
    why = why_weights | why_fidelity | why_given
    if why_idle is not None:
        why["idle"] = why_idle
    if asked["radius"] is None:
        why["window"] = why_window
    follows = course.chooses or follow_from_noise(asked) or asked["lam"] is None
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
        sigmas=noise.sigmas or (),
        photon=(noise.photon or ()) if follows else (),
        impulses=noise.impulses if follows and any(rule is not None for rule in noise.impulses) else (),
        units=units or (),
        flat_side=_flat_side(raster, flat) if course.chooses and course.filters and not idle and flat > _FLAT else 0,
        frame=raster.frame(units) if course.filters else None,
        report=noise.report,
        reasons=why,
    )
    plan = _with_the_pixel_itself(plan, asked)
    plan = with_passes(plan, raster, asked, course, noise, group or range(raster.channels))
    if course.search is None or plan.max_iter == 0:
        return plan
    return _searched(plan, raster, asked, course.search, own, spread, fidelity.start)


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
    ready = prepared(plan, raster, asked["dtype"])
    pixels = ready.pixels
    run: dict[str, Any] = {
        "solver": asked["solver"],
        "backend": asked["backend"],
        "memory": asked["memory"],
        "dtype": raster.chosen_type(asked["dtype"]),
    }

    def denoise(y: npt.NDArray[Any], lam: float) -> npt.NDArray[Any]:
        return solve(replace(ready.plan, lam=lam), y, ready.inside, **run).value

    white = 255.0 if raster.values.dtype == np.uint8 else spread
    found, how = choose_lam(
        method, denoise, pixels, sigma=noise.level, start=start, data_range=white, inside=raster.inside
    )
    return replace(plan, lam=found, reasons={**plan.reasons, "lam": how})
