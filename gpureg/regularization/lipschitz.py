"""Regularize with p = infinity, the absolutely minimal Lipschitz extension: :func:`regularize_lipschitz`."""

from __future__ import annotations

import math
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import backends
from ..arrays import FloatArray, computed_type
from ..backends import BackendUnavailable
from ..checks import choice, flag, integer, number
from ..doors import outside
from ..graphs.components import Components
from ..graphs.grid import AnyGraph, GridGraph
from ..model.matrices import undirected_edges
from ..model.on_device import DeviceProblem
from ..model.problem import NORMS, Problem, as_function
from ..model.result import Result, Stop
from ..solvers import Certified, Solver
from ..solvers.lipschitz import Extension, extend
from ..solvers.slopes import Slopes, Steepest, least_constant
from .results import as_given

# Systems solved at most by default: 100 to 200 are needed on 20,000 vertices.
_MOST = 5000
_NOTE = "No error bound: none is known for p = infinity, but the extension is unique."


def is_limit(p: object) -> bool:
    """Return whether p is infinite."""
    return isinstance(p, float | np.floating) and float(p) == math.inf


@dataclass(frozen=True, eq=False)
class _Pinned:
    """The connected vertices, and the values in the variable g = s f in which gamma is symmetric.

    Attributes
    ----------
    slopes : Slopes
        The graph; components without data are pinned.
    lone : (n,) bool array
        The vertices of components without data.
    scale : (n, 1) array or None
    g : (n, m) float64 array
        The data, and the constants of components without any.
    said : str
        What those were set to, in words; empty if there are none.
    """

    slopes: Slopes
    lone: npt.NDArray[np.bool_]
    scale: FloatArray | None
    g: FloatArray
    said: str

    @classmethod
    def of(cls, on: DeviceProblem, known: npt.NDArray[np.bool_]) -> _Pinned:
        edges, n, data = undirected_edges(on, scaled=False), len(known), on.problem.data
        assert data is not None
        there, back, scale = edges.there, edges.back, on.scale
        f = data.astype(np.float64) if scale is None else data.astype(np.float64) * scale
        if not np.array_equal(there, back):
            raise ValueError(
                "p = infinity needs a symmetric gamma, gamma(u, v) = gamma(v, u): the shortest paths between data have "
                "no meaning otherwise"
            )
        u, v, gamma = edges.u[there > 0], edges.v[there > 0], there[there > 0]
        parts = Components.of_edges(n, u, v)
        lone = parts.without(known)
        graph = on.problem.graph
        used = known & graph.mask.ravel() if isinstance(graph, GridGraph) and graph.mask is not None else known
        constant = f[used].min(axis=0) / 2 + f[used].max(axis=0) / 2 if used.any() else np.zeros(f.shape[1])
        f = np.where(lone[:, None], constant, f)
        said = ""
        if lone.any():
            listed = ", ".join(f"{x:.6g}" for x in (f if scale is None else f / scale)[np.flatnonzero(lone)[0], :4])
            why = "the middle of the data's range" if used.any() else "as there are no data at all"
            said = (
                f"{int(lone.sum())} vertices in {len(np.unique(parts.labels[lone]))} component(s) without data are set "
                f"to a constant, {listed}{', ...' if f.shape[1] > 4 else ''} ({why})"
            )
        return cls(Slopes.of(u, v, gamma, known | lone), lone, scale, f, said)


def regularize_lipschitz(f0: npt.ArrayLike, graph: AnyGraph, method: Solver, asked: dict[str, Any]) -> Result:
    """Find the absolutely minimal Lipschitz extension of the values where lam is infinite.

    Parameters
    ----------
    f0 : array
    graph : Graph or GridGraph
    method : Solver
    asked : dict
        The other arguments of :func:`gpureg.regularize`. Without `tol` it goes on until no choice can be improved;
        `max_iter` counts linear systems.

    Returns
    -------
    Result
        Its energy is the largest slope, its gap this minus the least Lipschitz constant of the data.
    """
    begin = time.perf_counter()
    _check(method, asked)
    most = _MOST if asked["max_iter"] is None else integer("max_iter", asked["max_iter"], low=1)
    tol = 0.0 if asked["tol"] is None else number("tol", asked["tol"], low=0)
    on = _on_device(f0, graph, asked)
    problem = on.problem
    assert problem.data is not None
    inside = graph.mask.ravel() if isinstance(graph, GridGraph) and graph.mask is not None else np.ones(1, bool)
    lam = np.broadcast_to(problem.lam, (graph.n_vertices, 1))[:, 0]
    known = np.isinf(lam) | ~inside
    if (lam[~known] > 0).any():
        raise ValueError(
            "lam must be 0 or infinite at every vertex with p = infinity, which extends pinned values, got "
            f"{lam[~known].max():g}"
        )
    start = None if asked["initial"] is None else as_function(graph, asked["initial"], "initial").astype(np.float64)
    if start is not None and start.shape != problem.f0.shape:
        raise ValueError(f"initial must have the shape of f0, {np.shape(f0)}, got {np.shape(asked['initial'])}")
    pinned = _Pinned.of(on, known)
    if pinned.said:
        warnings.warn(pinned.said, RuntimeWarning, stacklevel=outside())
    if start is not None and pinned.scale is not None:
        start = start * pinned.scale
    g, found = pinned.g.copy(), []
    for c in range(g.shape[1]):
        steepest = least_constant(pinned.slopes, g[:, c])
        own = None if start is None else start[:, c]
        extension = extend(pinned.slopes, g[:, c], steepest, start=own, most=most, tol=tol)
        g[:, c] = extension.f
        found.append((steepest, extension))
    f = g if pinned.scale is None else g / pinned.scale
    kind = np.promote_types(computed_type(asked["dtype"]), problem.data.dtype)
    value = np.where(known[:, None], problem.data, f).astype(kind)
    return _result(on, pinned, value, found, as_given(value.copy(), f0, graph), begin)


def _check(method: Solver, asked: dict[str, Any]) -> None:
    """Raise ValueError for options that p = infinity does not have."""
    flag("coupled", asked["coupled"])
    flag("progress", asked["progress"])
    choice("norm", asked["norm"], NORMS)
    if asked["norm"] != "edge" or not isinstance(method, Certified):
        raise ValueError(
            "p = infinity is the limit of the edge norm, computed by solver='certified': call with norm='edge', "
            f"solver='certified' or gpureg.interpolate; got norm={asked['norm']!r} and {type(method).__name__}"
        )
    if asked["update_weights"] is not None:
        raise ValueError("update_weights needs a process such as solver='jacobi', which p = infinity does not have")
    if asked["callback"] is not None:
        raise ValueError("callback is not called with p = infinity, which has no energy to check: leave callback=None")
    if asked["eps"] is not None and number("eps", asked["eps"], low=0) > 0:
        raise ValueError(f"eps must be None or 0 with p = infinity, got {asked['eps']}")


def _on_device(f0: npt.ArrayLike, graph: AnyGraph, asked: dict[str, Any]) -> DeviceProblem:
    """Return the problem with its weights, in float64 if the device has it."""
    names = ("lam", "weights", "gamma", "norm", "coupled")
    given: dict[str, Any] = {name: asked[name] for name in names} | {"p": 2.0, "eps": 0.0, "framed": True}
    kind = computed_type(asked["dtype"])
    if asked["dtype"] is None:
        try:
            backends.several(asked["backend"], np.dtype(np.float64))
            kind = np.dtype(np.float64)
        except BackendUnavailable:
            pass
    device = backends.several(asked["backend"], kind)[0]
    return DeviceProblem.put(Problem.make(f0, graph, dtype=kind, **given), device)


def _result(
    on: DeviceProblem,
    pinned: _Pinned,
    value: FloatArray,
    found: list[tuple[Steepest, Extension]],
    given: npt.NDArray[Any],
    begin: float,
) -> Result:
    """Make the result, with the slopes of the value as it is returned, (n, m)."""
    g = value.astype(np.float64) if pinned.scale is None else value * pinned.scale
    g = np.where(pinned.lone[:, None], pinned.g, g)
    largest = max(pinned.slopes.largest(g[:, c]) for c in range(g.shape[1]))
    least = max(steepest.slope for steepest, _ in found)
    # a gamma has a root and a quotient beyond the rounding of its weight; each slope two roundings more
    units = 4 * float(np.finfo(on.backend.dtype).eps) + 4 * float(np.finfo(np.float64).eps)
    channels, settled = len(found), all(extension.settled for _, extension in found)
    worst = max(
        (extension.residual / steepest.slope for steepest, extension in found if steepest.slope > 0), default=0.0
    )
    systems = sum(extension.systems for _, extension in found)
    balance = f"the steepest slopes up and down differ by at most {worst:.1e} of the least Lipschitz constant"
    method = f"Policy iteration for the absolutely minimal Lipschitz extension, {systems} linear systems; {balance}."
    if channels > 1:
        method += f" Each of {channels} channels by itself."
    if pinned.said:
        method += f" {pinned.said}."
    if not settled:
        warnings.warn(
            f"the extension has not converged in max_iter linear systems: {balance}",
            RuntimeWarning,
            stacklevel=outside(),
        )
    done = Stop.BALANCED_NO_DATA if pinned.said else Stop.BALANCED
    return Result(
        value=given,
        iterations=systems,
        stop=done if settled else Stop.MAX_ITER,
        energy=np.array([largest]),
        checks=np.array([systems]),
        gap=max(largest - least, 0.0) + units * largest,
        error_bound=None,
        eps=0.0,
        method=method,
        backend=f"{on.backend!r}; the systems by scipy on the host",
        seconds=time.perf_counter() - begin,
        error_bound_note=_NOTE,
    )
