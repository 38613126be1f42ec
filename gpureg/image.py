"""The door for images and volumes: :func:`denoise_image`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from . import backends
from .graph import GridGraph, Metric
from .memory import budget
from .nearest import nearest_patches
from .plan import DenoisePlan, checked, filled, guided_by, plan_denoising
from .problem import as_function, default_eps
from .regularization import one_sweep, regularize
from .result import Interrupted, Result, Stop
from .solvers import Jacobi, Solver, resolve
from .solvers.loop import Callback
from .tiles import OneStep
from .weights import Weights, patch_weights


def denoise_image(
    image: npt.ArrayLike,
    *,
    sigma: float | None = None,
    p: float | None = None,
    lam: float | npt.ArrayLike | None = None,
    radius: float | None = None,
    metric: Metric | None = None,
    weights: Weights | npt.ArrayLike | None = None,
    guide: npt.ArrayLike | None = None,
    nearest: int | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    norm: str = "vertex",
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
    sigma : float, optional
        Standard deviation of the noise in the image's units; None estimates it (:func:`gpureg.estimate_noise`).
    p : float, optional
        Degree of regularity > 0; None takes 2.
    lam : float or array, optional
        Fidelity >= 0, a number or one value per pixel: larger stays closer to the image.
    radius : float, optional
        Reach of the window, in the units of `spacing`; None takes 7 of the smallest cells (2 in a volume), or the
        nearest neighbours for constant weights.
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
    plan = plan_denoising(
        image,
        sigma=sigma,
        p=p,
        lam=lam,
        radius=radius,
        metric=metric,
        weights=weights,
        max_iter=max_iter,
        tol=tol,
        eps=eps,
        mask=mask,
        spacing=spacing,
        channel_axis=channel_axis,
    )
    if nearest is not None:
        plan = replace(plan, nearest=nearest)
    model = {"gamma": gamma, "norm": norm, "coupled": coupled, "update_weights": update_weights}
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


def run_plan(
    plan: DenoisePlan,
    image: npt.ArrayLike,
    *,
    solver: str | Solver = "jacobi",
    mask: npt.ArrayLike | None = None,
    channel_axis: int | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    callback: Callback | None = None,
    progress: bool = False,
    memory: int | None = None,
    guide: npt.ArrayLike | None = None,
    **model: Any,
) -> Result:
    """Carry out a plan; the parameters are those of :func:`denoise_image`, `model` those of :func:`gpureg.regularize`.

    Returns
    -------
    Result
        Its value is the image, in the shape and dtype of `image`. One sweep at p = 2 with bilateral or patch weights
        computes these without storing them: it reports no energy, and an interruption leaves no iterate.
    """
    begin = time.perf_counter()
    array = checked(image, channel_axis, mask)
    if plan.max_iter == 0:
        # Not through the device, whose float32 would round a float64 image.
        device = backends.get(backend, np.float32 if dtype is None else dtype)
        budget(device, memory)  # a wrong limit is one here too
        name = repr(device)
        none = np.empty(0, np.int64)
        return Result(
            value=array.copy(),
            iterations=0,
            stop=Stop.MAX_ITER,
            energy=np.empty(0),
            checks=none,
            gap=None,
            eps=0.0,
            method="Nothing was to be done.",
            backend=name,
            seconds=time.perf_counter() - begin,
        )
    kind = np.dtype(dtype) if dtype is not None else np.dtype(np.float64 if _is_long(array.dtype) else np.float32)
    f0 = array[..., None] if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    f0 = f0.astype(np.result_type(kind, np.float32), copy=False)
    inside = None if mask is None else np.asarray(mask)
    grid = GridGraph(f0.shape[:-1], plan.radius, plan.metric, spacing=plan.spacing, mask=inside)
    if inside is not None and not inside.all():
        f0 = filled(f0, inside)
    eps = default_eps(f0, plan.p) if plan.eps is None else plan.eps
    weights = plan.weights if guide is None else guided_by(plan.weights, guide, grid, channel_axis)
    common: dict[str, Any] = dict(
        lam=plan.lam, eps=eps, weights=weights, backend=backend, dtype=kind, memory=memory, progress=progress
    )
    settings = dict(p=plan.p, solver=solver, max_iter=plan.max_iter, tol=plan.tol, callback=callback, **model)
    with _converted(array, channel_axis, inside):
        once = callback is None and _is_plain(model) and _is_one_sweep(plan, solver)
        if once and (plan.centre == "largest" or plan.average_patches):
            averaged = plan.average_radius if plan.average_radius is not None else _patch_radius(plan)
            step = OneStep(
                plan.centre == "largest",
                averaged if plan.average_patches else None,
                plan.average_patches == "weighted",
            )
            result = one_sweep(f0, grid, step=step, **common)
        elif plan.nearest is not None:
            nodes = as_function(grid, f0, "image")
            graph = nearest_patches(nodes, grid, weights, plan.nearest, backend=backend, dtype=kind)
            result = regularize(nodes, graph, **common, **settings)
            result = replace(result, value=result.value.reshape(f0.shape))
        elif once:
            result = one_sweep(f0, grid, **common)
        else:
            result = regularize(f0, grid, **common, **settings)
    value = _as_image(result.value, array, channel_axis, inside)
    return replace(result, value=value, seconds=time.perf_counter() - begin)


def _is_plain(model: dict[str, Any]) -> bool:
    """Whether nothing of the model but what a plan says is other than by default (at p = 2 channels are alone)."""
    gamma = model.get("gamma", "sqrt")
    by_name = isinstance(gamma, str) and gamma == "sqrt"
    return by_name and model.get("norm", "vertex") == "vertex" and model.get("update_weights") is None


def _patch_radius(plan: DenoisePlan) -> int:
    found = patch_weights(plan.weights)
    assert found is not None
    return found[0].reach


def _is_one_sweep(plan: DenoisePlan, solver: str | Solver) -> bool:
    """Whether :func:`one_sweep` does what the plan asks for: one sweep by the book, at p = 2, of patch weights."""
    method = resolve(solver)
    whole = isinstance(method, Jacobi) and method.damping in (None, 1)
    # where data are missing the default may be damped
    data = isinstance(method, Jacobi) and (method.damping == 1 or bool(np.min(plan.lam) > 0))
    once = plan.p == 2 and plan.max_iter == 1 and plan.tol is None
    return once and whole and data and patch_weights(plan.weights) is not None


@contextmanager
def _converted(
    array: npt.NDArray[Any], channel_axis: int | None, inside: npt.NDArray[np.bool_] | None
) -> Iterator[None]:
    """Let the result of an interrupted run be an image too."""
    try:
        yield
    except Interrupted as interruption:
        value = _as_image(interruption.result.value, array, channel_axis, inside)
        raise Interrupted(replace(interruption.result, value=value)) from None


def _is_long(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "iu" and dtype.itemsize > 2


def _as_image(
    value: npt.NDArray[Any],
    array: npt.NDArray[Any],
    channel_axis: int | None,
    inside: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[Any]:
    """A regularized function as an image like `array`: its axes, its dtype, and its own pixels outside the mask."""
    image = value[..., 0] if channel_axis is None else np.moveaxis(value, -1, channel_axis)
    if array.dtype.kind in "iu":
        limits = np.iinfo(array.dtype)
        np.clip(np.rint(image, out=image), limits.min, limits.max, out=image)
    image = np.ascontiguousarray(image).astype(array.dtype, copy=False)
    if inside is not None and not inside.all():
        outside = ~inside if channel_axis is None else np.expand_dims(~inside, channel_axis)
        image = np.where(outside, array, image)
    return image
