"""The discrepancy principle: as much is taken away as there is noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray
from ..checks import number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import GridGraph
from ..model.problem import as_function, uses_degrees
from ..model.result import Result
from ..regularization.path import SETTINGS as _SERIES
from ..regularization.path import Series
from ..regularization.regularize import regularize
from ..solvers import resolve

# How far from 1 the ratio may end; factor from the first lam at which the search gives up.
RTOL, _FURTHEST = 0.01, 1e8


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What the discrepancy principle found.

    Attributes
    ----------
    lam : float or (n,) array
        The fidelity; one value per vertex where the noise was given so.
    result : Result
        The regularization with this fidelity.
    ratio : float
        What was taken away, |f - f0|^2, as a share of the noise's n m sigma^2; the principle asks for 1.
    evaluations : int
        Regularizations done.
    """

    lam: float | FloatArray
    result: Result
    ratio: float
    evaluations: int

    def __str__(self) -> str:
        lam = f"{self.lam:.4g}" if isinstance(self.lam, float) else f"{self.lam.min():.4g} to {self.lam.max():.4g}"
        return f"lam = {lam}: {explained(self.ratio, self.evaluations)}"


def explained(ratio: float, evaluations: int) -> str:
    """What the search did, in words."""
    return f"discrepancy principle: {ratio:.3f} of the noise's energy taken away, {evaluations} evaluation(s)"


@door
def discrepancy(
    f0: npt.ArrayLike,
    graph: GraphLike,
    sigma: float | npt.ArrayLike,
    *,
    start: float | None = None,
    rtol: float = RTOL,
    **settings: Any,
) -> Discrepancy:
    """Regularize with the fidelity that takes away as much as there is noise.

    Parameters
    ----------
    f0 : array
        The data, as in :func:`gpureg.regularize`.
    graph : Graph or GridGraph
    sigma : float or array
        Standard deviation > 0 of the noise, in the data's units; one number, or one per vertex. Then lam(u) is
        proportional to 1/sigma(u)^2, and each vertex is measured by its own noise.
    start : float, optional
        Where to begin the search. None takes 2.2 sigma^(p - 2), a good guess on the 4-adjacency graph of an image.
    rtol : float, default 0.01
        How far from 1 the ratio may end.
    **settings
        All others of :func:`gpureg.regularize`, but `lam` and `initial`.

    Returns
    -------
    Discrepancy
        Its ``lam`` and ``result``, and the ratio reached. That stays below 1 if all that regularization can take away
        is less than the noise: `sigma` is too large, or the iterations too few.

    Raises
    ------
    ValueError, TypeError
        A sigma that is not > 0, a setting that does not belong here; and as :func:`gpureg.regularize`.

    Notes
    -----
    Solves ||f_lam - f0||^2 = n m sigma^2 (Morozov 1966; for total variation Rudin, Osher, Fatemi 1992), n the vertices
    inside a grid's mask and m the channels, by Brent's method on log lam. With `tol` (the certified solver has one of
    its own) and p >= 1, where the end does not depend on the start, each run begins at the last one's outcome.
    The certified solver's tol must be small beside rtol: a gap of tol times the energy leaves a distance of about 1.5
    sqrt(tol) times that of the noise, and the ratio open to twice as much. tol = 1e-5 goes with rtol = 0.01. The
    principle smooths more than the least mean squared error asks for; :func:`sure` does better, at two runs for one.

    Examples
    --------
    >>> import numpy as np, gpureg as gr
    >>> noise = np.random.default_rng(7).normal(0, 0.1, 400)
    >>> f0 = np.sin(np.arange(400) / 30) + noise
    >>> found = gr.tuning.discrepancy(f0, gr.GridGraph(400), 0.1, max_iter=500, backend="numpy")
    >>> abs(found.ratio - 1) < 0.01
    True
    """
    for name in ("lam", "initial"):
        if name in settings:
            raise TypeError(f"{name} is what is looked for, or part of the search: leave it out")
    graph = as_graph(graph, degrees=uses_degrees(settings.get("gamma")))
    data = as_function(graph, f0, "f0")
    inside = graph.mask.ravel() if isinstance(graph, GridGraph) and graph.mask is not None else None
    noise = _noise(sigma, graph, inside)
    unit = math.sqrt(_mean_square(noise, None if noise.size == 1 else inside))
    relative: float | FloatArray = 1.0 if noise.size == 1 else (unit / noise[:, 0]) ** 2
    p = number("p", settings.pop("p", 2.0), above=0)
    if start is not None:
        number("start", start, above=0)
    number("rtol", rtol, above=0)
    solver = resolve(settings.get("solver", "jacobi"))
    # where the end does not depend on the start
    warm = p >= 1 and (settings.get("tol") is not None or solver.tol is not None) and _SERIES.issuperset(settings)
    series = Series(f0, graph, **settings) if warm else None
    nearest: tuple[float, Result] | None = None

    def ratio(scale: float) -> float:
        nonlocal nearest
        lam = scale * relative
        last = regularize(f0, graph, lam=lam, p=p, **settings) if series is None else series.solve(lam, p)
        taken = _mean_square((last.value.reshape(data.shape).astype(np.float64) - data) / noise, inside)
        off = abs(math.log(taken)) if taken > 0 else math.inf
        if nearest is None or off < nearest[0]:
            nearest = off, last
        return taken

    scale, reached, evaluations = match(ratio, 2.2 * unit ** (p - 2) if start is None else start, rtol)
    assert nearest is not None
    return Discrepancy(scale * relative, nearest[1], reached, evaluations)


def match(ratio: Callable[[float], float], start: float, rtol: float = RTOL) -> tuple[float, float, int]:
    """The lam at which a falling `ratio` is nearest to 1, the ratio there, and the evaluations."""
    from scipy import optimize

    number("start", start, above=0)
    number("rtol", rtol, above=0)
    found: dict[float, float] = {}

    def height(x: float) -> float:
        if x not in found:
            found[x] = math.log(max(ratio(math.exp(x)), 1e-300))
        return 0.0 if abs(found[x]) <= math.log1p(rtol) else found[x]

    first = x = math.log(start)
    y = height(x)
    # The ratio falls about as 1/lam: a step beyond that guess, then larger ones, until 1 lies between two of them.
    step, most = 1.5 * y, math.log(_FURTHEST)
    while y and x != (there := min(max(x + step, first - most), first + most)):
        beyond = height(there)
        if y * beyond < 0:
            optimize.brentq(height, min(x, there), max(x, there), xtol=1e-4, rtol=1e-6, maxiter=50, disp=False)
            break
        x, y, step = there, beyond, 2 * step
    nearest = min(found, key=lambda x: abs(found[x]))
    return math.exp(nearest), math.exp(found[nearest]), len(found)


def _mean_square(values: FloatArray, inside: npt.NDArray[np.bool_] | None) -> float:
    return float(np.mean((values if inside is None else values[inside]) ** 2))


def _noise(sigma: float | npt.ArrayLike, graph: Graph | GridGraph, inside: npt.NDArray[np.bool_] | None) -> FloatArray:
    """The noise as (1, 1) or (n, 1), after checking it; 1 outside the mask."""
    array = np.asarray(sigma)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"sigma must be a real number or an array of them, got {sigma!r}")
    shape = graph.shape if isinstance(graph, GridGraph) else (graph.n_vertices,)
    if array.shape not in ((), (graph.n_vertices,), shape):
        raise ValueError(f"sigma must be a number or one per vertex, shape {shape}, got shape {array.shape}")
    noise = array.reshape(-1, 1).astype(np.float64)
    if inside is not None and array.ndim:
        noise[~inside] = 1
    wrong = ~(np.isfinite(noise) & (noise > 0))
    if wrong.any():
        raise ValueError(
            f"sigma must be finite and > 0, got {noise[wrong][0]}: without noise there is nothing to choose lam from"
        )
    return noise
