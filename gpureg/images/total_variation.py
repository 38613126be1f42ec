"""Total variation: :func:`denoise_tv`."""

from __future__ import annotations

from typing import Any, Unpack, cast

import numpy.typing as npt

from ..doors import door
from .denoise import denoise_image
from .options import DENOISE, Denoise


@door(options={name: default for name, default in DENOISE.items() if name != "p"})
def denoise_tv(image: npt.ArrayLike, **options: Unpack[Denoise]) -> npt.NDArray[Any]:
    """Denoise an image by total variation on the graph of its pixels: flat regions, sharp edges.

    Parameters
    ----------
    image : array
        Two or more axes (space, time), not counting the channels; any integer or real type.
    lam : float or array, optional
        Fidelity >= 0 in units of 1 over the image's units, or one value per pixel: a larger value stays closer to the
        image (the inverse of scikit-image's `weight`). None means a value chosen from the noise.
    sigma : float, array, "photon", NoiseReport or PhotonNoise, optional
        Standard deviation of the noise, in the forms of :func:`gpureg.denoise_image`; None estimates it if `lam` is
        None.
    weights : Weights or array, optional
        As in :func:`gpureg.denoise_image`; None means 1 between the nearest neighbours, the paper's G_0.
    **options
        The other options of :func:`gpureg.denoise_image`, except `p`, which is 1.

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

    Warns
    -----
    UserWarning
        As :func:`gpureg.denoise_image`; of the noise only if `lam` is None or a search.

    Notes
    -----
    Minimises sum_u |grad_w f(u)| + lam/2 sum_u |f(u) - f0(u)|^2 by eq. 31 at p = 1: the digital TV filter of Chan,
    Osher and Shen (IEEE TIP 10(2), 2001). |grad_w f(u)| uses all neighbours of u, on both sides; the usual discrete
    total variation uses forward differences.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((16, 16)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> denoised = gr.denoise_tv(noisy, lam=15, backend="numpy")
    >>> bool(np.std(denoised - clean) < 0.5 * np.std(noisy - clean))
    True
    """
    return denoise_image(image, **cast("Denoise", {**options, "p": 1.0}))
