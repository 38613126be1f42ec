"""A job on a grid in tiles, with a halo so wide that what is kept of each is what the whole would give, to the bit.

n sweeps carry data over n neighbourhoods of reach k, and over n more where the gradient's norm enters (p != 2); weights
look k' cells further. So a tile is widened by n k + k', or 2 n k + k'. Many sweeps run in blocks of n, between which
the whole iterate is on the host. Weights are computed anew for each tile and block.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from .arrays import FloatArray, all_finite
from .backends import Array, Backend, Weighted, over_patches
from .graphs.grid import GridGraph
from .graphs.grid_parts import part_of, rows_of
from .memory import Budget, Job, Need, readable
from .problem import DeviceProblem, Problem
from .result import Stop
from .solvers import Jacobi, Solver
from .solvers.loop import expect_finite
from .weights import PatchWeights, Weights, patch_weights

# Sweeps between two exchanges that are tried, and work per vertex in units of an edge's part of a sweep: transfers,
# a neighbour's weight computed here or on the device, and per row of a patch.
_BLOCKS = (1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100)
_TRANSFER, _HOST_WEIGHT, _WEIGHT, _PATCH_ROW = 40.0, 20.0, 2.0, 1.0


@dataclass(frozen=True)
class Tile:
    """A part of a grid: what is kept of it, what is computed with the halo, and where the former is in the latter."""

    own: tuple[slice, ...]
    wide: tuple[slice, ...]

    @property
    def inner(self) -> tuple[slice, ...]:
        """The kept part inside the computed one."""
        return tuple(
            slice(own.start - wide.start, own.stop - wide.start) for own, wide in zip(self.own, self.wide, strict=True)
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis, with the halo."""
        return tuple(wide.stop - wide.start for wide in self.wide)


@dataclass(frozen=True)
class Tiling:
    """How a job is cut: the sweeps between two exchanges, the tiles, and how often a cell is computed on average."""

    sweeps: int
    tiles: tuple[Tile, ...]

    @property
    def waste(self) -> float:
        """Cells computed over cells kept."""
        kept = sum(math.prod(s.stop - s.start for s in tile.own) for tile in self.tiles)
        return float(sum(math.prod(tile.shape) for tile in self.tiles) / kept)


def halo(problem: Problem, sweeps: int) -> tuple[int, ...]:
    """Cells along each axis from which data reach a vertex in so many sweeps."""
    assert isinstance(problem.graph, GridGraph)
    reach = np.abs(problem.graph.offsets).max(axis=0, initial=0)
    steps = sweeps * (1 if problem.p == 2 or problem.norm == "edge" else 2)
    if isinstance(problem.gamma, str) and problem.gamma in ("normalized", "degree"):
        steps += 1  # a vertex's own factor is the sum of the weights around it
    further = problem.weights.reach if isinstance(problem.weights, Weights) else 0
    return tuple((steps * reach + further).tolist())


def cut(
    shape: tuple[int, ...], sizes: tuple[int, ...], halo: tuple[int, ...], blocks: tuple[int, ...]
) -> tuple[Tile, ...]:
    """Tiles of at most these sizes, equal ones as far as can be.

    With its halo a tile begins at a multiple of the axis' block, where a device's sums come in blocks of cells.
    """
    axes = []
    for length, size, wider, block in zip(shape, sizes, halo, blocks, strict=True):
        count = -(-length // size)
        ends = [length * i // count for i in range(count + 1)]
        axes.append(
            [
                (slice(a, b), slice(max(0, a - wider) // block * block, min(length, b + wider)))
                for a, b in itertools.pairwise(ends)
            ]
        )
    return tuple(Tile(tuple(o for o, _ in each), tuple(w for _, w in each)) for each in itertools.product(*axes))


def tiling(
    grid: GridGraph,
    job: Job,
    backend: Backend,
    budget: Budget,
    halo: Callable[[int], tuple[int, ...]],
    work: Callable[[int], float],
    most: int,
) -> Tiling:
    """The cheapest way to cut a job, `most` sweeps in a block at most; `work` is what a vertex takes in n sweeps.

    Bands of rows along the first axis, or where these are too much, pieces along the second axis as well.

    Raises
    ------
    MemoryError
        Even a small tile does not fit.
    """
    blocks = (1,) * grid.ndim if job.stored else _blocks(grid.ndim, backend)
    best: tuple[float, Tiling] | None = None
    least = Need(2**62, 2**62)
    for sweeps in [n for n in _BLOCKS if n <= max(most, 1)]:
        wider = halo(sweeps)
        pieces = 1
        while True:
            sizes = list(grid.shape)
            if grid.ndim > 1:
                sizes[1] = -(-grid.shape[1] // pieces)
            beside = min(grid.shape[1], sizes[1] + 2 * wider[1] + blocks[1] - 1) if grid.ndim > 1 else 0
            rows, need = _rows(grid, beside, job, backend, budget)
            least = min(least, need, key=lambda need: need.total)
            own = min(grid.shape[0], rows if rows >= grid.shape[0] else rows - 2 * wider[0] - blocks[0] + 1)
            if own >= 1:
                found = Tiling(sweeps, cut(grid.shape, (own, *sizes[1:]), wider, blocks))
                cost = found.waste * work(sweeps) / sweeps
                if best is None or cost < best[0]:
                    best = cost, found
            # narrower pieces only cost more once bands are high beside their halo
            if grid.ndim == 1 or own >= 8 * wider[0] or sizes[1] <= max(wider[1] // 2, 1):
                break
            pieces *= 2
    if best is None:
        raise MemoryError(
            f"even a tile of one row with its halo needs {readable(least.total)}, and {readable(budget.total)} are "
            "allowed: give more memory, or use a smaller window or fewer iterations"
        )
    return best[1]


def _blocks(ndim: int, backend: Backend) -> tuple[int, ...]:
    """Cells along each axis at whose multiples a device may begin a step without stored weights anew."""
    return tuple((*[1] * ndim, backend.row_block, backend.column_block)[-ndim:])


def _rows(grid: GridGraph, beside: int, job: Job, backend: Backend, budget: Budget) -> tuple[int, Need]:
    """The most rows of tiles of this width that fit, and what one row needs."""

    def need(rows: int) -> Need:
        shape = (rows, *((beside, *grid.shape[2:]) if grid.ndim > 1 else ()))
        mask = None if grid.mask is None else np.ones(shape, bool)
        return job.need(GridGraph(shape, grid.radius, grid.metric, spacing=grid.spacing, mask=mask), backend)

    least = need(1)
    low, high = 0, grid.shape[0] + 1  # the most that fits lies in low..high - 1
    if budget.holds(least):
        low = 1
    while low and high - low > max(1, low // 50):
        middle = (low + high) // 2
        if budget.holds(need(middle)):
            low = middle
        else:
            high = middle
    return low, least


def work_of(problem: Problem, stored: bool = True) -> Callable[[int], float]:
    """Work per vertex of n sweeps with their weights, in units of an edge's part of a sweep at p = 2."""
    assert isinstance(problem.graph, GridGraph)
    K = float(2 * problem.graph.half_window)
    found = patch_weights(problem.weights)
    setup = _TRANSFER
    if found is not None:
        setup += K * (_WEIGHT + _PATCH_ROW * 2 * (2 * found[0].reach + 1)) * (0.5 if stored else 1)
    elif isinstance(problem.weights, Weights):
        setup += _HOST_WEIGHT * K / 2
    return lambda sweeps: setup + sweeps * K * (1.0 if problem.p == 2 else 2.5)


def why_whole(
    problem: Problem, solver: Solver, *, callback: bool = False, update_weights: int | None = None
) -> str | None:
    """Why a job cannot be cut into tiles, as a clause; None if it can."""
    if not isinstance(problem.graph, GridGraph):
        return "only a GridGraph is cut into tiles"
    if callback:
        return "a callback is shown the energy of the whole"
    if not isinstance(solver, Jacobi):
        return "the step of this solver depends on the whole graph (solver='jacobi' does not)"
    if solver.accelerate:
        return "accelerated sweeps mix iterates of the whole (give accelerate=False)"
    if solver.stop != "change":
        return f"stop={solver.stop!r} is a question about the whole (stop='change' is not)"
    if solver.damping is None and problem.p > 2:
        return (
            "whether a sweep raised the energy is a question about the whole (give solver=gpureg.Jacobi(damping=...))"
        )
    if solver.damping is None and not np.min(problem.lam) > 0:
        return (
            "where lam is 0, whether a sweep has to be damped is a question about the whole graph "
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


def part_problem(problem: Problem, tile: Tile) -> Problem:
    """The problem on a tile."""
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    part = part_of(grid, tile.wide)
    lam, weights = problem.lam, problem.weights
    if not isinstance(lam, float):
        lam = lam.reshape(grid.shape)[tile.wide].reshape(-1)
    if isinstance(weights, Weights):
        weights = weights.part(grid, tile.wide)
    elif weights is not None:
        half = weights[:, *tile.wide]
        weights = np.zeros_like(half)
        for h, step in enumerate(part.forward_offsets):
            start, _ = part.ends(step)  # an edge that leaves the tile is none
            # a small tile may reach less far than the whole
            plane = int(np.flatnonzero((grid.forward_offsets == step).all(axis=1))[0])
            weights[h][start] = half[plane][start]
        weights = weights[: part.half_window]
    return replace(problem, graph=part, f0=rows_of(grid, problem.f0, tile.wide), lam=lam, weights=weights)


@dataclass
class TiledOutcome:
    """The last whole iterate (n, m), in the caller's variable, and how it was reached."""

    value: FloatArray
    iterations: int
    stop: Stop
    method: str


def run_in_tiles(
    problem: Problem,
    backend: Backend,
    solver: Jacobi,
    tiles: Tiling,
    initial: FloatArray,
    *,
    max_iter: int,
    threshold: float | None,
    update_weights: int | None,
    report: Callable[[int, int], None],
) -> TiledOutcome:
    """What ``solvers.run`` does, tile by tile and without energies; `report` is told the tiles done, and of how many.

    Raises
    ------
    FloatingPointError
        Values that are no longer finite.
    """
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    # What the solver would find out on the whole; a tile of it could come to another end.
    solver = replace(solver, damping=1.0 if solver.damping is None else solver.damping)
    # Blocks end where the whole would be looked at.
    ends = [max_iter]
    if threshold is not None:
        ends += range(solver.check_every, max_iter, solver.check_every)
    if update_weights is not None:
        ends += range(update_weights, max_iter, update_weights)
    plan = list(_in_blocks(sorted(set(ends)), tiles.sweeps))
    current = initial.astype(backend.dtype, copy=False)
    # In the device's variable once there was a block (DeviceProblem): it is brought back once, at the end.
    scale: FloatArray | None = None
    reference: FloatArray | None = None
    done, finished, stop, method = 0, 0, Stop.MAX_ITER, ""

    def block(sweeps: int, looks: bool) -> tuple[FloatArray, float]:
        nonlocal scale, method, finished
        after = np.empty((grid.n_vertices, problem.f0.shape[1]), backend.dtype)
        change = 0.0
        for tile in tiles.tiles:
            part = part_problem(problem, tile)
            start = rows_of(grid, current, tile.wide)
            compared = None if reference is None else rows_of(grid, reference, tile.wide)
            found = _sweeps(part, backend, solver, start, compared, sweeps, raw=done > 0, looks=looks)
            kept = _kept(part.graph, found.f, tile)
            if not all_finite(kept):
                expect_finite(backend, done + sweeps, math.nan)
            after.reshape(*grid.shape, -1)[tile.own] = kept
            if found.scale is not None:
                if scale is None:
                    scale = np.empty((grid.n_vertices, 1))
                scale.reshape(*grid.shape, 1)[tile.own] = _kept(part.graph, found.scale, tile)
            if found.previous is not None:
                change = max(change, _change(kept, _kept(part.graph, found.previous, tile), found.scale, part, tile))
            method = found.method
            finished += 1
            report(finished, len(tiles.tiles) * len(plan))
        return after, change

    try:
        for sweeps in plan:
            if update_weights is not None and done and done % update_weights == 0:
                reference = current
            looks = threshold is not None and ((done + sweeps) % solver.check_every == 0 or done + sweeps == max_iter)
            after, change = block(sweeps, looks)
            current, done = after, done + sweeps
            # as in the whole, not before the weights were computed anew once
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
    pieces = f", in {len(tiles.tiles)} tiles and blocks of {tiles.sweeps} sweep(s)"
    return TiledOutcome(value, done, stop, f"{method or 'Gauss-Jacobi (eq. 25)'}{anew}{pieces}.")


def _in_blocks(ends: list[int], sweeps: int) -> Iterator[int]:
    """Sweeps from 0 on in blocks, none of which goes beyond one of the ends."""
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
    """A block of sweeps on a tile; what is on the device goes when this returns."""
    on_device = DeviceProblem.put(part, backend, reference)
    f: Array = backend.put(part.graph, start) if raw else on_device.put_function(start)
    state = solver.start(on_device, f)
    for _ in range(sweeps):
        state = solver.advance(on_device, state)
    previous = backend.get(part.graph, state.previous) if looks else None
    return _Found(backend.get(part.graph, state.f), previous, on_device.scale, solver.describe(state))


def _kept(graph: object, f: FloatArray, tile: Tile) -> FloatArray:
    assert isinstance(graph, GridGraph)
    return f.reshape(*graph.shape, f.shape[1])[tile.inner]


def _change(a: FloatArray, b: FloatArray, scale: FloatArray | None, part: Problem, tile: Tile) -> float:
    """Largest change in the caller's variable, as ``DeviceProblem.change`` finds it; infinity if there is a NaN."""
    if scale is not None:
        own = _kept(part.graph, scale, tile)
        a, b = (a / own).astype(a.dtype).astype(np.float64), (b / own).astype(b.dtype)
    largest = float(np.abs(a - b).max(initial=0))
    return largest if math.isfinite(largest) else math.inf


@dataclass(frozen=True)
class OneStep:
    """What one sweep at p = 2 with patch weights does besides the book.

    Attributes
    ----------
    largest : bool
        lam counts in units of the largest weight around each vertex.
    averaged : int or None
        Radius of the patches whose estimates are averaged, each patch being estimated as a whole; None estimates each
        vertex by its own patch alone.
    by_weight : bool
        Whether a patch's estimate counts by the sum of the weights it was made with, instead of as one.
    """

    largest: bool = False
    averaged: int | None = None
    by_weight: bool = False

    def fuses(self, backend: Backend, grid: GridGraph) -> bool:
        """Whether averaged patches are a step whose weights are not stored: averaging patches is averaging weights."""
        return self.by_weight and not self.largest and backend.averages and grid.ndim == 2

    def halo(self, problem: Problem) -> tuple[int, ...]:
        """Cells along each axis from which data reach a vertex."""
        return tuple(cells + (self.averaged or 0) for cells in halo(problem, 1))


def step_in_tiles(
    problem: Problem, backend: Backend, step: OneStep, tiles: Tiling, report: Callable[[int, int], None]
) -> FloatArray:
    """One sweep at p = 2 of patch weights, which are kept for a tile at most, (n, m)."""
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    value = np.empty((grid.n_vertices, problem.f0.shape[1]), backend.dtype)
    for i, tile in enumerate(tiles.tiles):
        part = part_problem(problem, tile) if len(tiles.tiles) > 1 else problem
        kept = _kept(part.graph, _step(part, backend, step), tile)
        if not all_finite(kept):
            expect_finite(backend, 1, math.nan)
        value.reshape(*grid.shape, -1)[tile.own] = kept
        report(i + 1, len(tiles.tiles))
    return value


def _step(part: Problem, backend: Backend, step: OneStep) -> FloatArray:
    grid, found = part.graph, patch_weights(part.weights)
    assert isinstance(grid, GridGraph) and found is not None
    function: PatchWeights
    function, guided = found
    f = part.f0.astype(backend.dtype, copy=False)
    guide = None if guided is None else guided.of(grid, f).astype(backend.dtype, copy=False)
    form = function.form(grid, (f if guide is None else guide).shape[1], backend.dtype)
    if step.averaged is not None and step.fuses(backend, grid):
        form = replace(form, average=step.averaged)
        data, counted = backend.put(grid, f), backend.put(grid, _per_patch(grid, part.lam, step.averaged))
        return backend.get(grid, backend.similarity_step(grid, f, form, data, counted, guide=guide))
    if step.averaged is not None:
        weighted = backend.patch_distance(grid, f if guide is None else guide, form)
        return _averaged(grid, backend, weighted, f, part.lam, step, step.averaged)
    lam = part.lam if isinstance(part.lam, float) else backend.put(grid, part.lam[:, None])
    on_device = backend.put(grid, f)
    return backend.get(grid, backend.similarity_step(grid, f, form, on_device, lam, guide=guide, largest=step.largest))


def _per_patch(grid: GridGraph, lam: float | FloatArray, radius: int) -> FloatArray:
    """The fidelity times the patches that cover each vertex, (n, 1): a pixel counts in each of them."""
    inside = np.ones(grid.shape) if grid.mask is None else grid.mask.astype(np.float64)
    count = over_patches(inside, radius)
    every = np.broadcast_to(np.asarray(lam, np.float64).reshape(-1), (grid.n_vertices,))
    finite = np.where(np.isinf(every), 0, every) * count.ravel()
    counted: FloatArray = np.where(np.isinf(every), every, finite)[:, None]
    return counted


def _averaged(
    grid: GridGraph,
    backend: Backend,
    weighted: Weighted,
    f: FloatArray,
    lam: float | FloatArray,
    step: OneStep,
    radius: int,
) -> FloatArray:
    """Every vertex' mean over the estimates of all patches that cover it (``aggregate``).

    The patch around u is estimated as the mean of the patches around its neighbours v with the weights w(u, v), and of
    its own with lam/2 (at p = 2 a neighbour counts 2 w).
    """
    inside = np.ones((grid.n_vertices, 1)) if grid.mask is None else grid.mask.reshape(-1, 1).astype(np.float64)
    fidelity = np.broadcast_to(np.asarray(lam, np.float64).reshape(-1, 1), inside.shape)
    pinned = np.isinf(fidelity)
    centre = np.where(pinned, 0, fidelity) / 2
    if step.largest:
        centre = centre * backend.get(grid, backend.largest_weight(weighted))
    if step.by_weight:
        share, centre = inside, centre * inside
    else:
        total = centre + backend.get(grid, backend.degree(weighted))
        # a vertex without weights is its own estimate, as one that is pinned
        alone = ~(total > np.finfo(backend.dtype).tiny * 1e8) | pinned
        share = np.divide(1.0, total, out=np.zeros_like(total), where=~alone)
        centre = np.where(alone, 1.0, centre * share) * inside
    F = np.concatenate([np.where(inside > 0, f, 0), inside], axis=1)
    values, shares, centres = (backend.put(grid, x) for x in (F, share, centre))
    sums = backend.get(grid, backend.aggregate(weighted, values, shares, centres, radius))
    weight = sums[:, -1:]
    known = (weight > 0) & ~pinned & (inside > 0)
    return np.divide(sums[:, :-1], weight, out=f.copy(), where=known)
