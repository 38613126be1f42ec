"""Denoisers with the names and signatures of scikit-image: change one import.

    from gpureg.skimage import denoise_nl_means, denoise_bilateral, denoise_tv_chambolle

As in scikit-image, integer images become floats in 0..1 (unless `preserve_range`), parameters are in these units, and
images of float64, which integers become too, are computed in float64 (`dtype` can say float32, which is faster).
Where scikit-image's code differs from its documentation, these functions follow the documentation; see their Notes.
"""

from __future__ import annotations

import math
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from . import presets
from .checks import choice, flag, integer, number
from .doors import door
from .images.bilateral import denoise_bilateral as _bilateral
from .images.borders import Border
from .images.nl_means import denoise_nl_means as _nl_means
from .images.total_variation import denoise_tv as _tv
from .regularization.options import RUN, Run
from .solvers import Check
from .solvers.loop import Callback

__all__ = ["denoise_bilateral", "denoise_nl_means", "denoise_tv_chambolle"]

# Names of borders in numpy.pad and scikit-image, and in gpureg.
_BORDERS: dict[str, Border] = {
    "constant": "constant",
    "edge": "nearest",
    "symmetric": "symmetric",
    "reflect": "reflect",
    "wrap": "wrap",
}


def _as_float(image: npt.ArrayLike, preserve_range: bool = False) -> npt.NDArray[Any]:
    """Convert to float as ``skimage.util.img_as_float`` does: integers are divided by the largest value of the type."""
    array = np.asarray(image)
    if array.dtype.kind == "f":
        return array.astype(np.float32) if array.dtype == np.float16 else array
    if array.dtype.kind == "b" or preserve_range:
        return array.astype(np.float64)
    if array.dtype.kind not in "iu":
        raise TypeError(f"image must hold integers or real numbers, got {array.dtype}")
    scaled: npt.NDArray[np.float64] = array / np.float64(np.iinfo(array.dtype).max)
    return np.maximum(scaled, -1.0)


def _as_precise(array: npt.NDArray[Any], options: Run) -> Run:
    """Return the options with float64 as the type to compute in, if none is given, for an image of float64."""
    if options.get("dtype") is None and array.dtype.itemsize > 4:
        return {**options, "dtype": np.float64}
    return options


@door(options=RUN)
def denoise_nl_means(
    image: npt.ArrayLike,
    patch_size: int = 7,
    patch_distance: int = 11,
    h: float = 0.1,
    fast_mode: bool = True,
    sigma: float = 0.0,
    *,
    preserve_range: bool = False,
    channel_axis: int | None = None,
    **options: Unpack[Run],
) -> npt.NDArray[Any]:
    """Denoise an image as ``skimage.restoration.denoise_nl_means``, on any device.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels; scikit-image has a limit in its slow mode.
    patch_size, patch_distance : int, default 7 and 11
        Side of a patch (an even value means the next odd one), and radius of the window.
    h : float, default 0.1
        Cut-off of the root mean square difference of patches.
    fast_mode : bool, default True
        True means flat patches, False Gaussian ones of standard deviation (patch_size - 1)/4.
    sigma : float, default 0
        Standard deviation of the noise: 2 sigma^2 is subtracted from each squared difference.
    preserve_range : bool, default False
        Do not scale integers to 0..1.
    channel_axis : int, optional
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.denoise_image`.

    Returns
    -------
    float array
        In the shape of `image`.

    Raises
    ------
    ValueError, TypeError
        As :func:`gpureg.denoise_nl_means`.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    scikit-image documents patches of patch_size x patch_size, but its fast mode sums (patch_size - 1)^2 pixels, off
    centre, and divides by patch_size^2 (issue #5177 asks why the modes differ); here the patch is complete. Its slow
    mode approximates the exponential; here it is exact. In both libraries the fast mode pads by reflection and averages
    padded pixels too; the slow mode does not.
    """
    array = _as_float(image, flag("preserve_range", preserve_range))
    h = number("h", h, above=0)
    if not flag("fast_mode", fast_mode):
        return presets.skimage_nl_means(
            array, patch_size, patch_distance, h, sigma, channel_axis=channel_axis, **options
        )
    radius = integer("patch_size", patch_size, low=0) // 2
    axes, channels = presets.axes_and_channels(array, channel_axis)
    return _nl_means(
        array,
        patch_radius=radius,
        radius=integer("patch_distance", patch_distance, low=1),
        h=h * math.sqrt(channels * (2 * radius + 1) ** axes),
        sigma=sigma,
        cut=math.exp(-5),
        border="reflect",
        channel_axis=channel_axis,
        **options,
    )


@door(options=RUN)
def denoise_bilateral(
    image: npt.ArrayLike,
    win_size: int | None = None,
    sigma_color: float | None = None,
    sigma_spatial: float = 1,
    bins: int = 10000,
    mode: str = "constant",
    cval: float = 0,
    *,
    channel_axis: int | None = None,
    **options: Unpack[Run],
) -> npt.NDArray[Any]:
    """Denoise an image as ``skimage.restoration.denoise_bilateral``, with any number of axes and channels.

    Parameters
    ----------
    image : array
    win_size : int, optional
        Side of the square window. None means max(5, 2 ceil(3 sigma_spatial) + 1).
    sigma_color : float, optional
        Standard deviation of the Gaussian of values. None means the standard deviation of the image.
    sigma_spatial : float, default 1
        Standard deviation of the Gaussian of distances.
    bins : int, default 10000
        Not used: there is no table of the exponential.
    mode : {"constant", "edge", "symmetric", "reflect", "wrap"}, default "constant"
        Values beyond the border.
    cval : float, default 0
        The value beyond the border for "constant".
    channel_axis : int, optional
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.denoise_image`.

    Returns
    -------
    float array
        In the shape of `image`.

    Raises
    ------
    ValueError, TypeError
        As :func:`gpureg.denoise_bilateral`, and an unknown `mode`.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    scikit-image documents a Gaussian of the Euclidean distance between two pixels. Its code reads a table of Gaussians
    with the wrong stride, which skews the kernel: errors of 0.06 to 0.5 on camera in 0..1. Here the kernel is round.
    """
    choice("mode", mode, _BORDERS)
    integer("bins", bins)
    sigma_spatial = number("sigma_spatial", sigma_spatial, above=0)
    array = _as_float(image)
    side = max(5, 2 * math.ceil(3 * sigma_spatial) + 1) if win_size is None else integer("win_size", win_size, low=1)
    color = float(array.std()) if sigma_color is None else number("sigma_color", sigma_color, low=0)
    if color == 0:
        return array.copy()  # a constant image does not change
    return _bilateral(
        array,
        radius=max(side // 2, 1),
        sigma_space=math.sqrt(2) * sigma_spatial,
        sigma_value=math.sqrt(2) * color,
        border=_BORDERS[mode],
        constant=number("cval", cval),
        channel_axis=channel_axis,
        **options,
    )


@door(options=RUN)
def denoise_tv_chambolle(
    image: npt.ArrayLike,
    weight: float = 0.1,
    eps: float = 2.0e-4,
    max_num_iter: int = 200,
    *,
    channel_axis: int | None = None,
    **options: Unpack[Run],
) -> npt.NDArray[Any]:
    """Denoise an image as ``skimage.restoration.denoise_tv_chambolle``, by eq. 31 at p = 1.

    Parameters
    ----------
    image : array
        One or more axes, not counting the channels.
    weight : float, default 0.1
        Strength of the total variation: 1/lam.
    eps : float, default 2e-4
        Stop when the energy changes by less than this share of its first value.
    max_num_iter : int, default 200
        Maximum number of iterations.
    channel_axis : int, optional
        Axis of the channels, which are denoised separately, as in scikit-image.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.denoise_image`.

    Returns
    -------
    float array
        In the shape of `image`.

    Raises
    ------
    ValueError, TypeError
        As :func:`gpureg.denoise_tv`; also a weight that is not > 0.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    Minimises sum |grad f| + 1/(2 weight) |f - f0|^2, where |grad f| is the gradient norm on the graph with weights 1/2.
    It adds the squared differences to both sides along each axis with a factor 1/2: a centred length of the gradient.
    scikit-image uses forward differences, so that the results differ slightly. Its energy lacks the factor 1/2 of the
    documentation, and its default `eps` stops some percent above the minimum.
    """
    weight, eps = number("weight", weight, above=0), number("eps", eps, low=0)
    array = _as_float(image)
    most, options = integer("max_num_iter", max_num_iter, low=0), _as_precise(array, options)
    also = options.pop("callback", None)
    if channel_axis is None:
        return _chambolle(array, weight, eps, most, also, options)
    axis = integer("channel_axis", channel_axis, low=-array.ndim, high=array.ndim - 1)
    found = [_chambolle(channel, weight, eps, most, also, options) for channel in np.moveaxis(array, axis, 0)]
    return np.stack(found, axis=axis)


def _chambolle(
    array: npt.NDArray[Any], weight: float, eps: float, most: int, also: Callback | None, options: Run
) -> npt.NDArray[Any]:
    """Denoise one channel, with an own stop."""
    energies: list[float] = []

    def settled(check: Check) -> bool:
        energies.append(check.energy)
        if also is not None and also(check):
            return True
        return len(energies) > 1 and abs(energies[-2] - energies[-1]) < eps * abs(energies[0])

    handed: dict[str, Any] = {**options, "callback": settled}
    # weights 1/2 scale the norm by sqrt(1/2): weights 1 with lam sqrt(2) times as large have the same minimum
    value = _tv(array[None] if array.ndim == 1 else array, lam=math.sqrt(2) / weight, max_iter=most, **handed)
    return value.reshape(array.shape)
