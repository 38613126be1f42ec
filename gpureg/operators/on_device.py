"""Put the arguments of an operator on a device; the settings of operators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypedDict

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, computed_type
from ..backends import Chosen
from ..checks import number
from ..graphs.grid import AnyGraph, GridGraph
from ..model.on_device import DeviceProblem
from ..model.problem import Norm, Problem, as_function
from ..weights.base import AnyWeights


class Settings(TypedDict, total=False):
    """Settings of all operators, as in :func:`gpureg.regularize`.

    Attributes
    ----------
    weights : Weights or array, optional
    gamma : str or array, default "sqrt"
    backend : str, default "auto"
    dtype : dtype, default float32
    """

    weights: AnyWeights
    gamma: str | npt.ArrayLike
    backend: Chosen
    dtype: npt.DTypeLike | None


class Channels(Settings, total=False):
    """Settings of operators with a choice of norm.

    Attributes
    ----------
    norm : {"vertex", "edge"}, default "vertex"
    coupled : bool, default True
    """

    norm: Norm
    coupled: bool


class Smoothed(Channels, total=False):
    """Settings of operators with a smoothed gradient norm.

    Attributes
    ----------
    eps : float, default 0
    """

    eps: float


SETTINGS: dict[str, Any] = {"weights": None, "gamma": "sqrt", "backend": "auto", "dtype": None}
CHANNELS: dict[str, Any] = {"norm": "vertex", "coupled": True, **SETTINGS}
SMOOTHED: dict[str, Any] = {"eps": 0.0, **CHANNELS}


def put_function(
    f: npt.ArrayLike,
    graph: AnyGraph,
    p: float,
    settings: Mapping[str, object],
    *,
    lam: float | npt.ArrayLike = 0.0,
    f0: npt.ArrayLike | None = None,
) -> tuple[DeviceProblem, FloatArray]:
    """Put the problem with data `f0` (by default f) on the device; return it and f as (n, m)."""
    chosen: dict[str, Any] = {**SMOOTHED, **settings}
    chosen["eps"] = number("eps", chosen["eps"], low=0)
    backend, kind = chosen.pop("backend"), computed_type(chosen.pop("dtype"))
    problem = Problem.make(f if f0 is None else f0, graph, p=p, lam=lam, dtype=kind, **chosen)
    function = problem.f0 if f0 is None else as_function(graph, f, "f")
    if function.shape != problem.f0.shape:
        raise ValueError(f"f and f0 must have the same shape, got {np.asarray(f).shape} and {np.asarray(f0).shape}")
    return DeviceProblem.put(problem, backends.get(backend, kind)), function


def bare(graph: AnyGraph) -> tuple[tuple[int, ...], ...]:
    """Return the allowed shapes of a function without an axis of channels."""
    return ((graph.n_vertices,), graph.shape) if isinstance(graph, GridGraph) else ((graph.n_vertices,),)
