"""Run a plan on an image without its thin axes, and on groups of its channels: :func:`split`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..model.result import Interrupted, Result, Stop
from .noise import equal_channels
from .plan import DenoisePlan
from .raster import Raster

Run = Callable[[DenoisePlan, Raster], Result]


def split(plan: DenoisePlan, raster: Raster, run: Run) -> Result | None:
    """Run a plan on the image without its thin axes, or on its groups of channels.

    Returns
    -------
    Result or None
        None if there is nothing to split; then the plan is for the image as it is.

    Raises
    ------
    ValueError
        The plan is for another number of channels.
    Interrupted
        With the whole image.
    """
    if raster.thin_axes and 0 < len(plan.window) < raster.ndim:
        return _without_thin_axes(plan, raster, run)
    return _in_groups(plan, raster, run) if plan.groups else None


def _without_thin_axes(plan: DenoisePlan, raster: Raster, run: Run) -> Result:
    inner = raster.without_thin_axes()
    lam = plan.lam if np.ndim(plan.lam) == 0 else np.reshape(plan.lam, inner.shape)

    def whole(result: Result) -> Result:
        value = result.value.reshape(raster.cells.shape)
        value = value[..., 0] if raster.channel_axis is None else np.moveaxis(value, -1, raster.channel_axis)
        return replace(result, value=np.ascontiguousarray(value))

    try:
        return whole(run(replace(plan, lam=lam), inner))
    except Interrupted as interruption:
        raise Interrupted(whole(interruption.result)) from None


def _in_groups(plan: DenoisePlan, raster: Raster, run: Run) -> Result:
    """Denoise groups of channels one after the other, each with its plan."""
    begin = time.perf_counter()
    if raster.channel_axis is None or len(plan.same) != raster.channels:
        raise ValueError(f"the plan is for {len(plan.same)} channels, the image has {raster.channels}")
    groups, same = _groups_of(plan, raster)
    axis = raster.channel_axis
    value = raster.values.copy()
    cells = np.moveaxis(value, axis, -1)
    results: list[Result] = []

    def put(channels: Sequence[int], found: npt.NDArray[Any]) -> None:
        cells[..., list(channels)] = np.moveaxis(found, axis, -1)

    def finish() -> npt.NDArray[Any]:
        for channel, first in enumerate(same):
            if channel != first:
                cells[..., channel] = cells[..., first]
        return value

    for channels, own in groups:
        try:
            result = run(own, raster.only(channels))
        except Interrupted as interruption:
            put(channels, interruption.result.value)
            raise Interrupted(replace(interruption.result, value=finish())) from None
        put(channels, result.value)
        results.append(result)
        if result.stop is Stop.CALLBACK:
            break
    longest = max(results, key=lambda result: (result.stop is Stop.MAX_ITER, result.iterations))
    changed: dict[str, Any] = {"value": finish(), "seconds": time.perf_counter() - begin}
    if len(results) > 1:
        # energies of different channels do not belong together
        changed |= {"energy": np.empty(0), "checks": np.empty(0, np.int64), "gap": None, "error_bound": None}
        changed["method"] = f"{longest.method} In {len(results)} groups of channels."
    return replace(longest, **changed)


def _groups_of(
    plan: DenoisePlan, raster: Raster
) -> tuple[tuple[tuple[tuple[int, ...], DenoisePlan], ...], tuple[int, ...]]:
    """Return the groups for an image, and for each channel the first that is equal.

    Channels that were equal where the plan was made, and differ here, have the same plan, one by one.
    """
    groups, same = plan.groups, list(plan.same)
    for channel, first in enumerate(plan.same):
        if channel == first or equal_channels(raster, channel, first):
            continue
        own = next((own for channels, own in plan.groups if channels == (first,)), None)
        if own is None:
            raise ValueError(
                f"the plan is for an image whose channels {first} and {channel} are equal, and here they are not: make "
                "a plan for this image"
            )
        groups, same[channel] = (*groups, ((channel,), own)), channel
    return groups, tuple(same)
