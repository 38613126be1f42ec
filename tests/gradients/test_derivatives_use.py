"""What :func:`gpureg.derivatives` refuses, warns of, and how it agrees with itself."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import gpureg as gr
from gpureg.gradients import solving

GRID = gr.GridGraph((4, 5), metric="cityblock", mask=np.arange(20).reshape(4, 5) != 7)
RNG = np.random.default_rng(4)
F0, SLOPE = 5 + RNG.random(GRID.shape), RNG.normal(size=GRID.shape)
QUICK = {"max_iter": 1, "backend": "numpy"}


def fields(found):
    """The numbers of derivatives, by name."""
    return {name: np.asarray(getattr(found, name)) for name in ("f0", "lam", "weights", "p", "eps", "value")}


def assert_equal(a, b, tolerance):
    for name, value in fields(a).items():
        assert fields(b)[name] == pytest.approx(value, rel=tolerance, abs=tolerance * np.abs(value).max()), name


@pytest.mark.parametrize(("p", "lam", "norm"), [(1, 3.0, "edge"), (1.5, RNG.random(GRID.shape), "vertex")])
def test_many_sweeps_have_the_derivatives_of_the_minimiser(p, lam, norm):
    result = gr.regularize(F0, GRID, p=p, lam=lam, eps=0.2, norm=norm, **QUICK)
    found = gr.derivatives(result, lambda _: SLOPE)
    # the rate of the sweeps is below 0.97
    assert_equal(found, gr.derivatives(result, lambda _: SLOPE, unrolled=800), 1e-8)
    assert found.f0.shape == GRID.shape and found.f0[1, 2] == SLOPE[1, 2]
    assert np.shape(found.lam) == np.shape(lam) and found.weights.shape == (*GRID.shape, 4)
    # a stored graph gives the same
    stored = gr.regularize(
        F0.ravel(),
        GRID.to_graph(GRID.edges.unit_half()),
        p=p,
        lam=np.ravel(lam) if np.ndim(lam) else lam,
        eps=0.2,
        norm=norm,
        **QUICK,
    )
    listed = gr.derivatives(stored, lambda _: SLOPE.ravel()).weights
    assert GRID.edges.listed(found.weights, "weights") == pytest.approx(listed, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("p", [1.2, 2])
def test_other_ways_to_solve_the_system(p, monkeypatch):
    """Conjugate gradients, also with multigrid, instead of factors; factors after a few steps; and none of them."""
    f0, slope = np.stack([F0, F0**2], axis=-1), np.stack([SLOPE, SLOPE**2], axis=-1)
    result = gr.regularize(f0, GRID, p=p, lam=0.5, eps=0.1, **QUICK)
    found = gr.derivatives(result, lambda _: slope)
    monkeypatch.setattr(solving, "_SMALL", 0)
    again = [gr.derivatives(result, lambda _: slope)]
    # factors, or multigrid, after one step
    monkeypatch.setattr(solving, "_FEW", 1)
    monkeypatch.setattr(solving, "_PLAIN", 1)
    again.append(gr.derivatives(result, lambda _: slope))
    # multigrid
    monkeypatch.setattr(solving, "_BAND", 0)
    again.append(gr.derivatives(result, lambda _: slope))
    for other in again:
        assert_equal(found, other, 1e-8)
    for name in ("_CYCLES", "_MANY"):
        monkeypatch.setattr(solving, name, 1)
    with pytest.raises(ArithmeticError, match=r"conjugate gradients did not solve|not be found exactly"):
        gr.derivatives(result, lambda _: slope)


def test_a_result_far_from_the_minimiser():
    result = gr.regularize(F0, GRID, p=1.5, lam=0.1, eps=0.1, **QUICK)
    with pytest.warns(RuntimeWarning, match="away from the minimiser"):
        found = gr.derivatives(result, 2 * result.value)
    best = gr.regularize(F0, GRID, p=1.5, lam=0.1, eps=0.1, solver="certified", tol=1e-9, dtype=float, backend="numpy")
    assert found.value == pytest.approx(best.value, abs=1e-4)
    assert found.distance == pytest.approx(np.abs(found.value - result.value).max())
    # the gradient at the minimiser, as a function or as an array
    assert_equal(gr.derivatives(result, lambda f: 2 * f), gr.derivatives(best, 2 * found.value), 1e-8)


def test_parts_without_data_count_0():
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [3, 4]])
    result = gr.regularize([1.0, 2.0, 4.0, 8.0, 8.0], graph, lam=[1, 1, 1, 0, 0], **QUICK)
    with pytest.warns(RuntimeWarning, match="2 vertices are in connected parts of the graph without data"):
        found = gr.derivatives(result, lambda f: np.ones(5))
    # a mean is kept
    assert found.f0 == pytest.approx([1, 1, 1, 0, 0], abs=1e-12)
    assert found.lam[3:].tolist() == [0, 0] and found.weights[-2:].tolist() == [0, 0]
    assert len(found.notes) == 1


def test_without_curvature_there_is_no_derivative():
    """p = 3, eps = 0: a vertex without data between two equal values."""
    graph = gr.Graph.from_edges([[0, 1], [1, 2]])
    result = gr.regularize([1.0, 1.0, 1.0], graph, p=3, lam=[np.inf, 0, np.inf], eps=0, **QUICK)
    with pytest.raises(ArithmeticError, match="Hessian is singular: with eps = 0 and p > 2"):
        gr.derivatives(result, np.ones(3))


MODEL = {"p": 1.5, "lam": 1.0, "eps": 0.1}


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ({"p": 0.8}, {}, "below p = 1"),
        ({"eps": 0.0, "solver": "certified"}, {}, "no second derivatives"),
        ({"eps": 0.0, "solver": "certified"}, {"unrolled": 2}, "only for eps > 0"),
        ({"update_weights": 1, "weights": gr.weights.bilateral(2.0, 0.5)}, {}, "does not know its problem"),
        ({}, {"damping": 0.5}, "belong to unrolled=K"),
        ({}, {"unrolled": 0}, "unrolled must be >= 1"),
        ({}, {"unrolled": 2, "initial": np.ones((4, 5, 2))}, "must have the 1 channel"),
    ],
)
def test_refusals(model, options, message):
    result = gr.regularize(F0, GRID, **{**MODEL, **QUICK, **model})
    with pytest.raises(ValueError, match=message):
        gr.derivatives(result, SLOPE, **options)


def test_wrong_gradients():
    result = gr.regularize(F0, GRID, **MODEL, **QUICK)
    with pytest.raises(ValueError, match="g must have shape"):
        gr.derivatives(result, SLOPE[:3])
    with pytest.raises(ValueError, match="g must be finite"):
        gr.derivatives(result, lambda f: np.where(f > 0, np.nan, f))
    with pytest.raises(TypeError, match="must be a Result"):
        gr.derivatives(F0, SLOPE)


def test_the_problem_of_a_result():
    """It belongs to the result: the caller may change the data; channels by themselves, paths and files of it work."""
    data = F0.copy()
    result = gr.regularize(data, GRID, **MODEL, **QUICK)
    before = gr.derivatives(result, lambda _: SLOPE)
    data[:] = 0
    assert "problem" not in repr(result)
    again = gr.derivatives(pickle.loads(pickle.dumps(result)), lambda _: SLOPE)
    path = gr.regularization_path(F0, GRID, lam=[2.0, 1.0], p=1.5, eps=0.1, max_iter=1, backend="numpy")
    assert path[0].problem.data is path[1].problem.data and path[1].problem.lam == 1
    for other in (again, gr.derivatives(path[1], lambda _: SLOPE)):
        assert_equal(before, other, 1e-9)
    both = gr.regularize(np.stack([F0, 2 * F0], axis=-1), GRID, **MODEL, coupled=False, **QUICK)
    assert len(both.problem) == 2
    assert gr.derivatives(both, lambda f: SLOPE[..., None] * [1, 0]).f0[..., 0] == pytest.approx(before.f0)
    with pytest.raises(ValueError, match=r"result.value must have shape"):
        gr.derivatives(replace(result, value=F0[:2]), SLOPE)


def test_weights_of_the_data_are_constants():
    weights = gr.weights.bilateral(2.0, 0.5)
    result = gr.regularize(F0, GRID, weights=weights, **MODEL, **QUICK)
    found = gr.derivatives(result, lambda _: SLOPE)
    assert "constants" in found.notes[0]
    w = found.weights
    step = GRID.strides[1]
    assert w[0, 0, 2] == w[0, 1, 1] != 0 and w[1, 2].tolist() == [0] * 4 and step == 1
