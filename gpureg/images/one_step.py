"""One sweep of the model at p = 2, for :func:`denoise_nl_means` and :func:`denoise_bilateral`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graphs.grid import GridGraph
from ..model.result import Interrupted
from ..regularization.options import RUN
from ..solvers import Jacobi
from ..weights import Weights
from .borders import cropped, padded
from .options import Filter, map_of
from .parts import run_in_parts
from .plan import AveragePatches, DenoisePlan
from .raster import Raster


def one_step(
    raster: Raster,
    weights: Callable[[dict[str, Any]], Weights],
    maps: dict[str, Any],
    asked: Filter,
    *,
    radius: float,
    reach: int = 0,
    average_patches: AveragePatches = False,
    averaged: int = 0,
) -> npt.NDArray[Any]:
    """Make one sweep at p = 2, with any kind of border.

    Parameters
    ----------
    raster : Raster
        The image.
    weights : callable
        Makes the weight function from the maps, each a number or (n,).
    maps : dict
        Parameters of the weights: numbers, or arrays of the image's pixels.
    asked : Filter
        All options.
    radius : float
        Radius of the window.
    reach : int, default 0
        Radius of the patches that the weights compare.
    average_patches : bool or "weighted", default False
    averaged : int, default 0
        Radius of the patches that are averaged.
    """
    beyond, constant = asked["border"], asked["constant"]
    grid = GridGraph(raster.shape, radius, asked["metric"], spacing=asked["spacing"])
    last = None if raster.channel_axis is None else -1
    cells = raster.values if last is None else raster.cells
    inside, compared = raster.inside, None
    maps = maps | {"lam": 0.0 if asked["centre"] == "none" else map_of("lam", asked["lam"], raster.shape)}
    if asked["guide"] is not None:
        compared = np.asarray(asked["guide"])
        if raster.channel_axis is not None and compared.ndim == raster.values.ndim:
            compared = np.moveaxis(compared, raster.channel_axis, -1)
    # Wide enough that neither a window nor its patches are clipped.
    widths = (0,) * grid.ndim
    if beyond != "clip":
        steps = np.array(grid.spacing or (1.0,) * grid.ndim)
        beside = reach + (averaged if average_patches else 0)
        if not math.isfinite(radius):
            raise ValueError(f"an infinite window needs border='clip', got {beyond!r}: the padding would be infinite")
        widths = tuple((np.floor(radius / steps + 1e-9).astype(int) + beside).tolist())
        cells = padded(cells, widths, beyond, constant)
        repeated = "nearest" if beyond == "constant" else beyond
        maps = {name: x if np.ndim(x) == 0 else padded(np.asarray(x), widths, repeated) for name, x in maps.items()}
        inside = None if inside is None else padded(inside, widths, beyond, True)
        compared = None if compared is None else padded(compared, widths, beyond, constant)
    plan = DenoisePlan(
        sigma=None,
        estimated=False,
        weights=weights({name: x if np.ndim(x) == 0 else np.ravel(x) for name, x in maps.items()}),
        radius=float(radius),
        metric=asked["metric"],
        p=2.0,
        lam=maps["lam"],
        max_iter=1,
        spacing=grid.spacing,
        centre=asked["centre"],
        average_patches=average_patches,
        average_radius=averaged,
    )
    run: dict[str, Any] = {name: x for name, x in asked.items() if name in RUN}
    # No damping for lam = 0 on any graph: a single sweep cannot oscillate.
    wide = replace(raster, values=cells, inside=inside, channel_axis=last)

    def as_image(value: npt.NDArray[Any]) -> npt.NDArray[Any]:
        image = cropped(value, widths)
        axis = raster.channel_axis
        return image if axis is None else np.ascontiguousarray(np.moveaxis(image, -1, axis))

    try:
        return as_image(run_in_parts(plan, wide, solver=Jacobi(damping=1), guide=compared, **run).value)
    except Interrupted as interruption:
        result = interruption.result
        raise Interrupted(replace(result, value=as_image(result.value))) from None
