"""The discrepancy principle: the removed noise has the energy of the given noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

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

# Tolerance of the ratio to 1; factor from the first lam at which the search stops.
RTOL, _FURTHEST = 0.01, 1e8


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """The result of the discrepancy principle.

    Attributes
    ----------
    lam : float or (n,) array
        The fidelity; one value per vertex if the noise has one.
    result : Result
        The regularization with this fidelity.
    ratio : float
        |f - f0|^2 as a share of the noise's energy n m sigma^2; the principle requires 1.
    evaluations : int
        Number of regularizations.
    """

    lam: float | FloatArray
    result: Result
    ratio: float
    evaluations: int

    _exchanged: ClassVar[tuple[str, ...]] = ("result",)

    def __str__(self) -> str:
        lam = f"{self.lam:.4g}" if isinstance(self.lam, float) else f"{self.lam.min():.4g} to {self.lam.max():.4g}"
        return f"lam = {lam}: {explained(self.ratio, self.evaluations)}"


def explained(ratio: float, evaluations: int) -> str:
    """Describe the result of a search."""
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
    """Regularize with the fidelity for which the removed noise has the energy of the given noise.

    Parameters
    ----------
    f0 : array
        The data, as in :func:`gpureg.regularize`.
    graph : Graph or GridGraph
    sigma : float or array
        Standard deviation > 0 of the noise, in the data's units; one number, or one per vertex. With one per vertex,
        lam(u) is proportional to 1/sigma(u)^2, and the difference at each vertex is divided by sigma(u).
    start : float, optional
        First lam of the search. None means 2.2 sigma^(p - 2), a good value on the 4-adjacency graph of an image.
    rtol : float, default 0.01
        Tolerance of the ratio to 1.
    **settings
        The other options of :func:`gpureg.regularize`, except `lam` and `initial`.

    Returns
    -------
    Discrepancy
        The fidelity, the regularization and the ratio. The ratio is below 1 if regularization cannot remove enough:
        `sigma` is too large, or the iterations are too few.

    Raises
    ------
    ValueError, TypeError
        A sigma that is not > 0, `lam` or `initial`; also as :func:`gpureg.regularize`.

    Notes
    -----
    Solves ||f_lam - f0||^2 = n m sigma^2 (Morozov 1966; for total variation Rudin, Osher, Fatemi 1992) by Brent's
    method on log lam, with n vertices inside a grid's mask and m channels. With `tol` (the certified solver always has
    one) and p >= 1 the result does not depend on the start, and each run starts at the result of the run before. The
    certified solver's tol must be much smaller than rtol, e.g. 1e-5 for rtol = 0.01: a gap of tol times the energy
    means an error of about 1.5 sqrt(tol) times the norm of the noise, and twice this error in the ratio. The principle
    smooths more than the minimum of the mean squared error; :func:`sure` is better, but needs twice as many runs.

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
            raise TypeError(f"{name} is set by the search: leave it out")
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
    # only if the result does not depend on the start
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
    """Return the lam at which a decreasing `ratio` is nearest to 1, this ratio, and the number of evaluations."""
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
    # The ratio is about proportional to 1/lam. The first step goes beyond that estimate, further steps are larger,
    # until 1 lies between two ratios.
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
    """Check the noise, and return it as (1, 1) or (n, 1), with 1 outside the mask."""
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
