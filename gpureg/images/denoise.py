"""The door for images and volumes: :func:`denoise_image`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

from ..graphs.edges import Metric
from ..model.problem import Norm
from ..solvers import Solver
from ..solvers.loop import Callback
from ..tuning.fidelity import LamMethod
from ..weights import Weights
from .choose import plan_denoising
from .run import run_plan, without_averaging

# What of the model a search for lam does not know, as it is by default.
_USUAL: dict[str, Any] = {"gamma": "sqrt", "coupled": True, "update_weights": None}


def denoise_image(
    image: npt.ArrayLike,
    *,
    sigma: float | npt.ArrayLike | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | LamMethod | None = None,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    guide: npt.ArrayLike | None = None,
    nearest: int | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    norm: Norm = "vertex",
    coupled: bool = True,
    solver: str | Solver = "jacobi",
    max_iter: int | None = None,
    tol: float | None = None,
    eps: float | None = None,
    update_weights: int | None = None,
    mask: npt.ArrayLike | None = None,
    spacing: Sequence[float] | None = None,
    channel_axis: int | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
    memory: int | None = None,
) -> npt.NDArray[Any]:
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
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per directed edge of the grid.
    guide : array, optional
        What the weights compare instead of `image`, e.g. a cleaner picture of the same scene: on the same pixels, with
        channels of its own along `channel_axis` (by default the last axis) or without.
    nearest : int, optional
        Keep only the edges to so many nearest patches of each pixel's window (:func:`gpureg.patch_graph`): what makes
        nonlocal iterations with p other than 2 affordable. `weights` must be patch weights.
    gamma, norm, coupled, update_weights
        As in :func:`gpureg.regularize`.
    solver : str or Solver, default "jacobi"
    max_iter : int, optional
    tol : float, optional
        As in :func:`gpureg.regularize`.
    eps : float, optional
        Smoothing of the gradient norm; None takes 1e-3 of the image's range, 0 for p = 2.
    mask : bool array, optional
        True where a pixel takes part. The others come back as they are, NaN included; patches over them see the nearest
        pixel that takes part.
    spacing : tuple of float, optional
        Size of a pixel along each axis; None means 1. `radius` and the spatial part of weights are in its units.
    channel_axis : int, optional
        The axis of the channels, regularized together; None for a grey image.
    backend : str, default "auto"
    dtype : dtype, optional
        Type to compute in; None takes float32, or float64 for integers of more than 16 bits.
    callback : callable, optional
    progress : bool, default False
    memory : int, optional
        As in :func:`gpureg.regularize`.

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
    model = {"gamma": gamma, "norm": norm, "coupled": coupled, "update_weights": update_weights}
    if isinstance(lam, str) and any(model[name] != usual for name, usual in _USUAL.items()):
        raise ValueError(
            f"the search lam={lam!r} looks at the model with {', '.join(_USUAL)} as they are by default: "
            "give lam a number"
        )
    plan = plan_denoising(
        image,
        sigma=sigma,
        p=p,
        lam=lam,
        radius=radius,
        metric=metric,
        weights=weights,
        guide=guide,
        nearest=nearest,
        norm=norm,
        solver=solver,
        max_iter=max_iter,
        tol=tol,
        eps=eps,
        mask=mask,
        spacing=spacing,
        channel_axis=channel_axis,
        backend=backend,
        dtype=dtype,
        memory=memory,
    )
    plan = without_averaging(plan, solver=solver, callback=callback, model=model)
    return run_plan(
        plan,
        image,
        guide=guide,
        solver=solver,
        mask=mask,
        channel_axis=channel_axis,
        backend=backend,
        dtype=dtype,
        callback=callback,
        progress=progress,
        memory=memory,
        **model,
    ).value
