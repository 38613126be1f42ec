"""Solve p = 2 with some values known: the first fill that weights compare, and a start for sweeps.

A sweep carries information over one neighbourhood, so that a hole of k pixels across takes of the order of k^2 sweeps
to fill. For p = 2 a linear system gives the fill, and it is a good start for another p.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..graphs.grid import AnyGraph
from ..weights import Weights
from .joined import Joined
from .options import TOL_LINEAR
from .regularize import regularize


def harmonic(
    f0: FloatArray,
    graph: AnyGraph,
    known: npt.NDArray[np.bool_],
    *,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    **computed: Any,
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find the minimiser of the model for p = 2 with the known vertices pinned and lam = 0 at the others.

    Parameters
    ----------
    f0 : (n, m) float array
        The values of the known vertices; weight functions are computed from all values.
    graph : Graph or GridGraph
    known : (n,) bool array
    weights, gamma
        As in :func:`gpureg.regularize`.
    **computed
        `backend` and `dtype` of :func:`gpureg.regularize`.

    Returns
    -------
    f : (n, m) float array
        `f0`, with new values at the unknown vertices that are connected to a known one.
    reached : (n,) bool array
        Known vertices, and those connected to one by edges of weight > 0.

    Examples
    --------
    >>> import gpureg as gr
    >>> path = gr.GridGraph(5)
    >>> known = np.array([1, 0, 0, 0, 1], bool)
    >>> f, reached = harmonic(np.array([[0.0], [9], [9], [9], [1]]), path, known, backend="numpy")
    >>> f[:, 0].round(3)
    array([0.  , 0.25, 0.5 , 0.75, 1.  ])
    """
    joined = Joined.of(f0, graph, known, weights=weights, gamma=gamma, wanted=~known, **computed)
    reached = joined.reached
    # outside a mask nothing is reached
    free = reached & ~known
    if not free.any():
        return f0.copy(), reached
    lam = np.where(free, 0.0, np.inf)
    result = regularize(
        f0, graph, lam=lam, weights=weights, gamma=gamma, solver="certified", tol=TOL_LINEAR, **computed
    )
    value: FloatArray = result.value
    return value, reached
