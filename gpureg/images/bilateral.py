"""The bilateral filter: :func:`denoise_bilateral`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Unpack, cast

import numpy.typing as npt

from ..checks import number
from ..doors import door, warn
from ..weights import bilateral
from .by_noise import Treated, by_noise
from .noise import Sigma, check_sigma
from .one_step import one_step
from .options import FILTER, Filter, check_filter, map_of
from .raster import Raster
from .window import cell_sizes

# Number of pixels beyond which a window over the whole image is probably a mistake, and slow.
_MANY = 1024


@door(options=FILTER)
def denoise_bilateral(
    image: npt.ArrayLike,
    *,
    radius: float | None = None,
    sigma_space: float | None = None,
    sigma_value: float | npt.ArrayLike | None = None,
    sigma: Sigma | None = None,
    **options: Unpack[Filter],
) -> npt.NDArray[Any]:
    """Denoise an image by the bilateral filter: each pixel becomes the mean of near pixels with similar values.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), not counting the channels; any integer or real type.
    radius : float, optional
        Radius of the window, in the units of `spacing`. None means 2 sigma_space: there the spatial factor is 0.02.
    sigma_space : float, optional
        sigma_P of w1, in the units of `spacing`; sqrt(2) times the value of OpenCV and scikit-image. None means 3 of
        the smallest cells.
    sigma_value : float or array, optional
        sigma_X of w1, in the image's units; sqrt(2) times the value of OpenCV and scikit-image. With one value per
        pixel, sigma_X(u) sigma_X(v) replaces its square. None means 3 sqrt(C) times the noise, for C channels; then
        channels are filtered together only where that is better, and impulses are replaced, as in
        :func:`gpureg.denoise_image`.
    sigma : float, array, "photon", NoiseReport or PhotonNoise, optional
        Standard deviation of the noise, in the forms of :func:`gpureg.denoise_image`, if `sigma_value` is None; None
        estimates it.
    lam, centre, metric, border, constant, mask, spacing, channel_axis
    backend, dtype, memory, callback, progress
        As in :func:`denoise_nl_means`.
    guide : array, optional
        The image that the weights compare instead of `image` (joint or cross bilateral filter).

    Returns
    -------
    array
        In the shape and dtype of `image`; integers are rounded and clipped.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable
        A backend or device that is not available.

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`, of the noise only if it is estimated; also a window, chosen from `sigma_space`,
        that covers the whole image.

    Notes
    -----
    Computes f(u) = (lam/2 f0(u) + sum_v w1(u, v) f0(v)) / (lam/2 + sum_v w1(u, v)), eq. 25 at p = 2, with
    w1(u, v) = exp(-|u - v|^2/sigma_P^2) exp(-|f0(u) - f0(v)|^2/sigma_X^2) of section 5.2.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> step = np.repeat([[0.0, 1.0]], 4, axis=1) + np.zeros((8, 1))
    >>> gr.denoise_bilateral(step, sigma_value=0.1, backend="numpy")[0].round(3)
    array([0., 0., 0., 0., 1., 1., 1., 1.])
    """
    asked = cast("Filter", FILTER | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    check_filter(asked, raster.shape)
    finest, coarsest = cell_sizes(asked["spacing"])
    sigma_space = 3 * finest if sigma_space is None else number("sigma_space", sigma_space, above=0, finite=False)
    if radius is None:
        radius = max(2 * sigma_space if math.isfinite(sigma_space) else 7 * finest, coarsest)
        _warn_of_the_whole(raster.shape, radius, asked["spacing"], sigma_space)
    number("radius", radius, finite=False)
    check_sigma(sigma, raster)
    if sigma is not None and sigma_value is not None:
        raise ValueError("sigma decides sigma_value, which is given: leave one of them out")

    def run(treated: Treated, value: float | npt.ArrayLike) -> npt.NDArray[Any]:
        return one_step(
            treated.raster,
            lambda maps: bilateral(sigma_space, maps["sigma_value"]),
            {"sigma_value": map_of("sigma_value", value, raster.shape, above=0, finite=False)},
            cast("Filter", {**asked, "lam": treated.lam(asked["lam"])}),
            radius=radius,
        )

    if sigma_value is not None:
        return run(Treated(raster, 0.0), sigma_value)
    return by_noise(
        raster,
        sigma,
        asked["guide"] is not None,
        lambda treated: run(treated, 3 * math.sqrt(treated.raster.channels) * treated.level),
    )


def _warn_of_the_whole(
    shape: tuple[int, ...], radius: float, spacing: Sequence[float] | None, sigma_space: float
) -> None:
    """Warn if a window of this radius joins every pixel to all others, as lengths in another unit would do."""
    steps = (1.0,) * len(shape) if spacing is None or len(spacing) != len(shape) else spacing
    if math.prod(shape) > _MANY and all(radius >= (n - 1) * step for n, step in zip(shape, steps, strict=True)):
        size = " x ".join(f"{n * step:g}" for n, step in zip(shape, steps, strict=True))
        warn(
            f"the window of radius {radius:g} covers the whole image of {size}: sigma_space = {sigma_space:g} is a "
            "length in the units of spacing; None means 3 of the smallest cells, and radius gives a smaller window"
        )
