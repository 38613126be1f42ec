"""Label all vertices of a graph from the labels of a few: :func:`propagate_labels`."""

from __future__ import annotations

from typing import Any, Literal, Unpack, overload

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, unmasked
from ..checks import flag, number
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph
from ..model.problem import uses_degrees
from ..model.result import Result
from ..solvers import Certified
from ..weights import Weights
from .harmonic import harmonic
from .joined import Joined, Reweighting, as_reweighting
from .options import FILL, Fill, solver_of
from .regularize import regularize

# The defaults of :func:`propagate_labels` for the options of the model and the run.
_OPTIONS: dict[str, Any] = FILL | {"norm": "edge", "return_scores": False, "return_result": False}
# Sweeps of a solver that is not certified, and the tolerance at which they end.
_SWEEPS, _TOL = 5000, 1e-6


class _Options(Fill, total=False):
    return_scores: bool
    return_result: bool


@overload
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    return_scores: Literal[False] = False,
    return_result: Literal[False] = False,
    **settings: Any,
) -> IntArray: ...
@overload
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    return_scores: Literal[True],
    return_result: Literal[False] = False,
    **settings: Any,
) -> tuple[IntArray, FloatArray]: ...
@overload
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    return_scores: Literal[False] = False,
    return_result: Literal[True],
    **settings: Any,
) -> tuple[IntArray, Result]: ...
@overload
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    return_scores: Literal[True],
    return_result: Literal[True],
    **settings: Any,
) -> tuple[IntArray, FloatArray, Result]: ...
@door(options=_OPTIONS)  # type: ignore[misc]  # the overloads leave the settings to this one
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    p: float = 2.0,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    reweighting: Reweighting | float | None = None,
    balance: bool = False,
    max_iter: int | None = None,
    **options: Unpack[_Options],
) -> IntArray | tuple[IntArray, FloatArray] | tuple[IntArray, Result] | tuple[IntArray, FloatArray, Result]:
    """Label all vertices of a graph from the labels of a few (semi-supervised classification).

    Parameters
    ----------
    labels : int array
        One label >= 0 per vertex, or -1 if unknown, shape (n,); on a :class:`GridGraph` also its shape. Numbers may be
        missing between labels.
    graph : Graph or GridGraph
        The graph of n vertices.
    p : float, default 2
        Degree of regularity. 2 is a linear system; the harmonic solution of Zhu, Ghahramani and Lafferty (2003) with
        ``reweighting="none"``, which with few labels is nearly constant with a spike at each label. A larger p avoids
        that too; infinity is the absolutely minimal Lipschitz extension.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per stored directed edge. None: those of the graph, or 1. For
        vertices with features: ``gpureg.weights.gaussian(features, sigma)``. A weight function that compares data, such
        as bilateral, would compare labels: give it other data by ``gpureg.weights.guided``.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array, default "sqrt"
    norm : {"vertex", "edge"}, default "edge"
    eps : float, optional
        As in :func:`gpureg.regularize`; the regularized functions have values in 0..1.
    reweighting : {"wnll", "none"} or float, optional
        A factor that multiplies the weights of edges at known vertices: "none" is 1; "wnll", weighted nonlocal
        Laplacian (Shi, Osher and Zhu, 2017), is (1 + n / k) / 2 in a component with k of n vertices known, so that few
        labels have as much influence as many. None: "wnll" at p = 2 if gamma is "sqrt" or "combinatorial", otherwise
        "none".
    balance : bool, default False
        Scale the scores so that each class has the same share among the unknown vertices as among the known ones (class
        mass normalization). Use it if the known labels have representative shares.
    return_scores : bool, default False
        Return the scores too.
    return_result : bool, default False
        Return the :class:`gpureg.Result` too, for its gap and how the run ended.
    solver : str or Solver, optional
        None: "certified" for p >= 1, otherwise "jacobi".
    max_iter : int, optional
        None: 20 000 with "certified", otherwise 5000.
    tol : float, optional
        None: 1e-10 (p = 2) or 1e-4 with "certified", otherwise 1e-6.
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    labels : int array
        In the shape and dtype of `labels`. Known labels do not change. Vertices that are not connected to a known
        vertex by edges of weight > 0 have -1. Of two labels with the same score the smaller is taken.
    scores : float array
        If `return_scores`: one column per class, in the order of ``np.unique(labels[labels >= 0])``, on a last axis.
        With gamma "sqrt" or "combinatorial" and a finite p each row is a distribution (>= 0, sum 1); it is 0 where the
        label is -1.
    result : Result
        If `return_result`: its value are the scores before they are balanced; its gap and energy are those of the
        weights after reweighting.

    Raises
    ------
    ValueError, TypeError
        No known label; a label below -1; labels that are not integers or not one per vertex; otherwise as
        :func:`gpureg.regularize`.
    BackendUnavailable, FloatingPointError, Interrupted
        As :func:`gpureg.regularize`.

    Notes
    -----
    One call of :func:`gpureg.regularize` (eq. 19, 30) on the indicator functions of the classes, with one gradient norm
    for all classes, and with lam infinite at the known vertices and 0 at the others; a vertex gets the label of the
    largest value. With few labels the harmonic solution is nearly constant away from them; heavier edges at known
    vertices and a larger p are two ways to avoid that. Percent right, means of 20 draws (``bench/labels.py``)::

                      labels a class    p = 2, none    p = 2, wnll    p = 3    p = 6
        Cora citations             1           21.8           32.8     37.0     41.7
                                   5           46.0           58.4     56.8     59.7
                                  20           73.6           74.7     73.7     72.7
        digits                     1           85.0           86.3     84.7     81.5
                                   5           95.4           95.1     94.8     93.5
                                  20           97.5           97.3     97.3     96.6
        moons, 100-d               1           57.1           79.2     75.4     78.8
                                   5           70.5           91.5     87.6     90.3
                                  20           91.3           95.6     93.4     94.5
        Minnesota roads            1           62.5           63.3     66.1     67.2
                                   5           82.8           82.9     82.9     82.6
                                  20           92.5           92.3     92.0     91.6

    The default is thus at least level with p = 3 but for one label a class on Cora and the roads, and takes a third of
    the time. balance=True helps where labels are few and have the shares of the classes: 57.6, 68.9 and 73.6 on Cora
    with "wnll". On 4 draws of Cora p = 1.5 has 16.3, 32.2 and 69.1, p = 1 15.4, 15.4 and 29.8, p = inf 44.1, 64.7 and
    68.9, where "wnll" has 28.3, 62.9 and 74.0; with one label a class p = inf is the best there, and 10 points below
    "wnll" on digits. On p > 2 see El Alaoui et al., "Asymptotic behavior of l_p-based Laplacian regularization in
    semi-supervised learning", 2016.

    Examples
    --------
    Two groups of three, joined by one edge:

    >>> import gpureg as gr
    >>> graph = gr.Graph.from_edges([[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 5], [5, 3]])
    >>> gr.propagate_labels([7, -1, -1, -1, -1, 4], graph, backend="numpy")
    array([7, 7, 7, 4, 4, 4])
    """
    if isinstance(labels, Graph | GridGraph):
        raise TypeError("the labels come first now, then the graph: propagate_labels(labels, graph)")
    graph = as_graph(graph, degrees=uses_degrees(gamma))
    balance = flag("balance", balance)
    asked: dict[str, Any] = _OPTIONS | options
    return_scores, return_result = (flag(name, asked.pop(name)) for name in ("return_scores", "return_result"))
    p = number("p", p, above=0, finite=False)
    factor = as_reweighting(reweighting, p, gamma)
    given = _checked(graph, labels)
    flat = given.reshape(-1)
    known = flat >= 0
    classes, index = np.unique(flat[known], return_inverse=True)
    indicators = np.zeros((len(flat), len(classes)))
    indicators[known, index] = 1
    run = {name: asked[name] for name in ("backend", "dtype")}
    joined = Joined.of(indicators, graph, known, weights=weights, gamma=gamma, **run)
    reached = joined.reached
    if factor is not None:
        weights, gamma = joined.reweighted(factor), "sqrt"
    solver, max_iter, tol = solver_of(asked, p, max_iter, sweeps=_SWEEPS, tol=_TOL)
    start = None
    if not isinstance(solver, Certified):
        # The start decides how many sweeps are needed. The largest error after 300 sweeps at p = 3, on Cora with 5
        # labels per class, is 5e-2 from zeros, 4e-2 from 1/classes and 7e-3 from the solution of p = 2; on the
        # Minnesota roads, of larger diameter, 5e-1, 3e-1 and 5e-2.
        start, _ = harmonic(indicators, graph, known, weights=weights, gamma=gamma, **run)
    result = regularize(
        indicators,
        graph,
        p=p,
        # vertices that are not reached stay at 0
        lam=np.where(known | ~reached, np.inf, 0.0),
        weights=weights,
        gamma=gamma,
        # one conductance for all classes, and therefore one linear system: the values still sum to 1
        coupled=True,
        max_iter=max_iter,
        initial=start,
        **{**asked, "solver": solver, "tol": tol},
    )
    scores = result.value.copy()
    if balance:
        scores = _balanced(scores, known, reached, index)
    found = np.where(reached, classes[scores.argmax(axis=1)], -1)
    found[known] = flat[known]
    labelled = found.astype(given.dtype).reshape(given.shape)
    more = (scores.reshape(*given.shape, -1),) if return_scores else ()
    return (labelled, *more, *((result,) if return_result else ())) if more or return_result else labelled


def _checked(graph: AnyGraph, labels: npt.ArrayLike) -> IntArray:
    array = unmasked(labels, "labels")
    if array.dtype.kind not in "iu":
        raise TypeError(f"labels must be integers, -1 where unknown, got {array.dtype}")
    shapes = [(graph.n_vertices,), *([graph.shape] if isinstance(graph, GridGraph) else [])]
    if array.shape not in shapes:
        raise ValueError(f"labels must have shape {' or '.join(map(str, shapes))}, got {array.shape}")
    if array.min() < -1:
        raise ValueError(f"labels must be >= 0, or -1 where unknown, got {array.min()}")
    if array.max() < 0:
        raise ValueError("labels must be known (>= 0) at one vertex at least, got -1 everywhere")
    return array


def _balanced(
    scores: FloatArray, known: npt.NDArray[np.bool_], reached: npt.NDArray[np.bool_], index: IntArray
) -> FloatArray:
    """Scale the mass of each class in (n, classes) scores to its share among known vertices, with the same row sums.

    `known` and `reached` are (n,), `index` is the class of each known vertex.
    """
    unknown = reached & ~known
    share = np.bincount(index, minlength=scores.shape[1]) / len(index)
    mass = scores[unknown].mean(axis=0) if unknown.any() else share
    total = scores.sum(axis=1, keepdims=True)
    scaled = np.where(known[:, None], scores, scores * (share / np.where(mass > 0, mass, 1)))
    sums = scaled.sum(axis=1, keepdims=True)
    balanced: FloatArray = (scaled * (total / np.where(sums > 0, sums, 1))).astype(scores.dtype)
    return balanced
