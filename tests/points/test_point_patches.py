"""Patches of point clouds, and the graph of the most alike."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gpureg as gr

RNG = np.random.default_rng(7)
X, Y = (a.ravel() for a in np.mgrid[:20.0, :20.0])
JITTER = RNG.uniform(-0.2, 0.2, (400, 2))
U, V = X + JITTER[:, 0], Y + JITTER[:, 1]
# waves along one direction
WAVES = np.stack([U, V, np.sin(0.8 * U)], axis=1)
INSIDE = (X > 3) & (X < 16) & (Y > 3) & (Y < 16)


@pytest.mark.parametrize("channels", [None, 1, 3])
def test_patches_do_not_depend_on_the_coordinates(channels):
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    values = {None: None, 1: np.cos(U), 3: RNG.random((400, 3))}[channels]
    one = gr.point_patches(WAVES, values)
    two = gr.point_patches(WAVES @ turn + [3, 4, 5], values)
    assert one.shape == (400, 9 * (channels or 1))
    assert_allclose(two, one, atol=1e-9)


def test_patches_go_with_order_and_scale():
    order = RNG.permutation(400)
    assert_allclose(gr.point_patches(WAVES[order]), gr.point_patches(WAVES)[order], atol=1e-9)
    # heights are in the units of the coordinates
    assert_allclose(gr.point_patches(5 * WAVES), 5 * gr.point_patches(WAVES), atol=1e-9)


def test_patches_of_known_surfaces():
    plane = np.stack([U, V, 0.3 * U - 0.2 * V], axis=1)
    assert_allclose(gr.point_patches(plane), 0, atol=1e-12)
    values = np.full(400, 7.5)
    assert_allclose(gr.point_patches(plane, values), 7.5)
    # values that rise along a plane: the first axis is where they do, so rows of cells rise, columns are level
    cells = gr.point_patches(np.stack([U, V, 0 * U], axis=1), U, k=24).reshape(-1, 3, 3)[INSIDE]
    assert (cells[:, 2].mean(axis=1) > cells[:, 0].mean(axis=1)).all()
    assert np.abs(cells.mean(axis=1).std(axis=1)).mean() < 0.3 * cells.mean(axis=2).std(axis=1).mean()


def test_alike_patches_find_each_other():
    """Points of one phase of the wave are more alike than the nearest are: so the nonlocal graph joins."""
    graph = gr.patch_knn_graph(WAVES, k=6, among=100)
    local = gr.knn_graph(WAVES, 6)

    def apart(graph):
        u, v = graph.edge_rows(), graph.indices
        inside = INSIDE[u] & INSIDE[v]
        # a normal has no side: crests are like troughs
        return np.abs(np.abs(np.sin(0.8 * U[u])) - np.abs(np.sin(0.8 * U[v])))[inside].mean()

    assert apart(graph) < 0.8 * apart(local)
    assert graph.positions is not None and np.array_equal(graph.positions, WAVES)


def test_the_graph_chooses_by_features():
    """Against all distances, by a loop."""
    points, features = RNG.random((60, 3)), RNG.random((60, 4))
    k, among = 3, 12
    graph = gr.patch_knn_graph(points, k=k, among=among, features=features).to_scipy().toarray() > 0
    chose = np.zeros((60, 60), bool)
    for u in range(60):
        near = np.argsort(np.linalg.norm(points - points[u], axis=1))[1 : among + 1]
        chose[u, near[np.argsort(np.linalg.norm(features[near] - features[u], axis=1))[:k]]] = True
    assert np.array_equal(graph, chose | chose.T)
    mutual = gr.patch_knn_graph(points, k=k, among=among, features=features, symmetrize="mutual")
    assert np.array_equal(mutual.to_scipy().toarray() > 0, chose & chose.T)
    short = gr.patch_knn_graph(points, k=k, among=among, features=features, reach=0.15)
    u, v = short.edge_rows(), short.indices
    assert 0 < len(u) and np.linalg.norm(points[u] - points[v], axis=1).max() <= 0.15
    assert gr.patch_knn_graph(points, features=features, reach=1e-9).n_edges == 0


def test_values_by_patches_keep_more(device):
    """Colours in stripes on a plane: weights of patches blur less across the stripes than nearness does."""
    plane = np.stack([U, V, 0 * U], axis=1)
    truth = (np.floor(X / 3) % 2).astype(float)
    seen = truth + RNG.normal(0, 0.25, 400)
    near = gr.knn_graph(plane, 8)
    alike = gr.patch_knn_graph(plane, seen, k=8, among=80)
    error = {
        name: np.sqrt(np.mean((gr.regularize(seen, graph, p=2, lam=2, max_iter=1, backend=device).value - truth) ** 2))
        for name, graph in (("near", near), ("alike", alike))
    }
    assert error["alike"] < error["near"]


@pytest.mark.parametrize(
    "points",
    [np.zeros((1, 3)), np.zeros((2, 3)), np.zeros((40, 3)), np.stack([X[:40]] * 3, 1), np.r_[WAVES[:50], WAVES[:50]]],
    ids=["one", "two", "all the same", "a line", "twice"],
)
@pytest.mark.parametrize("channels", [None, 1, 2])
def test_degenerate_clouds(points, channels):
    n = len(points)
    values = {None: None, 1: np.arange(n), 2: np.ones((n, 2))}[channels]
    patches = gr.point_patches(points, values)
    assert len(patches) == n and np.isfinite(patches).all()
    graph = gr.patch_knn_graph(points, values, k=2)
    assert graph.n_vertices == n


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: gr.point_patches(WAVES[:, :2]), ValueError, "points in space"),
        (lambda: gr.point_patches(WAVES, k=2), ValueError, "k must be >= 3"),
        (lambda: gr.point_patches(WAVES, patch_radius=1.5), TypeError, "patch_radius must be an integer"),
        (lambda: gr.point_patches(WAVES, side=3), TypeError, "'side' is called patch_radius"),
        (lambda: gr.point_patches(WAVES, np.ones(3)), ValueError, "values must have shape"),
        (lambda: gr.patch_knn_graph(WAVES, k=8, among=4), ValueError, "among must be an integer >= k"),
        (lambda: gr.patch_knn_graph(WAVES, k=0), ValueError, "k must be >= 1"),
        (lambda: gr.patch_knn_graph(WAVES, reach=0), ValueError, "reach must be > 0"),
        (lambda: gr.patch_knn_graph(WAVES, features=np.ones((3, 2))), ValueError, "400 rows"),
        (lambda: gr.patch_knn_graph(WAVES, np.ones(400), features=np.ones((400, 2))), ValueError, "leave values out"),
    ],
)
def test_wrong_input(call, error, words):
    with pytest.raises(error, match=words):
        call()
