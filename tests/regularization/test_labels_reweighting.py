"""Edges at labelled vertices that count more: the weighted nonlocal Laplacian."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph, linalg

import gpureg as gr

ORACLE = {"backend": "numpy", "dtype": np.float64}
GRAPH = cases.irregular(60, 150, isolated=5)
LABELS = np.where(np.arange(60) % 13 == 0, np.arange(60) % 2, -1)


def nonlocal_laplacian(W: sparse.csr_array, labels: np.ndarray) -> np.ndarray:
    """Scores (n, classes) of Shi, Osher and Zhu (2017), eq. 1.7, in each component, by a direct solution.

    The sum over x without a label of sum_y w (u(x) - u(y))^2, and n/k times that over x with one.
    """
    _, part = csgraph.connected_components(W, directed=False)
    known = labels >= 0
    scores = np.zeros((len(labels), labels.max() + 1))
    scores[known, labels[known]] = 1
    for c in np.unique(part[known]):
        inside = np.flatnonzero(part == c)
        at = known[inside]
        mu = np.where(at, len(inside) / at.sum(), 1.0)
        own = W[inside][:, inside].toarray()
        both = mu[:, None] * own + own * mu[None]
        A = np.diag(both.sum(axis=1)) - both
        right = both[np.ix_(~at, at)] @ scores[inside[at]]
        scores[inside[~at]] = linalg.spsolve(sparse.csc_array(A[np.ix_(~at, ~at)]), right).reshape(right.shape)
    return scores


@pytest.mark.parametrize("gamma", ["sqrt", "combinatorial"])
@pytest.mark.parametrize("how", ["stored", "array", "object"])
def test_scores_are_those_of_a_direct_solution(gamma: str, how: str) -> None:
    W = GRAPH.to_scipy().astype(float)
    graph, weights = GRAPH, None
    if how != "stored":
        graph = gr.Graph(GRAPH.indptr, GRAPH.indices)
        weights = GRAPH.weights
    if how == "object":
        x = cases.rng(1).random((60, 2))
        weights = gr.weights.gaussian(x, 0.5)
        rows, columns = GRAPH.edge_rows(), GRAPH.indices
        W = sparse.csr_array(
            (np.exp(-((x[rows] - x[columns]) ** 2).sum(axis=1) / 0.25), (rows, columns)), shape=W.shape
        )
    settings = {"weights": weights, "gamma": gamma, "return_scores": True, "return_result": True, **ORACLE}
    found, scores, result = gr.propagate_labels(LABELS, graph, **settings)
    exact = nonlocal_laplacian(W, LABELS)
    assert np.abs(scores - exact).max() < 1e-4  # a gap of 1e-10 of the energy, some 10
    assert 0 <= result.gap <= 1e-9 * result.energy[-1]
    reached = exact.sum(axis=1) > 0
    assert np.array_equal(found[~reached], np.full((~reached).sum(), -1))


def test_a_component_does_not_depend_on_another() -> None:
    """The share of labels is that of the component."""
    one = gr.Graph.from_edges([[k, k + 1] for k in range(8)] + [[0, 4]])
    A = one.to_scipy()
    two = gr.Graph.from_scipy(sparse.block_diag([A, A], format="csr"))
    labels = np.array([0, -1, -1, -1, -1, -1, -1, 1, -1])
    more = np.array([0, 1, 0, -1, 1, -1, -1, 1, -1])
    alone = gr.propagate_labels(labels, one, return_scores=True, **ORACLE)[1]
    together = gr.propagate_labels(np.concatenate([labels, more]), two, return_scores=True, **ORACLE)[1]
    assert np.abs(together[:9] - alone).max() < 1e-6


def test_grid_with_weights_and_a_factor() -> None:
    grid = gr.GridGraph((5, 6), mask=np.arange(30).reshape(5, 6) != 29)
    labels = np.full((5, 6), -1)
    labels[0, 0], labels[4, 3] = 0, 1
    half = cases.rng(2).random((grid.half_window, 5, 6))
    weights = grid.edges.gather_half(half)
    stored = gr.Graph.from_scipy(grid.to_graph(half).to_scipy())
    settings = {"reweighting": 7.0, "return_scores": True, **ORACLE}
    found, scores = gr.propagate_labels(labels, grid, weights=weights, **settings)
    same, others = gr.propagate_labels(labels.ravel(), stored, **settings)
    assert np.array_equal(found.ravel(), same) and found[4, 5] == -1
    assert np.abs(scores.reshape(30, 2) - others).max() < 1e-5
    plain = gr.propagate_labels(labels, grid, weights=weights, **{**settings, "reweighting": "none"})[1]
    assert np.abs(scores - plain).max() > 1e-2


def test_where_it_is_the_default() -> None:
    """At p = 2 with a symmetric gamma."""
    settings = {"return_scores": True, "max_iter": 200, **ORACLE}

    def differ(**more: object) -> float:
        named = gr.propagate_labels(LABELS, GRAPH, **settings, **more)[1]
        none = gr.propagate_labels(LABELS, GRAPH, **{**settings, **more, "reweighting": "none"})[1]
        return float(np.abs(named - none).max())

    assert differ() > 1e-2
    assert differ(reweighting=1) == differ(p=3) == differ(gamma="normalized") == 0
    assert differ(p=3, reweighting="wnll") > 1e-2


@pytest.mark.parametrize(
    ("settings", "error", "says"),
    [
        ({"reweighting": "poisson"}, ValueError, "reweighting must be"),
        ({"reweighting": 0}, ValueError, "reweighting must be"),
        ({"reweighting": 2.0, "gamma": "degree"}, ValueError, "reweighting needs gamma='sqrt' or 'combinatorial'"),
        ({"return_result": 1}, TypeError, "return_result"),
    ],
)
def test_wrong_settings(settings: dict, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        gr.propagate_labels(LABELS, GRAPH, **settings)
