"""Run a job on a grid in tiles, with a halo that gives the same values as the whole grid, bit for bit.

n sweeps carry data over n neighbourhoods of radius k, and over n more if the gradient norm is needed (p != 2); weights
need k' more cells. The halo of a tile is therefore n k + k', or 2 n k + k', cells wide. Sweeps run in blocks of n;
between blocks the complete iterate is on the host. Weights are computed for each tile and block.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray, all_finite
from ..backends import Array, Backend
from ..graphs.grid import GridGraph
from ..graphs.grid_parts import rows_of
from ..model.memory import Budget, Job, readable
from ..model.on_device import DeviceProblem
from ..model.problem import Problem
from ..model.result import Stop
from ..solvers import Jacobi, Solver
from ..solvers.loop import Callback, expect_finite
from ..weights import Weights
from .sharing import Shared, shares
from .tiling import Tile, Tiling, halo, need_of, part_problem, tiling, without_halo, work_of


def why_whole(
    problem: Problem, solver: Solver, *, callback: bool = False, update_weights: int | None = None
) -> str | None:
    """Return the reason why a job cannot be cut into tiles, as a clause; None if it can."""
    if not isinstance(problem.graph, GridGraph):
        return "only a GridGraph is cut into tiles"
    if callback:
        return "a callback is shown the energy of the whole"
    if not isinstance(solver, Jacobi):
        return "the step of this solver depends on the whole graph (solver='jacobi' does not)"
    if solver.accelerate:
        return "accelerated sweeps mix iterates of the whole (give accelerate=False)"
    if solver.stop != "change":
        return f"stop={solver.stop!r} needs the whole graph (stop='change' does not)"
    if solver.damping is None and problem.p > 2:
        return "whether a sweep raised the energy depends on the whole graph (give solver=gpureg.Jacobi(damping=...))"
    if solver.damping is None and not np.min(problem.lam) > 0:
        return (
            "where lam is 0, whether a sweep has to be damped depends on the whole graph "
            "(give solver=gpureg.Jacobi(damping=...))"
        )
    if not isinstance(problem.gamma, str):
        return "gamma is given per directed edge"
    if update_weights is not None and problem.gamma != "sqrt":
        return f"gamma={problem.gamma!r} changes with weights that are computed anew"
    if isinstance(problem.weights, Weights):
        everything = (slice(None),) * problem.graph.ndim
        if problem.weights.part(problem.graph, everything) is None:
            return f"{type(problem.weights).__name__} weights may know all vertices by their numbers"
    return None


@dataclass(frozen=True)
class Cutting:
    """What decides whether a job is cut into tiles, and how.

    Parameters
    ----------
    problem : Problem
    method : Solver
    max_iter, tol, callback, update_weights
        As in :func:`gpureg.regularize`.
    """

    problem: Problem
    method: Solver
    max_iter: int
    tol: float | None
    callback: Callback | None = None
    update_weights: int | None = None

    @property
    def job(self) -> Job:
        """What decides the memory."""
        problem, m = self.problem, self.problem.f0.shape[1]
        return Job(
            channels=m,
            norms=0 if problem.p == 2 or problem.norm == "edge" else 1 if problem.coupled else m,
            weights=problem.weights,
            directed=not isinstance(problem.gamma, str),
            per_vertex=problem.lam.ndim > 0,
            keeps=self.method.keeps(problem),
        )

    @property
    def why_whole(self) -> str | None:
        """The reason why the job cannot be cut into tiles, as a clause; None if it can."""
        given = {"callback": self.callback is not None, "update_weights": self.update_weights}
        return why_whole(self.problem, self.method, **given)  # type: ignore[arg-type]

    def tiles(self, devices: Sequence[Backend], allowed: Budget) -> Tiling | None:
        """Choose tiles for a job that does not fit into memory, or that several devices share; otherwise None.

        Raises
        ------
        MemoryError
            The job does not fit, and cannot be cut, or not into tiles that are small enough.
        """
        device, job = devices[0], self.job
        need = job.need(self.problem.graph, device)
        if self.max_iter == 0:
            return None
        if allowed.holds(need):
            return self._shares(devices, allowed) if len(devices) > 1 else None
        why = self.why_whole
        if why is not None:
            if not allowed.asked and need.total <= device.free_memory and need.largest <= device.largest_buffer:
                return None
            raise MemoryError(
                f"the job needs {readable(need.total)} on {device.device.id}, {readable(need.largest)} of them in one "
                f"array; {readable(allowed.total)} are allowed. It cannot be cut into tiles: {why}"
            )
        return self._within(devices, allowed)

    def halved(self, device: Backend, said: str) -> Tiling:
        """Choose tiles of half the job, for whose whole the memory of the device has run out, which `said` so.

        Raises
        ------
        MemoryError
            The job cannot be cut.
        """
        need, why = self.job.need(self.problem.graph, device), self.why_whole
        if why is not None:
            raise MemoryError(
                f"the job needs {readable(need.total)} on {device.device.id}, {readable(need.largest)} of them in one "
                f"array, and its memory ran out; {readable(device.free_memory)} of {readable(device.device.memory)} "
                f"are free now ({said}). It cannot be cut into tiles: {why}. End other programs that use the device, "
                "use float32, or another backend such as 'numpy'"
            )
        halves = self._within([device], Budget(need.total // 2, need.largest, True))
        return replace(halves, full=device.device.id)

    def _within(self, devices: Sequence[Backend], allowed: Budget) -> Tiling:
        assert isinstance(self.problem.graph, GridGraph)
        # a block ends at every check and every update of the weights
        until_check = self.method.check_every if self.tol is not None else self.max_iter
        most = min(self.max_iter, until_check, self.update_weights or self.max_iter)
        reach, work = functools.partial(halo, self.problem), work_of(self.problem)
        return tiling(self.problem.graph, self.job, devices, allowed, reach, work, most)

    def _shares(self, devices: Sequence[Backend], allowed: Budget) -> Tiling | None:
        """Choose tiles that the devices can share; None if the job cannot be cut, or its halos cost all the gain."""
        if self.why_whole is not None:
            return None
        need = self.job.need(self.problem.graph, devices[0])
        return shares(len(devices), need, allowed, lambda within: self._within(devices, within))


@dataclass
class TiledOutcome:
    """The last complete iterate (n, m), in the caller's variable, and information about the run."""

    value: FloatArray
    iterations: int
    stop: Stop
    method: str
    devices: str


def run_in_tiles(
    cutting: Cutting,
    devices: Sequence[Backend],
    tiles: Tiling,
    initial: FloatArray,
    *,
    threshold: float | None,
    report: Callable[[int, int], None],
) -> TiledOutcome:
    """Iterate as ``solvers.run`` from `initial`, (n, m), but tile by tile and without energies.

    `report` is called with the number of tiles done and of all tiles. FloatingPointError: values are not finite.
    """
    problem, max_iter, update_weights = cutting.problem, cutting.max_iter, cutting.update_weights
    solver, backend = cutting.method, devices[0]
    assert isinstance(solver, Jacobi)
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    # the damping depends on the whole graph, not on a tile
    solver = replace(solver, damping=1.0 if solver.damping is None else solver.damping)
    # blocks end at the checks
    ends = [max_iter]
    if threshold is not None:
        ends += range(solver.check_every, max_iter, solver.check_every)
    if update_weights is not None:
        ends += range(update_weights, max_iter, update_weights)
    plan = list(_in_blocks(sorted(set(ends)), tiles.sweeps))
    current = initial.astype(backend.dtype, copy=False)
    # after the first block `current` is in the device's variable (DeviceProblem), until the end
    scale: FloatArray | None = None
    reference: FloatArray | None = None
    done, blocks, finished, stop, method = 0, 0, 0, Stop.MAX_ITER, ""

    scales = np.empty((grid.n_vertices, 1))
    shared: Shared[float] = Shared(devices, tiles, lambda tile: need_of(grid, tile.shape, cutting.job, devices))

    def block(sweeps: int, looks: bool) -> tuple[FloatArray, float]:
        after = np.empty((grid.n_vertices, problem.f0.shape[1]), backend.dtype)

        def work(device: Backend, tile: Tile) -> float:
            nonlocal scale, method
            part = part_problem(problem, tile)
            start = rows_of(grid, current, tile.wide)
            compared = None if reference is None else rows_of(grid, reference, tile.wide)
            found = _sweeps(part, device, solver, start, compared, sweeps, raw=done > 0, looks=looks)
            interior = without_halo(part.graph, found.f, tile)
            if not all_finite(interior):
                expect_finite(device, done + sweeps, math.nan)
            after.reshape(*grid.shape, -1)[tile.own] = interior
            method = found.method
            if found.scale is not None:
                scales.reshape(*grid.shape, 1)[tile.own] = without_halo(part.graph, found.scale, tile)
                scale = scales
            if found.previous is None:
                return 0.0
            return _change(interior, without_halo(part.graph, found.previous, tile), found.scale, part, tile)

        def told(ready: int, of: int) -> None:
            report(finished + ready, finished + of * (len(plan) - blocks))

        return after, max(shared.run(work, told))

    try:
        for sweeps in plan:
            if update_weights is not None and done and done % update_weights == 0:
                reference = current
            looks = threshold is not None and ((done + sweeps) % solver.check_every == 0 or done + sweeps == max_iter)
            after, change = block(sweeps, looks)
            current, done, blocks = after, done + sweeps, blocks + 1
            finished += len(shared.tiles)
            # as without tiles, the weights must be updated once before the test counts
            anew_once = update_weights is None or done > update_weights
            if threshold is not None and looks and change <= threshold and anew_once:
                stop = Stop.TOLERANCE
                break
    except KeyboardInterrupt:
        stop = Stop.INTERRUPTED
    value = np.array(current) if done == 0 else current
    if scale is not None and done:
        value = (value / scale).astype(value.dtype)
    anew = f", weights computed anew every {update_weights} iteration(s)" if update_weights is not None else ""
    pieces = f", in {len(shared.tiles)} tiles and blocks of {tiles.sweeps} sweep(s){shared.told}"
    shared.warn()
    return TiledOutcome(value, done, stop, f"{method or 'Gauss-Jacobi (eq. 25)'}{anew}{pieces}.", shared.names)


def _in_blocks(ends: list[int], sweeps: int) -> Iterator[int]:
    """Yield the numbers of sweeps of blocks that do not cross any of the ends."""
    done = 0
    for end in ends:
        while done < end:
            step = min(sweeps, end - done)
            yield step
            done += step


@dataclass
class _Found:
    f: FloatArray
    previous: FloatArray | None
    scale: FloatArray | None
    method: str


def _sweeps(
    part: Problem,
    backend: Backend,
    solver: Jacobi,
    start: FloatArray,
    reference: FloatArray | None,
    sweeps: int,
    *,
    raw: bool,
    looks: bool,
) -> _Found:
    """Run a block of sweeps on a tile, from `start`, (n, m); memory on the device is freed on return."""
    on_device = DeviceProblem.put(part, backend, reference)
    f: Array = backend.put(part.graph, start) if raw else on_device.put_function(start)
    state = solver.start(on_device, f)
    for _ in range(sweeps):
        state = solver.advance(on_device, state)
    previous = backend.get(part.graph, state.previous) if looks else None
    return _Found(backend.get(part.graph, state.f), previous, on_device.scale, solver.describe(state))


def _change(a: FloatArray, b: FloatArray, scale: FloatArray | None, part: Problem, tile: Tile) -> float:
    """Compute the largest change in the caller's variable, as ``DeviceProblem.change``; infinity for a NaN."""
    if scale is not None:
        own = without_halo(part.graph, scale, tile)
        a, b = (a / own).astype(a.dtype).astype(np.float64), (b / own).astype(b.dtype)
    largest = float(np.abs(a - b).max(initial=0))
    return largest if math.isfinite(largest) else math.inf
