"""One sweep at p = 2 with weights that are never stored: what the filters are."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from . import backends
from .backends import Backend
from .graphs.grid import GridGraph
from .memory import Budget, Job, budget
from .problem import Problem
from .progress import progress_bar
from .regularization import as_given
from .result import Result, Stop
from .tiles import OneStep, Tile, Tiling, step_in_tiles, tiling, work_of
from .weights import Weights

# Bytes of a tile of a sweep that stores no weights.
_STEP_BYTES = 1 << 29


def one_sweep(
    f0: npt.ArrayLike,
    graph: GridGraph,
    *,
    lam: float | npt.ArrayLike,
    weights: Weights | npt.ArrayLike,
    eps: float | None = None,
    backend: str = "auto",
    dtype: npt.DTypeLike | None = None,
    memory: int | None = None,
    progress: bool = False,
    step: OneStep | None = None,
) -> Result:
    """:func:`regularize` with p = 2, one undamped Jacobi sweep, and weights that are computed but not stored.

    `weights` are such as :func:`gpureg.weights.patch_weights` finds. An energy needs stored weights: the result has
    none. An interruption leaves no iterate. `step` says what the sweep does besides the book.
    """
    begin = time.perf_counter()
    kind: np.dtype[Any] = np.dtype(np.float32 if dtype is None else dtype).newbyteorder("=")
    problem = Problem.make(
        f0, graph, p=2.0, lam=lam, weights=weights, gamma="sqrt", norm="vertex", coupled=True, eps=eps, dtype=kind
    )
    device = backends.get(backend, kind)
    allowed = budget(device, memory)
    step = OneStep() if step is None else step
    averages = step.averaged is not None
    # from stored weights, with the channel that is divided by, and its shares
    stored = averages and not step.fuses(device, graph)
    job = Job(
        channels=problem.f0.shape[1] + stored,
        weights=problem.weights,
        per_vertex=averages or not isinstance(problem.lam, float),
        stored=stored,
    )
    tiles = _tiles_of_a_step(graph, job, device, allowed, step.halo(problem), work_of(problem, stored=stored))
    with np.errstate(over="ignore", invalid="ignore"), progress_bar(progress, len(tiles.tiles), "tiles") as report:
        value = step_in_tiles(problem, device, step, tiles, lambda done, of: report(done))
    return Result(
        value=as_given(value, f0, graph),
        iterations=1,
        stop=Stop.MAX_ITER,
        energy=np.empty(0),
        checks=np.empty(0, np.int64),
        gap=None,
        error_bound=None,
        eps=problem.eps,
        method="Gauss-Jacobi (eq. 25), "
        + (
            "each patch estimated as a whole, patches averaged." if averages else "its weights computed and not stored."
        ),
        backend=repr(device),
        seconds=time.perf_counter() - begin,
    )


def _tiles_of_a_step(
    graph: GridGraph,
    job: Job,
    device: Backend,
    allowed: Budget,
    halo: tuple[int, ...],
    work: Callable[[int], float],
) -> Tiling:
    """Small tiles, which cost nothing where a halo is one window wide, and leave the host its memory.

    A window that is wide beside the grid may not fit such: then what is allowed is taken.
    """
    need = job.need(graph, device)
    for limit in sorted({min(allowed.total, _STEP_BYTES), allowed.total}):
        within = Budget(limit, min(allowed.largest, limit), allowed.asked)
        if within.holds(need):
            whole = tuple(slice(0, s) for s in graph.shape)
            return Tiling(1, (Tile(whole, whole),))
        try:
            return tiling(graph, job, device, within, lambda n: halo, work, 1)
        except MemoryError:
            if limit == allowed.total:
                raise
    raise AssertionError("the last limit is what is allowed")
