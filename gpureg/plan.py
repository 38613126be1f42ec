"""What to do with a noisy image: :func:`plan_denoising` chooses, the noise decides."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .graph import GridGraph, Metric, all_finite, unmasked
from .noise import estimate_noise
from .problem import default_eps
from .regularization import one_sweep, regularize
from .result import Result
from .solvers import Jacobi, Solver, resolve
from .solvers.loop import Callback
from .tuning.explanation import reasons_for, table
from .tuning.fidelity import LAM_METHODS, LamMethod, choose_lam, lam_rule
from .weights import Bilateral, Constant, Guided, Patch, Weights, constant, patch, patch_weights

# Brightness and two opponent colours, orthonormal; the colours count less, having less detail than noise.
_CHROMA = 0.45
_OPPONENT = np.array([[1, 1, 1], [1, 0, -1], [0.5, -1, 0.5]]) / np.sqrt(np.array([[3], [2], [1.5]]))
_OPPONENT[1:] *= _CHROMA

# Pixels that are filtered at a time.
_BAND = 1 << 22


@dataclass(frozen=True)
class DenoisePlan:
    """What :func:`denoise_image` does with an image: its parameters, chosen or given.

    Attributes
    ----------
    sigma : float or None
        Standard deviation of the noise, in the image's units; None where it was not given, and decided nothing.
    estimated : bool
        Whether it was estimated.
    weights : Weights or array
    radius, metric
        The neighbourhood of :class:`gpureg.GridGraph`.
    p, lam, max_iter, tol, eps
        As in :func:`gpureg.regularize`; ``max_iter`` 0 leaves the image as it is.
    opponent : bool
        Whether the weights compare brightness and, less strictly, two opponent colours instead of red, green and blue.
    spacing : tuple of float or None
        Size of a pixel along each axis, None where the window is one of cells.
    window : tuple of int
        Sides of the neighbourhood in cells.
    reasons : mapping of str to str
        Why a parameter is what it is, where it was not given; see :meth:`explain`.
    """

    sigma: float | None
    estimated: bool
    weights: Weights | npt.ArrayLike
    radius: float
    metric: Metric
    p: float
    lam: float | npt.ArrayLike
    max_iter: int
    tol: float | None = None
    eps: float | None = None
    opponent: bool = False
    spacing: tuple[float, ...] | None = None
    window: tuple[int, ...] = ()
    reasons: Mapping[str, str] = field(default_factory=dict, compare=False)

    def describe(self) -> str:
        """The plan in one line."""
        if self.max_iter == 0:
            found = np.ndim(self.lam) == 0 and self.lam == math.inf
            return "nothing to do: no noise was found" if found else "nothing to do: 0 iterations"
        w, window = self.weights, "x".join(map(str, self.window)) + " window"
        if self.metric != "chebyshev":
            window = (
                f"{2 * len(self.window)} neighbours"
                if self.metric == "cityblock" and max(self.window) <= 3
                else f"{window} ({self.metric})"
            )
        if isinstance(w, Patch):
            shape = "flat" if w.a is None else f"Gaussian (a = {w.a:.3g})"
            colours = ", opponent colours" if self.opponent else ""
            patches = "x".join([str(2 * w.radius + 1)] * len(self.window)) + f" {shape} patches"
            kind = f"nonlocal weights{colours}, {window}, {patches}, h = {w.h:.4g}"
        elif isinstance(w, Bilateral):
            kind = f"bilateral weights, {window}, sigma_space = {w.sigma_space:.4g}"
            kind += f", sigma_value = {w.sigma_value:.4g}"
        elif isinstance(w, Constant):
            kind = f"constant weights, {window}"
        else:
            kind = f"{type(w).__name__} weights, {window}"
        lam = f"{float(self.lam):.4g}" if np.ndim(self.lam) == 0 else "a map"  # type: ignore[arg-type]
        iterations = "1 iteration" if self.max_iter == 1 else f"at most {self.max_iter} iterations"
        return f"{kind}; p = {self.p:g}, lam = {lam}, {iterations}"

    def explain(self) -> str:
        """One line for each parameter: its value, and why it is that."""
        w, ndim, one = self.weights, len(self.window), np.ndim(self.lam) == 0
        rows = {"noise": ("unknown", "not looked for: it decides nothing")}
        if self.sigma is not None:
            where = "estimated from the image where its texture is weakest"
            rows["noise"] = f"sigma = {self.sigma:.4g}", where if self.estimated else "given"
        if self.max_iter == 0:
            return f"{table(rows)}\n{self.describe()}"
        rows["weights"] = type(w).__name__.lower(), self.reasons.get("weights", "given")
        if isinstance(w, Patch):
            shape = "flat" if w.a is None else f"Gaussian, a = {w.a:.3g}"
            rows["patch"] = f"{'x'.join([str(2 * w.radius + 1)] * ndim)}, {shape}", self.reasons.get("patch", "given")
            rows["h"] = f"{w.h:.4g}", self.reasons.get("h", "given")
        if isinstance(w, Bilateral):
            rows["reach"] = f"{w.sigma_space:.4g} in space, {w.sigma_value:.4g} in value", "given"
        rows["window"] = f"{'x'.join(map(str, self.window))}, {self.metric}", self.reasons.get("window", "given")
        rows["p"] = f"{self.p:g}", self.reasons.get("p", "given")
        rows["lam"] = f"{float(np.asarray(self.lam)):.4g}" if one else "a map", self.reasons.get("lam", "given")
        rows["iterations"] = f"at most {self.max_iter}", self.reasons.get("iterations", "given")
        if self.tol is not None:
            rows["tol"] = f"{self.tol:g}", self.reasons.get("tol", "given")
        if self.eps is not None or self.p != 2:
            rows["eps"] = ("1e-3 of the range", "rule") if self.eps is None else (f"{self.eps:g}", "given")
        return table(rows)


def plan_denoising(
    image: npt.ArrayLike,
    *,
    sigma: float | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | LamMethod | None = None,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
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

    The solver, the backend and what belongs to them matter only where `lam` is to be searched for, "discrepancy",
    "sure" or "j-invariance": these denoise the image several times.

    Raises
    ------
    TypeError, ValueError
        As :func:`denoise_image`.

    Notes
    -----
    The noise decides. With nothing else given, one sweep of nonlocal means (p = 2) over a 15 x 15 window: patches grow
    with the noise, and are smaller in colour, where three channels tell as much as a larger patch of one; h falls as
    they grow. In RGB the weights compare brightness and, at 0.45, two opponent colours. The rule was fitted on ten
    photographs at sigma 10, 20, 40 of 255. A volume gets a window of 5 and patches of 3 voxels a side, the best of six
    choices on two synthetic volumes. With p other than 2, the unweighted graph G_0 of nearest neighbours (p = 1:
    digital total variation) with lam = 2.2 G^(0.4 p^2) sigma^(p - 2), G the clean image's root mean square gradient
    over sigma, at least 0.3, taken from the noisy one: the more there is to keep, the larger lam; sigma^(p - 2) is the
    scale law of the model. In m coupled channels it is m^(p/2 - 1) as large, along d axes (d/2)^(p/2). Fitted on 11
    photographs at sigma 5 to 40; on ten of them at p from 0.5 to 2 within 0.05 dB of the best lam on average, at worst
    0.6. lam="sure" comes within 0.01 dB at p = 1, in some 15 runs instead of one; "discrepancy" smooths too much there,
    by 0.7 dB; "j-invariance" needs no white noise.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(7).normal(0.5, 0.1, (64, 64))
    >>> plan_denoising(image, p=1, sigma=0.1).describe()
    'constant weights, 4 neighbours; p = 1, lam = 13.59, at most 200 iterations'
    """
    array = checked(image, channel_axis, mask)
    channels = 1 if channel_axis is None else array.shape[channel_axis]
    for name, number in (("sigma", sigma), ("p", p)):
        if number is not None and (isinstance(number, bool) or not isinstance(number, int | float | np.number)):
            raise TypeError(f"{name} must be a number, got {number!r}")
    if sigma is not None and not (math.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be finite and >= 0, got {sigma}")
    if p is not None and not (math.isfinite(p) and p > 0):
        raise ValueError(f"p must be finite and > 0, got {p}")
    if max_iter is not None and max_iter < 0:
        raise ValueError(f"max_iter must be >= 0, got {max_iter}")
    wish: LamMethod | None = None
    if isinstance(lam, str):
        if lam not in LAM_METHODS:
            raise ValueError(f"lam must be a number, one per pixel, or one of {', '.join(LAM_METHODS)}, got {lam!r}")
        lam, wish = None, lam
    cells = array.shape if channel_axis is None else tuple(np.delete(array.shape, channel_axis).tolist())
    ndim = len(cells)
    # Without weights that look at the data a wide window only blurs: the paper's G_0.
    local = isinstance(weights, Constant) or (weights is None and p not in (None, 2))
    # What decides nothing is not looked for: it takes longer than the one step of a filter.
    filters = not local and p in (None, 2)
    chooses = weights is None and (lam is None or not local)
    estimated = sigma is None and (chooses or (lam is None and not filters) or wish is not None)
    noise = 0.0 if sigma is None else float(sigma)
    if estimated:
        noise = estimate_noise(array, channel_axis=channel_axis, mask=mask)
    spread = _contrast(array, channel_axis, mask) if chooses or wish is not None else 1.0
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
        reach, steps = max((7.0 if ndim == 2 else 2.0) * finest, coarsest), given.spacing
    else:
        reach, steps = float(radius), given.spacing
    offsets = GridGraph(cells, reach, metric, spacing=steps).offsets
    window = tuple((2 * np.abs(offsets).max(axis=0, initial=0) + 1).tolist())
    place: dict[str, Any] = {"radius": reach, "metric": metric, "spacing": steps, "window": window}
    chosen = {"p": p, "window": radius, "weights": weights, "lam": lam, "iterations": max_iter}
    reasons = reasons_for(chosen, local=local, filters=filters)
    opponent = False
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
            # The rule's unit is the 255th part of the contrast.
            level = min(60.0, 255 * noise / spread) if spread > 0 else 60.0
            opponent = channels == 3
            plain = channels == 1 and ndim == 2
            a, h, share = (1.0 if plain else 0.5) + level / 40, 1.2 + level / 200, 1.0
            if opponent:
                # the noise's share of a distance in opponent colours, as a part of that in three equal channels
                a, h, share = 0.8 * a, 1.15, math.sqrt((_OPPONENT**2).sum() / 3)
            h *= noise / a
            weights = patch(min(3 if ndim == 2 else 1, math.ceil(1.5 * a)), h, sigma=noise * share, a=a)
            default_lam = 1.0
    else:
        degree = 2.0 if p is None else p
        weights = constant() if weights is None else weights
        default_lam = 0.0
        if lam is None:
            default_lam = lam_rule(array, noise, degree, channel_axis=channel_axis, mask=mask, local=local)
        default_iterations = 3 if degree == 2 else 200  # at p = 2 more sweeps only blur
        if tol is None and max_iter is None and degree != 2:
            tol, reasons["tol"] = 1e-4, "rule"
    plan = DenoisePlan(
        sigma=noise if estimated or sigma is not None else None,
        estimated=estimated,
        weights=weights,
        p=2.0 if p is None else float(p),
        lam=default_lam if lam is None else lam,
        max_iter=default_iterations if max_iter is None else max_iter,
        tol=tol,
        eps=eps,
        opponent=opponent,
        reasons=reasons,
        **place,
    )
    if wish is None or plan.max_iter == 0:
        return plan
    pixels, inside = pixels_of(array, channel_axis, dtype), None if mask is None else np.asarray(mask)

    def denoise(y: npt.NDArray[Any], lam: float) -> npt.NDArray[Any]:
        one = replace(plan, lam=lam)
        return solve(one, y, inside, solver=solver, backend=backend, dtype=pixels.dtype, memory=memory).value

    white = 255.0 if array.dtype == np.uint8 else spread
    found, how = choose_lam(wish, denoise, pixels, sigma=noise, start=default_lam, data_range=white, inside=inside)
    return replace(plan, lam=found, reasons={**reasons, "lam": how})


def pixels_of(
    array: npt.NDArray[Any], channel_axis: int | None, dtype: npt.DTypeLike | None
) -> npt.NDArray[np.floating[Any]]:
    """An image as floats in the type to compute in, its channels last."""
    wide = array.dtype.kind in "iu" and array.dtype.itemsize > 2
    kind = np.dtype(dtype) if dtype is not None else np.dtype(np.float64 if wide else np.float32)
    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    return cells.astype(np.result_type(kind, np.float32), copy=False)


def solve(
    plan: DenoisePlan,
    pixels: npt.NDArray[Any],
    inside: npt.NDArray[np.bool_] | None,
    *,
    solver: str | Solver,
    callback: Callback | None = None,
    **settings: Any,
) -> Result:
    """Carry out a plan of one iteration or more on pixels (..., m).

    `settings` are the backend, dtype, memory and progress of :func:`gpureg.regularize`. One sweep at p = 2 with weights
    that need not be stored takes the way that stores none.
    """
    grid = GridGraph(pixels.shape[:-1], plan.radius, plan.metric, spacing=plan.spacing, mask=inside)
    f0 = pixels if inside is None or inside.all() else filled(pixels, inside)
    eps = default_eps(f0, plan.p) if plan.eps is None else plan.eps
    weights = weights_of(plan, f0)
    if callback is None and _is_one_sweep(plan, solver):
        return one_sweep(f0, grid, lam=plan.lam, weights=weights, eps=eps, **settings)
    return regularize(
        f0, grid, p=plan.p, lam=plan.lam, weights=weights, eps=eps, solver=solver, max_iter=plan.max_iter,
        tol=plan.tol, callback=callback, **settings,
    )  # fmt: skip


def _is_one_sweep(plan: DenoisePlan, solver: str | Solver) -> bool:
    """Whether :func:`one_sweep` does what the plan asks for: one sweep by the book, at p = 2, of patch weights."""
    method = resolve(solver)
    whole = isinstance(method, Jacobi) and method.damping in (None, 1)
    # where data are missing the default may be damped
    data = isinstance(method, Jacobi) and (method.damping == 1 or bool(np.min(plan.lam) > 0))
    once = plan.p == 2 and plan.max_iter == 1 and plan.tol is None
    return once and whole and data and patch_weights(plan.weights) is not None


def weights_of(plan: DenoisePlan, f0: npt.NDArray[Any]) -> Weights | npt.ArrayLike:
    """The plan's weights for the pixels `f0`, (..., m)."""
    if not (plan.opponent and isinstance(plan.weights, Weights)):
        return plan.weights
    guide = np.empty(f0.shape, f0.dtype)
    red, green, blue = np.moveaxis(f0, -1, 0)
    for c, (r, g, b) in enumerate(_OPPONENT.astype(f0.dtype)):
        # not a matrix product, whose order of sums may depend on where a pixel lies
        guide[..., c] = r * red + g * green + b * blue
    return Guided(plan.weights, guide.reshape(-1, 3))


def checked(image: npt.ArrayLike, channel_axis: int | None, mask: npt.ArrayLike | None) -> npt.NDArray[Any]:
    """`image` as an array, after checking values, axes and mask."""
    array = unmasked(image, "image")
    if array.dtype.kind not in "iuf":
        raise TypeError(f"image must hold integers or real numbers, got {array.dtype}")
    if channel_axis is not None and (isinstance(channel_axis, bool) or not isinstance(channel_axis, int | np.integer)):
        raise TypeError(f"channel_axis must be an integer, got {channel_axis!r}")
    if channel_axis is not None and not -array.ndim <= channel_axis < array.ndim:
        raise ValueError(f"channel_axis must lie in {-array.ndim}..{array.ndim - 1}, got {channel_axis}")
    cells = np.moveaxis(array, channel_axis, -1) if channel_axis is not None else array[..., None]
    if cells.ndim < 3:
        raise ValueError(f"image must have two or more axes besides the channels, got shape {array.shape}")
    if not array.size:
        raise ValueError(f"image is empty, shape {array.shape}")
    if mask is not None:
        inside = np.asarray(mask)
        if inside.dtype != np.bool_ or inside.shape != cells.shape[:-1]:
            raise ValueError(
                f"mask must be boolean of shape {cells.shape[:-1]}, got {inside.dtype} of shape {inside.shape}"
            )
        cells = cells[inside]
    if not all_finite(cells):
        bad = cells[~np.isfinite(cells)]
        raise ValueError(f"image must be finite, got {bad[0]} at {len(bad)} place(s); a mask can leave them out")
    return array


def filled(f0: npt.NDArray[Any], inside: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
    """`f0` with pixels outside the mask replaced by the nearest inside, so that patches over them mean something."""
    from scipy import ndimage

    if not inside.any():
        return np.zeros_like(f0)
    nearest = ndimage.distance_transform_edt(~inside, return_distances=False, return_indices=True)
    spread: npt.NDArray[Any] = f0[tuple(nearest)]
    return spread


def _contrast(array: npt.NDArray[Any], channel_axis: int | None, mask: npt.ArrayLike | None) -> float:
    """Range of the image without its noise: of a Gaussian-smoothed copy, over all channels."""
    from scipy import ndimage

    cells = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    kind: Any = np.float64 if array.dtype.itemsize > 4 else np.float32
    if mask is not None:
        cells = filled(cells.astype(kind), np.asarray(mask))
    # Bands of rows with the filter's reach around them: the same values in little memory.
    spread, reach = 2.0, 8
    band = max(1, _BAND // max(1, cells[0].size))
    low, high = math.inf, -math.inf
    for first in range(0, len(cells), band):
        start, end = max(0, first - reach), min(len(cells), first + band + reach)
        part: Any = cells[start:end].astype(kind, copy=False)
        smooth = ndimage.gaussian_filter(part, (spread,) * (cells.ndim - 1) + (0.0,))[first - start :][:band]
        low, high = min(low, float(smooth.min())), max(high, float(smooth.max()))
    return high - low
