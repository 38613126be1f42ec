"""Cut a grid graph into tiles: their sizes, halos and problems."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..backends import Backend
from ..graphs.grid import GridGraph
from ..graphs.grid_parts import rows_of
from ..model.memory import Budget, Job, Need, readable
from ..model.problem import Problem
from ..weights import Weights, patch_weights

# Candidates for the number of sweeps per block, and the work per vertex in units of one edge in a sweep: transfers,
# the weight of a neighbour computed on the host or on the device, and each row of a patch.
_BLOCKS = (1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100)
_TRANSFER, _HOST_WEIGHT, _WEIGHT, _PATCH_ROW = 40.0, 20.0, 2.0, 1.0


@dataclass(frozen=True)
class Tile:
    """A part of a grid.

    Attributes
    ----------
    own : tuple of slice
        Its interior, a slice along each axis.
    wide : tuple of slice
        The interior with the halo.
    """

    own: tuple[slice, ...]
    wide: tuple[slice, ...]

    @property
    def inner(self) -> tuple[slice, ...]:
        """The interior as slices of the tile with its halo."""
        return tuple(
            slice(own.start - wide.start, own.stop - wide.start) for own, wide in zip(self.own, self.wide, strict=True)
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis, with the halo."""
        return tuple(wide.stop - wide.start for wide in self.wide)


@dataclass(frozen=True)
class Tiling:
    """The tiles of a job, and the number of sweeps per block."""

    sweeps: int
    tiles: tuple[Tile, ...]

    @property
    def waste(self) -> float:
        """How often a cell is computed on average: cells of the tiles over cells of their interiors."""
        own = sum(math.prod(s.stop - s.start for s in tile.own) for tile in self.tiles)
        return float(sum(math.prod(tile.shape) for tile in self.tiles) / own)


def halo(problem: Problem, sweeps: int) -> tuple[int, ...]:
    """Return the distance along each axis, in cells, from which data reach a vertex in this number of sweeps."""
    assert isinstance(problem.graph, GridGraph)
    reach = np.abs(problem.graph.offsets).max(axis=0, initial=0)
    steps = sweeps * (1 if problem.p == 2 or problem.norm == "edge" else 2)
    if isinstance(problem.gamma, str) and problem.gamma in ("normalized", "degree"):
        steps += 1  # the factor of a vertex is the sum of its weights
    further = problem.weights.reach if isinstance(problem.weights, Weights) else 0
    return tuple((steps * reach + further).tolist())


def cut(
    shape: tuple[int, ...], sizes: tuple[int, ...], halo: tuple[int, ...], blocks: tuple[int, ...]
) -> tuple[Tile, ...]:
    """Cut a grid into tiles of at most these sizes, as equal as possible.

    With its halo a tile begins at a multiple of the block size of each axis, because devices sum in blocks of cells.
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
    """Choose the cheapest tiles with at most `most` sweeps per block; `work` is the work per vertex of n sweeps.

    Tiles are bands of rows along the first axis; if these do not fit, they are cut along the second axis too.

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
            # narrower tiles only cost more once bands are high compared to their halo
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
    """Return the block sizes along each axis: a step without stored weights may begin at multiples of them."""
    return tuple((*[1] * ndim, backend.row_block, backend.column_block)[-ndim:])


def _rows(grid: GridGraph, beside: int, job: Job, backend: Backend, budget: Budget) -> tuple[int, Need]:
    """Return the largest number of rows of tiles of this width that fit, and the memory that one row needs."""

    def need(rows: int) -> Need:
        shape = (rows, *((beside, *grid.shape[2:]) if grid.ndim > 1 else ()))
        mask = None if grid.mask is None else np.ones(shape, bool)
        return job.need(GridGraph(shape, grid.radius, grid.metric, spacing=grid.spacing, mask=mask), backend)

    least = need(1)
    low, high = 0, grid.shape[0] + 1  # the result is in low..high - 1
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
    """Return the work per vertex of n sweeps and their weights, in units of one edge in a sweep at p = 2."""
    assert isinstance(problem.graph, GridGraph)
    K = float(2 * problem.graph.half_window)
    found = patch_weights(problem.weights)
    setup = _TRANSFER
    if found is not None:
        setup += K * (_WEIGHT + _PATCH_ROW * 2 * (2 * found[0].reach + 1)) * (0.5 if stored else 1)
    elif isinstance(problem.weights, Weights):
        setup += _HOST_WEIGHT * K / 2
    return lambda sweeps: setup + sweeps * K * (1.0 if problem.p == 2 else 2.5)


def part_problem(problem: Problem, tile: Tile) -> Problem:
    """Return the problem on a tile with its halo."""
    grid = problem.graph
    assert isinstance(grid, GridGraph)
    part = grid.part(tile.wide)
    lam, weights = problem.lam, problem.weights
    if lam.ndim:
        lam = lam.reshape(grid.shape)[tile.wide].reshape(-1, 1)
    if isinstance(weights, Weights):
        weights = weights.part(grid, tile.wide)
    elif weights is not None:
        half = weights[:, *tile.wide]
        weights = np.zeros_like(half)
        for h, step in enumerate(part.forward_offsets):
            start, _ = part.ends(step)  # edges that leave the tile are dropped
            # a small tile may have fewer offsets than the grid
            plane = int(np.flatnonzero((grid.forward_offsets == step).all(axis=1))[0])
            weights[h][start] = half[plane][start]
        weights = weights[: part.half_window]
    return replace(problem, graph=part, f0=rows_of(grid, problem.f0, tile.wide), lam=lam, weights=weights)


def without_halo(graph: object, f: FloatArray, tile: Tile) -> FloatArray:
    """Return the part of a function on a tile with its halo, (n, m), that belongs to the interior, shape + (m,)."""
    assert isinstance(graph, GridGraph)
    return f.reshape(*graph.shape, f.shape[1])[tile.inner]
