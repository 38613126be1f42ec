"""Skeletons: known ones, what noise adds to them, and what smoothing takes away."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

import gpureg as gr
from gpureg.curves.crossings import is_inside


def rectangle(width, height, step=1.0):
    """The border of a rectangle from the origin, a vertex each step."""
    x, y = np.arange(0, width, step), np.arange(0, height, step)
    sides = [(x, 0 * x), (0 * y + width, y), (width - x, 0 * x + height), (0 * y, height - y)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def ellipse(n, a=3.0, b=1.0):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1)


def test_a_rectangle_has_a_spine_and_four_branches():
    found = gr.skeleton(rectangle(40, 10))
    assert (found.n_ends, found.n_junctions, found.n_branches) == (4, 2, 5)
    spine = max(found.branches(), key=len)
    # between the junctions it is the middle line, at half the height and with that radius (within a step's square / 8)
    np.testing.assert_allclose(found.positions[spine][:, 1], 5, atol=1e-9)
    assert np.abs(found.radii[spine] - 5).max() < 0.1
    assert connected_components(found.graph.to_scipy())[0] == 1


def test_radii_are_distances_from_the_vertices():
    polygon = ellipse(120) + np.random.default_rng(0).normal(0, 0.01, (120, 2))
    found = gr.skeleton(polygon)
    distance = np.linalg.norm(found.positions[:, None] - polygon[None], axis=2).min(axis=1)
    np.testing.assert_allclose(found.radii, distance, rtol=1e-9)
    assert is_inside(found.positions, polygon).all()


def test_branches_are_all_edges_once():
    found = gr.skeleton(ellipse(150) + np.random.default_rng(1).normal(0, 0.02, (150, 2)))
    edges = np.concatenate([np.stack([chain[:-1], chain[1:]], axis=1) for chain in found.branches()])
    graph = {(u, v) for u, v in zip(found.graph.edge_rows(), found.graph.indices, strict=True) if u < v}
    assert len(edges) == len(graph) == len({tuple(sorted(pair)) for pair in edges.tolist()})
    # a tree, for the polygon has no hole: one edge less than vertices
    assert found.graph.n_edges // 2 == found.graph.n_vertices - 1


def test_noise_adds_branches_and_smoothing_takes_them_away():
    clean = ellipse(300)
    noisy = clean + np.random.default_rng(0).normal(0, 0.02, clean.shape)
    found = gr.simplify_skeleton(noisy)
    assert gr.skeleton(clean).n_branches == 1
    assert found.before.n_branches > 10
    assert found.after.n_branches < found.before.n_branches / 3
    np.testing.assert_array_equal(found.before.points, noisy)
    assert (found.after.points != noisy).any()


def test_detail_keeps_less():
    noisy = ellipse(300) + np.random.default_rng(0).normal(0, 0.02, (300, 2))
    counts = [gr.skeleton(noisy, detail=detail).n_branches for detail in (0, 1, 3, 10)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 2 * counts[1] > 2 * counts[3]


@pytest.mark.parametrize("name", ["horse_skimage", "mpeg7_elephant_5", "cell_300"])
def test_silhouettes(data_folder, name):
    curve = np.loadtxt(data_folder / "curves" / f"{name}.csv", delimiter=",", skiprows=1)
    found = gr.simplify_skeleton(curve)
    # figure 9: ten iterations; measured 39 to 23, 135 to 31, 56 to 25
    assert found.after.n_branches < 0.7 * found.before.n_branches
    assert found.after.n_ends >= 5


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_inside_is_by_even_and_odd(turn):
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = np.random.default_rng(2).random((500, 2)) * 2 - 0.5
    expected = ((points > 0) & (points < 1)).all(axis=1)
    np.testing.assert_array_equal(is_inside(points @ rotation.T, square @ rotation.T), expected)


def test_polygons_without_much_inside():
    assert gr.skeleton([[0, 0], [1, 0], [0, 1.0]]).n_branches == 0
    doubled = np.repeat(rectangle(20, 10), 2, axis=0)
    assert gr.skeleton(doubled, detail=2).n_branches == gr.skeleton(rectangle(20, 10), detail=2).n_branches > 0


WRONG = [
    (lambda: gr.skeleton(np.stack([np.arange(9.0), np.arange(9.0)], axis=1)), "on one line"),
    (lambda: gr.skeleton(np.ones((9, 3))), "in the plane"),
    (lambda: gr.skeleton(ellipse(20), detail=-1), "detail must be"),
    (lambda: gr.skeleton(ellipse(2)), "needs 3"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_a_wrong_call_says_what_is_allowed(call, message):
    with pytest.raises(ValueError, match=message):
        call()
