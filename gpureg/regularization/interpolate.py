"""Interpolate values that are known at some vertices: :func:`interpolate`."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np
import numpy.typing as npt

from ..arrays import unmasked
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.grid import AnyGraph, GridGraph
from ..model.problem import uses_degrees
from ..model.result import Result
from ..weights import Weights
from .options import MODEL, Model
from .regularize import regularize

# The defaults of :func:`interpolate` for the options of the model and the run.
_OPTIONS: dict[str, Any] = MODEL | {"norm": "edge", "solver": "certified"}


@door(options=_OPTIONS)
def interpolate(
    values: npt.ArrayLike,
    graph: GraphLike,
    *,
    known: npt.ArrayLike | None = None,
    p: float = 2.0,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    max_iter: int | None = None,
    **options: Unpack[Model],
) -> Result:
    """Interpolate values that are known at some vertices of a graph.

    Parameters
    ----------
    values : array
        The values, shape (n,) or (n, m); on a :class:`GridGraph` also its shape, or its shape with a last axis of m
        channels. NaN where they are not known: in all channels of a vertex, or in none.
    graph : Graph or GridGraph
        The graph of n vertices; or a sparse matrix of scipy, or a graph of networkx, as in :func:`gpureg.regularize`.
    known : bool array, optional
        Where the values are known, one per vertex; the other values do not matter. None: where they are not NaN.
    p : float, default 2
        Degree of regularity >= 1. 2 is the harmonic function, the linear system; towards 1 it is piecewise constant;
        a larger p gives smaller largest slopes, and ``math.inf`` the absolutely minimal Lipschitz extension. With few
        known values on many vertices p = 2 is nearly constant with a spike at each of them; a larger p avoids that.
    weights : Weights or array, optional
        As in :func:`gpureg.regularize`. Weight functions that compare data see the mean of the known values at the
        other vertices: give them other data by ``gpureg.weights.guided``.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array, default "sqrt"
    norm : {"vertex", "edge"}, default "edge"
        With "edge" the limit of a large p is that of p = infinity. At p = 2 both are the same.
    eps : float, optional
        As in :func:`gpureg.regularize`.
    solver : str or Solver, default "certified"
    max_iter : int, optional
    tol : float, optional
        Share of the energy to which the gap falls. None: 1e-4. With p = infinity the share of the least Lipschitz
        constant that the steepest slopes up and down may differ by; None: rounding.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    Result
        Its value has the known values, bit for bit, and the interpolated ones at the other vertices. ``gap`` bounds the
        energy above the minimum, ``error_bound`` the distance from the interpolation, where a bound exists.

    Raises
    ------
    ValueError, TypeError
        A vertex with NaN in some channels only; otherwise as :func:`gpureg.regularize`.
    BackendUnavailable, FloatingPointError, Interrupted, MemoryError
        As :func:`gpureg.regularize`.

    Warns
    -----
    RuntimeWarning
        Components of the graph without known values, which are set to a constant.

    Notes
    -----
    One call of :func:`gpureg.regularize` with lam infinite at the known vertices and 0 at the others.

    Examples
    --------
    A path with both ends known, and one value between:

    >>> import math, numpy as np, gpureg as gr
    >>> values = [0, math.nan, math.nan, 3, math.nan, 4]
    >>> result = gr.interpolate(values, gr.GridGraph(6), p=math.inf, backend="numpy")
    >>> result.value
    array([0. , 1. , 2. , 3. , 3.5, 4. ])
    >>> float(result.energy[-1].round(6))  # the largest slope, which no function with these values can have smaller
    1.0
    """
    graph = as_graph(graph, degrees=uses_degrees(gamma))
    filled, there = _filled(graph, values, known)
    return regularize(
        filled,
        graph,
        p=p,
        lam=np.where(there, np.inf, 0.0),
        weights=weights,
        gamma=gamma,
        max_iter=max_iter,
        **{**_OPTIONS, **options},
    )


def _filled(
    graph: AnyGraph, values: npt.ArrayLike, known: npt.ArrayLike | None
) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]:
    """Return the values with means of the known ones at the other vertices, and where they are known, (n,)."""
    array = unmasked(values, "values")
    if array.dtype.kind not in "biuf":
        raise TypeError(f"values must hold real numbers, got {array.dtype}")
    n = graph.n_vertices
    shapes = (graph.shape, (n,)) if isinstance(graph, GridGraph) else ((n,),)
    fits = [s for s in shapes if array.shape[: len(s)] == s and array.ndim - len(s) in (0, 1) and array.size]
    if not fits:
        allowed = " or ".join(f"{s} or {s} with a last axis of channels" for s in shapes)
        raise ValueError(f"values must have shape {allowed}, got {array.shape}")
    rows = array.reshape(n, -1)
    there: npt.NDArray[np.bool_]
    if known is None:
        missing = np.isnan(rows) if array.dtype.kind == "f" else np.zeros(rows.shape, bool)
        partly = missing.any(axis=1) & ~missing.all(axis=1)
        if isinstance(graph, GridGraph) and graph.mask is not None:
            partly = partly & graph.mask.ravel()
        if partly.any():
            raise ValueError(
                f"values must be NaN in all channels of a vertex or in none, but {int(partly.sum())} vertices have NaN "
                "in some: interpolate the channels one by one, or give known"
            )
        there = np.logical_not(missing.any(axis=1))
    else:
        told = unmasked(known, "known")
        if told.dtype.kind != "b" or told.shape not in shapes:
            raise ValueError(f"known must be True or False for each vertex, shape {shapes[0]}, got {told.shape}")
        there = told.reshape(n)
    inside = graph.mask.ravel() if isinstance(graph, GridGraph) and graph.mask is not None else np.ones(n, bool)
    empty = inside & ~there
    if not empty.any():
        return array, there
    used = there & inside
    kind = array.dtype if array.dtype.kind == "f" or array.dtype.kind == "b" else np.dtype(np.float64)
    mean = rows[used].mean(axis=0) if used.any() else np.zeros(rows.shape[1])
    return np.where(empty[:, None], mean, rows).astype(kind).reshape(array.shape), there
