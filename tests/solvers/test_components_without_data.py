"""Components of a graph without data, the box, and what a result says of its error where lam is 0."""

from __future__ import annotations

import math
import warnings

import cases
import numpy as np
import pytest
from test_certified_no_data import F0, GRAPH, LAM, ORACLE, both_norms, gamma_of, solve

import gpureg as gr
from gpureg import backends
from gpureg.arrays import FloatArray
from gpureg.model.on_device import DeviceProblem
from gpureg.model.problem import Problem
from gpureg.solvers.box import with_box

PATHS = gr.Graph.from_edges([[0, 1], [1, 2], [3, 4], [5, 6], [6, 7]], n_vertices=9)
VALUES = np.array([1.0, 77, 5, 99, -99, 2, 99, 99, 88])
FAINT = gr.Graph.from_edges([[0, 1], [1, 2]], [1, 1e-12])
KNOWN = np.array([np.inf, 0, 3, 0, 0, 0.5, 0, 0, 0])  # none in {3, 4} and {8}


def boxed(f0: FloatArray, graph, lam, **model) -> tuple[DeviceProblem, FloatArray, FloatArray]:
    """The problem with its box, and the ends of that on the host."""
    problem = Problem.make(f0, graph, lam=lam, dtype=np.dtype(float), smoothed=False, **model)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ vert.*without data", RuntimeWarning)
        found = with_box(DeviceProblem.put(problem, backends.get("numpy", "float64")))
    assert found.box is not None
    return found, found.backend.get(graph, found.box.low), found.backend.get(graph, found.box.high)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_a_constant_where_there_are_no_data(p: float) -> None:
    """The middle of the data's range, 1 to 5, said in three places; elsewhere the data's component decides."""
    given = {"p": p, "lam": KNOWN, "solver": "certified", "tol": 1e-8, **ORACLE}
    with pytest.warns(
        RuntimeWarning, match=r"^3 vertices in 2 components without data set to the constant 3 \(the middle"
    ):
        result = gr.regularize(VALUES, PATHS, **given)
    assert result.stop is gr.Stop.GAP_NO_DATA
    assert "without data" in str(result.stop)
    assert "3 vertices in 2 components without data set to the constant 3" in result.method
    assert np.array_equal(result.value[[3, 4, 8]], [3, 3, 3])
    assert result.value[0] == 1
    assert result.value[5:8] == pytest.approx(2, abs=1e-4)
    assert 1 <= result.value[1] <= result.value[2] <= 5
    # two channels, each with a constant of its own
    both = solve(np.stack([VALUES, VALUES * 2], axis=1), PATHS, p=p, lam=KNOWN)
    assert "set to the constant 3, 6 (" in both.method
    assert both.value[3] == pytest.approx([3, 6])


def test_no_data_at_all() -> None:
    """0, on a grid too; a mask hides what is outside."""
    with pytest.warns(RuntimeWarning, match="480 vertices in 1 component without data set to the constant 0 .as there"):
        result = gr.regularize(np.full((24, 20), 7.5), gr.GridGraph((24, 20)), lam=0, solver="certified")
    assert (result.value == 0).all()
    assert result.gap == result.error_bound == 0
    mask = np.ones((4, 5), bool)
    mask[:, 2] = False
    lam = np.zeros((4, 5))
    lam[:, 3:] = 2
    f0 = np.where(mask, np.arange(20.0).reshape(4, 5), np.nan)
    with pytest.warns(RuntimeWarning, match="^8 vertices in 1 component without data set to the constant 11 "):
        found = gr.regularize(f0, gr.GridGraph((4, 5), mask=mask), lam=lam, p=1, solver="certified")
    assert np.isnan(found.value[~mask]).all()
    assert found.value[:, :2] == pytest.approx(11)


def test_every_component_has_data(recwarn: pytest.WarningsRecorder) -> None:
    lam = np.where(np.arange(9) == 8, 1, np.where(KNOWN > 0, KNOWN, [0, 0, 0, 4, 0, 0, 0, 0, 0]))
    result = gr.regularize(VALUES, PATHS, p=1, lam=lam, solver="certified", **ORACLE)
    assert result.stop is gr.Stop.GAP
    assert "without data" not in result.method
    assert not recwarn.list


@pytest.mark.parametrize("kind", ["normalized", "degree", "array"])
def test_constants_of_other_gammas(kind: str) -> None:
    """No function has less energy there than s f = const, or than 0."""
    graph = gr.Graph.from_edges([[0, 1], [2, 3], [3, 4], [2, 4], [3, 5]], [1, 2, 0.5, 3, 1], n_vertices=6)
    lam, f0 = np.array([2.0, 0, 0, 0, 0, 0]), np.array([3.0, 9, 9, 9, 9, 9])
    result = solve(f0, graph, p=1.5, lam=lam, gamma=gamma_of("array", graph) if kind == "array" else kind)
    if kind == "array":
        assert "4 vertices in 1 component without data set to 0" in result.method
        assert (result.value[2:] == 0).all()
    else:
        assert "divided by s(u)" in result.method
        degree = np.bincount(graph.edge_rows(), graph.weights)[2:]
        assert np.ptp(result.value[2:] / np.sqrt(degree)) == pytest.approx(0, abs=1e-12)
    assert result.energy[-1] == pytest.approx(0 if kind != "array" else result.energy[-1], abs=1e-9)


@both_norms
@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_f0_without_data_does_not_matter(p: float, norm: str) -> None:
    """Not even a number beyond float32."""
    usual = solve(p=p, norm=norm, dtype="float32")
    for value in (-3.0, 1e30):
        other = solve(np.where(LAM[:, None] > 0, F0, value), p=p, norm=norm, dtype="float32")
        assert other.value.tobytes() == usual.value.tobytes()
        assert other.gap == usual.gap


def test_a_start_of_ones_own() -> None:
    """`initial` is clipped to the box, and used instead of the solution for p = 2."""
    near = solve(p=1.5, tol=1e-9)
    warm, cold = solve(p=1.5, initial=near.value), solve(p=1.5)
    assert "p = 2" in cold.method and "p = 2" not in warm.method
    assert warm.iterations < cold.iterations
    far = solve(p=1.5, initial=np.full(F0.shape, 1e6), max_iter=0)
    inside = LAM > 0
    assert far.value.max() <= F0[inside].max()


# The box


def test_box_of_each_component() -> None:
    """The range of the data of a component; the constant where there are none."""
    problem, low, high = boxed(VALUES, PATHS, KNOWN)
    assert low[:, 0].tolist() == [1, 1, 1, 3, 3, 2, 2, 2, 3]
    assert high[:, 0].tolist() == [5, 5, 5, 3, 3, 2, 2, 2, 3]
    assert problem.problem.f0[:, 0].tolist() == [1, 5, 5, 3, 3, 2, 2, 2, 3]
    assert np.isinf(problem.problem.lam[[0, 3, 4, 8]]).all()


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_box_of_an_array(p: float) -> None:
    """Finite, it holds the minimiser, and a minimiser leaves the range of the data (on 148 of 300 such graphs)."""
    rng, outside = cases.rng(3), 0
    for seed in range(1, 9, 2):
        graph = cases.irregular(13, 40, isolated=5, seed=seed)
        lam = np.where(np.arange(13) == 5, 1.0, rng.choice([0, 0, 0, 1, np.inf], 13))
        lam[0] = 1.0
        gamma = rng.random(graph.n_edges) * rng.choice([0, 1, 1, 1], graph.n_edges)
        f0 = rng.normal(1, 0.1, (13, 1))
        solved = solve(f0, graph, p=p, lam=lam, gamma=gamma, tol=1e-9)
        _, low, high = boxed(f0, graph, lam, p=p, gamma=gamma)
        assert np.isfinite(low).all() and np.isfinite(high).all()
        assert (low - 1e-6 <= solved.value).all() and (solved.value <= high + 1e-6).all()
        data = f0[lam > 0]
        outside += bool((solved.value < data.min() - 1e-3).any() or (solved.value > data.max() + 1e-3).any())
    assert outside


def test_no_box_without_zeros() -> None:
    problem = Problem.make(F0, GRAPH, lam=np.where(LAM > 0, LAM, 1), dtype=np.dtype(float))
    on_device = DeviceProblem.put(problem, backends.get("numpy", "float64"))
    assert with_box(on_device) is on_device


# The error


@pytest.mark.parametrize(
    ("p", "eps", "norm", "gamma"),
    [
        (1.2, 0.0, "vertex", "sqrt"),
        (1.5, 0.2, "vertex", "sqrt"),
        (1.5, 0.0, "edge", "normalized"),
        (2.0, 0.0, "edge", "sqrt"),
        (3.0, 0.2, "edge", "normalized"),
        (3.0, 0.0, "vertex", "sqrt"),
    ],
)
def test_error_bound_along_paths(p: float, eps: float, norm: str, gamma: str) -> None:
    """Of loose runs, against a sharp one."""
    given = {"p": p, "eps": eps, "norm": norm, "gamma": gamma}
    sharp = solve(tol=1e-12, **given)
    for tol in (1e-1, 1e-3):
        loose = solve(tol=tol, **given)
        assert "paths" in loose.error_bound_note or p == 2
        error = float(np.linalg.norm(loose.value - sharp.value))
        assert error <= loose.error_bound + sharp.error_bound
        assert math.isfinite(loose.error_bound)


def test_error_bound_of_a_path_in_numbers() -> None:
    """p = 2 on 0 - 1 - 2, both ends pinned: |e(1)| <= sqrt(l S) with l = 1 and S = 2 gap."""
    path = gr.Graph.from_edges([[0, 1], [1, 2]])
    result = solve(np.array([0.0, 9, 1]), path, "newton", p=3, lam=np.array([np.inf, 0, np.inf]), max_iter=0,
                   initial=np.array([0.0, 0.9, 1]))  # fmt: skip
    assert result.error_bound == pytest.approx((3 * 3 * result.gap) ** (1 / 3))
    assert result.error_bound >= 0.4


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"p": 1.0}, "many minimisers"),
        ({"p": 1.5, "gamma": gamma_of("array", GRAPH)}, "gamma"),
        # 1e-6 to the power -101
        ({"p": 1.01, "f0": VALUES[:3], "graph": FAINT, "lam": np.array([1.0, 1, 0])}, "overflow"),
    ],
)
def test_no_error_bound(given: dict, words: str) -> None:
    result = solve(max_iter=3, **given)
    assert result.gap is not None
    assert result.error_bound is None
    assert words in result.error_bound_note and result.error_bound_note.startswith("There is none")


def test_error_bounds_are_said() -> None:
    everywhere = solve(p=1.5, lam=2.0)
    assert "strongly convex" in everywhere.error_bound_note
    assert everywhere.error_bound == pytest.approx(math.sqrt(everywhere.gap))
    assert gr.regularize(F0, GRAPH, lam=1.0, **ORACLE).error_bound_note == ""
    apart = solve(p=1.5, coupled=False)
    assert "paths" in apart.error_bound_note and apart.error_bound > 0
