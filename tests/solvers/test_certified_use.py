"""The certified solver in use: its methods, odd problems, when it stops and says why, what it refuses."""

from __future__ import annotations

import math
from typing import Any

import cases
import numpy as np
import pytest
from test_certified import ORACLE, fidelity, noisy, ring, solve

import gpureg as gr
from gpureg.solvers import Solver, multigrid

GRID = gr.GridGraph((24, 20), 1, "cityblock")
ALL = ("auto", "dual", "newton")


def methods(p: float) -> tuple[str, ...]:
    return (*ALL, "linear") if p == 2 else ALL


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


def test_auto_goes_on_with_newton(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where lam is small and pyamg there; without pyamg it stays what it was, and reaches the same."""
    f0, given = noisy(), {"p": 1.0, "lam": 0.05, "tol": 1e-7}
    if multigrid.is_there():
        found = solve(f0, GRID, **given)
        assert "then Primal-dual Newton" in found.method
        assert "multigrid" in found.method
        assert "pyamg is not" not in found.method
        # measured: 62 against 1273
        assert found.iterations < 150
    monkeypatch.setattr(multigrid, "is_there", lambda: False)
    without = solve(f0, GRID, **given)
    assert "Newton" not in without.method
    assert without.stop is gr.Stop.GAP
    newton = solve(f0, GRID, "newton", **given)
    assert "pyamg is not installed" in newton.method
    assert newton.stop is gr.Stop.GAP
    assert within(without, newton)
    if multigrid.is_there():
        assert within(found, newton)


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


@pytest.mark.one_driver
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_fidelity_per_vertex_and_pins(device: str, p: float) -> None:
    f0 = noisy().astype(np.float32)
    lam = cases.rng(5).uniform(0.5, 9, f0.shape)
    lam[3, 4], lam[:, 7] = np.inf, np.inf
    results = [solve(f0, GRID, method, p=p, lam=lam, tol=1e-6, max_iter=3000) for method in methods(p)]
    results.append(gr.regularize(f0, GRID, p=p, lam=lam, solver="certified", backend=device, tol=1e-4))
    for result in results:
        assert np.array_equal(result.value[np.isinf(lam)], f0[np.isinf(lam)])
        assert result.error_bound == pytest.approx(math.sqrt(2 * result.gap / lam.min()))
        assert np.linalg.norm(result.value - results[0].value) <= result.error_bound + results[0].error_bound


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_all_pinned(p: float, method: str) -> None:
    result = solve(noisy(), GRID, method, p=p, lam=np.inf)
    assert np.array_equal(result.value, noisy())
    assert result.error_bound == 0


@pytest.mark.one_driver
@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_mask(device: str, p: float) -> None:
    """NaN outside comes back, no lam outside matters, and inside it is the graph of what is left."""
    mask = cases.rng(7).random((24, 20)) < 0.8
    f0 = np.where(mask, noisy(), np.nan).astype(np.float32)
    grid = gr.GridGraph((24, 20), 1, mask=mask)
    left = grid.to_graph()
    number = np.cumsum(mask.ravel()) - 1
    rows, inside = left.edge_rows(), mask.ravel()
    forward = (rows < left.indices) & inside[rows] & inside[left.indices]
    pairs = np.stack([number[rows[forward]], number[left.indices[forward]]], axis=1)
    alone = gr.Graph.from_edges(pairs, n_vertices=int(mask.sum()))
    exact = solve(f0[mask], alone, p=p, lam=2.0, tol=1e-8)
    for lam in (2.0, np.where(mask, 2.0, 0.0)):
        for method in methods(p):
            result = solve(f0, grid, method, p=p, lam=lam, backend=device, tol=1e-5)
            assert np.isnan(result.value[~mask]).all()
            assert np.linalg.norm(result.value[mask] - exact.value) <= result.error_bound + exact.error_bound
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
    for seed in (3, 5, 7):
        near = results[0].value + 1e-3 * cases.rng(seed).standard_normal(f0.shape)
        energy = solve(f0, graph, "newton", initial=near, max_iter=0, **given).energy[0]
        assert energy > results[0].lower_bound


@pytest.mark.parametrize("method", ALL)
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_nothing_to_do(p: float, method: str) -> None:
    """Constant data, one vertex, no edges, weights of 0, isolated vertices: the data, with a gap of 0."""
    for graph, f0 in (
        (GRID, np.zeros((24, 20))),
        (GRID, np.full((24, 20), 3.5)),
        (gr.Graph([0, 0], []), np.array([2.0])),
        (gr.GridGraph((1, 1)), np.array([[2.0]])),
        (gr.Graph([0, 0, 0, 0], []), np.array([2.0, 1.0, 5.0])),
        (gr.Graph.from_edges([[0, 1]], [0.0]), np.array([2.0, 5.0])),
    ):
        result = solve(f0, graph, method, p=p)
        assert result.stop is gr.Stop.GAP
        assert result.iterations == 0
        assert np.array_equal(result.value, f0)
        assert result.gap == result.error_bound == 0
    f0 = cases.function(ring())
    assert solve(f0, ring(), method, p=p).value[60] == pytest.approx(f0[60, 0], abs=1e-15)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0])
def test_large_offset(p: float) -> None:
    """Digits that an offset takes are missing from the gap reached, and the certificate knows of it."""
    f0 = (noisy() + 4096).astype(np.float32)  # exact in both types from here on
    given = {"p": p, "lam": 4.0}
    exact = solve(f0, GRID, tol=1e-9, **given)
    near = solve(f0 - 4096.0, GRID, tol=1e-9, **given)
    assert np.linalg.norm(exact.value - near.value - 4096) <= near.error_bound + exact.error_bound
    for method in methods(p):
        result = solve(f0, GRID, method, dtype="float32", tol=1e-5, **given)
        assert result.stop in (gr.Stop.GAP, gr.Stop.PRECISION)
        assert result.gap < 1e-2 * result.energy[-1]
        assert np.linalg.norm(result.value.astype(float) - exact.value) <= result.error_bound + exact.error_bound
        assert result.iterations < 5000


@pytest.mark.parametrize("kind", [np.uint8, np.int64, bool])
def test_integers(kind: type) -> None:
    f0 = cases.rng(3).integers(0, 2 if kind is bool else 255, (24, 20)).astype(kind)
    for p, lam in ((1.0, 0.05), (2.0, 1.0), (3.0, 50.0)):
        result = gr.regularize(f0, GRID, p=p, lam=lam, solver="certified", backend="numpy")
        assert result.value.dtype == np.float32
        assert result.stop is gr.Stop.GAP
        assert within(result, solve(f0, GRID, p=p, lam=lam))


# Stopping


@pytest.mark.one_driver
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 6.0])
def test_precision_is_said(device: str, p: float) -> None:
    """1e-12 of the energy is beyond float32: a bounded number of iterations, and a gap that is true."""
    f0, lam = noisy().astype(np.float32), fidelity(p)
    exact = solve(f0, GRID, "newton", p=p, lam=lam, tol=1e-10)
    for method in methods(p):
        solver = gr.Certified(tol=1e-12, method=method)
        result = gr.regularize(f0, GRID, p=p, lam=lam, solver=solver, backend=device)
        # a residual can be that small; what powers and sums hide cannot be
        if "linear system" not in result.method:
            assert result.stop is gr.Stop.PRECISION
            assert "floating-point type" in str(result.stop)
            # measured with p = 1, whose dual iterations take longest to stand still: 1000 to 6000
            assert result.iterations < 10_000
            assert result.gap >= p * np.finfo(np.float32).eps * result.energy[-1] / 2
        # roundings of f itself
        slack = 2.0**-23 * float(np.linalg.norm(f0))
        assert np.linalg.norm(result.value - exact.value) <= result.error_bound + exact.error_bound + slack
        assert result.gap <= 1e-5 * result.energy[-1]


@pytest.mark.parametrize("seed", [47, 233, 253])
def test_slow_is_not_imprecise(seed: int) -> None:
    """In float64 iterations that make no progress for half of their time, at gaps of 2 to 15 percent, go on to 1e-9."""
    made = cases.irregular(12, 30, isolated=5, seed=seed)
    graph = gr.Graph(made.indptr, made.indices, 30 * made.weights.astype(float) ** 4)
    rng = cases.rng(seed)
    f0, lam = rng.integers(-20, 21, (12, 2)) / 10, rng.uniform(0.01, 1, 12)
    result = solve(f0, graph, "dual", p=1, lam=lam, coupled=False, tol=1e-9)
    assert result.stop is gr.Stop.GAP
    # measured: 792 to 1863
    assert result.iterations < 4000
    assert within(result, solve(f0, graph, "newton", p=1, lam=lam, coupled=False, tol=1e-9))


@pytest.mark.parametrize("seed", [1, 3, 5, 7])
def test_newton_to_the_last_digit(seed: int) -> None:
    """In float64 without a tolerance: matrices that are singular to working precision, and an end."""
    graph = cases.irregular(12, 30, isolated=5, seed=seed)
    f0 = cases.rng(seed).integers(-20, 21, (12, 2)) / 10
    result = solve(f0, graph, "newton", p=1, lam=0.01, coupled=False, tol=0.0, max_iter=2000)
    assert result.stop is gr.Stop.PRECISION
    # measured: 24 to 36, and 4e-14 to 1.1e-11 of the energy, on eight such graphs
    assert result.iterations < 100
    assert result.gap <= 1e-10 * result.energy[-1]


def test_out_of_range_is_an_error() -> None:
    """Squares of y that underflow: not a gap of 0."""
    with pytest.raises(FloatingPointError, match="float64"):
        gr.regularize(noisy() * 1e-3, GRID, p=8, lam=1e-18, solver="certified", backend="numpy")


# What a caller sees


@pytest.mark.parametrize("method", ALL)
def test_callback(method: str) -> None:
    """Check.gap is the result's at the end, and never rises for the same f; True stops with a certificate."""
    seen: list[gr.Check] = []
    result = solve(noisy(), GRID, method, p=1, lam=4, callback=lambda check: seen.append(check))
    assert [check.iteration for check in seen] == result.checks.tolist()
    assert [check.energy for check in seen] == result.energy.tolist()
    assert seen[-1].gap == result.gap
    assert result.lower_bound == result.energy[-1] - result.gap
    bounds = [check.energy - check.gap for check in seen]
    assert np.diff(bounds).min() >= -16 * 2.0**-53 * result.energy[0]
    stopped = solve(noisy(), GRID, method, p=1, lam=4, callback=lambda check: check.gap < 0.1 * check.energy)
    assert stopped.stop is gr.Stop.CALLBACK
    assert within(stopped, result)
    assert stopped.gap < 0.1 * stopped.energy[-1]


@pytest.mark.parametrize("method", ALL)
def test_interruption(method: str) -> None:
    """Ctrl-C at a check leaves the last whole iterate."""

    def interrupt(check: gr.Check) -> None:
        if check.iteration:
            raise KeyboardInterrupt

    with pytest.raises(gr.Interrupted) as caught:
        solve(noisy(), GRID, method, p=1, lam=4, callback=interrupt)
    result = caught.value.result
    assert result.stop is gr.Stop.INTERRUPTED
    assert result.iterations > 0
    assert np.isfinite(result.value).all()


@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_no_iterations(p: float) -> None:
    """Energy and gap of the data."""
    exact = solve(noisy(), GRID, p=p, lam=4.0)
    for method in methods(p):
        result = solve(noisy(), GRID, method, p=p, lam=4.0, max_iter=0)
        assert result.stop is gr.Stop.MAX_ITER
        assert result.iterations == 0
        assert np.array_equal(result.value, noisy())
        assert result.energy[0] - exact.energy[-1] <= result.gap
        assert within(result, exact)


@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_initial(p: float) -> None:
    """The minimiser, but for a little, is a better start than the data; any start has the same end."""
    exact = solve(noisy(), GRID, p=p, lam=4.0, tol=1e-9)
    near = exact.value + 1e-4 * cases.rng(3).standard_normal((24, 20))
    far = cases.rng(5).standard_normal((24, 20))
    for method in ("newton", "dual", *(["linear"] if p == 2 else [])):
        given = {"p": p, "lam": 4.0, "tol": 1e-4}
        cold, warm, lost = (solve(noisy(), GRID, method, initial=f, **given) for f in (None, near, far))
        assert warm.iterations <= cold.iterations
        assert within(warm, exact)
        assert within(lost, exact)


def test_memory() -> None:
    """Functions on the edges count: a job beyond `memory` says what it needs, and that it is not cut into tiles."""
    grid = gr.GridGraph((64, 64), 5)
    f0 = np.zeros((64, 64, 3), np.float32)
    edge = 120 * 64 * 64 * 3 * 4  # bytes of one, of three channels
    given = {"backend": "numpy", "p": 1.0, "max_iter": 1}
    with pytest.raises(MemoryError, match=r"the job needs .* MiB .* cannot be cut into tiles: .* whole graph"):
        gr.regularize(f0, grid, solver="certified", memory=2 * edge, **given)
    result = gr.regularize(f0, grid, solver="certified", memory=3 * edge, **given)
    assert result.stop is gr.Stop.GAP
    # sweeps take no such thing
    assert gr.regularize(f0, grid, solver="jacobi", memory=2 * edge, **given).iterations == 1
    with pytest.raises(MemoryError, match="whole"):
        gr.regularize(f0, grid, solver=gr.Jacobi(accelerate=True), memory=25 * f0.nbytes, **given)


# Refused


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"p": 0.7}, "needs p >= 1, got 0.7.*jacobi"),
        ({"lam": 0.0}, "needs lam > 0 at every vertex"),
        ({"lam": np.where(np.arange(480) == 7, 0.0, 1.0)}, "needs lam > 0 at every vertex"),
        ({"tol": -1e-3}, "tol must be finite and >= 0"),
        ({"tol": np.inf}, "tol must be finite and >= 0"),
        ({"p": 1.5, "solver": gr.Certified(method="linear")}, "method='linear' is for p = 2, got p = 1.5"),
        ({"weights": gr.weights.bilateral(1.0, 0.3), "update_weights": 3}, "weights that stay"),
    ],
)
def test_wrong_problems(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        gr.regularize(noisy(), GRID, **{"p": 1.0, "solver": "certified", **ORACLE, **settings})


def test_wrong_settings() -> None:
    for tol in (-1, np.nan, np.inf):
        with pytest.raises(ValueError, match="Certified: tol must be finite and >= 0"):
            gr.Certified(tol=tol)
    for tol in ("small", None):
        with pytest.raises(TypeError, match="Certified: tol must be a number"):
            gr.Certified(tol=tol)  # type: ignore[arg-type]
    for method in ("jacobi", "", 3):
        with pytest.raises(ValueError, match='Certified: method must be "auto", "dual", "linear" or "newton"'):
            gr.Certified(method=method)  # type: ignore[arg-type]
    assert isinstance(gr.Certified(), Solver)
