"""The certified solver in use: its methods, odd problems, what it refuses."""

from __future__ import annotations

import functools
import math
from typing import Any

import cases
import numpy as np
import pytest
from test_certified import ORACLE, fidelity, noisy, ring, solve

import gpureg as gr
from gpureg.solvers import Solver

GRID = gr.GridGraph((24, 20), 1, "cityblock")
ALL = ("auto", "dual", "newton")


def methods(p: float) -> tuple[str, ...]:
    return (*ALL, "linear") if p == 2 else ALL


def by_every_method(*degrees: float) -> pytest.MarkDecorator:
    return pytest.mark.parametrize(("p", "method"), [(p, method) for p in degrees for method in methods(p)])


def within(a: gr.Result, b: gr.Result) -> bool:
    """Whether two results are as near to one another as their certificates say, but for roundings."""
    assert a.error_bound is not None and b.error_bound is not None
    inside = np.isfinite(a.value)
    apart = float(np.linalg.norm(a.value[inside] - b.value[inside]))
    return apart <= a.error_bound + b.error_bound + 1e-14 * float(np.linalg.norm(a.value[inside]))


# Methods


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize(("p", "eps"), [(1.0, 0.0), (1.0, 0.02), (1.3, 0.0), (1.3, 0.02), (2.0, 0.0), (4.0, 0.0)])
def test_every_method_has_the_same_minimiser(p: float, eps: float, norm: str) -> None:
    f0 = noisy()
    given = {"p": p, "eps": eps, "norm": norm, "lam": fidelity(p), "tol": 1e-7}
    results = [solve(f0, GRID, method, **given) for method in methods(p)]
    assert {result.stop for result in results} == {gr.Stop.GAP}
    assert all(within(results[0], result) for result in results[1:])
    assert all(result.eps == eps for result in results)
    # how far bounds of 1e-7 of the energy reach
    assert max(result.error_bound for result in results) <= math.sqrt(2e-7 * results[0].energy[-1] / fidelity(p)) * 1.01


def test_auto_goes_on_with_newton() -> None:
    """Where lam is small; the other methods reach the same."""
    f0, given = noisy(), {"p": 1.0, "lam": 0.05, "tol": 1e-7}
    found = solve(f0, GRID, **given)
    assert "then Primal-dual Newton" in found.method
    assert "multigrid" in found.method
    # measured: 62 against 1273
    assert found.iterations < 150
    dual, newton = (solve(f0, GRID, method, **given) for method in ("dual", "newton"))
    assert {dual.stop, newton.stop} == {gr.Stop.GAP}
    assert within(found, newton) and within(dual, newton)


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize(
    ("grid", "most"),
    [
        (GRID, 1),  # its eigenvectors are cosines
        # measured: 10, 16 and 12; by the diagonal 103, 46 and 72
        (gr.GridGraph((24, 20)), 12),
        (gr.GridGraph((9, 8, 7), 2, "euclidean"), 18),
        (gr.GridGraph((24, 20), 3, spacing=(1, 2)), 14),
    ],
)
def test_cosines_as_a_preconditioner(grid: gr.GridGraph, most: int, norm: str) -> None:
    f0 = np.random.default_rng(3).standard_normal((*grid.shape, 2))
    given = {"p": 2, "lam": 1e-3, "norm": norm, "backend": "numpy", "dtype": np.float64}
    found = gr.regularize(f0, grid, solver=gr.Certified(tol=1e-10), **given)
    assert found.stop is gr.Stop.GAP and found.iterations <= most
    stored = gr.regularize(f0.reshape(-1, 2), grid.to_graph(), solver=gr.Certified(tol=1e-10, method="linear"), **given)
    distance = float(np.linalg.norm(found.value.reshape(-1, 2) - stored.value))
    assert distance <= found.error_bound + stored.error_bound


def test_names_of_methods() -> None:
    f0 = noisy()
    assert "cosine" in solve(f0, gr.GridGraph((24, 20), 2), p=2).method
    assert "diagonal" in solve(f0, GRID, p=2, weights=np.ones(GRID.n_edges) * 0.5).method
    assert "dual" in solve(f0, GRID, p=3, lam=5).method


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("p", [3.0, 4.5])
def test_newton_on_flat_edges(p: float, norm: str) -> None:
    """Beyond p = 2 without eps the second derivative vanishes with the slopes; the first step begins there."""
    f0 = np.repeat([0.0, 1.0], [30, 31])
    newton, dual = (solve(f0, ring(), method, p=p, lam=0.3, norm=norm, tol=1e-8) for method in ("newton", "dual"))
    assert newton.stop is gr.Stop.GAP
    assert within(newton, dual)


# Odd problems


def pinned() -> tuple[np.ndarray, np.ndarray]:
    """Data, and a fidelity that is infinite at some vertices."""
    lam = cases.rng(5).uniform(0.5, 9, (24, 20))
    lam[3, 4], lam[:, 7] = np.inf, np.inf
    return noisy().astype(np.float32), lam


@functools.cache
def with_pins(p: float, method: str) -> gr.Result:
    f0, lam = pinned()
    return solve(f0, GRID, method, p=p, lam=lam, tol=1e-6, max_iter=3000)


def check_pins(result: gr.Result, p: float) -> None:
    f0, lam = pinned()
    assert np.array_equal(result.value[np.isinf(lam)], f0[np.isinf(lam)])
    assert result.error_bound == pytest.approx(math.sqrt(2 * result.gap / lam.min()))
    other = with_pins(p, "auto")
    assert np.linalg.norm(result.value - other.value) <= result.error_bound + other.error_bound


@by_every_method(1.0, 1.5, 2.0, 3.0)
def test_fidelity_per_vertex_and_pins(p: float, method: str) -> None:
    check_pins(with_pins(p, method), p)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_fidelity_per_vertex_and_pins_on_every_device(device: str, p: float) -> None:
    f0, lam = pinned()
    check_pins(gr.regularize(f0, GRID, p=p, lam=lam, solver="certified", backend=device, tol=1e-4), p)


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_all_pinned(p: float, method: str) -> None:
    result = solve(noisy(), GRID, method, p=p, lam=np.inf)
    assert np.array_equal(result.value, noisy())
    assert result.error_bound == 0


@functools.cache
def masked(p: float) -> tuple[np.ndarray, gr.GridGraph, gr.Result]:
    """Data that is NaN outside a mask, the grid, and the minimiser on the graph of what is left."""
    mask = cases.rng(7).random((24, 20)) < 0.8
    f0 = np.where(mask, noisy(), np.nan).astype(np.float32)
    grid = gr.GridGraph((24, 20), 1, mask=mask)
    left = grid.to_graph()
    number = np.cumsum(mask.ravel()) - 1
    rows, inside = left.edge_rows(), mask.ravel()
    forward = (rows < left.indices) & inside[rows] & inside[left.indices]
    pairs = np.stack([number[rows[forward]], number[left.indices[forward]]], axis=1)
    alone = gr.Graph.from_edges(pairs, n_vertices=int(mask.sum()))
    return f0, grid, solve(f0[mask], alone, p=p, lam=2.0, tol=1e-8)


@by_every_method(1.0, 2.0, 3.0)
@pytest.mark.parametrize("lam_outside", [2.0, 0.0])
def test_mask(device: str, p: float, method: str, lam_outside: float) -> None:
    """NaN outside comes back, no lam outside matters, and inside it is the graph of what is left."""
    f0, grid, exact = masked(p)
    lam = np.where(grid.mask, 2.0, 0.0) if lam_outside == 0 else lam_outside
    result = solve(f0, grid, method, p=p, lam=lam, backend=device, tol=1e-5)
    assert np.isnan(result.value[~grid.mask]).all()
    assert np.linalg.norm(result.value[grid.mask] - exact.value) <= result.error_bound + exact.error_bound
    assert result.energy[-1] == pytest.approx(exact.energy[-1], rel=1.1e-5)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("gamma", ["combinatorial", "normalized", "degree", "array"])
def test_gamma(gamma: str, p: float) -> None:
    """Every gamma has its own minimiser, which all methods find, and whose energy no function near it is below."""
    graph = ring()
    f0 = cases.function(graph, 2)
    given = {"p": p, "lam": fidelity(p), "gamma": cases.rng(4).random(graph.n_edges) if gamma == "array" else gamma}
    results = [solve(f0, graph, method, tol=1e-8, **given) for method in methods(p)]
    assert all(within(results[0], result) for result in results[1:])
    plain = solve(f0, graph, p=p, lam=fidelity(p), tol=1e-8)
    assert np.linalg.norm(plain.value - results[0].value) > 10 * results[0].error_bound
    near = [results[0].value + 1e-3 * cases.rng(seed).standard_normal(f0.shape) for seed in (3, 5, 7)]
    energies = [solve(f0, graph, "newton", initial=f, max_iter=0, **given).energy[0] for f in near]
    assert min(energies) > results[0].lower_bound


NOTHING = {
    "zeros": (GRID, np.zeros((24, 20))),
    "constant": (GRID, np.full((24, 20), 3.5)),
    "one vertex": (gr.Graph([0, 0], []), np.array([2.0])),
    "one pixel": (gr.GridGraph((1, 1)), np.array([[2.0]])),
    "no edges": (gr.Graph([0, 0, 0, 0], []), np.array([2.0, 1.0, 5.0])),
    "weights of 0": (gr.Graph.from_edges([[0, 1]], [0.0]), np.array([2.0, 5.0])),
}


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("kind", NOTHING)
def test_nothing_to_do(p: float, method: str, kind: str) -> None:
    """The data, with a gap of 0."""
    graph, f0 = NOTHING[kind]
    result = solve(f0, graph, method, p=p)
    assert result.stop is gr.Stop.GAP
    assert result.iterations == 0
    assert np.array_equal(result.value, f0)
    assert result.gap == result.error_bound == 0


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_an_isolated_vertex_keeps_its_data(p: float, method: str) -> None:
    f0 = cases.function(ring())
    assert solve(f0, ring(), method, p=p).value[60] == pytest.approx(f0[60, 0], abs=1e-15)


@functools.cache
def offset(p: float) -> tuple[np.ndarray, gr.Result]:
    """Data far from 0, exact in both types, and the minimiser."""
    f0 = (noisy() + 4096).astype(np.float32)
    return f0, solve(f0, GRID, tol=1e-9, p=p, lam=4.0)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0])
def test_an_offset_moves_the_minimiser(p: float) -> None:
    f0, exact = offset(p)
    near = solve(f0 - 4096.0, GRID, tol=1e-9, p=p, lam=4.0)
    assert np.linalg.norm(exact.value - near.value - 4096) <= near.error_bound + exact.error_bound


@by_every_method(1.0, 1.5, 2.0)
def test_large_offset(p: float, method: str) -> None:
    """Digits that an offset takes are missing from the gap reached, and the certificate knows of it."""
    f0, exact = offset(p)
    result = solve(f0, GRID, method, dtype="float32", tol=1e-5, p=p, lam=4.0)
    assert result.stop in (gr.Stop.GAP, gr.Stop.PRECISION)
    assert result.gap < 1e-2 * result.energy[-1]
    assert np.linalg.norm(result.value.astype(float) - exact.value) <= result.error_bound + exact.error_bound
    assert result.iterations < 5000


@pytest.mark.parametrize("kind", [np.uint8, np.int64, bool])
@pytest.mark.parametrize(("p", "lam"), [(1.0, 0.05), (2.0, 1.0), (3.0, 50.0)])
def test_integers(kind: type, p: float, lam: float) -> None:
    f0 = cases.rng(3).integers(0, 2 if kind is bool else 255, (24, 20)).astype(kind)
    result = gr.regularize(f0, GRID, p=p, lam=lam, solver="certified", backend="numpy")
    assert result.value.dtype == (np.float64 if kind is np.int64 else np.float32)
    assert result.stop is gr.Stop.GAP
    assert within(result, solve(f0, GRID, p=p, lam=lam))


# Refused


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"p": 0.7}, "needs p >= 1, got 0.7.*jacobi"),
        ({"lam": 0.0, "solver": gr.Certified(method="dual")}, "needs lam > 0 at every vertex"),
        (
            {"lam": np.where(np.arange(480) == 7, 0.0, 1.0), "solver": gr.Certified(method="dual")},
            "needs lam > 0 at every vertex",
        ),
        ({"tol": -1e-3}, "tol must be finite and >= 0"),
        ({"tol": np.inf}, "tol must be finite and >= 0"),
        ({"p": 1.5, "solver": gr.Certified(method="linear")}, "method='linear' is for p = 2, got p = 1.5"),
        ({"weights": gr.weights.bilateral(1.0, 0.3), "update_weights": 3}, "weights that stay"),
    ],
)
def test_wrong_problems(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        gr.regularize(noisy(), GRID, **{"p": 1.0, "solver": "certified", **ORACLE, **settings})


@pytest.mark.parametrize("tol", [-1, np.nan, np.inf])
def test_wrong_numbers(tol: float) -> None:
    with pytest.raises(ValueError, match="Certified: tol must be finite and >= 0"):
        gr.Certified(tol=tol)


@pytest.mark.parametrize("tol", ["small", None])
def test_wrong_types(tol) -> None:
    with pytest.raises(TypeError, match="Certified: tol must be a number"):
        gr.Certified(tol=tol)


@pytest.mark.parametrize("method", ["jacobi", "", 3])
def test_wrong_methods(method) -> None:
    with pytest.raises(
        ValueError, match='Certified: method must be "auto", "dual", "primal-dual", "linear" or "newton"'
    ):
        gr.Certified(method=method)


def test_it_is_a_solver() -> None:
    assert isinstance(gr.Certified(), Solver)


@pytest.mark.parametrize("norm", ["vertex", "edge"])
def test_newton_at_a_large_p(norm: str) -> None:
    """Powers that fall to 0 in flat parts neither stop the steps nor make NaN: p = 40, values known at one in three."""
    graph, rng = gr.GridGraph((12, 9)), np.random.default_rng(5)
    f0 = rng.random(graph.shape)
    lam = np.where(rng.random(graph.shape) < 0.3, np.inf, 0)
    given = {"lam": lam, "norm": norm, "backend": "numpy", "dtype": np.float64}
    found = gr.regularize(f0, graph, p=40, solver=gr.Certified(method="newton", tol=1e-6), **given)
    assert found.stop is gr.Stop.GAP and np.isfinite(found.value).all()
    assert "smaller p" in found.method
    # for a large p the largest slope counts: it is not above that of p = 6
    before = gr.regularize(f0, graph, p=6, solver="certified", **given)

    def largest(value: np.ndarray) -> float:
        of = gr.operators.gradient_norm if norm == "vertex" else gr.operators.difference
        return float(np.abs(of(value, graph)).max())

    assert largest(found.value) <= largest(before.value) * (1 + 1e-6)
