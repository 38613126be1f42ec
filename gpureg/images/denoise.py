"""Denoising of images and volumes: :func:`denoise_image`."""

from __future__ import annotations

from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from ..doors import door
from .choose import plan_denoising
from .options import CHOICE, DENOISE, RUN_PLAN, Choice, Denoise
from .parts import run_in_parts
from .raster import Raster
from .run import without_averaging

# Options of the model that a search for lam does not support.
_UNSEEN = ("gamma", "coupled", "update_weights")
# Options of a run that the raster has.
_OF_THE_IMAGE = ("mask", "channel_axis")


@door(options=DENOISE)
def denoise_image(image: npt.ArrayLike, **options: Unpack[Denoise]) -> npt.NDArray[Any]:
    """Denoise an image or a volume; without parameters, they are chosen from the noise that is found.

    Parameters
    ----------
    image : array
        Two or more axes, not counting the channels. Results and parameters are in its units.
    sigma : float, array, "photon", NoiseReport or PhotonNoise, optional
        Standard deviation of the noise in the image's units: a number, one per channel, or one per pixel (a map in the
        shape of the image, with or without its channels; axes of length 1 are repeated). "photon" measures how the
        noise grows with the signal. A report of :func:`gpureg.describe_noise` or the numbers of
        :func:`gpureg.estimate_photon_noise` are used as they are. None describes the noise and treats what is found,
        see the notes.
    p : float, optional
        Degree of regularity > 0; None means 2.
    lam : float, array or str, optional
        Fidelity >= 0, a number or one value per pixel: a larger value stays closer to the image. "discrepancy", "sure"
        and "j-invariance" search for it (:mod:`gpureg.tuning`), in 5 to 15 runs. None means a rule.
    radius : float, optional
        Radius of the window, in the units of `spacing`. None means the nearest neighbours for constant weights;
        otherwise 10 of the smallest cells, 7 if weights are given, 2 in a volume.
    metric : {"chebyshev", "euclidean", "cityblock"}, optional
        Shape of the window: square, disk or diamond.
    weights : Weights, array or {"constant", "bilateral", "patch"}, optional
        An object of :mod:`gpureg.weights`, one value per directed edge of the grid, or a kind of weights with the
        parameters of the next five lines. None means nonlocal weights by a rule at p = 2, constant weights otherwise.
    patch_radius : int, optional
        For weights="patch" and for the rule: radius >= 0 of a patch, in pixels. None means 2, or the rule's choice.
    patch_sigma : float, optional
        For weights="patch": standard deviation > 0 of a Gaussian patch, in pixels. None means a flat patch.
    h : float, optional
        For weights="patch": filtering parameter > 0, as in :func:`gpureg.weights.patch`. None means 0.6 times the noise
        times the square root of the number of samples in a patch.
    sigma_space : float, optional
        For weights="bilateral": sigma_P > 0, in the units of `spacing`. None means 3 of the smallest cells.
    sigma_value : float, optional
        For weights="bilateral": sigma_X > 0, in the image's units. None means 3 times the noise.
    guide : array, optional
        The image that the weights compare instead of `image`, e.g. a cleaner image of the same scene. It has the same
        pixels, and may have other channels, along `channel_axis` (by default the last axis).
    k : int, optional
        Use only the edges of each pixel to its k nearest patches in the window (:func:`gpureg.patch_graph`). This makes
        nonlocal iterations with p other than 2 fast enough. `weights` must be patch weights.
    centre : {"once", "largest", "none"}, optional
        For one sweep at p = 2: lam = 2 gives the pixel itself weight 1, the largest weight of its neighbours, or
        weight 0. None means "once".
    average_patches : bool or "weighted", optional
        For one sweep at p = 2 with patch weights: estimate whole patches; a pixel is the mean over all patches that
        cover it. "weighted" weights each patch by the sum of its weights. None means "weighted" in a 2-D image whose
        weights are chosen by the rule, if the other options allow it.
    passes : {1, 2, 3}, optional
        How often the image is estimated. 1 is the filter that the other parameters describe. 2 adds a pass that finds
        groups of similar patches of 7 x 7 in the filter's result, and estimates the patches of each group together;
        3 adds one with patches of 5 x 5 before it; in a volume or series 3 x 5 x 5 and 3 x 3 x 3. None means 3 where
        passes follow by default (see the notes), otherwise 1.
    quality : {"fast", "balanced", "best"}, optional
        How much work None is for `passes`: "fast" is the filter alone; "best" finds groups at more pixels than
        "balanced", which is the default. A number of passes takes the places of groups from the word ("fast" as
        "balanced").
    gamma, coupled, update_weights
        As in :func:`gpureg.regularize`.
    max_iter : int, optional
        Maximum number of iterations. None means 1 for a filter, 3 for other weights at p = 2, otherwise 4 with `k` and
        200 without.
    mask : bool array, optional
        True where a pixel takes part. The other pixels are returned unchanged and may be NaN; patches that cover them
        use the nearest pixel that takes part.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1. `radius` and spatial weights are in its units.
    channel_axis : int, optional
        The axis of the channels; None for a grey image. Channels are regularized together; where a parameter follows
        from the noise, only those that are better together.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. eps = None means 1e-3 of the image's spread, 0 for p = 2 and with the certified
        solver; dtype = None means float32, or float64 for integers of more than 16 bits.

    Returns
    -------
    array
        In the shape and dtype of `image`; integers are rounded and clipped. A channel without noise, or whose noise
        cannot be told, is unchanged.

    Raises
    ------
    ValueError, TypeError
        An argument out of its range, or values that are not real and finite.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Warns
    -----
    UserWarning
        If the noise is estimated: it cannot be told, so that none is removed; it is correlated, or has stripes, blocks
        of a JPEG, the mosaic of a colour sensor or a Rician distribution, with what to do
        (:meth:`gpureg.NoiseReport.warnings`); it is below half a unit of an image of integers, which is returned.
    UserWarning
        An array without `channel_axis` that looks like a colour image: the last of three or more axes has 3 or 4
        pixels, the two before it at least 8 times as many. It is processed as a volume.

    Notes
    -----
    Without `sigma`, or with a report, noise that grows with the signal is treated by a map of it; impulses are replaced
    by the median of their neighbours, and lam is 0 there; in correlated noise and in mosaics sigma is that of pixels 6
    apart. Channels are denoised together if their noise is independent, its strength differs by a factor of 2 at most,
    and their edges agree. With weights by a rule at p = 2, large areas of exactly equal values take no part.

    By default the image is estimated three times. First by the filter, one sweep of nonlocal means (eq. 25 of the
    paper, whose eq. 19 to 31 are the model). Then two passes follow. A pass takes a pixel every few along each axis,
    and the last one, and finds the patches around it that are similar in the last result: a group. All patches of a
    group are estimated together: a noisy patch is moved towards the mean of its group, the more in those directions in
    which the patches of the last result differ less than the noise. A pixel is the mean over all patches that cover
    it. Three channels are turned to brightness and two opponent colours for this, of which groups compare the first
    two.

    Passes are left out by default, and :meth:`DenoisePlan.explain` says why, where a parameter is given that makes
    another filter (p, weights, lam, max_iter, tol, centre, k or a guide); where the noise is found not to be white
    (correlated noise, stripes, mosaics, and blocks of a JPEG in strong noise would count as signal); in a picture with
    fewer than 32 pixels along an axis, which has too few similar patches, unless `quality` is given; in images of other
    than 2 or 3 axes. passes=3 makes them all the same. quality="fast" or passes=1 leaves them out.

    With passes a picture takes about 2.5 times as long as by the filter alone, a volume about 10 times. As groups
    belong to every few pixels from the first one, the result of a flipped image is not exactly the flipped result. In a
    volume the patches of the second pass are larger along the last two axes: put the slow axis (z or time) first.

    :func:`gpureg.plan_denoising` returns the parameters that are chosen, with reasons.

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
            f"the search lam={asked['lam']!r} needs the default values of {', '.join(_UNSEEN)}: give lam a number"
        )
    plan = plan_denoising(raster, **cast("Choice", {name: asked[name] for name in CHOICE}))
    run = {name: asked[name] for name in RUN_PLAN}
    if asked["average_patches"] is None:
        plan = without_averaging(plan, run)
    return run_in_parts(plan, raster, **{name: x for name, x in run.items() if name not in _OF_THE_IMAGE}).value


def _is_usual(name: str, value: Any) -> bool:
    """Return whether an option has its default value; an array never has."""
    return value is None or (isinstance(value, str | bool | np.bool_) and value == DENOISE[name])
