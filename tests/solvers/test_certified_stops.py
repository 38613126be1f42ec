"""When the certified solver stops and says why; what a caller sees of it on the way."""

from __future__ import annotations

import functools

import cases
import numpy as np
import pytest
from test_certified import fidelity, noisy, solve
from test_certified_use import ALL, GRID, by_every_method, methods, within

import gpureg as gr


@functools.cache
def sharp(p: float, lam: float, tol: float = 1e-6) -> gr.Result:
    """The minimiser for `noisy`."""
    return solve(noisy(), GRID, p=p, lam=lam, tol=tol)


# Stopping


@functools.cache
def rounded(p: float) -> tuple[np.ndarray, gr.Result]:
    """Data that float32 holds, and the minimiser."""
    f0 = noisy().astype(np.float32)
    return f0, solve(f0, GRID, "newton", p=p, lam=fidelity(p), tol=1e-10)


@by_every_method(1.0, 1.5, 2.0, 6.0)
def test_precision_is_said(device: str, p: float, method: str) -> None:
    """1e-12 of the energy is beyond float32: a bounded number of iterations, and a gap that is true."""
    f0, exact = rounded(p)
    solver = gr.Certified(tol=1e-12, method=method)
    result = gr.regularize(f0, GRID, p=p, lam=fidelity(p), solver=solver, backend=device)
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
    """Powers of one far sample that overflow; a lam or data of any size are computed in units that fit."""
    far = noisy()
    far[5, 6] = 1e30
    with pytest.raises(FloatingPointError, match="float64"):
        gr.regularize(far, GRID, p=8, lam=1, solver="certified", backend="numpy", dtype=np.float32)
    small = gr.regularize(noisy() * 1e-3, GRID, p=8, lam=1e-18, solver="certified", backend="numpy")
    assert within(small, solve(noisy() * 1e-3, GRID, p=8, lam=1e-18))


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


@by_every_method(1.0, 2.0, 3.0)
def test_no_iterations(p: float, method: str) -> None:
    """Energy and gap of the data."""
    exact = sharp(p, 4.0)
    result = solve(noisy(), GRID, method, p=p, lam=4.0, max_iter=0)
    assert result.stop is gr.Stop.MAX_ITER
    assert result.iterations == 0
    assert np.array_equal(result.value, noisy())
    assert result.energy[0] - exact.energy[-1] <= result.gap
    assert within(result, exact)


@pytest.mark.parametrize(
    ("p", "method"), [(p, method) for p in (1.0, 1.5, 2.0, 3.0) for method in methods(p) if method != "auto"]
)
def test_initial(p: float, method: str) -> None:
    """The minimiser, but for a little, is a better start than the data; any start has the same end."""
    exact = sharp(p, 4.0, 1e-9)
    near = exact.value + 1e-4 * cases.rng(3).standard_normal((24, 20))
    far = cases.rng(5).standard_normal((24, 20))
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
