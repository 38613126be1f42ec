"""Denoising with the parameters of a plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Unpack, cast

import numpy as np
import numpy.typing as npt

from .. import backends
from ..checks import choice, flag, integer
from ..doors import door
from ..graphs.grid import GridGraph
from ..model.memory import budget
from ..model.problem import NORMS, as_function
from ..model.result import Interrupted, Result, Stop
from ..regularization.one_sweep import one_sweep
from ..regularization.regularize import regularize
from ..solvers import Jacobi, Solver, resolve
from .group_passes import after_passes, method_of
from .guides import filled, guided_by
from .on_device import run_on_device
from .once import fits_one_sweep, is_one_sweep, process_of, step_of
from .options import RUN_PLAN, RunPlan, check_run
from .patch_graph import nearest_patches
from .plan import DenoisePlan
from .prepare import Prepared, prepared
from .raster import Raster
from .split import split

# Options that are also options of a sweep that does not store its weights.
_RUN = ("backend", "dtype", "memory", "progress")


def solve(
    plan: DenoisePlan,
    pixels: npt.NDArray[Any],
    inside: npt.NDArray[np.bool_] | None,
    *,
    guide: npt.ArrayLike | None = None,
    channel_axis: int | None = None,
    **options: Any,
) -> Result:
    """Run a plan of one or more iterations on pixels (..., m).

    `options` are those of :func:`gpureg.regularize` that are not in the plan; `channel_axis` is that of the guide.
    A single sweep at p = 2 does not store its weights, if possible. Patches are averaged only after such a sweep.
    """
    grid = GridGraph(pixels.shape[:-1], plan.radius, plan.metric, spacing=plan.spacing, mask=inside)
    f0 = pixels if inside is None or inside.all() else filled(pixels, inside)
    weights = plan.weights if guide is None else guided_by(plan.weights, guide, grid, channel_axis)
    options["solver"] = process_of(plan, options.get("solver", "jacobi"))
    run = {name: options.pop(name) for name in _RUN if name in options}
    common: dict[str, Any] = {"lam": plan.lam, "eps": plan.eps, "weights": weights, **run}
    process: dict[str, Any] = {"p": plan.p, "max_iter": plan.max_iter, "tol": plan.tol, **options}
    once = fits_one_sweep(plan, options)
    if (plan.average_patches or plan.centre == "largest") and not once:
        what = "average_patches" if plan.average_patches else "centre='largest'"
        raise ValueError(
            f"{what} needs one sweep at p = 2 on a grid, without callback, tol and another norm, gamma or solver; "
            "dataclasses.replace(plan, average_patches=False, centre='once') removes it"
        )
    if plan.k is not None:
        nodes = as_function(grid, f0, "image")
        found = {name: x for name, x in run.items() if name != "progress"}
        graph = nearest_patches(nodes, grid, weights, plan.k, **found)
        result = regularize(nodes, graph, **common, **process)
        return replace(result, value=result.value.reshape(f0.shape))
    if once:
        return one_sweep(f0, grid, step=step_of(plan), frame=plan.frame, **common)
    return regularize(f0, grid, **common, **process)


def without_averaging(plan: DenoisePlan, options: Mapping[str, Any]) -> DenoisePlan:
    """Return the plan, without averaging of patches if the other options do not allow it."""
    groups = tuple((channels, without_averaging(own, options)) for channels, own in plan.groups)
    averages = bool(plan.average_patches) and fits_one_sweep(plan, options)
    return replace(plan, groups=groups, average_patches=plan.average_patches if averages else False)


def expect_one_sweep(plan: DenoisePlan, solver: str | Solver, what: str) -> None:
    """Check that a plan is one sweep at p = 2 with bilateral or patch weights, which the option `what` needs.

    Raises
    ------
    ValueError
    """
    if plan.max_iter > 0 and not (plan.k is None and is_one_sweep(plan, process_of(plan, solver))):
        raise ValueError(
            f"{what} needs one sweep at p = 2 with bilateral or patch weights: leave out p, max_iter, tol, k, "
            "solver and other weights"
        )


@door(options=RUN_PLAN)
def run_plan(plan: DenoisePlan, image: npt.ArrayLike | Raster, **options: Unpack[RunPlan]) -> Result:
    """Denoise an image with the parameters of a plan.

    Parameters
    ----------
    plan : DenoisePlan
        From :func:`gpureg.plan_denoising`.
    image : array
    mask, channel_axis, guide
        As in :func:`denoise_image`.
    norm, gamma, coupled, update_weights, solver, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    Result
        Its value is the denoised image, in the shape and dtype of `image`. One sweep at p = 2 with bilateral or patch
        weights does not store the weights: it returns no energy, and an interruption returns no iterate. A plan with
        several groups of channels returns no energies.

    Raises
    ------
    TypeError, ValueError, BackendUnavailable, FloatingPointError, Interrupted
        As :func:`denoise_image`; also a plan for another number of channels.

    Warns
    -----
    UserWarning
        An array without `channel_axis` that looks like a colour image. Nothing of the noise, which is in the plan.
    """
    begin = time.perf_counter()
    asked = cast("RunPlan", RUN_PLAN | options)
    raster = Raster.of(image, asked["channel_axis"], asked["mask"])
    if not isinstance(plan, DenoisePlan):
        raise TypeError(f"plan must be a DenoisePlan, as gpureg.plan_denoising makes it, got {type(plan).__name__}")
    check_run(asked)
    choice("norm", asked["norm"], NORMS)
    flag("coupled", asked["coupled"])
    if asked["update_weights"] is not None:
        integer("update_weights", asked["update_weights"], low=1)

    def on(own: DenoisePlan, part: Raster) -> Result:
        again = {**asked, "channel_axis": part.channel_axis, "mask": None}
        return run_plan(own, part, **cast("RunPlan", again))

    parts = split(plan, raster, on)
    if parts is not None:
        return parts
    if plan.max_iter == 0 and not plan.replaces_impulses:
        return _nothing_done(raster, asked, begin)
    ready = prepared(plan, raster, asked["dtype"])
    if plan.max_iter == 0:
        return replace(_nothing_done(raster, asked, begin), value=raster.like(ready.back(ready.pixels)))
    more: dict[str, Any] = {name: x for name, x in asked.items() if name not in ("mask", "channel_axis", "dtype")}
    if ready.impulses and is_one_sweep(plan, more["solver"]):
        # the default solver is damped where lam = 0, but a single sweep cannot oscillate
        more["solver"] = replace(cast("Jacobi", resolve(more["solver"])), damping=1)
    kind = raster.chosen_type(asked["dtype"])
    if plan.flat_side and ready.inside is not None and not ready.inside.any():
        # a part inside of such an area
        return _nothing_done(raster, asked, begin)
    raster = replace(raster, inside=ready.inside)
    method = process_of(ready.plan, more["solver"])
    if asked["guide"] is None and fits_one_sweep(ready.plan, more | {"solver": method}):
        direct = run_on_device(ready, raster, asked)
        if direct is not None:
            return replace(direct, seconds=time.perf_counter() - begin)
    with _converted(raster, ready.back):
        result = solve(
            ready.plan, ready.pixels, raster.inside, channel_axis=raster.channel_axis, **more | {"dtype": kind}
        )
        if plan.passes and result.stop is not Stop.CALLBACK:
            result = _with_passes(result, ready, raster, asked)
    # the problem has other channels and another border than the image
    seconds = time.perf_counter() - begin
    return replace(result, value=raster.like(ready.back(result.value)), seconds=seconds, problem=None)


def _nothing_done(raster: Raster, asked: RunPlan, begin: float) -> Result:
    """Return the unchanged image, without the device, whose float32 would round a float64 image."""
    resolve(asked["solver"])
    device = backends.get(asked["backend"], np.float32 if asked["dtype"] is None else asked["dtype"])
    budget(device, asked["memory"])  # raises for a wrong limit
    return Result(
        value=raster.values.copy(),
        iterations=0,
        stop=Stop.MAX_ITER,
        energy=np.empty(0),
        checks=np.empty(0, np.int64),
        gap=None,
        error_bound=None,
        eps=0.0,
        method="Nothing was to be done.",
        backend=repr(device),
        seconds=time.perf_counter() - begin,
    )


def _with_passes(result: Result, ready: Prepared, raster: Raster, asked: RunPlan) -> Result:
    """Return the result of a filter and of the plan's passes after it; an interruption leaves that of the filter."""
    kind = raster.computed_type(asked["dtype"])
    try:
        value = after_passes(
            ready, result.value, raster.inside, backend=asked["backend"], dtype=kind, progress=asked["progress"]
        )
    except KeyboardInterrupt:
        raise Interrupted(replace(result, stop=Stop.INTERRUPTED)) from None
    return replace(result, value=value, method=method_of(ready.plan, result.method))


@contextmanager
def _converted(raster: Raster, back: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]) -> Iterator[None]:
    """Convert the result of an interrupted run to an image."""
    try:
        yield
    except Interrupted as interruption:
        value = raster.like(back(interruption.result.value))
        raise Interrupted(replace(interruption.result, value=value)) from None
