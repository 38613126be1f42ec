"""Cut a grid graph into tiles: their sizes, halos and problems."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
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

# Share of the cells of a tile that its halves may have, halos included, to be worth a try.
_WORTH = 0.8


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

    @property
    def size(self) -> int:
        """Number of cells, with the halo."""
        return math.prod(self.shape)

    @classmethod
    def around(
        cls, own: tuple[slice, ...], shape: tuple[int, ...], halo: tuple[int, ...], blocks: tuple[int, ...]
    ) -> Tile:
        """Make the tile with this interior on a grid.

        With its halo it begins at a multiple of the block size of each axis, because devices sum in blocks of cells.
        """
        wide = tuple(
            slice(max(0, s.start - wider) // block * block, min(length, s.stop + wider))
            for s, length, wider, block in zip(own, shape, halo, blocks, strict=True)
        )
        return cls(own, wide)


@dataclass(frozen=True)
class Tiling:
    """The tiles of a job, and the number of sweeps per block.

    Attributes
    ----------
    sweeps : int
    tiles : tuple of Tile
    shape : tuple of int
        Cells of the grid along each axis.
    halo : tuple of int
        Cells of a halo along each axis, on each side.
    blocks : tuple of int
        A tile begins at multiples of these.
    full : str, default ""
        Name of the device whose memory ran out for the whole grid.
    """

    sweeps: int
    tiles: tuple[Tile, ...]
    shape: tuple[int, ...]
    halo: tuple[int, ...]
    blocks: tuple[int, ...]
    full: str = ""

    @classmethod
    def whole(cls, shape: tuple[int, ...], halo: tuple[int, ...], blocks: tuple[int, ...]) -> Tiling:
        """Make one tile of a whole grid, for one sweep; `halo` and `blocks` serve its halves."""
        everything = tuple(slice(0, size) for size in shape)
        return cls(1, (Tile(everything, everything),), shape, halo, blocks)

    def halves(self, tile: Tile) -> tuple[Tile, ...]:
        """Cut a tile into two with as few cells as possible; none if even these have most of its cells."""
        found: list[tuple[Tile, ...]] = []
        for axis, own in enumerate(tile.own):
            middle = (own.start + own.stop) // 2
            if own.start < middle:
                ends = (slice(own.start, middle), slice(middle, own.stop))
                parts = [(*tile.own[:axis], end, *tile.own[axis + 1 :]) for end in ends]
                found.append(tuple(Tile.around(part, self.shape, self.halo, self.blocks) for part in parts))
        best = min(found, key=lambda halves: max(half.size for half in halves), default=())
        return best if best and max(half.size for half in best) <= _WORTH * tile.size else ()

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
    """Cut a grid into tiles of at most these sizes, as equal as possible."""
    axes = []
    for length, size in zip(shape, sizes, strict=True):
        count = -(-length // size)
        ends = [length * i // count for i in range(count + 1)]
        axes.append([slice(a, b) for a, b in itertools.pairwise(ends)])
    return tuple(Tile.around(own, shape, halo, blocks) for own in itertools.product(*axes))


def tiling(
    grid: GridGraph,
    job: Job,
    devices: Sequence[Backend],
    budget: Budget,
    halo: Callable[[int], tuple[int, ...]],
    work: Callable[[int], float],
    most: int,
) -> Tiling:
    """Choose the cheapest tiles with at most `most` sweeps per block; `work` is the work per vertex of n sweeps.

    Each device can do each tile. Tiles are bands of rows along the first axis; if these do not fit, they are cut along
    the second axis too.

    Raises
    ------
    MemoryError
        Even a small tile does not fit.
    """
    blocks = blocks_of(grid, job, devices)
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
            rows, need = _rows(grid, beside, job, devices, budget)
            least = min(least, need, key=lambda need: need.total)
            own = min(grid.shape[0], rows if rows >= grid.shape[0] else rows - 2 * wider[0] - blocks[0] + 1)
            if own >= 1:
                parts = cut(grid.shape, (own, *sizes[1:]), wider, blocks)
                found = Tiling(sweeps, parts, grid.shape, wider, blocks)
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


def blocks_of(grid: GridGraph, job: Job, devices: Sequence[Backend]) -> tuple[int, ...]:
    """Return the block sizes along each axis: a step without stored weights may begin at multiples of them."""
    sides = [math.lcm(*(one.row_block for one in devices)), math.lcm(*(one.column_block for one in devices))]
    return tuple((*[1] * grid.ndim, *([1, 1] if job.stored else sides))[-grid.ndim :])


def need_of(grid: GridGraph, shape: tuple[int, ...], job: Job, devices: Sequence[Backend]) -> Need:
    """Return the memory that a job needs on a part of a grid, on any of the devices."""
    mask = None if grid.mask is None else np.ones(shape, bool)
    part = GridGraph(shape, grid.radius, grid.metric, spacing=grid.spacing, mask=mask)
    needs = [job.need(part, device) for device in dict.fromkeys(devices)]
    return Need(max(need.total for need in needs), max(need.largest for need in needs))


def _rows(grid: GridGraph, beside: int, job: Job, devices: Sequence[Backend], budget: Budget) -> tuple[int, Need]:
    """Return the largest number of rows of tiles of this width that fit, and the memory that one row needs."""

    def need(rows: int) -> Need:
        return need_of(grid, (rows, *((beside, *grid.shape[2:]) if grid.ndim > 1 else ())), job, devices)

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
