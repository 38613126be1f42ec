"""Denoising by a plan."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..graphs.grid import GridGraph
from ..model.memory import budget
from ..model.problem import as_function, default_eps
from ..model.result import Interrupted, Result, Stop
from ..regularization.one_sweep import OneStep, one_sweep
from ..regularization.regularize import regularize
from ..solvers import Jacobi, Solver, resolve
from ..solvers.loop import Callback
from ..weights import patch_weights
from .guides import filled, guided_by
from .patch_graph import nearest_patches
from .plan import DenoisePlan
from .raster import as_image, checked, pixels_of


def solve(
    plan: DenoisePlan,
    pixels: npt.NDArray[Any],
    inside: npt.NDArray[np.bool_] | None,
    *,
    solver: str | Solver = "jacobi",
    callback: Callback | None = None,
    guide: npt.ArrayLike | None = None,
    channel_axis: int | None = None,
    model: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Result:
    """Carry out a plan of one iteration or more on pixels (..., m).

    `settings` are the backend, dtype, memory and progress of :func:`gpureg.regularize`, `model` what else it takes;
    `channel_axis` is that of the guide. One sweep at p = 2 with weights that need not be stored takes the way that
    stores none; patches are averaged after such a sweep alone.
    """
    grid = GridGraph(pixels.shape[:-1], plan.radius, plan.metric, spacing=plan.spacing, mask=inside)
    f0 = pixels if inside is None or inside.all() else filled(pixels, inside)
    eps = default_eps(f0, plan.p) if plan.eps is None else plan.eps
    weights = plan.weights if guide is None else guided_by(plan.weights, guide, grid, channel_axis)
    common: dict[str, Any] = {"lam": plan.lam, "eps": eps, "weights": weights, **settings}
    process: dict[str, Any] = {"p": plan.p, "solver": solver, "max_iter": plan.max_iter, "tol": plan.tol}
    process |= {"callback": callback, **(model or {})}
    once = callback is None and _is_plain(model or {}) and _is_one_sweep(plan, solver)
    if (plan.average_patches or plan.centre == "largest") and (plan.nearest is not None or not once):
        what = "patches are averaged" if plan.average_patches else "a centre as heavy as the largest weight counts"
        raise ValueError(
            f"{what} in one plain sweep at p = 2 on a grid alone, without a callback, tol, another norm, gamma or "
            "solver; dataclasses.replace(plan, average_patches=False, centre='once') leaves it out"
        )
    if plan.nearest is not None:
        nodes = as_function(grid, f0, "image")
        backend, dtype = settings.get("backend", "auto"), settings.get("dtype", np.float32)
        graph = nearest_patches(nodes, grid, weights, plan.nearest, backend=backend, dtype=dtype)
        result = regularize(nodes, graph, **common, **process)
        return replace(result, value=result.value.reshape(f0.shape))
    if once:
        return one_sweep(f0, grid, step=_one_step(plan), **common)
    return regularize(f0, grid, **common, **process)


def without_averaging(
    plan: DenoisePlan, *, solver: str | Solver, callback: Callback | None, model: Mapping[str, Any]
) -> DenoisePlan:
    """The plan, its averaging of patches left out where what else is asked for does not go with it."""
    fits = callback is None and _is_plain(model) and _is_one_sweep(plan, solver)
    return plan if fits or not plan.average_patches else replace(plan, average_patches=False)


def _one_step(plan: DenoisePlan) -> OneStep:
    """What the plan's one sweep does besides the book."""
    found = patch_weights(plan.weights)
    assert found is not None
    averaged = found[0].reach if plan.average_radius is None else plan.average_radius
    by_weight = plan.average_patches == "weighted"
    return OneStep(plan.centre == "largest", averaged if plan.average_patches else None, by_weight)


def _is_plain(model: Mapping[str, Any]) -> bool:
    """Whether nothing of the model but what a plan says is other than by default (at p = 2 channels are alone)."""
    gamma = model.get("gamma", "sqrt")
    by_name = isinstance(gamma, str) and gamma == "sqrt"
    return by_name and model.get("norm", "vertex") == "vertex" and model.get("update_weights") is None


def _is_one_sweep(plan: DenoisePlan, solver: str | Solver) -> bool:
    """Whether :func:`one_sweep` does what the plan asks for: one sweep by the book, at p = 2, of patch weights."""
    method = resolve(solver)
    whole = isinstance(method, Jacobi) and method.damping in (None, 1)
    # where data are missing the default may be damped
    filters = bool(plan.average_patches) or plan.centre == "largest"
    data = isinstance(method, Jacobi) and (method.damping == 1 or filters or bool(np.min(plan.lam) > 0))
    once = plan.p == 2 and plan.max_iter == 1 and plan.tol is None
    return once and whole and data and patch_weights(plan.weights) is not None


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
            error_bound=None,
            eps=0.0,
            method="Nothing was to be done.",
            backend=name,
            seconds=time.perf_counter() - begin,
        )
    pixels = pixels_of(array, channel_axis, dtype)
    inside = None if mask is None else np.asarray(mask)
    with _converted(array, channel_axis, inside):
        result = solve(
            plan,
            pixels,
            inside,
            solver=solver,
            callback=callback,
            guide=guide,
            channel_axis=channel_axis,
            model=model,
            backend=backend,
            dtype=pixels.dtype,
            memory=memory,
            progress=progress,
        )
    value = as_image(result.value, array, channel_axis, inside)
    return replace(result, value=value, seconds=time.perf_counter() - begin)


@contextmanager
def _converted(
    array: npt.NDArray[Any], channel_axis: int | None, inside: npt.NDArray[np.bool_] | None
) -> Iterator[None]:
    """Let the result of an interrupted run be an image too."""
    try:
        yield
    except Interrupted as interruption:
        value = as_image(interruption.result.value, array, channel_axis, inside)
        raise Interrupted(replace(interruption.result, value=value)) from None
