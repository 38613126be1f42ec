"""Regularize each channel as if it were alone: :func:`by_channel`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..exchange import as_came, on_host
from ..graphs.grid import AnyGraph
from ..model.problem import Problem, as_function
from ..model.result import Interrupted, Result, Stop
from ..solvers.loop import Callback, Check
from ..weights import Constant, Guided, Weights


def by_channel(
    regularize: Callable[..., Result],
    f0: npt.ArrayLike,
    graph: AnyGraph,
    *,
    weights: Weights | npt.ArrayLike | None,
    initial: npt.ArrayLike | None,
    callback: Callback | None,
    options: dict[str, Any],
) -> Result:
    """Regularize the channels one after another, each with an eps, a tolerance and a stop of its own.

    Weights that depend on the data are computed from all channels. A callback sees the checks of one channel after the
    other; if it stops the run, later channels stay at their start.
    """
    begin = time.perf_counter()
    data = as_function(graph, f0, "f0")
    start = data if initial is None else as_function(graph, initial, "initial")
    if start.shape != data.shape:
        raise ValueError(f"initial must have the shape of f0, {np.shape(f0)}, got {start.shape}")
    if isinstance(weights, Weights) and not isinstance(weights, Constant):
        # a copy, as results keep it
        weights = Guided(weights.on(graph), data.copy())
    value: FloatArray = start.copy()
    results: list[Result] = []

    def joined() -> Result:
        return _joined(results, value.astype(results[0].value.dtype, copy=False), time.perf_counter() - begin)

    for c in range(data.shape[1]):
        own = slice(c, c + 1)
        watched = None if callback is None else _of_all(callback, value, own)
        try:
            result = regularize(
                data[:, own], graph, weights=weights, initial=start[:, own], callback=watched, **options
            )
        except Interrupted as interruption:
            value[:, own] = interruption.result.value
            results.append(interruption.result)
            raise Interrupted(joined()) from None
        value[:, own] = result.value
        results.append(result)
        if result.stop is Stop.CALLBACK:
            break
    return joined()


def _of_all(callback: Callback, value: FloatArray, own: slice) -> Callback:
    """Return a callback whose ``check.value()`` has all channels: the iterate of one, and `value` for the others."""

    def watched(check: Check) -> Any:
        def whole() -> FloatArray:
            now = value.copy()
            now[:, own] = on_host(check.value(), "value")
            found: FloatArray = as_came(now)
            return found

        return callback(replace(check, value=whole))

    return watched


def _joined(results: Sequence[Result], value: FloatArray, seconds: float) -> Result:
    """Join the results of the channels; `value` is (n, m)."""
    checks = np.unique(np.concatenate([result.checks for result in results]))
    energy = np.zeros(len(checks))
    for result in results:
        if len(result.checks):
            # a channel that has stopped keeps its last energy
            energy += result.energy[np.searchsorted(result.checks, checks, side="right") - 1]
    gaps, bounds = [r.gap for r in results], [r.error_bound for r in results]
    stops = [result.stop for result in results]
    early = [stop for stop in (Stop.INTERRUPTED, Stop.CALLBACK, Stop.MAX_ITER) if stop in stops]
    return Result(
        value=value,
        iterations=max(result.iterations for result in results),
        stop=early[0] if early else stops[-1],
        energy=energy,
        checks=checks.astype(np.int64),
        gap=None if None in gaps else math.fsum(gap for gap in gaps if gap is not None),
        error_bound=None if None in bounds else math.hypot(*(bound for bound in bounds if bound is not None)),
        eps=max(result.eps for result in results),
        method=f"{results[0].method} Each of {value.shape[1]} channels by itself.",
        backend=results[0].backend,
        seconds=seconds,
        # why there is none for one channel, if there is none
        error_bound_note=results[bounds.index(None) if None in bounds else 0].error_bound_note,
        problem=_problems(results, value.shape[1]),
    )


def _problems(results: Sequence[Result], channels: int) -> tuple[Problem, ...] | None:
    """Return the problem of each channel; None if one was not solved."""
    found = tuple(result.problem for result in results if isinstance(result.problem, Problem))
    return found if len(found) == channels else None
