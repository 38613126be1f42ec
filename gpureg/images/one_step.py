"""The doors for image filters people know: :func:`denoise_nl_means`, :func:`denoise_bilateral`, :func:`denoise_tv`.

Nonlocal means and the bilateral filter are one step of the model at p = 2, total variation is p = 1 on the graph G_0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .borders import cropped, expect_border, padded
from .graphs.edges import Metric
from .graphs.grid import GridGraph
from .image import denoise_image, run_plan
from .noise.white import estimate_noise
from .pixels import checked
from .plan import CENTRES, AveragePatches, Centre, DenoisePlan
from .solvers import Jacobi
from .weights import Weights, bilateral, patch


def denoise_nl_means(
    image: npt.ArrayLike,
    *,
    patch_radius: int = 2,
    radius: float | None = None,
    h: float | npt.ArrayLike | None = None,
    a: float | None = None,
    sigma: float | npt.ArrayLike = 0.0,
    lam: float | npt.ArrayLike = 2.0,
    centre: Centre = "once",
    average_patches: AveragePatches = False,
    average_radius: int | None = None,
    cut: float = 0.0,
    metric: Metric = "chebyshev",
    border: str = "clip",
    constant: float = 0.0,
    guide: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    progress: bool = False,
    memory: int | None = None,
) -> npt.NDArray[Any]:
    """Nonlocal means: every pixel becomes the mean of those of its window whose surroundings look alike.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), besides the channels; any integer or real type.
    patch_radius : int, default 2
        Patches are squares of 2 patch_radius + 1 pixels a side.
    radius : float, optional
        Reach of the window, in the units of `spacing`; None takes 7 of the smallest cells, 2 in a volume.
    h : float or array, optional
        Filtering parameter > 0, or one per pixel (then h(u) h(v) stands for h^2): in the image's units times the square
        root of the sum of g and of the number of channels. None takes 0.6 of the noise times that root; where
        `sigma` is 0, the noise is estimated, and its share taken off the distances as if it had been given.
    a : float, optional
        Standard deviation, in pixels, of a Gaussian patch g_a that sums to 1. None: the flat patch, g = 1.
    sigma : float or array, default 0
        Standard deviation of the noise, or one per pixel: its share 2 sigma^2 is taken off each squared difference.
    lam : float or array, default 2
        Twice the weight of the pixel itself, in the units that `centre` says; infinity keeps a pixel.
    centre : {"once", "largest", "none"}, default "once"
        Whether lam = 2 counts the pixel itself with weight 1, with the largest weight of its neighbours, or not at all.
    average_patches : bool or "weighted", default False
        Estimate whole patches, and average at each pixel the estimates of all patches that cover it: less noise left
        around edges and in rare places. "weighted" counts a patch by the sum of the weights it found, so that one that
        found nothing alike does not speak for its neighbours.
    average_radius : int, optional
        Radius of the patches that are averaged; None takes `patch_radius`.
    cut : float, default 0
        Weights below it count as 0.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        Window: square, disk or diamond.
    border : {"clip", "reflect", "symmetric", "nearest", "wrap", "constant"}, default "clip"
        What a window that reaches over the border sees: nothing, the image mirrored without its edge pixel or
        with it, the edge pixel again, the other end, or `constant`. With "clip" patches alone are filled by reflection.
    constant : float, default 0
        The value beyond the border for "constant".
    guide : array, optional
        What the patches compare instead of `image`.
    mask : bool array, optional
        True where a pixel takes part; the others, which may be NaN, come back as they are.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        Axis of the channels, which are compared and averaged together.
    backend, dtype, progress, memory
        As in :func:`gpureg.denoise_image`.

    Returns
    -------
    array
        In the shape and dtype of `image`; integers are rounded and clipped.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable
        A backend or device that is not there.

    Notes
    -----
    f(u) = (lam/2 f0(u) + sum_v w2(u, v) f0(v)) / (lam/2 + sum_v w2(u, v)) with w2(u, v) = exp(-rho(u, v)/h^2), eq. 25
    at p = 2 with the weights of section 5.2; Buades, Coll, Morel (SIAM MMS 4(2), 2005; IPOL 2011 for averaged patches,
    which they call patchwise). With the H of OpenCV and scikit-image, h^2 = C s H^2 for flat patches of s pixels and C
    channels.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((16, 16)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> denoised = gr.denoise_nl_means(noisy, h=0.3, sigma=0.1, backend="numpy")
    >>> bool(np.std(denoised - clean) < 0.4 * np.std(noisy - clean))
    True
    """
    array = checked(image, channel_axis, mask)
    shape = _cells(array, channel_axis)
    if centre not in CENTRES:
        raise ValueError(f"centre must be one of {', '.join(CENTRES)}, got {centre!r}")
    if not (isinstance(average_patches, bool | np.bool_) or average_patches == "weighted"):
        raise ValueError(f"average_patches must be True, False or 'weighted', got {average_patches!r}")
    averaged = patch_radius if average_radius is None else average_radius
    patch(averaged, 1.0)  # a radius as a patch's is
    if radius is None:
        finest, coarsest = _cell_sizes(spacing)
        radius = max((7 if len(shape) == 2 else 2) * finest, coarsest)
    # The weight function's own checks come first; a map is checked on its own shape.
    sigmas = _map("sigma", sigma, shape)
    patch(patch_radius, 1.0, sigma=sigmas if np.ndim(sigmas) == 0 else np.ravel(sigmas), a=a, cut=cut)
    if h is None:
        noise = float(np.sqrt(np.mean(np.square(sigmas))))
        if noise == 0:
            noise = estimate_noise(array, channel_axis=channel_axis, mask=mask)
            sigmas = noise
        channels = array.size // max(1, math.prod(shape))
        samples = (2 * patch_radius + 1) ** len(shape) if a is None else 1
        h = 0.6 * noise * math.sqrt(samples * channels)
        if h == 0:
            return array.copy()  # no noise was found
    bandwidths = _map("h", h, shape)
    maps = {"h": bandwidths, "sigma": sigmas, "lam": 0.0 if centre == "none" else _map("lam", lam, shape)}
    return _one_step(
        array,
        lambda maps: patch(patch_radius, maps["h"], sigma=maps["sigma"], a=a, cut=cut),
        maps,
        reach=patch_radius,
        radius=radius,
        centre=centre,
        average_patches=average_patches,
        averaged=int(averaged),
        metric=metric,
        border=border,
        constant=constant,
        guide=guide,
        mask=mask,
        spacing=spacing,
        channel_axis=channel_axis,
        run={"backend": backend, "dtype": dtype, "progress": progress, "memory": memory},
    )


def denoise_bilateral(
    image: npt.ArrayLike,
    *,
    radius: float | None = None,
    sigma_space: float = 3.0,
    sigma_value: float | npt.ArrayLike | None = None,
    lam: float | npt.ArrayLike = 2.0,
    centre: Centre = "once",
    metric: Metric = "chebyshev",
    border: str = "clip",
    constant: float = 0.0,
    guide: npt.ArrayLike | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    progress: bool = False,
    memory: int | None = None,
) -> npt.NDArray[Any]:
    """The bilateral filter: every pixel becomes the mean of those nearby whose values are alike.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), besides the channels; any integer or real type.
    radius : float, optional
        Reach of the window, in the units of `spacing`; None takes 2 sigma_space, where the spatial factor is 0.02.
    sigma_space : float, default 3
        sigma_P of w1, in the units of `spacing`; sqrt(2) times that of OpenCV and scikit-image.
    sigma_value : float or array, optional
        sigma_X of w1, in the image's units, or one per pixel (then sigma_X(u) sigma_X(v) stands for its square);
        likewise. None takes 3 times the noise, and sqrt(C) times that for C channels.
    lam, centre, metric, border, constant, mask, spacing, channel_axis, backend, dtype, progress, memory
        As in :func:`denoise_nl_means`.
    guide : array, optional
        What the weights compare instead of `image`: the joint or cross bilateral filter.

    Returns
    -------
    array
        In the shape and dtype of `image`; integers are rounded and clipped.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable
        A backend or device that is not there.

    Notes
    -----
    f(u) = (lam/2 f0(u) + sum_v w1(u, v) f0(v)) / (lam/2 + sum_v w1(u, v)), eq. 25 at p = 2 with
    w1(u, v) = exp(-|u - v|^2/sigma_P^2) exp(-|f0(u) - f0(v)|^2/sigma_X^2) of section 5.2.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1) + np.zeros((8, 1))
    >>> gr.denoise_bilateral(step, sigma_value=0.1, backend="numpy")[0].round(3)
    array([0., 0., 0., 0., 1., 1., 1., 1.])
    """
    array = checked(image, channel_axis, mask)
    shape = _cells(array, channel_axis)
    if centre not in CENTRES:
        raise ValueError(f"centre must be one of {', '.join(CENTRES)}, got {centre!r}")
    bilateral(sigma_space, 1.0)
    if radius is None:
        finest, coarsest = _cell_sizes(spacing)
        radius = max(2 * sigma_space if math.isfinite(sigma_space) else 7 * finest, coarsest)
    if sigma_value is None:
        channels = array.size // max(1, math.prod(shape))
        sigma_value = 3 * estimate_noise(array, channel_axis=channel_axis, mask=mask) * math.sqrt(channels)
        if sigma_value == 0:
            return array.copy()  # no noise was found
    maps = {
        "sigma_value": _map("sigma_value", sigma_value, shape),
        "lam": 0.0 if centre == "none" else _map("lam", lam, shape),
    }
    return _one_step(
        array,
        lambda maps: bilateral(sigma_space, maps["sigma_value"]),
        maps,
        reach=0,
        radius=radius,
        centre=centre,
        average_patches=False,
        averaged=0,
        metric=metric,
        border=border,
        constant=constant,
        guide=guide,
        mask=mask,
        spacing=spacing,
        channel_axis=channel_axis,
        run={"backend": backend, "dtype": dtype, "progress": progress, "memory": memory},
    )


def denoise_tv(
    image: npt.ArrayLike,
    *,
    lam: float | npt.ArrayLike | None = None,
    sigma: float | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    **settings: Any,
) -> npt.NDArray[Any]:
    """Total variation on the pixels' graph: flat regions, sharp edges.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), besides the channels; any integer or real type.
    lam : float or array, optional
        Fidelity >= 0 in units of 1 over the image's, or one value per pixel: larger stays closer to the image (the
        inverse of scikit-image's `weight`). None chooses it from the noise.
    sigma : float, optional
        Standard deviation of the noise; None estimates it where `lam` is None.
    weights : Weights or array, optional
        As in :func:`gpureg.denoise_image`; None means 1 between the nearest neighbours, the paper's G_0.
    **settings
        All else that :func:`gpureg.denoise_image` takes, but `p`.

    Returns
    -------
    array
        In the shape and dtype of `image`; integers are rounded and clipped.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    Minimises sum_u |grad_w f(u)| + lam/2 sum_u |f(u) - f0(u)|^2 by eq. 31 at p = 1: the digital TV filter of Chan,
    Osher and Shen (IEEE TIP 10(2), 2001). |grad_w f(u)| sees all neighbours of u, on either side, where the usual
    discrete total variation takes forward differences.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((16, 16)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> denoised = gr.denoise_tv(noisy, lam=15, backend="numpy")
    >>> bool(np.std(denoised - clean) < 0.5 * np.std(noisy - clean))
    True
    """
    if "p" in settings:
        raise TypeError("denoise_tv is denoise_image at p = 1: call that one for another p")
    return denoise_image(image, p=1.0, lam=lam, sigma=sigma, weights=weights, **settings)


def _cells(array: npt.NDArray[Any], channel_axis: int | None) -> tuple[int, ...]:
    """The shape of the pixels' grid."""
    shape = array.shape
    return shape if channel_axis is None else tuple(np.delete(shape, channel_axis).tolist())


def _cell_sizes(spacing: Sequence[float] | None) -> tuple[float, float]:
    """The smallest and the largest side of a cell; of a spacing that is none the grid will tell."""
    if spacing is None or np.ndim(spacing) != 1 or not len(spacing):
        return 1.0, 1.0
    return float(min(spacing)), float(max(spacing))


def _map(name: str, value: float | npt.ArrayLike, shape: tuple[int, ...]) -> Any:
    """A parameter: a number as it came, or an array of one value per pixel."""
    if np.ndim(value) == 0:
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be a number or an array of them, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"{name} must be a number or one value per pixel, shape {shape}; got shape {array.shape}")
    return array


def _one_step(
    array: npt.NDArray[Any],
    weights: Any,
    maps: dict[str, Any],
    *,
    reach: int,
    radius: float,
    centre: Centre,
    average_patches: AveragePatches,
    averaged: int,
    metric: Metric,
    border: str,
    constant: float,
    guide: npt.ArrayLike | None,
    mask: npt.ArrayLike | None,
    spacing: Sequence[float] | None,
    channel_axis: int | None,
    run: dict[str, Any],
) -> npt.NDArray[Any]:
    """One sweep at p = 2 with the weight function that `weights` makes of the maps, beyond borders of any kind."""
    beyond = expect_border(border)
    shape = _cells(array, channel_axis)
    grid = GridGraph(shape, radius, metric, spacing=spacing)
    cells = array if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    axis = None if channel_axis is None else -1
    compared = None
    if guide is not None:
        compared = np.asarray(guide)
        if channel_axis is not None and compared.ndim == array.ndim:
            compared = np.moveaxis(compared, channel_axis, -1)
    # So far that neither a window nor the patches in it end inside what is kept.
    widths = (0,) * grid.ndim
    if beyond != "clip":
        steps = np.array(grid.spacing or (1.0,) * grid.ndim)
        beside = reach + (averaged if average_patches else 0)
        if not math.isfinite(radius):
            raise ValueError(
                f"an infinite window needs border='clip', got {border!r}: beyond the border there is no end"
            )
        widths = tuple((np.floor(radius / steps + 1e-9).astype(int) + beside).tolist())
        cells = padded(cells, widths, beyond, constant)
        repeated = "nearest" if beyond == "constant" else beyond
        maps = {name: x if np.ndim(x) == 0 else padded(np.asarray(x), widths, repeated) for name, x in maps.items()}
        mask = None if mask is None else padded(np.asarray(mask), widths, beyond, True)
        compared = None if compared is None else padded(compared, widths, beyond, constant)
    plan = DenoisePlan(
        sigma=None,
        estimated=False,
        weights=weights({name: x if np.ndim(x) == 0 else np.ravel(x) for name, x in maps.items()}),
        radius=float(radius),
        metric=metric,
        p=2.0,
        lam=maps["lam"],
        max_iter=1,
        spacing=grid.spacing,
        centre=centre,
        average_patches=average_patches,
        average_radius=averaged,
    )
    # lam = 0 is the plain sweep, whatever the graph: a step is no iteration that could swing
    result = run_plan(plan, cells, solver=Jacobi(damping=1), guide=compared, mask=mask, channel_axis=axis, **run).value
    kept = cropped(result, widths)
    return kept if channel_axis is None else np.ascontiguousarray(np.moveaxis(kept, -1, channel_axis))
