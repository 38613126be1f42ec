"""Denoise an image part by part, with halos that give the same bits as the whole, in less memory of the process."""

from __future__ import annotations

import gc
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..backends import Backend, Chosen
from ..graphs.grid import GridGraph
from ..model.memory import Job, Need, process_limit, readable
from ..model.result import Interrupted, Result
from ..progress import progress_bar
from ..regularization.one_sweep import OneStep
from ..regularization.sharing import Shared
from ..regularization.tiling import Tile, Tiling, cut
from ..solvers import Solver
from ..weights import Weights, patch_weights
from .group_passes import bytes_of_passes
from .plan import DenoisePlan
from .prepare import reach_of
from .raster import Raster
from .run import expect_one_sweep, run_plan
from .split import split

# Bytes of a value in the arrays of a run beside those of the device: as a float before and after, and copies of both.
_HOST = 6
# Into how many parts an axis may be cut.
_CUTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 256, 512, 1024)
# Memory of a run for which more is not much faster: halos take 5 to 35 percent of the work. For less than the second
# number nothing is saved beside the libraries.
_ENOUGH, LEAST = 1 << 28, 1 << 26
# Values above which a run may have twice that: the image itself takes more.
_LARGE = 1 << 25


def tiles_of(
    plan: DenoisePlan,
    shape: tuple[int, ...],
    channels: int,
    *,
    solver: str | Solver,
    backend: Chosen,
    dtype: np.dtype[Any],
    masked: bool,
    memory: int,
) -> tuple[Tile, ...] | None:
    """Cut an image of this shape, without its channels, into parts that need at most `memory` bytes each.

    Returns
    -------
    tuple of Tile or None
        None if the plan has to see the whole image: it is more than one sweep, or its weights have no parts.

    Raises
    ------
    MemoryError
        Even a small part with its halo needs more.
    """
    active = [own for own in _plans(plan) if own.max_iter > 0]
    device = backends.get(backend, dtype)
    edges = _edges(plan, shape, solver, device, masked=masked)
    if edges is None:
        return None
    halo, blocks = edges
    if not active:
        rows = max(1, memory // max(1, channels * math.prod(shape[1:]) * dtype.itemsize * _HOST))
        return cut(shape, (min(rows, shape[0]), *shape[1:]), halo, (1,) * len(shape))

    def wide(sizes: tuple[int, ...]) -> tuple[int, ...]:
        whole = zip(shape, sizes, halo, blocks, strict=True)
        return tuple(n if s >= n else min(n, s + 2 * h + b - 1) for n, s, h, b in whole)

    def needs(sizes: tuple[int, ...]) -> int:
        return max(_bytes(own, _grid(own, wide(sizes)), channels, device) for own in active)

    if needs(shape) <= memory and 1 in _CUTS:
        everything = tuple(slice(0, n) for n in shape)
        return (Tile(everything, everything),)
    candidates = [sorted({-(-n // k) for k in _CUTS if k <= n}) for n in shape]
    per_pixel = needs(shape) / math.prod(shape)
    while True:
        fitting = [sizes for sizes in itertools.product(*candidates) if math.prod(wide(sizes)) * per_pixel <= memory]
        if not fitting:
            least = tuple(each[0] for each in candidates)
            raise MemoryError(
                f"a part of {' x '.join(map(str, least))} pixels with its halo needs {readable(needs(least))}, "
                f"and {readable(memory)} are allowed: give more memory, or use a smaller window"
            )
        # the cheapest: the fewest pixels are computed twice
        sizes = min(fitting, key=lambda sizes: math.prod(w / s for w, s in zip(wide(sizes), sizes, strict=True)))
        if needs(sizes) <= memory:
            return cut(shape, sizes, halo, blocks)
        per_pixel *= 1.05 * needs(sizes) / (math.prod(wide(sizes)) * per_pixel)


def _plans(plan: DenoisePlan) -> list[DenoisePlan]:
    """Return the plans of all groups of channels, or the plan."""
    return [own for _, own in plan.groups] or [plan]


def _edges(
    plan: DenoisePlan, shape: tuple[int, ...], solver: str | Solver, device: Backend, *, masked: bool
) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Return the halo of a part along each axis, and the sides of which it begins at multiples; None: no parts."""
    plans = _plans(plan)
    active = [own for own in plans if own.max_iter > 0]
    halos = [_halo(own, shape, solver, masked=masked or own.flat_side > 0) for own in active]
    reaches = [(reach_of(own, len(shape)),) * len(shape) for own in plans]
    known = [halo for halo in halos if halo is not None]
    if len(known) < len(active):
        return None
    return tuple(max(each) for each in zip(*known, *reaches, strict=True)), _blocks(plans, len(shape), device)


def _blocks(plans: Sequence[DenoisePlan], ndim: int, device: Backend) -> tuple[int, ...]:
    """Return the sides of which a part may begin at multiples: devices, and passes on groups, sum in blocks."""
    sides = [(*[1] * ndim, device.row_block, device.column_block)[-ndim:]]
    sides += [each.block for own in plans for each in own.passes]
    return tuple(math.lcm(*axis) for axis in zip(*sides, strict=True))


def _grid(plan: DenoisePlan, shape: tuple[int, ...]) -> GridGraph:
    """Return the grid of a plan."""
    return GridGraph(shape, plan.radius, plan.metric, spacing=plan.spacing)


def _halo(plan: DenoisePlan, shape: tuple[int, ...], solver: str | Solver, *, masked: bool) -> tuple[int, ...] | None:
    """Return the distance along each axis of the pixels on which a pixel depends; None if the plan has no parts."""
    found = patch_weights(plan.weights)
    grid = _grid(plan, shape)
    if found is None or plan.k is not None or not isinstance(plan.weights, Weights):
        return None
    if plan.weights.part(grid, tuple(slice(0, n) for n in shape)) is None:
        return None
    try:
        expect_one_sweep(plan, solver, "a part")
    except ValueError:
        return None
    averaged = (found[0].reach if plan.average_radius is None else plan.average_radius) if plan.average_patches else 0
    # a pixel that a mask leaves out takes the value of the nearest inside, at most a patch away
    beyond = averaged + plan.weights.reach * (3 if masked else 1) + reach_of(plan, len(shape))
    reach = np.abs(grid.offsets).max(axis=0, initial=0) + beyond
    for each in plan.passes:
        reach = reach + each.beyond(masked=masked)
    return tuple(reach.tolist())


def _bytes(plan: DenoisePlan, grid: GridGraph, channels: int, device: Backend) -> int:
    """Return the bytes of one sweep and of passes on a grid: on the device, and in the process."""
    by_weight = plan.average_patches == "weighted"
    step = OneStep(plan.centre == "largest", 0 if plan.average_patches else None, by_weight)
    stored = bool(plan.average_patches) and not step.fuses(device, grid)
    maps = bool(plan.average_patches) or np.ndim(plan.lam) > 0 or bool(plan.photon) or plan.replaces_impulses
    job = Job(channels + stored, weights=plan.weights, per_vertex=maps, stored=stored)  # type: ignore[arg-type]
    # the memory of a GPU is not that of the process; its own limit cuts tiles of a part
    on_device = 0 if device.device.kind == "gpu" else job.need(grid, device).total
    # passes begin when the arrays of the filter are free
    needed = max(on_device, bytes_of_passes(plan.passes, grid, channels, device)) if plan.passes else on_device
    return needed + grid.n_vertices * channels * device.dtype.itemsize * _HOST


def working_set(limit: int, values: int) -> int:
    """Return the bytes that the run on a part may need where this many are allowed, for an image of so many values."""
    return min(LEAST + limit, _ENOUGH if values <= _LARGE else 2 * _ENOUGH)


def part_of(plan: DenoisePlan, shape: tuple[int, ...], tile: Tile) -> DenoisePlan:
    """Return the plan for a part: maps are cut as the image is."""
    groups = tuple((channels, part_of(own, shape, tile)) for channels, own in plan.groups)
    lam, weights = plan.lam, plan.weights
    if np.ndim(lam):
        lam = np.asarray(lam).reshape(shape)[tile.wide]
    if isinstance(weights, Weights) and plan.max_iter > 0:
        weights = weights.part(_grid(plan, shape), tile.wide) or weights
    noise = None if plan.noise is None else plan.noise.part_of(shape, tile)
    return replace(plan, lam=lam, weights=weights, noise=noise, groups=groups)


def run_in_parts(
    plan: DenoisePlan,
    raster: Raster,
    *,
    out: npt.NDArray[Any] | None = None,
    guide: npt.ArrayLike | None = None,
    progress: bool = False,
    **run: Any,
) -> Result:
    """Run a plan as :func:`run_plan`, with the same bits, part by part if that saves memory.

    Parameters
    ----------
    plan : DenoisePlan
    raster : Raster
    out : array, optional
        Where the result is written, in the shape and type of the image. None means a new array.
    guide, progress, run
        As the options of :func:`run_plan`.

    Raises
    ------
    Interrupted
        With the whole image; parts that are not begun are those of the noisy image.
    """
    if raster.thin_axes:

        def on(own: DenoisePlan, part: Raster) -> Result:
            return run_in_parts(own, part, guide=guide, progress=progress, **run)

        result = split(plan, raster, on)
        if result is not None:
            if out is None:
                return result
            out[...] = result.value
            return replace(result, value=out)
    limit = process_limit(run.get("memory"))
    kind = raster.computed_type(run.get("dtype"))
    tiles = None
    if run.get("callback") is None and run.get("update_weights") is None:
        tiles = tiles_of(
            plan,
            raster.shape,
            raster.channels,
            solver=run.get("solver", "jacobi"),
            backend=run.get("backend", "auto"),
            dtype=kind,
            masked=not raster.whole,
            memory=working_set(limit.bytes, raster.values.size),
        )
    if tiles is None or len(tiles) == 1:
        result = _run(plan, raster, guide, progress=progress, **run)
        if out is None:
            return result
        out[...] = result.value
        return replace(result, value=out)
    value = np.empty(raster.values.shape, raster.values.dtype) if out is None else out
    target = value[..., None] if raster.channel_axis is None else np.moveaxis(value, raster.channel_axis, -1)
    compared = None if guide is None else _channels_last(np.asarray(guide), raster)
    results = list[Result]()
    with progress_bar(progress, len(tiles), "parts") as done:
        for i, tile in enumerate(tiles):
            done(i)
            part = Raster(raster.cells[tile.wide], None if raster.inside is None else raster.inside[tile.wide], -1)
            beside = None if compared is None else compared[tile.wide]
            try:
                target[tile.own], result = run_part(part_of(plan, raster.shape, tile), part, tile, beside, **run)
            except Interrupted as interruption:
                target[tile.own] = interruption.result.value[tile.inner]
                for later in tiles[i + 1 :]:
                    target[later.own] = raster.cells[later.own]
                raise Interrupted(replace(interruption.result, value=value)) from None
            results.append(result)
        done(len(tiles))
    return replace(joined(results), value=value)


def run_part(
    plan: DenoisePlan, part: Raster, tile: Tile, guide: npt.NDArray[Any] | None, **run: Any
) -> tuple[npt.NDArray[Any], Result]:
    """Run the plan of a part on it; return the values of its interior with the channels, and the result without."""
    if part.inside is not None and not part.inside.any():
        nothing = replace(plan, max_iter=0, groups=(), impulses=())
        result = run_plan(nothing, part, channel_axis=-1, **run)
    else:
        result = _run(plan, part, guide, **run)
    return result.value[tile.inner], replace(result, value=np.empty(0))


def _run(plan: DenoisePlan, raster: Raster, guide: npt.ArrayLike | None, **run: Any) -> Result:
    """Run a plan; in halves with the same bits if the memory of the device runs out.

    Raises
    ------
    MemoryError
        The plan has no parts, or not even a part that is hardly larger than its halo fits.
    """
    try:
        return run_plan(plan, raster, guide=guide, channel_axis=raster.channel_axis, **run)
    except MemoryError as error:
        if type(error) is MemoryError:  # a limit, not the memory of a device or of the process
            raise
        said = str(error)
    # only now has the error let go of the arrays
    gc.collect()
    device = backends.get(run.get("backend", "auto"), raster.computed_type(run.get("dtype")))
    device.release()
    edges = None
    if run.get("callback") is None and run.get("update_weights") is None:
        edges = _edges(plan, raster.shape, run.get("solver", "jacobi"), device, masked=not raster.whole)
    if edges is None:
        raise MemoryError(f"{said}. The plan depends on the whole image, and is not made in parts")
    return _in_halves(
        plan, raster, guide, replace(Tiling.whole(raster.shape, *edges), full=device.device.id), said, run
    )


def _in_halves(
    plan: DenoisePlan, raster: Raster, guide: npt.ArrayLike | None, tiling: Tiling, said: str, run: dict[str, Any]
) -> Result:
    """Run a plan on the halves of an image, and on the halves of those for which the memory of the device runs out."""
    device = backends.get(run.get("backend", "auto"), raster.computed_type(run.get("dtype")))
    halves = tiling.halves(tiling.tiles[0])
    if not halves:
        raise MemoryError(f"{said}. A part of the image is hardly smaller than the image, with its halo")
    value = np.empty(raster.values.shape, raster.values.dtype)
    target = value[..., None] if raster.channel_axis is None else np.moveaxis(value, raster.channel_axis, -1)
    compared = None if guide is None else _channels_last(np.asarray(guide), raster)
    left = np.ones(raster.shape, bool)

    def work(on: Backend, tile: Tile) -> Result:
        part = Raster(raster.cells[tile.wide], None if raster.inside is None else raster.inside[tile.wide], -1)
        beside = None if compared is None else compared[tile.wide]
        own = part_of(plan, raster.shape, tile)
        result = run_plan(own, part, guide=beside, channel_axis=-1, **run)
        target[tile.own], left[tile.own] = result.value[tile.inner], False
        return result

    def need(tile: Tile) -> Need:
        needed = max(_bytes(own, _grid(own, tile.shape), raster.channels, device) for own in _plans(plan))
        return Need(needed, needed)

    shared: Shared[Result] = Shared([device], replace(tiling, tiles=halves), need)
    try:
        results = shared.run(work)
    except Interrupted as interruption:
        target[left] = raster.cells[left]
        raise Interrupted(replace(interruption.result, value=value)) from None
    shared.warn()
    result = joined(results)
    return replace(result, value=value, method=f"{result.method.removesuffix('.')}{shared.told}.")


def joined(results: list[Result]) -> Result:
    """Return the result of all parts, without its value."""
    first = max(results, key=lambda result: result.iterations)
    return replace(first, seconds=sum(result.seconds for result in results))


def _channels_last(guide: npt.NDArray[Any], raster: Raster) -> npt.NDArray[Any]:
    """Return a guide with its channels last, if it has any."""
    if raster.channel_axis is None or guide.ndim == raster.ndim:
        return guide
    return np.moveaxis(guide, raster.channel_axis, -1)
