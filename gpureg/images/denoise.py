"""The door for images and volumes: :func:`denoise_image`."""

from __future__ import annotations

from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from ..doors import door
from .choose import plan_denoising
from .options import CHOICE, DENOISE, RUN_PLAN, Choice, Denoise, RunPlan
from .raster import Raster
from .run import run_plan, without_averaging

# What of the model a search for lam does not know.
_UNSEEN = ("gamma", "coupled", "update_weights")


@door(options=DENOISE)
def denoise_image(image: npt.ArrayLike, **options: Unpack[Denoise]) -> npt.NDArray[Any]:
    """Denoise an image or a volume; with no parameter at all, the noise is estimated and the rest follows from it.

    Parameters
    ----------
    image : array
        Two or more axes, besides the channels. Values are used as they come, never rescaled.
    sigma : float or array, optional
        Standard deviation of the noise in the image's units, or one per pixel; None estimates it
        (:func:`gpureg.estimate_noise`).
    p : float, optional
        Degree of regularity > 0; None takes 2.
    lam : float, array or str, optional
        Fidelity >= 0, a number or one value per pixel: larger stays closer to the image. "discrepancy", "sure" or
        "j-invariance" search for it (:mod:`gpureg.tuning`), in 5 to 15 runs; None takes a rule.
    radius : float, optional
        Reach of the window, in the units of `spacing`; None takes 10 of the smallest cells, 7 where weights are given,
        2 in a volume, or the nearest neighbours for constant weights.
    metric : {"chebyshev", "euclidean", "cityblock"}, optional
        Shape of the window: square, disk or diamond.
    weights : Weights, array or {"constant", "bilateral", "patch"}, optional
        An object of :mod:`gpureg.weights`, one value per directed edge of the grid, or a kind of weights, made of the
        noise and of what the next five say. None takes nonlocal weights by rule at p = 2, constant ones otherwise.
    patch_radius : int, optional
        Of weights="patch", or of the patches of the rule: radius >= 0 of a patch in pixels. None takes 2, or the
        rule's.
    patch_sigma : float, optional
        Of weights="patch": standard deviation > 0, in pixels, of a Gaussian patch; None is a flat one.
    h : float, optional
        Of weights="patch": filtering parameter > 0, as in :func:`gpureg.weights.patch`. None takes 0.6 of the noise
        times the square root of the samples in a patch.
    sigma_space : float, optional
        Of weights="bilateral": reach > 0 in the units of `spacing`; None takes 3 of the smallest cells.
    sigma_value : float, optional
        Of weights="bilateral": reach > 0 in the image's units; None takes 3 of the noise.
    guide : array, optional
        What the weights compare instead of `image`, e.g. a cleaner picture of the same scene: on the same pixels, with
        channels of its own along `channel_axis` (by default the last axis) or without.
    k : int, optional
        Leave of the edges of each pixel's window only those to the k nearest patches (:func:`gpureg.patch_graph`):
        what makes nonlocal iterations with p other than 2 affordable. `weights` must be patch weights.
    centre : {"once", "largest", "none"}, optional
        In one sweep at p = 2: whether lam = 2 counts the pixel itself with weight 1, with the largest weight of its
        neighbours, or not at all. None is "once".
    average_patches : bool or "weighted", optional
        In one sweep at p = 2 of patch weights: whether patches are estimated as a whole, and a pixel is the mean over
        all patches that cover it; "weighted" counts a patch by the sum of the weights it found. None takes "weighted"
        in a picture whose weights are chosen by rule, and where nothing else asked for forbids it.
    gamma, coupled, update_weights
        As in :func:`gpureg.regularize`.
    max_iter : int, optional
        Iterations at most, >= 0; None takes 1 for a filter, 3 for other weights at p = 2, 200 otherwise, 4 with `k`.
    mask : bool array, optional
        True where a pixel takes part. The others come back as they are, NaN included; patches over them see the nearest
        pixel that takes part.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1. `radius` and the spatial part of weights are in its units.
    channel_axis : int, optional
        The axis of the channels, regularized together; None for a grey image.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. eps = None takes 1e-3 of the image's range, 0 for p = 2; dtype = None takes
        float32, or float64 for integers of more than 16 bits.

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
        Without `channel_axis`: an array of three axes or more whose last one has 3 or 4 pixels, and the two before it
        at least 8 times as many each. It is taken for a volume, and was perhaps meant as a picture in colour.

    Notes
    -----
    :func:`gpureg.plan_denoising` tells what would be chosen, and how. The model is eq. 19 to 31 of the paper; the
    default is one sweep of nonlocal means.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> clean = np.kron([[0.2, 0.8], [0.8, 0.2]], np.ones((32, 32)))
    >>> noisy = clean + np.random.default_rng(7).normal(0, 0.1, clean.shape)
    >>> denoised = gr.denoise_image(noisy, backend="numpy")
    >>> bool(np.std(denoised - clean) < 0.3 * np.std(noisy - clean))
    True
    """
    asked: dict[str, Any] = DENOISE | options
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    if isinstance(asked["lam"], str) and any(not _is_usual(name, asked[name]) for name in _UNSEEN):
        raise ValueError(
            f"the search lam={asked['lam']!r} looks at the model with {', '.join(_UNSEEN)} as they are by default: "
            "give lam a number"
        )
    plan = plan_denoising(raster, **cast("Choice", {name: asked[name] for name in CHOICE}))
    run = {name: asked[name] for name in RUN_PLAN}
    if asked["average_patches"] is None:
        plan = without_averaging(plan, run)
    return run_plan(plan, raster, **cast("RunPlan", run)).value


def _is_usual(name: str, value: Any) -> bool:
    """Whether an option is as it is by default; an array never is."""
    return value is None or (isinstance(value, str | bool | np.bool_) and value == DENOISE[name])
