"""What to do with a noisy image: :func:`plan_denoising` chooses, the noise decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graphs.edges import Metric
from ..graphs.grid import GridGraph
from ..model.problem import Norm
from ..noise.white import estimate_noise
from ..solvers import Certified, Solver, resolve
from ..tuning.explanation import reasons_for
from ..tuning.fidelity import LAM_METHODS, LamMethod, choose_lam, lam_rule
from ..weights import Constant, Weights, constant, patch
from .guides import contrast, for_a_guide
from .nonlocal_rule import nonlocal_rule
from .plan import DenoisePlan
from .raster import checked, pixels_of
from .run import solve

# The rule's lam for the edge norm, as a share of that for the vertex norm: on the camera picture at sigma 20 and p = 1
# the best, on three photographs 0.5 to 0.7 were.
_EDGE_NORM = 0.7


def plan_denoising(
    image: npt.ArrayLike,
    *,
    sigma: float | npt.ArrayLike | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | LamMethod | None = None,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    guide: npt.ArrayLike | None = None,
    nearest: int | None = None,
    norm: Norm = "vertex",
    solver: str | Solver = "jacobi",
    max_iter: int | None = None,
    tol: float | None = None,
    eps: float | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    memory: int | None = None,
) -> DenoisePlan:
    """Choose what :func:`denoise_image` would do; the parameters are the same, and what is given is kept.

    Of a guide it matters that there is one: the rule then takes no noise off the distances of its patches. The solver,
    the backend and what belongs to them matter only where `lam` is to be searched for, "discrepancy",
    "sure" or "j-invariance": these denoise the image several times.

    Raises
    ------
    TypeError, ValueError
        As :func:`denoise_image`.

    Notes
    -----
    The noise decides. With nothing else given, one sweep of nonlocal means (p = 2) over a 21 x 21 window, in a volume
    5 x 5 x 5, whose weights compare a copy blurred by half a pixel:
    :func:`gpureg.images.nonlocal_rule.nonlocal_rule` says which. A map of sigma makes maps of their h and sigma.

    With p other than 2, the unweighted graph G_0 of nearest neighbours (p = 1: digital total variation) with
    lam = 2.2 G^(0.4 p^2) sigma^(p - 2), G the clean image's root mean square gradient over sigma, at least 0.3, taken
    from the noisy one: the more there is to keep, the larger lam; sigma^(p - 2) is the scale law of the model. In m
    coupled channels it is m^(p/2 - 1) as large, along d axes (d/2)^(p/2); a map of sigma makes it one, as 1/sigma^2.
    Fitted on 11 photographs at sigma 5 to 40; on ten of them at p from 0.5 to 2 within 0.05 dB of the best lam on
    average, at worst 0.6. lam="sure" comes within 0.01 dB, in 8 runs instead of one; "discrepancy" smooths too
    much, by 0.7 dB at p = 1; "j-invariance" needs no white noise.

    With `nearest` and p other than 2, patches of 7 x 7 over a window of 21 x 21, h = sigma per sample,
    lam = 3.1 sigma^(p - 2) and 4 iterations, which was good on the camera picture at p = 1.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(7).normal(0.5, 0.1, (64, 64))
    >>> plan_denoising(image, p=1, sigma=0.1).describe()
    'constant weights, 4 neighbours; p = 1, lam = 13.59, at most 200 iterations'
    """
    array = checked(image, channel_axis, mask)
    channels = 1 if channel_axis is None else array.shape[channel_axis]
    cells = array.shape if channel_axis is None else tuple(np.delete(array.shape, channel_axis).tolist())
    ndim = len(cells)
    profile = None
    if sigma is not None and np.ndim(sigma) > 0:
        sigma, profile = _noise_profile(sigma, cells, mask)
    for name, number in (("sigma", sigma), ("p", p)):
        if number is not None and (isinstance(number, bool) or not isinstance(number, int | float | np.number)):
            raise TypeError(f"{name} must be a number, got {number!r}")
    assert sigma is None or isinstance(sigma, float | int | np.number)  # a map has become its mean
    if sigma is not None and not (math.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be finite and >= 0, got {sigma}")
    if p is not None and not (math.isfinite(p) and p > 0):
        raise ValueError(f"p must be finite and > 0, got {p}")
    if max_iter is not None and max_iter < 0:
        raise ValueError(f"max_iter must be >= 0, got {max_iter}")
    method = resolve(solver)
    # a solver with a tolerance of its own ends where that is met
    converges = isinstance(method, Certified)
    wish: LamMethod | None = None
    if isinstance(lam, str):
        if lam not in LAM_METHODS:
            raise ValueError(f"lam must be a number, one per pixel, or one of {', '.join(LAM_METHODS)}, got {lam!r}")
        if guide is not None or norm != "vertex":
            raise ValueError(
                f"the search lam={lam!r} looks at the vertex norm and weights without a guide: give lam a number"
            )
        lam, wish = None, lam
    # Without weights that look at the data a wide window only blurs: the paper's G_0.
    local = isinstance(weights, Constant) or (weights is None and p not in (None, 2) and nearest is None)
    # What decides nothing is not looked for: it takes longer than the one step of a filter.
    filters = not local and p in (None, 2)
    chooses = weights is None and (lam is None or not local)
    estimated = sigma is None and (chooses or (lam is None and not filters) or wish is not None)
    noise = 0.0 if sigma is None else float(sigma)
    if estimated:
        noise = estimate_noise(array, channel_axis=channel_axis, mask=mask)
    spread = contrast(array, channel_axis, mask) if chooses or wish is not None else 1.0
    if not (math.isfinite(noise) and math.isfinite(spread)):
        raise ValueError("the image's values are too large to tell signal from noise: rescale them")
    if metric is None:
        metric = "cityblock" if local and radius is None else "chebyshev"
    # What was given is checked here, whatever becomes of it; the image's own size cuts the window short.
    widest = 1.0 if spacing is None or np.ndim(spacing) != 1 else max(spacing, default=1.0)
    given = GridGraph(cells, widest if radius is None else radius, metric, spacing=spacing)
    if radius is None and local:
        # The nearest neighbours, however far apart: constant weights do not look at distances.
        reach, steps = 1.0, None
    elif radius is None:
        # So many of the finest cells, and one cell at least along every axis.
        finest, coarsest = (min(given.spacing), max(given.spacing)) if given.spacing else (1.0, 1.0)
        wide = 2.0 if ndim > 2 else 10.0 if weights is None else 7.0
        reach, steps = max(wide * finest, coarsest), given.spacing
    else:
        reach, steps = float(radius), given.spacing
    offsets = GridGraph(cells, reach, metric, spacing=steps).offsets
    window = tuple((2 * np.abs(offsets).max(axis=0, initial=0) + 1).tolist())
    place: dict[str, Any] = {"radius": reach, "metric": metric, "spacing": steps, "window": window}
    chosen = {"p": p, "window": radius, "weights": weights, "lam": lam, "iterations": max_iter}
    reasons = reasons_for(chosen, local=local, filters=filters)
    if nearest is not None and weights is None:
        reasons["weights"] = "rule: patches, on the graph of the nearest"
    average_radius: int | None = None
    # Half a grey level: what rounding alone may add.
    negligible = noise < (0.5 if array.dtype.kind in "iu" else 0.5 / 255 * spread) or noise == 0
    if chooses and negligible and (estimated or noise == 0):
        nothing: dict[str, Any] = {"p": 2.0 if p is None else float(p), "lam": math.inf, "max_iter": 0}
        return DenoisePlan(noise, estimated, constant(), tol=tol, eps=eps, reasons=reasons, **nothing, **place)
    if lam is None and noise == 0 and (wish is not None or not filters):
        raise ValueError("without noise there is nothing to choose lam from: give it")
    if filters:
        # lam = 2: the centre counted once
        default_lam, default_iterations = 2.0, 1
        if weights is None:
            weights, default_lam, average_radius = nonlocal_rule(noise, spread, channels, ndim, steps, profile)
            if guide is not None:
                weights = for_a_guide(weights)
            if nearest is not None:
                weights, default_lam = _patches(noise, channels, ndim), 2.0
            if nearest is not None or max_iter not in (None, 1) or tol is not None or converges:
                average_radius = None  # patches are averaged after one sweep on the grid alone
    else:
        degree = 2.0 if p is None else p
        if weights is None:
            weights = constant() if nearest is None else _patches(noise, channels, ndim)
        default_lam = 0.0
        if lam is None and nearest is not None:
            default_lam = 3.1 * noise ** (degree - 2)
        elif lam is None:
            default_lam = lam_rule(array, noise, degree, channel_axis=channel_axis, mask=mask, local=local)
        # at p = 2 more sweeps only blur
        default_iterations = 3 if degree == 2 else 200 if nearest is None else 4
        if tol is None and max_iter is None and degree != 2 and not converges:
            tol, reasons["tol"] = 1e-4, "rule"
    if converges:
        default_iterations = method.most
    plan = DenoisePlan(
        sigma=noise if estimated or sigma is not None else None,
        estimated=estimated,
        weights=weights,
        p=2.0 if p is None else float(p),
        lam=default_lam if lam is None else lam,
        max_iter=default_iterations if max_iter is None else max_iter,
        tol=tol,
        eps=eps,
        average_patches=False if average_radius is None else "weighted",
        average_radius=average_radius,
        nearest=nearest,
        reasons=reasons,
        **place,
    )
    if norm == "edge" and not filters and lam is None:
        scaled = float(np.asarray(plan.lam)) * _EDGE_NORM
        plan = replace(plan, lam=scaled, reasons={**reasons, "lam": f"{reasons['lam']}, {_EDGE_NORM} of it: edge norm"})
    if profile is not None and not filters and lam is None:
        # the data count by their variance
        plan = replace(plan, lam=np.asarray(plan.lam, np.float64) / profile.reshape(cells) ** 2)
    if wish is None or plan.max_iter == 0:
        return plan
    pixels, inside = pixels_of(array, channel_axis, dtype), None if mask is None else np.asarray(mask)

    def denoise(y: npt.NDArray[Any], lam: float) -> npt.NDArray[Any]:
        one = replace(plan, lam=lam)
        return solve(one, y, inside, solver=solver, backend=backend, dtype=pixels.dtype, memory=memory).value

    white = 255.0 if array.dtype == np.uint8 else spread
    found, how = choose_lam(wish, denoise, pixels, sigma=noise, start=default_lam, data_range=white, inside=inside)
    return replace(plan, lam=found, reasons={**reasons, "lam": how})


def _noise_profile(
    sigma: npt.ArrayLike, cells: tuple[int, ...], mask: npt.ArrayLike | None
) -> tuple[float, npt.NDArray[np.float64]]:
    """A map of the noise as its root mean square over the mask, and what each pixel has of that, (n,)."""
    values = np.asarray(sigma)
    if values.dtype.kind not in "biuf" or values.shape != cells:
        raise ValueError(
            f"sigma must be a number or one per pixel, shape {cells}, got {values.dtype} of shape {values.shape}"
        )
    values = values.astype(np.float64)
    inside = np.ones(cells, bool) if mask is None else np.asarray(mask)
    known = values[inside]
    if not (np.isfinite(known).all() and (known >= 0).all()):
        raise ValueError("a map of sigma must be finite and >= 0 wherever a pixel takes part")
    mean = math.sqrt(float(np.mean(known**2))) if known.size else 0.0
    if mean == 0:
        return 0.0, np.ones(values.size)
    # no less than a hundredth: a pixel without any noise would leave the others nothing to be compared with
    profile = np.where(inside, np.maximum(np.where(inside, values, mean) / mean, 0.01), 1.0)
    return mean, profile.ravel()


def _patches(noise: float, channels: int, ndim: int) -> Weights:
    """Patch weights for iterations on the graph of nearest patches."""
    radius = 3 if ndim == 2 else 1
    h = noise * math.sqrt(channels * (2 * radius + 1) ** ndim)
    return patch(radius, h, sigma=noise)
