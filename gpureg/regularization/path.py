"""Regularize the same data with many values of lam or p: :func:`regularization_path`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Unpack

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import unmasked
from ..checks import flag
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..model.memory import budget
from ..model.on_device import DeviceProblem
from ..model.problem import Problem, as_function, uses_degrees
from ..model.result import Result
from ..progress import progress_bar
from ..solvers import resolve, run
from ..weights import Weights
from .options import MODEL, Model
from .regularize import regularize
from .results import as_run, result_of, value_of
from .tiled import Cutting

# Settings of `regularize` that are the same for all runs of a series.
SETTINGS = frozenset(("weights", "gamma", "coupled", "max_iter", *MODEL)) - {"callback", "progress"}


class Series:
    """Runs of :func:`gpureg.regularize` on the same data, graph and weights; each starts from the previous result.

    The weights are computed once, but a job that needs tiles, or several separate channels, calls
    :func:`gpureg.regularize` for each run.

    Parameters
    ----------
    f0, graph, weights, gamma, coupled, max_iter
        As in :func:`gpureg.regularize`.
    **options
        norm, eps, solver, tol, backend, dtype, memory, callback, progress, as in :func:`gpureg.regularize`.
    """

    def __init__(
        self,
        f0: npt.ArrayLike,
        graph: GraphLike,
        *,
        weights: Weights | npt.ArrayLike | None = None,
        gamma: str | npt.ArrayLike = "sqrt",
        coupled: bool = True,
        max_iter: int | None = None,
        **options: Unpack[Model],
    ) -> None:
        chosen = {**MODEL, **options}
        self._f0, self._graph = f0, as_graph(graph, degrees=uses_degrees(gamma))
        self._model: dict[str, Any] = {"weights": weights, "gamma": gamma, "coupled": coupled}
        self._model |= {name: chosen[name] for name in ("norm", "eps")}
        self._run = {name: chosen[name] for name in ("backend", "memory", "callback", "progress")}
        self._solver = resolve(chosen["solver"])
        self._max_iter, self._tol, self._dtype = as_run(
            self._solver, max_iter, chosen["tol"], chosen["dtype"], chosen["callback"], chosen["progress"]
        )
        self._on: DeviceProblem | None = None
        self._state: Any = None
        self._last: Result | None = None
        self._asked: Problem | None = None

    def solve(self, lam: float | npt.ArrayLike, p: float) -> Result:
        """Run with this fidelity, a number or an (n,) array, and degree."""
        begin = time.perf_counter()
        problem = Problem.make(
            self._f0,
            self._graph,
            p=p,
            lam=lam,
            dtype=self._dtype,
            smoothed=self._solver.smooths,
            framed=True,
            **self._model,
        )
        device = backends.get(self._run["backend"], self._dtype)
        callback = self._run["callback"]
        if not flag("coupled", self._model["coupled"]) and as_function(self._graph, self._f0, "f0").shape[1] > 1:
            return self._anew(lam, p)
        if self._last is None or self._on is None:
            cutting = Cutting(problem, self._solver, self._max_iter, self._tol, callback)
            if cutting.tiles([device], budget(device, self._run["memory"])) is not None:
                return self._anew(lam, p)
            self._solver.accept(problem)
            self._on = DeviceProblem.put(problem, device)
        else:
            self._solver.accept(problem)
            self._on = self._on.changed(problem)
        with (
            np.errstate(over="ignore", invalid="ignore"),
            progress_bar(self._run["progress"], self._max_iter) as report,
        ):
            outcome = run(
                self._on,
                self._solver,
                self._on.put_function(problem.f0) if self._state is None else self._on.f0,
                max_iter=self._max_iter,
                tol=self._tol,
                callback=callback,
                report=report,
                resume=self._state,
            )
        self._state = outcome.state
        self._asked = self._detached(problem)
        self._last = result_of(outcome, value_of(outcome, self._f0, self._graph), begin, self._asked)
        return self._last

    def _detached(self, problem: Problem) -> Problem:
        """Return the problem for a result, with the data of the last one, so that a series has one copy of them."""
        last = self._asked
        if last is not None and last.frame == problem.frame and last.f0.dtype == problem.f0.dtype:
            return replace(problem, f0=last.f0, data=last.data)
        return problem.detached(self._f0)

    def _anew(self, lam: float | npt.ArrayLike, p: float) -> Result:
        self._last = regularize(
            self._f0,
            self._graph,
            p=p,
            lam=lam,
            solver=self._solver,
            max_iter=self._max_iter,
            tol=self._tol,
            initial=None if self._last is None else self._last.value,
            dtype=self._dtype,
            **self._model,
            **self._run,
        )
        return self._last


@dataclass(frozen=True, eq=False)
class Path:
    """Results for a list of values of one parameter; iterating gives them in order.

    Attributes
    ----------
    parameter : {"lam", "p"}
        The parameter that changes.
    values : (k,) float array
        Its values, in the order of the runs.
    results : tuple of Result
        One result per value.
    """

    parameter: str
    values: npt.NDArray[np.float64]
    results: tuple[Result, ...]

    _exchanged: ClassVar[tuple[str, ...]] = ("results",)

    def __iter__(self) -> Iterator[Result]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)

    def __getitem__(self, k: int) -> Result:
        return self.results[k]


@door(options=MODEL)
def regularization_path(
    f0: npt.ArrayLike,
    graph: GraphLike,
    *,
    lam: float | npt.ArrayLike = 1.0,
    p: float | npt.ArrayLike = 2.0,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    coupled: bool = True,
    max_iter: int | None = None,
    **options: Unpack[Model],
) -> Path:
    """Regularize with a list of values of `lam` or of `p`, each run starting from the previous result.

    Parameters
    ----------
    f0 : array
        The data, as in :func:`gpureg.regularize`.
    graph : Graph or GridGraph
    lam, p : float or sequence of float
        One of them is a sequence of values, used in this order. A run is short if its value is near the previous one.
    weights, gamma, coupled
        As in :func:`gpureg.regularize`. The weights are computed once.
    max_iter : int, optional
        Maximal number of iterations of each run, as in :func:`gpureg.regularize`.
    norm, eps, solver, tol, backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`. A callback is called at the checks of all runs; True stops only one run.

    Returns
    -------
    Path
        The values and their results.

    Raises
    ------
    ValueError, TypeError
        No sequence, or two; otherwise as :func:`gpureg.regularize`.

    Notes
    -----
    With ``solver="certified"`` each result is within its gap of the minimum for any start: a warm start only saves
    time. With p < 1 the result is a local minimum, which depends on the start: decreasing p from 1 often gives good
    ones.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> f0 = np.array([0, 0, 0.3, 0, 1, 1, 0.8, 1])
    >>> path = gr.regularization_path(f0, gr.GridGraph(8), p=1, lam=[8, 4, 2], solver="certified", backend="numpy")
    >>> [round(float(np.ptp(result.value)), 2) for result in path]
    [0.78, 0.66, 0.43]
    """
    many = {name: np.ndim(value) > 0 for name, value in (("lam", lam), ("p", p))}
    if sum(many.values()) != 1:
        given = "both" if all(many.values()) else "neither"
        raise ValueError(f"one of lam and p must be a sequence of values, got {given}")
    parameter = "lam" if many["lam"] else "p"
    values = unmasked(lam if many["lam"] else p, parameter)
    if values.ndim != 1:
        raise ValueError(f"{parameter} must be a list of numbers, got an array of shape {values.shape}")
    if values.dtype.kind not in "iuf":
        raise TypeError(f"{parameter} must be a list of numbers, got {values.dtype}")
    values = values.astype(np.float64)
    series = Series(f0, graph, weights=weights, gamma=gamma, coupled=coupled, max_iter=max_iter, **options)
    results = []
    for value in values.tolist():
        results.append(series.solve(value, p) if parameter == "lam" else series.solve(lam, value))  # type: ignore[arg-type]
    return Path(parameter, values, tuple(results))
