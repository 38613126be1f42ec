"""Nonlocal means: :func:`denoise_nl_means`."""

from __future__ import annotations

import math
from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from ..checks import integer, number
from ..doors import door
from ..weights import patch
from .by_noise import Treated, by_noise, level_of
from .noise import Sigma, check_sigma, noise_of
from .one_step import one_step
from .options import FILTER, Filter, check_averaging, check_filter, map_of
from .plan import AveragePatches
from .raster import Raster
from .window import cell_sizes


@door(options=FILTER)
def denoise_nl_means(
    image: npt.ArrayLike,
    *,
    patch_radius: int = 2,
    radius: float | None = None,
    h: float | npt.ArrayLike | None = None,
    patch_sigma: float | None = None,
    sigma: Sigma = 0.0,
    average_patches: AveragePatches = False,
    average_radius: int | None = None,
    cut: float = 0.0,
    **options: Unpack[Filter],
) -> npt.NDArray[Any]:
    """Denoise an image by nonlocal means: each pixel becomes the mean of the pixels with similar patches around them.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), not counting the channels; any integer or real type.
    patch_radius : int, default 2
        Patches are squares with a side of 2 patch_radius + 1 pixels.
    radius : float, optional
        Radius of the window, in the units of `spacing`. None means 7 of the smallest cells, 2 in a volume.
    h : float or array, optional
        Filtering parameter > 0, in the image's units times sqrt(C sum(g)) for C channels. With one value per pixel,
        h(u) h(v) replaces h^2. None means 0.6 times the noise times that root; if `sigma` is 0, the noise is estimated
        and also used as `sigma`. Then channels are denoised together only where that is better, and impulses are
        replaced, as in :func:`gpureg.denoise_image`.
    patch_sigma : float, optional
        Standard deviation a > 0, in pixels, of a Gaussian patch g_a that sums to 1. None means a flat patch, g = 1.
    sigma : float, array, "photon", NoiseReport or PhotonNoise, default 0
        Standard deviation of the noise, in the forms of :func:`gpureg.denoise_image`: 2 sigma^2 is subtracted from each
        squared difference.
    lam : float or array, default 2
        Twice the weight of the pixel itself, in the unit defined by `centre`; with infinity the pixel does not change.
    centre : {"once", "largest", "none"}, default "once"
        lam = 2 gives the pixel itself weight 1, the largest weight of its neighbours, or weight 0.
    average_patches : bool or "weighted", default False
        Estimate whole patches, and average at each pixel the estimates of all patches that cover it. This leaves less
        noise at edges and in rare structures. "weighted" weights each patch by the sum of its weights, so that a patch
        without similar ones counts little.
    average_radius : int, optional
        Radius of the patches that are averaged; None means `patch_radius`.
    cut : float, default 0
        Weights below this value are set to 0.
    metric : {"chebyshev", "euclidean", "cityblock"}, default "chebyshev"
        Shape of the window: square, disk or diamond.
    border : {"clip", "reflect", "symmetric", "nearest", "wrap", "constant"}, default "clip"
        Values beyond the border: none, the image mirrored without its edge pixel or with it, the edge pixel repeated,
        the other end, or `constant`. "clip" clips windows; patches that cross the border are filled by reflection.
    constant : float, default 0
        The value beyond the border for "constant".
    guide : array, optional
        The image that the patches compare instead of `image`.
    mask : bool array, optional
        True where a pixel takes part; the other pixels are returned unchanged and may be NaN.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1.
    channel_axis : int, optional
        Axis of the channels, which are compared and averaged together (all of them, if `h` is given).
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.denoise_image`. With a callback the weights are stored, as the energy needs them.

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
        As :func:`gpureg.denoise_image`; of the noise only if it is estimated, without `h` and `sigma`.

    Notes
    -----
    Computes f(u) = (lam/2 f0(u) + sum_v w2(u, v) f0(v)) / (lam/2 + sum_v w2(u, v)) with w2(u, v) =
    exp(-rho(u, v)/h^2): eq. 25 at p = 2 with the weights of section 5.2. See Buades, Coll, Morel (SIAM MMS 4(2), 2005;
    IPOL 2011 for averaged patches, called patchwise there). The parameter H of OpenCV and scikit-image gives
    h^2 = C s H^2 for flat patches of s pixels and C channels.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((16, 16)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> denoised = gr.denoise_nl_means(noisy, h=0.3, sigma=0.1, backend="numpy")
    >>> bool(np.std(denoised - clean) < 0.4 * np.std(noisy - clean))
    True
    """
    asked = cast("Filter", FILTER | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    check_filter(asked, raster.shape)
    check_averaging(average_patches)
    patch_radius = integer("patch_radius", patch_radius, low=0)
    averaged = patch_radius if average_radius is None else integer("average_radius", average_radius, low=0)
    if radius is None:
        finest, coarsest = cell_sizes(asked["spacing"])
        radius = max((7 if raster.ndim == 2 else 2) * finest, coarsest)
    number("radius", radius, finite=False)
    # Run the checks of the weight function before the noise is estimated.
    check_sigma(sigma, raster)
    patch(patch_radius, 1.0, patch_sigma=patch_sigma, cut=cut)
    samples = (2 * patch_radius + 1) ** raster.ndim if patch_sigma is None else 1

    def run(treated: Treated, h: float | npt.ArrayLike | None) -> npt.NDArray[Any]:
        part, level = treated.raster, treated.level
        if h is None:
            h = 0.6 * math.sqrt(samples * part.channels) * level
        return one_step(
            part,
            lambda maps: patch(patch_radius, maps["h"], sigma=maps["sigma"], patch_sigma=patch_sigma, cut=cut),
            {"h": map_of("h", h, raster.shape, above=0), "sigma": level},
            cast("Filter", {**asked, "lam": treated.lam(asked["lam"])}),
            radius=radius,
            reach=patch_radius,
            average_patches=average_patches,
            averaged=averaged,
        )

    if h is None:
        given = None if np.ndim(cast("Any", sigma)) == 0 and sigma == 0 else sigma
        return by_noise(raster, given, asked["guide"] is not None, lambda treated: run(treated, None))
    noise = noise_of(raster, sigma, needed=False)
    return run(Treated(raster, level_of(raster, noise)), h)
