"""What :func:`denoise_nl_means` and :func:`denoise_bilateral` have in common: one step of the model at p = 2."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..graphs.edges import Metric
from ..graphs.grid import GridGraph
from ..solvers import Jacobi
from .borders import cropped, expect_border, padded
from .plan import AveragePatches, Centre, DenoisePlan
from .run import run_plan


def cells_of(array: npt.NDArray[Any], channel_axis: int | None) -> tuple[int, ...]:
    """The shape of the pixels' grid."""
    shape = array.shape
    return shape if channel_axis is None else tuple(np.delete(shape, channel_axis).tolist())


def cell_sizes(spacing: Sequence[float] | None) -> tuple[float, float]:
    """The smallest and the largest side of a cell; of a spacing that is none the grid will tell."""
    if spacing is None or np.ndim(spacing) != 1 or not len(spacing):
        return 1.0, 1.0
    return float(min(spacing)), float(max(spacing))


def map_of(name: str, value: float | npt.ArrayLike, shape: tuple[int, ...]) -> Any:
    """A parameter: a number as it came, or an array of one value per pixel."""
    if np.ndim(value) == 0:
        return value
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be a number or an array of them, got {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"{name} must be a number or one value per pixel, shape {shape}; got shape {array.shape}")
    return array


def one_step(
    array: npt.NDArray[Any],
    weights: Any,
    maps: dict[str, Any],
    *,
    reach: int,
    radius: float,
    centre: Centre,
    average_patches: AveragePatches,
    averaged: int,
    metric: Metric,
    border: str,
    constant: float,
    guide: npt.ArrayLike | None,
    mask: npt.ArrayLike | None,
    spacing: Sequence[float] | None,
    channel_axis: int | None,
    run: dict[str, Any],
) -> npt.NDArray[Any]:
    """One sweep at p = 2 with the weight function that `weights` makes of the maps, beyond borders of any kind."""
    beyond = expect_border(border)
    shape = cells_of(array, channel_axis)
    grid = GridGraph(shape, radius, metric, spacing=spacing)
    cells = array if channel_axis is None else np.moveaxis(array, channel_axis, -1)
    axis = None if channel_axis is None else -1
    compared = None
    if guide is not None:
        compared = np.asarray(guide)
        if channel_axis is not None and compared.ndim == array.ndim:
            compared = np.moveaxis(compared, channel_axis, -1)
    # So far that neither a window nor the patches in it end inside what is kept.
    widths = (0,) * grid.ndim
    if beyond != "clip":
        steps = np.array(grid.spacing or (1.0,) * grid.ndim)
        beside = reach + (averaged if average_patches else 0)
        if not math.isfinite(radius):
            raise ValueError(
                f"an infinite window needs border='clip', got {border!r}: beyond the border there is no end"
            )
        widths = tuple((np.floor(radius / steps + 1e-9).astype(int) + beside).tolist())
        cells = padded(cells, widths, beyond, constant)
        repeated = "nearest" if beyond == "constant" else beyond
        maps = {name: x if np.ndim(x) == 0 else padded(np.asarray(x), widths, repeated) for name, x in maps.items()}
        mask = None if mask is None else padded(np.asarray(mask), widths, beyond, True)
        compared = None if compared is None else padded(compared, widths, beyond, constant)
    plan = DenoisePlan(
        sigma=None,
        estimated=False,
        weights=weights({name: x if np.ndim(x) == 0 else np.ravel(x) for name, x in maps.items()}),
        radius=float(radius),
        metric=metric,
        p=2.0,
        lam=maps["lam"],
        max_iter=1,
        spacing=grid.spacing,
        centre=centre,
        average_patches=average_patches,
        average_radius=averaged,
    )
    # lam = 0 is the plain sweep, whatever the graph: a step is no iteration that could swing
    result = run_plan(plan, cells, solver=Jacobi(damping=1), guide=compared, mask=mask, channel_axis=axis, **run).value
    kept = cropped(result, widths)
    return kept if channel_axis is None else np.ascontiguousarray(np.moveaxis(kept, -1, channel_axis))
