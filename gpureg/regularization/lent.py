"""Regularize data that lie on the device already: :func:`regularize_lent`.

The host reads the rows from which the frame and the spread are found, and no others.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, held_type
from ..backends import Array, Backend, Weighted
from ..exchange import Lent
from ..frame import Frame, spread, steps_of_samples
from ..graphs.grid import AnyGraph, GridGraph
from ..model.memory import budget_of
from ..model.on_device import DeviceProblem, put_lam
from ..model.problem import SQUARES, Problem, as_function, as_lam, default_eps
from ..model.result import Result
from ..progress import progress_bar
from ..solvers import Euler, Jacobi, Solver, run
from ..weights import Constant, EdgeWeights, PatchWeights, Weights
from .results import result_of
from .tiled import Cutting


@dataclass(frozen=True, eq=False)
class LentProblem(Problem):
    """A problem whose data are on a device: `f0` and `data` have a shape and a type, but no values.

    Parameters
    ----------
    known_spread : float
        The spread of the data, in units of the frame.
    """

    known_spread: float = 0.0

    @property
    def spread(self) -> float:
        """The spread of the data; 1 for constant data."""
        return self.known_spread or 1.0

    def _in(self, frame: Frame, dtype: np.dtype[Any]) -> FloatArray:
        # whoever reads them computes with NaN
        return np.broadcast_to(np.full((), np.nan, dtype), self.f0.shape)


def regularize_lent(lent: Lent, graph: AnyGraph, method: Solver, asked: dict[str, Any]) -> Result | None:
    """Regularize data without copying them to the host, with the result on their device too.

    Parameters
    ----------
    lent : Lent
        The data f0.
    graph : Graph or GridGraph
    method : Solver
    asked : dict
        The other arguments of :func:`gpureg.regularize`, whose numbers of a run are checked.

    Returns
    -------
    Result or None
        None if the host has to see the data: another device, a mask, other solvers and stop tests, vertices without
        data or pinned to them, weights that are computed on the host from the data, constant or infinite data, tiles.
    """
    begin, kind = time.perf_counter(), np.dtype(np.float32 if asked["dtype"] is None else asked["dtype"])
    shape = _rows_of(graph, lent.memory.shape)
    if shape is None or not _is_plain(graph, shape[1], method, asked) or lent.memory.dtype.kind not in "iuf":
        return None
    devices = backends.several(asked["backend"], kind)
    device = devices[0]
    if not device.reads(lent.memory):
        return None
    held = held_type(lent.memory.dtype, np.float32)
    few, many = (lent.rows(shape[1], step).astype(held, copy=False) for step in steps_of_samples(shape[0]))
    if not _varies(few) or not _varies(many):
        return None
    frame = Frame.of(few)
    weights = asked["weights"]
    if isinstance(weights, Weights) and weights.scaled(frame.scale) is None:
        return None
    problem = _problem(graph, np.broadcast_to(np.zeros((), held), shape), frame, many, method, asked, kind)
    method.accept(problem)
    cutting = Cutting(problem, method, asked["max_iter"], asked["tol"], asked["callback"])
    if cutting.tiles(devices, budget_of(devices, asked["memory"])) is not None:
        return None
    try:
        return _solved(problem, device, lent, method, asked, begin)
    except MemoryError:
        # the host can cut the job into tiles
        if asked["callback"] is not None:
            raise
        return None


def _solved(
    problem: LentProblem, device: Backend, lent: Lent, method: Solver, asked: dict[str, Any], begin: float
) -> Result | None:
    """Run on the device; None if the data are out of the range of the type, or the start has another shape."""
    graph, frame = problem.graph, problem.frame
    f0 = device.put_memory(graph, lent.memory, frame)
    if not _is_in_range(device, graph, f0, asked["dtype"]):
        return None
    weighted = _weighted(problem, device, f0)
    on_device = DeviceProblem(problem, device, weighted, f0, put_lam(problem, device, None), None)
    if asked["initial"] is None:
        first = device.put_memory(graph, lent.memory, frame, fresh=True)
    else:
        start = as_function(graph, asked["initial"], "initial")
        if start.shape != problem.f0.shape:
            return None
        first = on_device.put_function(problem.framed(start))
    with (
        np.errstate(over="ignore", invalid="ignore"),
        progress_bar(asked["progress"], asked["max_iter"]) as report,
    ):
        run_with = {name: asked[name] for name in ("max_iter", "tol", "callback")}
        outcome = run(on_device, method, first, report=report, **run_with)
    data = problem.f0 if problem.data is None else problem.data
    numbers = device.get_memory(graph, outcome.f, frame, np.promote_types(device.dtype, data.dtype))
    # the caller may free the data, and read the result on any stream
    device.finish()
    return result_of(outcome, lent.like(numbers), begin)


def _rows_of(graph: AnyGraph, shape: tuple[int, ...]) -> tuple[int, int] | None:
    """Return (n, m) for data of this shape; None if they are no function on the graph."""
    n = graph.n_vertices
    for own in (graph.shape if isinstance(graph, GridGraph) else (n,), (n,)):
        more = shape[len(own) :]
        if shape[: len(own)] == own and len(more) < 2 and 0 not in shape:
            return n, more[0] if more else 1
    return None


def _is_plain(graph: AnyGraph, channels: int, method: Solver, asked: dict[str, Any]) -> bool:
    """Return whether the host does not need the data, as far as the arguments say."""
    weights = asked["weights"]
    known = not isinstance(weights, Weights) or isinstance(weights, Constant | PatchWeights)
    if isinstance(weights, EdgeWeights):
        known = not weights.reads_data
    lam = as_lam(graph, asked["lam"])
    return (
        known
        and asked["update_weights"] is None
        and isinstance(method, Jacobi | Euler)
        and method.stop == "change"
        and (asked["coupled"] is True or channels == 1)
        and isinstance(asked["gamma"], str)
        and asked["gamma"] == "sqrt"
        and not (isinstance(graph, GridGraph) and graph.mask is not None)
        and bool(lam.min() > 0)
        and bool(np.isfinite(lam).all())
    )


def _varies(values: FloatArray) -> bool:
    """Return whether the middle 90 percent of the values of each channel, (k, m), are finite and not all equal."""
    ordered = np.sort(values, axis=0)
    few = max(1, len(ordered) // 20)
    if len(ordered) <= 2 * few or not np.isfinite(ordered[[0, -1]]).all():
        return False
    return bool((ordered[few] < ordered[-1 - few]).all())


def _problem(
    graph: AnyGraph,
    virtual: FloatArray,
    frame: Frame,
    sampled: FloatArray,
    method: Solver,
    asked: dict[str, Any],
    kind: np.dtype[Any],
) -> LentProblem:
    """Check the arguments, and make the problem in units of the frame."""
    model = {name: asked[name] for name in ("p", "lam", "weights", "gamma", "norm", "coupled", "eps")}
    if model["eps"] is None and method.smooths:
        model["eps"] = default_eps(sampled, asked["p"])
    made = LentProblem.make(virtual, graph, dtype=kind, smoothed=method.smooths, framed=frame, **model)
    assert isinstance(made, LentProblem)
    return replace(made, known_spread=spread(made.frame.into(sampled, kind)))


def _is_in_range(device: Backend, graph: AnyGraph, f0: Array, dtype: npt.DTypeLike | None) -> bool:
    """Return whether all data are finite, and in the range of the type to compute in."""
    largest = device.max_change(graph, f0, device.empty(graph, device.channels(f0)))
    return bool(np.isfinite(largest)) and (dtype is not None or largest <= SQUARES)


def _weighted(problem: Problem, device: Backend, f0: Array) -> Weighted:
    """Return the graph with its weights on the device."""
    weights = problem.weights
    if isinstance(weights, PatchWeights):
        form = weights.form(problem.graph, device.channels(f0), device.dtype)
        return device.patch_distance(problem.graph, f0, form, storage=weights.storage)
    if isinstance(weights, Weights):
        assert isinstance(weights, Constant | EdgeWeights)
        return weights.prepare(device, problem.graph, problem.f0)
    return device.prepare(problem.graph, weights)
