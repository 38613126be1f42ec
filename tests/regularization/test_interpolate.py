"""Interpolation of values that are known at some vertices."""

import math

import numpy as np
import pytest

import gpureg as gr


@pytest.mark.parametrize("p", [1.5, 2, 3, math.inf])
def test_a_path_is_linear_for_every_p_above_1(p):
    values = np.full(7, np.nan)
    values[[0, 3, 6]] = 0, 3, -3
    result = gr.interpolate(values, gr.GridGraph(7), p=p, tol=1e-9, dtype=float, backend="numpy")
    # the energy is p-uniformly convex: a gap of 1e-9 of it moves f by far less than 1e-3
    np.testing.assert_allclose(result.value, [0, 1, 2, 3, 1, -1, -3], atol=1e-3)
    assert np.array_equal(result.value[[0, 3, 6]], [0, 3, -3])
    assert 0 <= result.gap <= 1e-8 * result.energy[-1] + 1e-12
    if p == 1.5:
        assert result.error_bound is not None


def test_known_and_nan_are_the_same():
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [2, 3], [3, 0], [1, 3]])
    values = np.array([[0.0, 1], [8, 8], [2, 0], [8, 8]])
    known = np.array([1, 0, 1, 0], bool)
    named = gr.interpolate(values, graph, known=known, p=math.inf, backend="numpy")
    missing = gr.interpolate(np.where(known[:, None], values, np.nan), graph, p=math.inf, backend="numpy")
    assert np.array_equal(named.value, missing.value)
    np.testing.assert_allclose(named.value, [[0, 1], [1, 0.5], [2, 0], [1, 0.5]], atol=1e-15)
    # integers
    whole = gr.interpolate(values.astype(int), graph, known=known, p=math.inf, backend="numpy")
    assert np.array_equal(whole.value, named.value)


def test_outside_a_mask_nothing_changes():
    grid = gr.GridGraph((2, 4), mask=np.array([[1, 1, 1, 1], [0, 0, 1, 1]], bool))
    values = np.full((2, 4), np.nan)
    values[0, 0], values[0, 3], values[1, 0] = 0, 3, 7
    value = gr.interpolate(values, grid, p=math.inf, backend="numpy").value
    np.testing.assert_allclose(value, [[0, 1, 2, 3], [7, np.nan, 2.5, 3]], atol=0.6)
    assert np.isnan(value[1, 1]) and value[1, 0] == 7


@pytest.mark.parametrize(
    ("values", "known", "match"),
    [
        ([[1, math.nan], [0, 1], [math.nan, math.nan]], None, "in some"),
        ([1.0, 2], None, "shape"),
        ([1.0, 2, 3], [1, 0, 1], "known must be True or False"),
        ([1.0, 2, 3], [True, False], "known must be"),
    ],
)
def test_errors(values, known, match):
    with pytest.raises(ValueError, match=f"^interpolate: .*{match}"):
        gr.interpolate(values, gr.GridGraph(3), known=known, backend="numpy")
