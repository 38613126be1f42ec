"""Every stop test means what it says; below p = 1 the result says that its minimum is local."""

from __future__ import annotations

import functools
import math

import cases
import numpy as np
import pytest

import gpureg as gr
from gpureg.solvers.stopping import estimated_error

ORACLE = {"backend": "numpy", "dtype": np.float64}
ops = gr.operators


def g0(shape: tuple[int, ...]) -> gr.GridGraph:
    return gr.GridGraph(shape, 1, "cityblock")


def noisy(shape: tuple[int, int] = (24, 31)) -> np.ndarray:
    _, x = np.indices(shape)
    return np.where(x < 15, 0.0, 1.0) + 0.1 * cases.rng(7).standard_normal(shape)


@pytest.mark.parametrize("metric", ["cityblock", "chebyshev"])
def test_error_is_the_distance_still_to_go(metric: str) -> None:
    """Where a smooth error is 800 and 1600 times the change, 1/(1 - rate) = (lam + 2 degree)/lam.

    On 4-adjacency the checkerboard part of noise flips at the same rate: changes are large then, and errors are not.
    """
    f0, grid = noisy(), gr.GridGraph((24, 31), 1, metric)
    model = {"p": 2, "lam": 0.01, "max_iter": 20_000, "tol": 1e-3, **ORACLE}
    exact = gr.regularize(f0, grid, solver=gr.Jacobi(accelerate=True, stop="gradient"), **{**model, "tol": 1e-10})
    assert exact.error_bound is not None
    assert exact.error_bound < 1e-5

    def stopped(stop: str) -> tuple[gr.Stop, float]:
        result = gr.regularize(f0, grid, solver=gr.Jacobi(stop=stop), **model)
        return result.stop, float(np.abs(result.value - exact.value).max() / np.ptp(f0))

    stop, error = stopped("error")
    assert stop is gr.Stop.ERROR
    assert 1e-3 / 3 < error < 3e-3
    stop, error = stopped("change")
    assert stop is gr.Stop.TOLERANCE
    if metric == "chebyshev":
        assert error > 0.1  # a hundred times the tolerance


@pytest.mark.parametrize("p", [1.0, 1.5, 3.0])
def test_error_for_other_p(p: float) -> None:
    f0, grid = noisy(), g0((24, 31))
    model = {"p": p, "lam": 0.5, "eps": 0.01, "max_iter": 20_000, **ORACLE}
    exact = gr.regularize(f0, grid, solver=gr.Jacobi(accelerate=True, stop="gradient", tol=1e-10), **model)
    result = gr.regularize(f0, grid, solver=gr.Jacobi(stop="error", tol=1e-4), **model)
    assert (exact.stop, result.stop) == (gr.Stop.GRADIENT, gr.Stop.ERROR)
    assert np.abs(result.value - exact.value).max() < 3e-4 * np.ptp(f0)


def test_an_error_that_the_type_cannot_reach_is_said() -> None:
    f0, grid = noisy().astype(np.float32), g0((24, 31))
    model = {"p": 2, "lam": 0.1, "max_iter": 20_000, "backend": "numpy"}
    result = gr.regularize(f0, grid, solver=gr.Jacobi(stop="error", tol=1e-9), **model)
    assert result.stop is gr.Stop.ROUNDING
    assert result.iterations < 20_000
    constant = gr.regularize(np.full(50, 0.25), gr.GridGraph(50), **{**model, "solver": gr.Jacobi(stop="error", tol=0)})
    assert constant.stop is gr.Stop.ERROR  # nothing moves: that is no rounding
    # in float64 it can be reached
    result = gr.regularize(f0, grid, solver=gr.Jacobi(stop="error", tol=1e-9), **{**model, **ORACLE})
    assert result.stop is gr.Stop.ERROR


def test_estimate_on_known_ways() -> None:
    """Ways of 0.9^10 over ten iterations each; the first entry is the start."""
    R, checks = 0.9**10, [10 * k for k in range(9)]
    falling = [0.0, *(R**k for k in range(8))]
    assert estimated_error(falling, checks, 0.0) == pytest.approx(R**8 / (1 - R))
    # a last check that comes early
    assert estimated_error([*falling, R**8 * 0.6], [*checks, 86], 0.0) < R**9 / (1 - R) * 3
    assert estimated_error(falling[:3], checks[:3], 0.0) == math.inf  # not observed yet
    assert estimated_error([0.0, *[1e-3] * 8], checks, 0.0) == math.inf  # rate 1
    assert estimated_error([0.0, *(2.0**k for k in range(8))], checks, 0.0) == math.inf
    # one way that is short by chance: the rates before it count
    lucky = [*falling[:-1], falling[-1] / 1000]
    assert estimated_error(lucky, checks, 0.0) == pytest.approx(lucky[-1] * R / (1 - R))
    assert estimated_error([0.0, 1.0, *[0.0] * 7], checks, 1e-8) == math.inf  # as far as that can be known
    assert estimated_error([0.0] * 9, checks, 1e-8) == 0.0  # nothing ever moved


@pytest.mark.parametrize("solver", [gr.Jacobi, gr.Euler])
@pytest.mark.parametrize("gamma", ["sqrt", "normalized"])
@pytest.mark.parametrize("norm", ["vertex", "edge"])
def test_gradient_is_that_of_the_energy(solver: type, gamma: str, norm: str) -> None:
    """The stop comes at the first check at which the norm of lam (f - f0) + p-Laplacian is small enough."""
    graph = cases.irregular(40, 150, isolated=17)
    f0 = cases.function(graph, 2)
    known = {"p": 1.5, "eps": 0.05, "gamma": gamma, "norm": norm}

    def norm_at(f: np.ndarray) -> float:
        return float(np.linalg.norm(0.7 * (f - f0) + ops.p_laplacian(f, graph, **known, **ORACLE)))

    norms = []
    result = gr.regularize(
        f0, graph, lam=0.7, solver=solver(stop="gradient", tol=1e-3), max_iter=5000,
        callback=lambda check: norms.append(norm_at(check.value())), **known, **ORACLE,
    )  # fmt: skip
    assert result.stop is gr.Stop.GRADIENT
    assert norms[-1] <= 1e-3 * norms[0] < norms[-2]


@functools.cache
def pinned(p: float, norm: str) -> tuple[np.ndarray, gr.Graph, dict, gr.Result]:
    """Data, graph and model with a fidelity per vertex, and the minimiser."""
    graph = cases.irregular(60, 240, isolated=17)
    f0 = cases.function(graph)
    lam = 0.5 + cases.rng(9).random(graph.n_vertices)
    lam[::9] = np.inf
    model = {"p": p, "lam": lam, "eps": 0.05, "norm": norm, "gamma": "normalized", **ORACLE}
    solver = gr.Jacobi(accelerate=True, stop="gradient", tol=1e-12)
    return f0, graph, model, gr.regularize(f0, graph, solver=solver, max_iter=5000, **model)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("sweeps", [1, 3, 6])
def test_gap_of_the_gradient_bounds_energy_and_error(p: float, norm: str, sweeps: int) -> None:
    f0, graph, model, exact = pinned(p, norm)
    assert exact.stop is gr.Stop.GRADIENT
    result = gr.regularize(f0, graph, solver=gr.Jacobi(stop="gradient"), max_iter=sweeps, **model)
    above = result.energy[-1] - exact.energy[-1]
    assert 0 < above <= result.gap
    assert np.linalg.norm(result.value - exact.value) <= result.error_bound
    # not by far: the energy's own curvature is lam and what the graph adds, here up to some hundred times as much
    assert result.gap < 300 * above


@pytest.mark.parametrize(
    "model",
    [{"p": 0.8}, {"p": 1, "lam": np.where(np.arange(24 * 31) == 97, 0.0, 1.0).reshape(24, 31)}],
    ids=["p below 1", "lam of 0 at a vertex"],
)
def test_no_gap_where_nothing_bounds_the_error(model: dict) -> None:
    solver = gr.Jacobi(stop="gradient", tol=0.1)
    result = gr.regularize(noisy(), g0((24, 31)), solver=solver, max_iter=1000, **model, **ORACLE)
    assert result.stop is gr.Stop.GRADIENT
    assert result.gap is None


def test_no_gap_of_the_change() -> None:
    """It looks at no gradient."""
    assert gr.regularize(noisy(), g0((24, 31)), p=1, max_iter=5, **ORACLE).gap is None


@pytest.mark.parametrize("solver", [gr.Jacobi, gr.Euler])
def test_energy_is_its_decrease_per_iteration(solver: type) -> None:
    f0, grid = noisy(), g0((24, 31))
    result = gr.regularize(
        f0, grid, p=1.5, lam=1, solver=solver(stop="energy", tol=1e-4, check_every=4), max_iter=5000, **ORACLE
    )
    assert result.stop is gr.Stop.ENERGY
    decrease = -np.diff(result.energy) / 4
    share = decrease / result.energy[1:]
    assert share[-1] <= 1e-4
    assert (share[:-1] > 1e-4).all()
    assert len(share) > 1


def test_tol_of_the_solver_is_used_where_none_is_given() -> None:
    f0, grid = noisy(), g0((24, 31))
    model = {"p": 2, "lam": 1, "max_iter": 500, **ORACLE}
    own = gr.regularize(f0, grid, solver=gr.Jacobi(tol=1e-4), **model)
    given = gr.regularize(f0, grid, tol=1e-4, **model)
    assert own.stop is given.stop is gr.Stop.TOLERANCE
    assert own.iterations == given.iterations
    assert gr.regularize(f0, grid, solver=gr.Jacobi(tol=1e-4), tol=1e-8, **model).iterations > own.iterations
    assert gr.regularize(f0, grid, solver=gr.Jacobi(stop="error"), **model).stop is gr.Stop.MAX_ITER


@pytest.mark.parametrize("solver", [gr.Jacobi, gr.Euler])
def test_wrong_settings(solver: type) -> None:
    with pytest.raises(ValueError, match='stop must be "change", "error", "gradient" or "energy", got'):
        solver(stop="gap")
    with pytest.raises(ValueError, match="tol must be finite and >= 0, got -1"):
        solver(tol=-1)
    with pytest.raises(TypeError, match="tol must be a number, got '1'"):
        solver(tol="1")
    with pytest.raises(ValueError, match="accelerated sweeps have none: use stop='gradient'"):
        gr.Jacobi(accelerate=True, stop="error")


@pytest.mark.parametrize("stop", ["error", "gradient", "energy"])
def test_only_the_change_is_tested_in_tiles(stop: str) -> None:
    given = {"p": 1, "tol": 1e-3, "max_iter": 20, "memory": 12_000, "backend": "numpy"}
    with pytest.raises(MemoryError, match=rf"stop='{stop}' needs the whole graph \(stop='change' does not\)"):
        gr.regularize(noisy(), g0((24, 31)), solver=gr.Jacobi(stop=stop), **given)
    assert "tiles" in gr.regularize(noisy(), g0((24, 31)), **given).method


STEP, STEP_MODEL = np.array([0.0, 1.0]), {"p": 0.5, "lam": 12.0, "eps": 1e-3}
STARTS = {"data": STEP, "mean": np.array([0.5, 0.5])}
accelerated_or_not = pytest.mark.parametrize("accelerate", [False, True])


@functools.cache
def step_from(start: str, accelerate: bool) -> gr.Result:
    """Two vertices, p = 1/2."""
    solver = gr.Jacobi(accelerate=accelerate, stop="gradient", tol=1e-8)
    given = {"solver": solver, "max_iter": 20_000, "initial": STARTS[start], **STEP_MODEL, **ORACLE}
    return gr.regularize(STEP, gr.Graph.from_edges([[0, 1]]), **given)


@accelerated_or_not
def test_below_1_the_minimum_depends_on_the_start(accelerate: bool) -> None:
    """The step of the data stays, or it is gone."""
    from_data, from_mean = step_from("data", accelerate), step_from("mean", accelerate)
    assert np.ptp(from_data.value) > 0.5
    assert np.ptp(from_mean.value) < 1e-3
    assert abs(from_data.energy[-1] - from_mean.energy[-1]) > 0.1


@accelerated_or_not
@pytest.mark.parametrize("start", STARTS)
def test_below_1_the_minimum_is_local(start: str, accelerate: bool) -> None:
    """Neither end is a saddle."""
    result, graph = step_from(start, accelerate), gr.Graph.from_edges([[0, 1]])
    assert result.stop is gr.Stop.GRADIENT
    assert "a local minimum that depends on the start (p < 1)" in result.method

    def energy(f: np.ndarray) -> float:
        return ops.energy(f, STEP, graph, **STEP_MODEL, **ORACLE)

    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    around = [energy(result.value + 1e-4 * np.array([np.cos(angle), np.sin(angle)])) for angle in angles]
    assert min(around) > energy(result.value)


def test_at_1_no_minimum_is_called_local() -> None:
    assert "local" not in gr.regularize(STEP, gr.Graph.from_edges([[0, 1]]), p=1, max_iter=1, **ORACLE).method
