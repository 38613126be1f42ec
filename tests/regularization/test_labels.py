"""The door for labels: propagate_labels."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from scipy.sparse import csgraph

import gpureg as gr

ORACLE = {"backend": "numpy", "dtype": np.float64}


def test_p2_is_the_harmonic_solution(device: str) -> None:
    """Zhu, Ghahramani and Lafferty: L f = 0 at the unknown vertices, directly solved; every score row sums to 1."""
    graph = cases.irregular(60, 240, isolated=5)
    W = graph.to_scipy().toarray().astype(float)
    part = csgraph.connected_components(W > 0, directed=False)[1]
    main = np.flatnonzero(part == np.bincount(part).argmax())
    labels = np.full(60, -1)
    labels[main[:6]] = [3, 3, 8, 8, 8, 5]
    known = labels >= 0
    free = np.array([u for u in main if not known[u]])
    L = np.diag(W.sum(axis=1)) - W
    indicator = (labels[known][:, None] == np.array([3, 5, 8])).astype(float)
    exact = np.linalg.solve(L[np.ix_(free, free)], W[np.ix_(free, np.flatnonzero(known))] @ indicator)
    found, scores = gr.propagate_labels(labels, graph, reweighting="none", return_scores=True, backend=device)
    # float32 weights, and a gap of 1e-10 of the energy
    assert np.abs(scores[free] - exact).max() < 1e-4
    assert np.abs(scores[main].sum(axis=1) - 1).max() < 1e-5
    sure = np.sort(exact, axis=1)[:, -1] - np.sort(exact, axis=1)[:, -2] > 1e-3
    assert np.array_equal(found[free][sure], np.array([3, 5, 8])[exact.argmax(axis=1)][sure])
    assert np.array_equal(found[known], labels[known])
    others = np.setdiff1d(np.arange(60), main)
    assert (found[others] == -1).all()  # nothing is known there
    assert not scores[others].any()


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("gamma", ["sqrt", "normalized"])
def test_larger_p(norm: str, gamma: str) -> None:
    """The scores are those of regularize with lam infinite at the known vertices, wherever it starts."""
    graph = cases.irregular(40, 200, isolated=5)
    labels = np.full(40, -1)
    labels[[0, 1, 2, 3]] = [0, 1, 0, 1]
    given = {"p": 3, "norm": norm, "gamma": gamma, "eps": 1e-3, **ORACLE}
    how = {"solver": "jacobi", "max_iter": 20_000, "tol": 1e-10}
    _, scores, result = gr.propagate_labels(labels, graph, return_scores=True, return_result=True, **given)
    f0 = np.stack([labels == 0, labels == 1], axis=1).astype(float)
    lam = np.where(labels >= 0, np.inf, 0)
    plain = gr.regularize(f0, graph, lam=lam, **how, **given).value
    reached = scores.sum(axis=1) > 0
    assert np.abs(scores - plain)[reached].max() < 1e-2  # a gap of 1e-4, and p = 3 is flat at the minimum
    assert 0 <= result.gap <= 1.01e-4 * result.energy[-1]
    assert np.array_equal(result.value, scores)


def test_infinite_p() -> None:
    """On a path the scores of the Lipschitz extension are straight between labels."""
    graph = gr.Graph.from_edges([[k, k + 1] for k in range(8)])
    labels = np.array([0, -1, -1, -1, 1, -1, -1, -1, 2])
    found, scores = gr.propagate_labels(labels, graph, p=np.inf, return_scores=True, **ORACLE)
    assert np.abs(scores[:5, 0] - [1, 0.75, 0.5, 0.25, 0]).max() < 1e-9
    assert np.abs(scores.sum(axis=1) - 1).max() < 1e-9
    assert found.tolist() == [0, 0, 0, 1, 1, 1, 1, 2, 2]  # a tie goes to the smaller label


def test_grid_and_types() -> None:
    grid = gr.GridGraph((7, 9))
    labels = np.full((7, 9), -1, np.int16)
    labels[3, 1], labels[3, 7] = 4, 2
    found, scores = gr.propagate_labels(labels, grid, return_scores=True, backend="numpy")
    assert found.dtype == np.int16
    assert scores.shape == (7, 9, 2)
    assert (found[:, :4] == 4).all()
    assert (found[:, 5:] == 2).all()
    flat = gr.propagate_labels(labels.ravel(), grid, backend="numpy")
    assert np.array_equal(flat.reshape(7, 9), found)


def test_balance() -> None:
    """Class mass normalization: a class with one label in a corner is given its share."""
    graph = gr.Graph.from_edges([[k, k + 1] for k in range(9)])
    labels = np.full(10, -1)
    labels[0], labels[5], labels[6] = 1, 0, 0
    _, plain = gr.propagate_labels(labels, graph, reweighting="none", return_scores=True, **ORACLE)
    _, scaled = gr.propagate_labels(labels, graph, reweighting="none", balance=True, return_scores=True, **ORACLE)
    unknown = labels < 0
    assert plain[unknown, 1].mean() < 1 / 3
    assert abs(scaled[unknown, 1].mean() - 1 / 3) < abs(plain[unknown, 1].mean() - 1 / 3)
    assert np.abs(scaled.sum(axis=1) - 1).max() < 1e-12


def test_the_graph_comes_second() -> None:
    graph = gr.Graph.from_edges([[0, 1], [1, 2]])
    with pytest.raises(TypeError, match=r"labels come first now, then the graph: propagate_labels\(labels, graph\)"):
        gr.propagate_labels(graph, [1, -1, 2])


def test_how_it_is_done_is_handed_on() -> None:
    """The options of a run: a callback that stops, a limit of memory that is honoured, and no other names."""
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3]])
    checks: list[int] = []
    gr.propagate_labels([1, -1, -1, 2], graph, callback=lambda check: not checks.append(check.iteration), **ORACLE)
    assert checks == [0]
    with pytest.raises(MemoryError, match="only a GridGraph is cut into tiles"):
        gr.propagate_labels([1, -1, -1, 2], graph, memory=1, **ORACLE)
    with pytest.raises(TypeError, match="unexpected keyword argument 'steps'"):
        gr.propagate_labels([1, -1, -1, 2], graph, steps=3)


@pytest.mark.parametrize(
    ("labels", "error", "says"),
    [
        ([0.5, -1, -1], TypeError, "labels must be integers, -1 where unknown, got float64"),
        ([0, -1], ValueError, r"labels must have shape \(3,\), got \(2,\)"),
        ([0, -2, -1], ValueError, "or -1 where unknown, got -2"),
        ([-1, -1, -1], ValueError, "known .* at one vertex at least"),
    ],
)
def test_wrong_labels(labels: list, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        gr.propagate_labels(labels, gr.Graph.from_edges([[0, 1], [1, 2]]))
    with pytest.raises(TypeError, match="graph must be"):
        gr.propagate_labels(labels, "graph")


def accuracy(graph: gr.Graph, truth: np.ndarray, count: int, seeds: int, **settings: object) -> float:
    """Mean share of right labels over the unknown vertices of parts with a label."""
    part = csgraph.connected_components(graph.to_scipy(), directed=False)[1]
    found: list[float] = []
    for seed in range(seeds):
        labels, generator = np.full(len(truth), -1), cases.rng(seed)
        for c in np.unique(truth):
            labels[generator.choice(np.flatnonzero(truth == c), count, replace=False)] = c
        counted = np.isin(part, part[labels >= 0]) & (labels < 0)
        guess = gr.propagate_labels(labels, graph, **settings)
        found.append(float((guess == truth)[counted].mean()))
    return float(np.mean(found))


def test_cora(data_folder) -> None:
    """With 5 labels a class the weighted nonlocal Laplacian is 10 points better than the plain one."""
    path = data_folder / "graphs" / "cora.npz"
    graph, truth = gr.read_graph(path, symmetrize="max"), np.load(path, allow_pickle=True)["labels"]
    assert accuracy(graph, truth, 5, 4) > accuracy(graph, truth, 5, 4, reweighting="none") + 0.1
