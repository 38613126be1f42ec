"""Graphs of meshes, faces, curves and points, held against literal loops."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import gpureg as gr

RNG = np.random.default_rng(8)

# A fan of four triangles, two of them on an edge that a third shares (non-manifold), one without area, a loose vertex.
VERTICES = RNG.random((8, 3))
FACES = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [4, 5, 0], [5, 5, 6], [0, 2, 1]])


def edges_of(graph):
    """Undirected edges as a set of sorted pairs."""
    return {(int(u), int(v)) for u, v in zip(graph.edge_rows(), graph.indices, strict=True) if u < v}


def test_mesh_graph_joins_the_corners_of_faces():
    # the face 5, 5, 6 has no area, and joins nothing
    proper = [f for f in FACES if len(set(f.tolist())) == 3]
    expected = {tuple(sorted(map(int, pair))) for f in proper for pair in itertools.combinations(f, 2)}
    graph = gr.mesh_graph(VERTICES, FACES)
    assert edges_of(graph) == expected
    assert graph.n_vertices == 8
    assert graph.degree()[7] == 0
    np.testing.assert_array_equal(graph.positions, VERTICES)


def test_mesh_graph_of_quads_has_no_diagonals():
    graph = gr.mesh_graph(RNG.random((6, 2)), [[0, 1, 4, 3], [1, 2, 5, 4]])
    assert edges_of(graph) == {(0, 1), (1, 4), (3, 4), (0, 3), (1, 2), (2, 5), (4, 5)}
    # a corner may be repeated to fill a row, as long as three are left
    filled = gr.mesh_graph(RNG.random((6, 2)), [[0, 1, 4, 4], [1, 2, 2, 1]])
    assert edges_of(filled) == {(0, 1), (1, 4), (0, 4)}


@pytest.mark.parametrize("across", ["edge", "vertex"])
def test_face_graph_joins_faces_that_share(across):
    def parts(face):
        if len(set(face)) < 3:
            return set()
        if across == "vertex":
            return set(face)
        return {frozenset(pair) for pair in itertools.combinations(face, 2) if pair[0] != pair[1]}

    faces = FACES.tolist()
    expected = {(i, j) for i, j in itertools.combinations(range(len(faces)), 2) if parts(faces[i]) & parts(faces[j])}
    graph = gr.face_graph(VERTICES, FACES, across=across)
    assert edges_of(graph) == expected
    np.testing.assert_allclose(graph.positions, VERTICES[FACES].mean(axis=1), rtol=1e-15)


@pytest.mark.parametrize("closed", [True, False])
def test_curve_graph(closed):
    expected = {(k, k + 1) for k in range(6)} | ({(0, 6)} if closed else set())
    assert edges_of(gr.curve_graph(RNG.random((7, 2)), closed)) == expected


@pytest.mark.parametrize("symmetrize", ["max", "mutual"])
@pytest.mark.parametrize(
    ("n", "d", "k", "reach"), [(40, 3, 4, np.inf), (30, 2, 7, 0.3), (5, 1, 9, np.inf), (1, 2, 3, 1)]
)
def test_knn_graph_is_that_of_sorted_distances(n, d, k, reach, symmetrize):
    points = np.random.default_rng(n).random((n, d))
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    order = np.argsort(distance, axis=1)[:, : min(k, n - 1)]
    chosen = {(u, int(v)) for u in range(n) for v in order[u] if distance[u, v] < reach}
    both = {(u, v) for u, v in chosen if (v, u) in chosen}
    expected = {tuple(sorted(pair)) for pair in (chosen if symmetrize == "max" else both)}
    assert edges_of(gr.knn_graph(points, k, symmetrize=symmetrize, reach=reach)) == expected


def test_points_that_coincide_have_neighbours_too():
    # more of them than k: each must choose k others, and never itself
    graph = gr.knn_graph(np.repeat([[0.0, 0.0], [1.0, 1.0]], 9, axis=0), 3)
    assert graph.n_vertices == 18
    assert graph.degree().min() >= 3


def test_radius_graph_is_that_of_distances():
    points = RNG.random((50, 3))
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    expected = {(i, j) for i, j in itertools.combinations(range(50), 2) if distance[i, j] <= 0.3}
    assert edges_of(gr.radius_graph(points, 0.3)) == expected
    assert len(expected) > 20


POINTS = np.zeros((4, 2))

WRONG = [
    (lambda: gr.mesh_graph([[0, 0, np.nan]], [[0, 0, 0]]), ValueError, "row 0 is"),
    (lambda: gr.mesh_graph(np.zeros(3), [[0, 1, 2]]), ValueError, "shape \\(n, d\\)"),
    (lambda: gr.mesh_graph(np.zeros((3, 3), complex), [[0, 1, 2]]), TypeError, "real numbers"),
    (lambda: gr.mesh_graph(POINTS, [[0, 1, 4]]), ValueError, "0..3, got 4"),
    (lambda: gr.mesh_graph(POINTS, [[0, 1, -1]]), ValueError, "0..3, got -1"),
    (lambda: gr.mesh_graph(POINTS, [[0.0, 1, 2]]), TypeError, "integers"),
    (lambda: gr.mesh_graph(POINTS, [[0, 1]]), ValueError, "three vertices"),
    (lambda: gr.face_graph(POINTS, np.zeros((0, 3), int)), ValueError, "no face"),
    (lambda: gr.face_graph(POINTS, [[0, 1, 2]], across="corner"), ValueError, "across must be"),
    (lambda: gr.curve_graph(POINTS[:2]), ValueError, "closed curve needs at least 3"),
    (lambda: gr.curve_graph(POINTS[:1], closed=False), ValueError, "open curve needs at least 2"),
    (lambda: gr.knn_graph(POINTS, 0), ValueError, ">= 1"),
    (lambda: gr.knn_graph(POINTS, 2.5), TypeError, "k must be an integer"),
    (lambda: gr.knn_graph(POINTS, 2, symmetrize="mean"), ValueError, "symmetrize must be"),
    (lambda: gr.knn_graph(POINTS, 2, reach=0), ValueError, "reach must be > 0"),
    (lambda: gr.radius_graph(POINTS, -1), ValueError, "radius must be > 0"),
    (lambda: gr.radius_graph(POINTS, "1"), TypeError, "radius must be a number"),
]


@pytest.mark.parametrize(("call", "error", "message"), WRONG)
def test_a_wrong_call_says_what_is_allowed(call, error, message):
    with pytest.raises(error, match=message):
        call()
