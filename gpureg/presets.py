"""Filters with the parameters and results of OpenCV, scikit-image and gputools.

The Notes of each function give the difference to the original, which ``tests/images/test_presets.py`` checks. In terms
of the paper's w1 and w2, with lam = 2 (weight 1 for the pixel itself), the filters are

==================  =============================================================================
OpenCV's bilateral  sigma_X^2 = 2 sigmaColor^2, sigma_P^2 = 2 sigmaSpace^2, disk, "reflect"
OpenCV's NLM        flat patch of s = side^2 pixels, h^2 = s H^2, "reflect", weights under 0.001 are 0
scikit-image's NLM  (slow mode) Gaussian patch a = (side - 1)/4, h = H, "clip", weights under exp(-5) are 0
gputools            w1 unchanged, square, "nearest"; flat patch, h^2 = s H^2, "nearest"
==================  =============================================================================
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .checks import integer, number
from .doors import door
from .images.bilateral import denoise_bilateral
from .images.nl_means import denoise_nl_means
from .images.raster import Raster

__all__ = ["gputools_bilateral", "gputools_nl_means", "opencv_bilateral", "opencv_nl_means", "skimage_nl_means"]

# Weights below which OpenCV and scikit-image use 0.
_OPENCV_CUT, _SKIMAGE_CUT = 1e-3, math.exp(-5)


@door
def opencv_bilateral(
    image: npt.ArrayLike, d: int, sigma_color: float, sigma_space: float, **settings: Any
) -> npt.NDArray[Any]:
    """Filter a grey image as OpenCV's ``bilateralFilter(src, d, sigmaColor, sigmaSpace)``, border reflect-101.

    Parameters
    ----------
    image : (H, W) array
        Any type; OpenCV has 8 bits and float32.
    d : int
        Diameter of the window, a disk; if it is not positive, it is computed from `sigma_space`.
    sigma_color, sigma_space : float
        Standard deviations. If one is not above 1.2e-7 the image does not change, as in OpenCV 5.
    **settings
        backend, dtype, mask and other options of :func:`gpureg.denoise_bilateral`.

    Returns
    -------
    array
        In the shape and dtype of `image`.

    Raises
    ------
    ValueError
        An image with channels. OpenCV adds the absolute differences of colours, unlike the weights of the paper;
        :func:`gpureg.denoise_bilateral` compares colours by their Euclidean distance.

    Notes
    -----
    The difference to OpenCV is at most 1e-5 of the range on float32, and one grey level on 8 bits.
    """
    d, sigma_color, sigma_space = (
        integer("d", d),
        number("sigma_color", sigma_color, finite=False),
        number("sigma_space", sigma_space, finite=False),
    )
    _only_grey(image, settings, "bilateralFilter adds up the absolute differences of the channels")
    if min(sigma_color, sigma_space) <= np.finfo(np.float32).eps:
        return Raster.of(image).values.copy()
    radius = max(round(sigma_space * 1.5) if d <= 0 else d // 2, 1)
    return denoise_bilateral(
        image,
        radius=radius,
        metric="euclidean",
        sigma_space=math.sqrt(2) * sigma_space,
        sigma_value=math.sqrt(2) * sigma_color,
        border="reflect",
        **settings,
    )


@door
def opencv_nl_means(
    image: npt.ArrayLike,
    h: float = 3,
    template_window_size: int = 7,
    search_window_size: int = 21,
    *,
    channel_axis: int | None = None,
    **settings: Any,
) -> npt.NDArray[Any]:
    """Denoise as OpenCV's ``fastNlMeansDenoising(src, None, h, templateWindowSize, searchWindowSize)``.

    Parameters
    ----------
    image : array
        Any type; OpenCV has 8 bits.
    h : float, default 3
        Filtering parameter of the root mean square difference of patches.
    template_window_size, search_window_size : int, default 7 and 21
        Sides of patch and window; an even value means the next odd one.
    channel_axis : int, optional
        The axis of the channels; OpenCV has 1 to 4 channels.
    **settings
        backend, dtype, mask and other options of :func:`gpureg.denoise_nl_means`.

    Returns
    -------
    array
        In the shape and dtype of `image`.

    Notes
    -----
    The difference to OpenCV is at most one grey level on 8-bit images. OpenCV rounds distances to steps of 64/49 and
    weights to steps of 1/19,000, which changes the result by less than one level.
    """
    h = number("h", h, above=0)
    patch = integer("template_window_size", template_window_size, low=1) // 2
    search = integer("search_window_size", search_window_size, low=2) // 2
    return denoise_nl_means(
        image,
        patch_radius=patch,
        radius=search,
        h=_flat(image, h, patch, channel_axis),
        cut=_OPENCV_CUT,
        border="reflect",
        channel_axis=channel_axis,
        **settings,
    )


@door
def skimage_nl_means(
    image: npt.ArrayLike,
    patch_size: int = 7,
    patch_distance: int = 11,
    h: float = 0.1,
    sigma: float = 0.0,
    *,
    channel_axis: int | None = None,
    **settings: Any,
) -> npt.NDArray[Any]:
    """Denoise as scikit-image's ``denoise_nl_means(..., fast_mode=False, preserve_range=True)``.

    Parameters
    ----------
    image : array
        Two or three axes, not counting the channels.
    patch_size, patch_distance : int, default 7 and 11
        Side of a patch (an even value means the next odd one), and radius of the window.
    h, sigma : float, default 0.1 and 0
        Filtering parameter and noise, as in scikit-image.
    channel_axis : int, optional
    **settings
        backend, dtype, mask and other options of :func:`gpureg.denoise_nl_means`.

    Returns
    -------
    array
        In the shape and dtype of `image`.

    Notes
    -----
    scikit-image approximates the exponential by shifting bits, with an error of some percent.
    """
    radius = integer("patch_size", patch_size, low=0) // 2
    h = number("h", h, above=0)
    _, channels = axes_and_channels(image, channel_axis)
    return denoise_nl_means(
        image,
        patch_radius=radius,
        radius=integer("patch_distance", patch_distance, low=1),
        h=h * math.sqrt(channels),
        patch_sigma=(2 * radius) / 4 if radius else None,
        sigma=sigma,
        cut=_SKIMAGE_CUT,
        channel_axis=channel_axis,
        **settings,
    )


@door
def gputools_bilateral(
    image: npt.ArrayLike, size_filter: int, sigma_p: float, sigma_x: float = 10.0, **settings: Any
) -> npt.NDArray[Any]:
    """Filter as gputools' ``bilateral2(data, fSize, sigma_p, sigma_x)`` and ``bilateral3``: the paper's w1.

    Parameters
    ----------
    image : array of 2 or 3 axes
        Any type; gputools has float32.
    size_filter : int
        Radius of the square window.
    sigma_p, sigma_x : float
        Widths of the Gaussians of values and of distances, without the factor 1/2.
    **settings
        backend, dtype, mask and other options of :func:`gpureg.denoise_bilateral`.

    Returns
    -------
    array
        In the shape and dtype of `image`.

    Notes
    -----
    The difference to gputools is at most 1e-5 of the range on float32.
    """
    radius = integer("size_filter", size_filter, low=1)
    sigma_p, sigma_x = number("sigma_p", sigma_p, above=0), number("sigma_x", sigma_x, above=0, finite=False)
    return denoise_bilateral(
        image, radius=radius, sigma_space=sigma_x, sigma_value=sigma_p, border="nearest", **settings
    )


@door
def gputools_nl_means(
    image: npt.ArrayLike, sigma: float, size_filter: int = 2, size_search: int = 3, **settings: Any
) -> npt.NDArray[Any]:
    """Denoise as gputools' ``nlm2(data, sigma, size_filter, size_search)`` and ``nlm3``.

    Parameters
    ----------
    image : array of 2 or 3 axes
        Any type; gputools has float32.
    sigma : float
        Filtering parameter of the root mean square difference of patches.
    size_filter, size_search : int, default 2 and 3
        Radii of patch and window.
    **settings
        backend, dtype, mask and other options of :func:`gpureg.denoise_nl_means`.

    Returns
    -------
    array
        In the shape and dtype of `image`.

    Notes
    -----
    The difference to gputools is at most 1e-5 of the range on float32, further than size_filter + size_search from the
    border. Nearer, gputools repeats the edge of its distance maps instead of computing distances across the border.
    """
    sigma, size_filter = number("sigma", sigma, above=0), integer("size_filter", size_filter, low=0)
    return denoise_nl_means(
        image,
        patch_radius=size_filter,
        radius=integer("size_search", size_search, low=1),
        h=_flat(image, sigma, size_filter, None),
        border="nearest",
        **settings,
    )


def axes_and_channels(image: npt.ArrayLike, channel_axis: int | None) -> tuple[int, int]:
    """Return the number of axes of an image's grid, and of its channels."""
    shape = np.shape(image)
    if channel_axis is None:
        return len(shape), 1
    return len(shape) - 1, shape[integer("channel_axis", channel_axis, low=-len(shape), high=len(shape) - 1)]


def _flat(image: npt.ArrayLike, H: float, patch_radius: int, channel_axis: int | None) -> float:
    """Return the h of w2 for a parameter H of the root mean square difference of flat patches."""
    axes, channels = axes_and_channels(image, channel_axis)
    return H * math.sqrt(channels * (2 * patch_radius + 1) ** axes)


def _only_grey(image: npt.ArrayLike, settings: dict[str, Any], why: str) -> None:
    if np.ndim(image) != 2 or settings.get("channel_axis") is not None:
        raise ValueError(f"image must be grey, shape (H, W): {why}; see denoise_bilateral")
