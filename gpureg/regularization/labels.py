"""Label all vertices of a graph from the labels of a few: :func:`propagate_labels`."""

from __future__ import annotations

from typing import Any, Literal, Unpack, overload

import numpy as np
import numpy.typing as npt

from ..arrays import FloatArray, IntArray, unmasked
from ..checks import flag
from ..doors import door
from ..graphs.accepted import GraphLike, as_graph
from ..graphs.csr import Graph
from ..graphs.grid import AnyGraph, GridGraph
from ..model.problem import uses_degrees
from ..weights import Weights
from .harmonic import harmonic
from .options import MODEL, Model
from .regularize import regularize

# The defaults of :func:`propagate_labels` for the options of the model and the run.
_OPTIONS: dict[str, Any] = MODEL | {"norm": "edge", "tol": 1e-6}


@overload
def propagate_labels(
    labels: npt.ArrayLike, graph: GraphLike, *, return_scores: Literal[False] = False, **settings: Any
) -> IntArray: ...
@overload
def propagate_labels(
    labels: npt.ArrayLike, graph: GraphLike, *, return_scores: Literal[True], **settings: Any
) -> tuple[IntArray, FloatArray]: ...
@door(options=_OPTIONS)  # type: ignore[misc]  # the overloads leave the settings to this one
def propagate_labels(
    labels: npt.ArrayLike,
    graph: GraphLike,
    *,
    p: float = 3.0,
    weights: Weights | npt.ArrayLike | None = None,
    gamma: str | npt.ArrayLike = "sqrt",
    balance: bool = False,
    return_scores: bool = False,
    max_iter: int = 5000,
    **options: Unpack[Model],
) -> IntArray | tuple[IntArray, FloatArray]:
    """Label all vertices of a graph from the labels of a few (semi-supervised classification).

    Parameters
    ----------
    labels : int array
        One label >= 0 per vertex, or -1 if unknown, shape (n,); on a :class:`GridGraph` also its shape. Numbers may be
        missing between labels.
    graph : Graph or GridGraph
        The graph of n vertices.
    p : float, default 3
        Degree of regularity. 2 is the harmonic solution of Zhu, Ghahramani and Lafferty (2003), which with few labels
        is nearly constant with a spike at each label; a larger p avoids that.
    weights : Weights or array, optional
        An object of :mod:`gpureg.weights`, or one value per stored directed edge. None: those of the graph, or 1. For
        vertices with features: ``gpureg.weights.gaussian(features, sigma)``. A weight function that compares data, such
        as bilateral, would compare labels: give it other data by ``gpureg.weights.guided``.
    gamma : {"sqrt", "combinatorial", "normalized", "degree"} or array, default "sqrt"
    norm : {"vertex", "edge"}, default "edge"
    eps : float, optional
        As in :func:`gpureg.regularize`; the regularized functions have values in 0..1.
    balance : bool, default False
        Scale the scores so that each class has the same share among the unknown vertices as among the known ones (class
        mass normalization). Use it if the known labels have representative shares.
    return_scores : bool, default False
        Return the scores too.
    solver : str or Solver, default "jacobi"
    max_iter : int, default 5000
    tol : float, default 1e-6
    backend, dtype, memory, callback, progress
        As in :func:`gpureg.regularize`.

    Returns
    -------
    labels : int array
        In the shape and dtype of `labels`. Known labels do not change. Vertices that are not connected to a known
        vertex by edges of weight > 0 have -1. Of two labels with the same score the smaller is taken.
    scores : float array
        If `return_scores`: one column per class, in the order of ``np.unique(labels[labels >= 0])``, on a last axis.
        With gamma "sqrt" or "combinatorial" each row is a distribution (>= 0, sum 1); it is 0 where the label is -1.

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
    largest value. On p > 2 for few labels see El Alaoui et al., "Asymptotic behavior of l_p-based Laplacian
    regularization in semi-supervised learning", 2016, who advise p = d + 1 for data of d dimensions. Measured by
    ``bench/labels.py`` on the Cora citations, 20 draws: with 5 labels per class 46.0 percent right at p = 2, 56.8 at 3
    and 59.7 at 6; with 20 labels 73.6, 73.7 and 72.7. There balance=True helps more, and most at p = 2: 70.0 and 75.3;
    on the Minnesota roads with 20 labels it makes the result worse.

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
    balance, return_scores = flag("balance", balance), flag("return_scores", return_scores)
    given = _checked(graph, labels)
    flat = given.reshape(-1)
    known = flat >= 0
    classes, index = np.unique(flat[known], return_inverse=True)
    indicators = np.zeros((len(flat), len(classes)))
    indicators[known, index] = 1
    # The start decides how many sweeps are needed. The largest error after 300 sweeps at p = 3, on Cora with 5 labels
    # per class, is 5e-2 from zeros, 4e-2 from 1/classes and 7e-3 from the solution of p = 2; on the Minnesota roads, of
    # larger diameter, 5e-1, 3e-1 and 5e-2. This solution takes 0.02 to 0.04 s, the time of some 20 sweeps.
    start, reached = harmonic(
        indicators,
        graph,
        known,
        weights=weights,
        gamma=gamma,
        backend=options.get("backend", "auto"),
        dtype=options.get("dtype"),
    )
    scores = regularize(
        indicators,
        graph,
        p=p,
        lam=np.where(known, np.inf, 0.0),
        weights=weights,
        gamma=gamma,
        # one conductance for all classes, and therefore one linear system: the values still sum to 1
        coupled=True,
        max_iter=max_iter,
        initial=start,
        **{**_OPTIONS, **options},
    ).value
    scores[~reached] = 0
    if balance:
        scores = _balanced(scores, known, reached, index)
    found = np.where(reached, classes[scores.argmax(axis=1)], -1)
    found[known] = flat[known]
    found = found.astype(given.dtype).reshape(given.shape)
    return (found, scores.reshape(*given.shape, -1)) if return_scores else found


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
