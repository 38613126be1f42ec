"""The door of the bilateral filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from ..graphs.edges import Metric
from ..noise.white import estimate_noise
from ..weights import bilateral
from .one_step import cell_sizes, cells_of, map_of, one_step
from .plan import CENTRES, Centre
from .raster import checked


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
    shape = cells_of(array, channel_axis)
    if centre not in CENTRES:
        raise ValueError(f"centre must be one of {', '.join(CENTRES)}, got {centre!r}")
    bilateral(sigma_space, 1.0)
    if radius is None:
        finest, coarsest = cell_sizes(spacing)
        radius = max(2 * sigma_space if math.isfinite(sigma_space) else 7 * finest, coarsest)
    if sigma_value is None:
        channels = array.size // max(1, math.prod(shape))
        sigma_value = 3 * estimate_noise(array, channel_axis=channel_axis, mask=mask) * math.sqrt(channels)
        if sigma_value == 0:
            return array.copy()  # no noise was found
    maps = {
        "sigma_value": map_of("sigma_value", sigma_value, shape),
        "lam": 0.0 if centre == "none" else map_of("lam", lam, shape),
    }
    return one_step(
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
