"""One sweep at p = 2 with weights that are not stored, as the filters do."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, all_finite, computed_type
from ..backends import Array, Backend, Chosen, Weighted, over_patches
from ..frame import Frame
from ..graphs.grid import GridGraph
from ..model.memory import Budget, Job, budget_of
from ..model.problem import Problem
from ..model.result import Result, Stop
from ..progress import progress_bar
from ..solvers.loop import expect_finite
from ..weights import PatchWeights, Weights, patch_weights
from .results import as_given
from .sharing import Shared, shares
from .tiling import Tile, Tiling, blocks_of, halo, need_of, part_problem, tiling, without_halo, work_of

# Bytes per tile of a sweep without stored weights.
_STEP_BYTES = 1 << 29


def one_sweep(
    f0: npt.ArrayLike,
    graph: GridGraph,
    *,
    lam: float | npt.ArrayLike,
    weights: Weights | npt.ArrayLike,
    eps: float | None = None,
    backend: Chosen = "auto",
    dtype: npt.DTypeLike | None = None,
    memory: int | None = None,
    progress: bool = False,
    step: OneStep | None = None,
    frame: Frame | None = None,
    in_frame: bool = False,
) -> Result:
    """Do one undamped Jacobi sweep at p = 2, as :func:`regularize`, with weights that are not stored.

    `weights` are bilateral or patch weights. The result has no energy, which would need stored weights. After an
    interruption there is no iterate. `step` describes differences from a sweep of eq. 25; `frame` are the units
    in which to compute, None to choose them from the data. With `in_frame` the result stays in these units.
    """
    begin = time.perf_counter()
    kind = None if dtype is None else computed_type(dtype)
    problem = Problem.make(f0, graph, lam=lam, weights=weights, eps=eps, dtype=kind, framed=frame or True)
    devices = backends.several(backend, problem.f0.dtype)
    step = OneStep() if step is None else step
    # devices share a step only if all of them do it in the same way
    devices = tuple(one for one in devices if step.fuses(one, graph) == step.fuses(devices[0], graph))
    allowed = budget_of(devices, memory)
    job = step.job(devices[0], graph, problem.f0.shape[1], problem.weights, problem.lam)
    tiles = _tiles_of_a_step(problem, job, devices, allowed, step.halo(problem))
    if len(tiles.tiles) == 1:
        devices = devices[:1]
    shared: Shared[None] = Shared(devices, tiles, lambda tile: need_of(graph, tile.shape, job, devices))
    with np.errstate(over="ignore", invalid="ignore"), progress_bar(progress, len(tiles.tiles), "tiles") as report:
        value = step_in_tiles(problem, step, shared, lambda done, of: report(done))
    shared.warn()
    return Result.bare(
        as_given(value if in_frame else problem.back(value), f0, graph),
        iterations=1,
        stop=Stop.MAX_ITER,
        eps=problem.eps * problem.frame.scale,
        method=f"{step.method}{shared.told}.",
        backend=shared.names,
        seconds=time.perf_counter() - begin,
    )


def _tiles_of_a_step(
    problem: Problem, job: Job, devices: Sequence[Backend], allowed: Budget, halo: tuple[int, ...]
) -> Tiling:
    """Choose small tiles, which cost little because the halo is one window wide, and save memory of the host.

    If the window is too large for small tiles, the whole budget is used.
    """
    graph = problem.graph
    assert isinstance(graph, GridGraph)
    need = need_of(graph, graph.shape, job, devices)
    work = work_of(problem, stored=job.stored)

    def within(budget: Budget) -> Tiling:
        return tiling(graph, job, devices, budget, lambda n: halo, work, 1)

    if len(devices) > 1:
        found = shares(len(devices), need, Budget(min(allowed.total, _STEP_BYTES), allowed.largest, True), within)
        if found is not None:
            return found
    for limit in sorted({min(allowed.total, _STEP_BYTES), allowed.total}):
        some = Budget(limit, min(allowed.largest, limit), allowed.asked)
        if some.holds(need):
            return Tiling.whole(graph.shape, halo, blocks_of(graph, job, devices))
        try:
            return within(some)
        except MemoryError:
            if limit == allowed.total:
                raise
    raise AssertionError("the last limit is what is allowed")


def fits_device(job: Job, grid: GridGraph, device: Backend, allowed: Budget) -> bool:
    """Return whether a sweep is made on the whole grid at once.

    On a CPU larger ones are made in tiles, which save memory of the process.
    """
    most = allowed.total if device.device.kind == "gpu" else min(allowed.total, _STEP_BYTES)
    return Budget(most, min(allowed.largest, most), allowed.asked).holds(job.need(grid, device))


@dataclass(frozen=True)
class OneStep:
    """The variant of one sweep at p = 2 with patch weights; the default is eq. 25.

    Attributes
    ----------
    largest : bool
        Whether lam is in units of the largest weight of each vertex.
    averaged : int or None
        Radius of the patches that are estimated as a whole and averaged. None: each vertex is estimated alone.
    by_weight : bool
        Whether the estimate of a patch is weighted by the sum of its weights, instead of by 1.
    """

    largest: bool = False
    averaged: int | None = None
    by_weight: bool = False

    def fuses(self, backend: Backend, grid: GridGraph) -> bool:
        """Return whether patches are averaged without stored weights: the weights are averaged instead."""
        return self.by_weight and not self.largest and backend.averages and grid.ndim == 2

    @property
    def method(self) -> str:
        """Describe the step in a sentence without its stop."""
        alone = self.averaged is None
        how = "its weights computed and not stored" if alone else "each patch estimated as a whole, patches averaged"
        return f"Gauss-Jacobi (eq. 25), {how}"

    def job(
        self,
        backend: Backend,
        grid: GridGraph,
        channels: int,
        weights: Weights | FloatArray | None,
        lam: FloatArray,
    ) -> Job:
        """Return what decides the memory of this step on data of so many channels."""
        averages = self.averaged is not None
        # averaging from stored weights needs one more channel, the denominator, and shares
        stored = averages and not self.fuses(backend, grid)
        return Job(channels + stored, weights=weights, per_vertex=averages or lam.ndim > 0, stored=stored)

    def halo(self, problem: Problem) -> tuple[int, ...]:
        """Return the distance along each axis, in cells, from which data reach a vertex."""
        return tuple(cells + (self.averaged or 0) for cells in halo(problem, 1))


def step_in_tiles(
    problem: Problem, step: OneStep, shared: Shared[None], report: Callable[[int, int], None]
) -> FloatArray:
    """Do one sweep at p = 2 with patch weights, tile by tile, (n, m)."""
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    value = np.empty((grid.n_vertices, problem.f0.shape[1]), shared.devices[0].dtype)

    def work(device: Backend, tile: Tile) -> None:
        part = part_problem(problem, tile) if tile.shape != grid.shape else problem
        interior = without_halo(part.graph, _step(part, device, step), tile)
        if not all_finite(interior):
            expect_finite(device, 1, math.nan)
        value.reshape(*grid.shape, -1)[tile.own] = interior

    shared.run(work, report)
    return value


def device_step(
    backend: Backend,
    grid: GridGraph,
    data: Array,
    *,
    lam: FloatArray,
    weights: Weights,
    step: OneStep,
) -> Array:
    """Do one sweep at p = 2 with patch weights on device data, and return the device function.

    Parameters
    ----------
    backend : Backend
    grid : GridGraph
    data : Array
        Device function f0, in units of a frame.
    lam : () or (n, 1) array
        The fidelity; infinite outside the mask if it is an array.
    weights : Weights
        Bilateral or patch weights, in the same units.
    step : OneStep
    """
    found = patch_weights(weights)
    assert found is not None
    function: PatchWeights
    function, guided = found
    guide = None if guided is None else guided.on_device(backend, grid, data)
    form = function.form(grid, backend.channels(data if guide is None else guide), backend.dtype)
    if step.averaged is not None and step.fuses(backend, grid):
        form = replace(form, average=step.averaged)
        counted = backend.put(grid, _per_patch(grid, lam, step.averaged))
        return backend.similarity_step(grid, data, form, data, counted, guide=guide)
    if step.averaged is not None:
        weighted = backend.patch_distance(grid, data if guide is None else guide, form)
        f = backend.get(grid, data)
        return backend.put(grid, _averaged(grid, backend, weighted, f, lam, step, step.averaged))
    fidelity = backend.put(grid, lam) if lam.ndim else float(lam)
    return backend.similarity_step(grid, data, form, data, fidelity, guide=guide, largest=step.largest)


def _step(part: Problem, backend: Backend, step: OneStep) -> FloatArray:
    grid, weights = part.graph, part.weights
    assert isinstance(grid, GridGraph) and isinstance(weights, Weights)
    data = backend.put(grid, part.f0)
    return backend.get(grid, device_step(backend, grid, data, lam=part.lam, weights=weights, step=step))


def _per_patch(grid: GridGraph, lam: FloatArray, radius: int) -> FloatArray:
    """Compute the fidelity times the number of patches that cover each vertex, (n, 1)."""
    if grid.mask is None:
        # a product of numbers along the axes
        places = [np.arange(size) for size in grid.shape]
        along = [np.minimum(x + radius, len(x) - 1) - np.maximum(x - radius, 0) + 1.0 for x in places]
        count: FloatArray = functools.reduce(np.multiply.outer, along).reshape(-1, 1)
    else:
        count = over_patches(grid.mask.astype(np.float64), radius).reshape(-1, 1)
    if np.ndim(lam) == 0 and math.isfinite(lam):
        return count * float(lam)
    counted: FloatArray = np.where(np.isinf(lam), lam, np.where(np.isinf(lam), 0, lam) * count)
    return counted


def _averaged(
    grid: GridGraph,
    backend: Backend,
    weighted: Weighted,
    f: FloatArray,
    lam: FloatArray,
    step: OneStep,
    radius: int,
) -> FloatArray:
    """Average at each vertex the estimates of all patches that cover it (``aggregate``), (n, m); `f` is (n, m).

    The estimate of the patch around u is the mean of the patches around its neighbours v with the weights w(u, v), and
    of the patch itself with the weight lam/2 (at p = 2 a neighbour has the weight 2 w).
    """
    inside = np.ones((grid.n_vertices, 1)) if grid.mask is None else grid.mask.reshape(-1, 1).astype(np.float64)
    fidelity = np.broadcast_to(lam, inside.shape)
    pinned = np.isinf(fidelity)
    centre = np.where(pinned, 0, fidelity) / 2
    if step.largest:
        centre = centre * backend.get(grid, backend.largest_weight(weighted))
    if step.by_weight:
        share, centre = inside, centre * inside
    else:
        total = centre + backend.get(grid, backend.degree(weighted))
        # a vertex without weights is its own estimate, like a pinned one
        alone = ~(total > np.finfo(backend.dtype).tiny * 1e8) | pinned
        share = np.divide(1.0, total, out=np.zeros_like(total), where=~alone)
        centre = np.where(alone, 1.0, centre * share) * inside
    F = np.concatenate([np.where(inside > 0, f, 0), inside], axis=1)
    values, shares, centres = (backend.put(grid, x) for x in (F, share, centre))
    sums = backend.get(grid, backend.aggregate(weighted, values, shares, centres, radius))
    weight = sums[:, -1:]
    known = (weight > 0) & ~pinned & (inside > 0)
    return np.divide(sums[:, :-1], weight, out=f.copy(), where=known)
