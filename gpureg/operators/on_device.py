"""Arguments of an operator on a device."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray
from ..checks import number
from ..graphs.grid import AnyGraph, GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Problem, as_function


def put_function(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    eps: float,
    coupled: bool,
    settings: dict[str, Any],
    *,
    lam: float | npt.ArrayLike = 0.0,
    f0: npt.ArrayLike | None = None,
) -> tuple[DeviceProblem, FloatArray]:
    """The problem whose data is `f0` (or f itself) on the device, and f as (n, m)."""
    number("eps", eps, low=0)
    kind = np.dtype(settings["dtype"] or np.float32)
    make = {"p": p, "lam": lam, "weights": settings["weights"], "gamma": settings["gamma"]}
    make["norm"] = settings.get("norm", "vertex")
    make |= {"coupled": coupled, "eps": eps, "dtype": kind}
    problem = Problem.make(f if f0 is None else f0, graph, **make)
    function = problem.f0 if f0 is None else as_function(graph, f, "f")
    if function.shape != problem.f0.shape:
        raise ValueError(f"f and f0 must have the same shape, got {np.asarray(f).shape} and {np.asarray(f0).shape}")
    return DeviceProblem.put(problem, backends.get(settings["backend"], kind)), function


def bare(graph: AnyGraph) -> tuple[tuple[int, ...], ...]:
    """Shapes of a function without an axis of channels."""
    return ((graph.n_vertices,), graph.shape) if isinstance(graph, GridGraph) else ((graph.n_vertices,),)
