"""What to do with a noisy image: :func:`plan_denoising` chooses, the noise decides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .graph import GridGraph, Metric, all_finite, unmasked
from .noise import estimate_noise
from .rule import nonlocal_rule
from .weights import Bilateral, Compared, Constant, Patch, Smoothed, Weights, constant, guided

Centre = Literal["once", "largest", "none"]
CENTRES: tuple[Centre, ...] = ("once", "largest", "none")
AveragePatches = bool | Literal["weighted"]

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
    spacing : tuple of float or None
        Size of a pixel along each axis, None where the window is one of cells.
    window : tuple of int
        Sides of the neighbourhood in cells.
    centre : {"once", "largest", "none"}
        What lam = 2 makes of a pixel's own value in one sweep at p = 2: weight 1, the largest weight around it, or none
        (lam is 0 then).
    average_patches : bool or "weighted"
        Whether each patch is estimated as a whole, and a pixel is the mean over all patches that cover it; "weighted"
        counts a patch by the sum of the weights it found.
    average_radius : int or None
        Radius of these patches; None for that of the weights' patches.
    nearest : int or None
        Edges kept of each pixel, those to the nearest patches; None for the whole window.
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
    spacing: tuple[float, ...] | None = None
    window: tuple[int, ...] = ()
    centre: Centre = "once"
    average_patches: AveragePatches = False
    average_radius: int | None = None
    nearest: int | None = None

    def describe(self) -> str:
        """The plan in one line."""
        if self.max_iter == 0:
            found = np.ndim(self.lam) == 0 and self.lam == math.inf
            return "nothing to do: no noise was found" if found else "nothing to do: 0 iterations"
        w: Any = self.weights
        seen = ""
        while isinstance(w, Compared):
            if isinstance(w, Smoothed):
                seen = (", opponent colours" if w.opponent else "") + f", blurred by {w.std:.2g}" * (w.std > 0)
            w = w.weights
        window = "x".join(map(str, self.window)) + " window"
        if self.metric != "chebyshev":
            window = (
                f"{2 * len(self.window)} neighbours"
                if self.metric == "cityblock" and max(self.window) <= 3
                else f"{window} ({self.metric})"
            )
        if isinstance(w, Patch):
            shape = "flat" if w.a is None else f"Gaussian (a = {w.a:.3g})"
            patches = "x".join([str(2 * w.radius + 1)] * len(self.window)) + f" {shape} patches"
            kind = f"nonlocal weights{seen}, {window}, {patches}, h = {w.h:.4g}"
            kind += ", averaged patches" if self.average_patches else ""
            kind += f", {self.nearest} nearest" if self.nearest else ""
        elif isinstance(w, Bilateral):
            kind = f"bilateral weights, {window}, sigma_space = {w.sigma_space:.4g}"
            kind += f", sigma_value = {w.sigma_value:.4g}"
        elif isinstance(w, Constant):
            kind = f"constant weights, {window}"
        else:
            kind = f"{type(w).__name__} weights, {window}"
        lam = f"{float(self.lam):.4g}" if np.ndim(self.lam) == 0 else "a map"  # type: ignore[arg-type]
        lam += " of the largest weight" if self.centre == "largest" else ""
        iterations = "1 iteration" if self.max_iter == 1 else f"at most {self.max_iter} iterations"
        return f"{kind}; p = {self.p:g}, lam = {lam}, {iterations}"


def plan_denoising(
    image: npt.ArrayLike,
    *,
    sigma: float | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    max_iter: int | None = None,
    tol: float | None = None,
    eps: float | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
) -> DenoisePlan:
    """Choose what :func:`denoise_image` would do; the parameters are the same, and what is given is kept.

    Raises
    ------
    TypeError, ValueError
        As :func:`denoise_image`.

    Notes
    -----
    The noise decides. With nothing else given, one sweep of nonlocal means (p = 2) over a 15 x 15 window, in a volume
    5 x 5 x 5, whose weights compare a copy blurred by half a pixel: :func:`gpureg.rule.nonlocal_rule` says which.
    With p other than 2, the unweighted graph G_0 of nearest neighbours (p = 1:
    digital total variation) with lam = 2.2 sigma^(p - 2), which follows the scale law of the model; 2.2 was best on the
    camera picture for p = 1 and 1.5.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.random.default_rng(7).normal(0.5, 0.1, (64, 64))
    >>> plan_denoising(image, p=1, sigma=0.1).describe()
    'constant weights, 4 neighbours; p = 1, lam = 22, at most 200 iterations'
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
    cells = array.shape if channel_axis is None else tuple(np.delete(array.shape, channel_axis).tolist())
    ndim = len(cells)
    # Without weights that look at the data a wide window only blurs: the paper's G_0.
    local = isinstance(weights, Constant) or (weights is None and p not in (None, 2))
    # What decides nothing is not looked for: it takes longer than the one step of a filter.
    filters = not local and p in (None, 2)
    chooses = weights is None and (lam is None or not local)
    estimated = sigma is None and (chooses or (lam is None and not filters))
    noise = 0.0 if sigma is None else float(sigma)
    if estimated:
        noise = estimate_noise(array, channel_axis=channel_axis, mask=mask)
    spread = _contrast(array, channel_axis, mask) if chooses else 1.0
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
    average_radius: int | None = None
    # Half a grey level: what rounding alone may add.
    negligible = noise < (0.5 if array.dtype.kind in "iu" else 0.5 / 255 * spread) or noise == 0
    if chooses and negligible and (estimated or noise == 0):
        degree = 2.0 if p is None else float(p)
        return DenoisePlan(noise, estimated, constant(), p=degree, lam=math.inf, max_iter=0, tol=tol, eps=eps, **place)
    if filters:
        # lam = 2: the centre counted once
        default_lam, default_iterations = 2.0, 1
        if weights is None:
            weights, default_lam, average_radius = nonlocal_rule(noise, spread, channels, ndim)
            if max_iter not in (None, 1) or tol is not None:
                average_radius = None  # patches are averaged after one sweep alone
    else:
        degree = 2.0 if p is None else p
        if lam is None and noise == 0:
            raise ValueError("without noise there is nothing to choose lam from: give it")
        weights = constant() if weights is None else weights
        default_lam = 2.2 * noise ** (degree - 2) if noise else 0.0
        default_iterations = 3 if degree == 2 else 200  # at p = 2 more sweeps only blur
        if tol is None and max_iter is None and degree != 2:
            tol = 1e-4
    return DenoisePlan(
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
        **place,
    )


def guided_by(
    weights: Weights | npt.ArrayLike, guide: npt.ArrayLike, grid: GridGraph, channel_axis: int | None
) -> Weights:
    """A weight function that compares a guide: an image of the grid's shape, or with channels as the image has them.

    Raises
    ------
    TypeError, ValueError
        No weight function, or a guide of another shape, or not of finite numbers.
    """
    if not isinstance(weights, Weights):
        raise TypeError("a guide needs weights that are computed from it, such as gpureg.weights.bilateral(...)")
    array = unmasked(guide, "guide")
    axis = -1 if channel_axis is None else channel_axis
    cells = array[..., None] if array.ndim == grid.ndim else np.moveaxis(array, axis, -1) if array.ndim else array
    if cells.shape[:-1] != grid.shape or array.dtype.kind not in "biuf":
        raise ValueError(
            f"guide must hold numbers on the image's {grid.shape} pixels, with channels or without; "
            f"got {array.dtype} of shape {array.shape}"
        )
    values: npt.NDArray[Any] = cells.astype(np.float64)
    if grid.mask is not None and not grid.mask.all():
        values = filled(values, grid.mask)
    if isinstance(weights, Smoothed) and weights.opponent and values.shape[-1] != 3:
        weights = replace(weights, opponent=False)
    return guided(weights, values.reshape(grid.n_vertices, -1))


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
