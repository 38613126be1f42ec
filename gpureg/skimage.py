"""scikit-image's denoisers under their own names and signatures: change one import.

    from gpureg.skimage import denoise_nl_means, denoise_bilateral, denoise_tv_chambolle

As there, integer images become floats in 0..1 (unless `preserve_range`), and parameters are in these units. Where
scikit-image's code departs from its documentation, these compute what the documentation says, and say so.
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

__all__ = ["denoise_bilateral", "denoise_nl_means", "denoise_tv_chambolle"]

# numpy.pad's names for borders, which scikit-image uses, and ours.
_BORDERS: dict[str, Border] = {
    "constant": "constant",
    "edge": "nearest",
    "symmetric": "symmetric",
    "reflect": "reflect",
    "wrap": "wrap",
}


def _as_float(image: npt.ArrayLike, preserve_range: bool = False) -> npt.NDArray[Any]:
    """A float image as ``skimage.util.img_as_float`` makes it: integers become shares of the most they can be."""
    array = np.asarray(image)
    if array.dtype.kind == "f":
        return array.astype(np.float32) if array.dtype == np.float16 else array
    if array.dtype.kind == "b" or preserve_range:
        return array.astype(np.float64)
    if array.dtype.kind not in "iu":
        raise TypeError(f"image must hold integers or real numbers, got {array.dtype}")
    scaled: npt.NDArray[np.float64] = array / np.float64(np.iinfo(array.dtype).max)
    return np.maximum(scaled, -1.0)


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
    """``skimage.restoration.denoise_nl_means``, on any device, in one run for every mode.

    Parameters
    ----------
    image : array
        2 or more axes besides the channels; more than scikit-image takes in its slow mode.
    patch_size, patch_distance : int, default 7 and 11
        Side of a patch (an even one counts as the next odd one), and reach of the window.
    h : float, default 0.1
        Cut-off of the root mean square difference of patches.
    fast_mode : bool, default True
        Flat patches; False weights them by a Gaussian of standard deviation (patch_size - 1)/4.
    sigma : float, default 0
        Standard deviation of the noise, whose share is taken off the distances.
    preserve_range : bool, default False
        Leave integers as they are, instead of making 0..1 of them.
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
    Documented there: patches of patch_size x patch_size. Its fast mode sums (patch_size - 1)^2 pixels, off centre, and
    divides by patch_size^2 (issue #5177 asks why the modes differ); here the patch is whole. Its slow mode approximates
    the exponential; here it is exact. Its fast mode pads by reflection and lets padded pixels vote, as here; the slow
    one does not.
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
    """``skimage.restoration.denoise_bilateral``, for any number of axes and channels.

    Parameters
    ----------
    image : array
    win_size : int, optional
        Side of the square window; None takes max(5, 2 ceil(3 sigma_spatial) + 1).
    sigma_color : float, optional
        Standard deviation of the values' Gaussian; None takes that of the image.
    sigma_spatial : float, default 1
        Standard deviation of the distances' Gaussian.
    bins : int, default 10000
        Not used: the exponential is computed, not looked up.
    mode : {"constant", "edge", "symmetric", "reflect", "wrap"}, default "constant"
        What lies beyond the border.
    cval : float, default 0
        The value there for "constant".
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
    Documented there: a Gaussian of the Euclidean distance between two pixels. Its code reads a table of such Gaussians
    with the wrong stride, so that the kernel is skewed: 0.06 to 0.5 off on camera in 0..1. Here it is round.
    """
    choice("mode", mode, _BORDERS)
    integer("bins", bins)
    sigma_spatial = number("sigma_spatial", sigma_spatial, above=0)
    array = _as_float(image)
    side = max(5, 2 * math.ceil(3 * sigma_spatial) + 1) if win_size is None else integer("win_size", win_size, low=1)
    color = float(array.std()) if sigma_color is None else number("sigma_color", sigma_color, low=0)
    if color == 0:
        return array.copy()  # a constant image, the same whatever its weights
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
    """``skimage.restoration.denoise_tv_chambolle`` by eq. 31 at p = 1, for any number of axes.

    Parameters
    ----------
    image : array
    weight : float, default 0.1
        Strength of the total variation: 1/lam.
    eps : float, default 2e-4
        Stop once the energy changes by less than this share of its first value.
    max_num_iter : int, default 200
        Iterations at most.
    channel_axis : int, optional
        Axis of the channels, each denoised by itself, as there.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.denoise_image`.

    Returns
    -------
    float array
        In the shape of `image`.

    Raises
    ------
    ValueError, TypeError
        As :func:`gpureg.denoise_tv`, a weight that is not > 0.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`.

    Notes
    -----
    Minimises sum |grad f| + 1/(2 weight) |f - f0|^2. |grad f| is that of the graph whose edges weigh 1/2: the
    differences to either side along each axis, whose squares count half, so that it is the length of the gradient,
    centred, where scikit-image takes forward differences. The results differ by what the discretisation leaves. There
    the energy lacks the factor 1/2 that the documentation gives it, and the default `eps` stops some percent above the
    minimum.
    """
    weight, eps = number("weight", weight, above=0), number("eps", eps, low=0)
    array = _as_float(image)
    energies: list[float] = []
    also = options.pop("callback", None)

    def settled(check: Check) -> bool:
        energies.append(check.energy)
        if also is not None and also(check):
            return True
        return len(energies) > 1 and abs(energies[-2] - energies[-1]) < eps * abs(energies[0])

    handed: dict[str, Any] = {**options, "callback": settled}
    # sqrt(1/2) of every difference is taken out of the norm, which is of degree 1
    return _tv(
        array,
        lam=math.sqrt(2) / weight,
        coupled=False,
        max_iter=integer("max_num_iter", max_num_iter, low=0),
        channel_axis=channel_axis,
        **handed,
    )
