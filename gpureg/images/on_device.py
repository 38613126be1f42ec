"""Run a plan on an image that goes to the device once and comes back once: :func:`run_on_device`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..backends import Array, Backend
from ..checks import number
from ..frame import Frame
from ..graphs.grid import GridGraph
from ..model.memory import budget
from ..model.problem import as_lam, as_pinned, known_rows, real_type
from ..model.result import Interrupted, Result, Stop
from ..regularization.one_sweep import device_step, fits_device, one_sweep
from ..solvers.loop import expect_finite
from ..weights import Weights
from .group_passes import after_filter, method_of, suits_passes
from .guides import filled
from .once import step_of
from .options import RunPlan
from .prepare import Prepared
from .raster import Raster


@dataclass(frozen=True, eq=False)
class _Image:
    """An image on its way to a device and back.

    Attributes
    ----------
    ready : Prepared
    raster : Raster
        The image, with the cells that take part.
    grid : GridGraph
    frame : Frame
        The units of its function.
    device : Backend
    """

    ready: Prepared
    raster: Raster
    grid: GridGraph
    frame: Frame
    device: Backend

    def put(self) -> Array:
        """Copy the image to the device, as a function in the units of the frame."""
        cells, inside = self.ready.cells, self.raster.inside
        if inside is not None and not inside.all():
            cells = filled(cells, inside)
        return self.device.put_cells(self.grid, cells, frame=self.frame, units=self.ready.plan.units)

    def back(self, f: Array, lam: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the image of a device function, in the shape and type of the given image.

        Where lam is infinite and outside the mask it has the given values.
        """
        raster = self.raster
        out = np.empty(raster.values.shape, raster.values.dtype)
        cells = out[..., None] if raster.channel_axis is None else np.moveaxis(out, raster.channel_axis, -1)
        self.device.get_cells(self.grid, f, cells, frame=self.frame, units=self.ready.plan.units)
        pinned = np.isinf(lam)
        if pinned.any():
            out = raster.unchanged(out, np.broadcast_to(pinned, (self.grid.n_vertices, 1)).reshape(self.grid.shape))
        return out if raster.inside is None or raster.whole else raster.unchanged(out, ~raster.inside)


def run_on_device(ready: Prepared, raster: Raster, asked: RunPlan) -> Result | None:
    """Make the single sweep of a plan and its passes without copies to the host between them.

    Parameters
    ----------
    ready : Prepared
        The image and its plan, of one sweep at p = 2 with patch weights.
    raster : Raster
        The image, with the cells that take part.
    asked : dict
        The options of :func:`gpureg.run_plan`; there is no guide.

    Returns
    -------
    Result or None
        None if no passes follow and the image does not fit the device as a whole, so that the sweep is made in tiles;
        or if the passes have other units than the sweep.

    Notes
    -----
    Several devices share the sweep in tiles. The passes are made on the first of them, from the function in the units
    of the frame: so the bits do not depend on the number of tiles.
    """
    plan = ready.plan
    weights = plan.weights
    if not isinstance(weights, Weights) or not suits_passes(plan) or (plan.frame is None and plan.units):
        return None
    grid = GridGraph(raster.shape, plan.radius, plan.metric, spacing=plan.spacing, mask=raster.inside)
    lam = as_pinned(grid, as_lam(grid, plan.lam))
    cells = ready.cells.reshape(grid.n_vertices, -1)
    frame = plan.frame or Frame.of(known_rows(grid, cells, lam))
    scaled = weights.on(grid).scaled(frame.scale)
    if scaled is None:
        return None
    eps = 0.0 if plan.eps is None else number("eps", plan.eps, low=0)
    kind = raster.chosen_type(asked["dtype"])
    if kind is None:
        kind = real_type(frame, cells, plan.units)
    devices, step = backends.several(asked["backend"], kind), step_of(plan)
    device = devices[0]
    job = step.job(device, grid, raster.channels, scaled, lam)
    whole = len(devices) == 1 and fits_device(job, grid, device, budget(device, asked["memory"]))
    if not whole and not plan.passes:
        return None
    image = _Image(ready, raster, grid, frame, device)

    def result(f: Array, method: str) -> Result:
        return Result.bare(
            image.back(f, lam),
            iterations=1,
            stop=Stop.MAX_ITER,
            eps=eps,
            method=method,
            backend=repr(device) if filtered is None else filtered.backend,
            seconds=0.0,
        )

    filtered, method = None, f"{step.method}."
    with np.errstate(over="ignore", invalid="ignore"):
        data = image.put()
        if whole:
            f = device_step(device, grid, data, lam=lam, weights=scaled, step=step)
            if not math.isfinite(device.dot(grid, f, f)):
                expect_finite(device, 1, math.nan)
        else:
            run: dict[str, Any] = {name: asked[name] for name in ("backend", "memory", "progress")}
            pixels = ready.pixels if grid.mask is None or grid.mask.all() else filled(ready.pixels, grid.mask)
            filtered = one_sweep(
                pixels, grid, lam=plan.lam, weights=weights, dtype=kind, step=step, frame=frame, in_frame=True, **run
            )
            f, method = device.put(grid, filtered.value.reshape(grid.n_vertices, -1)), filtered.method
    if not plan.passes:
        return result(f, method)
    try:
        value = after_filter(device, grid, data, f, plan, profile=ready.profile, progress=asked["progress"])
    except KeyboardInterrupt:
        raise Interrupted(replace(result(f, method), stop=Stop.INTERRUPTED)) from None
    return result(value, method_of(plan, method))
