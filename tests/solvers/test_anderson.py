"""Accelerated sweeps: the energy never rises, the limit is the same, and it takes far fewer of them."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gpureg as gr
from gpureg.backends.numpy import scalars

ORACLE = {"backend": "numpy", "dtype": np.float64}
FAST = gr.Jacobi(accelerate=True)


def picture(shape: tuple[int, int] = (40, 40)) -> np.ndarray:
    """Two grey levels, a ramp and a disk, with noise of 0.1."""
    y, x = np.indices(shape)
    clean = np.where(x < shape[1] / 2, 0.2, 0.8) + 0.2 * y / shape[0]
    clean[(x - 12) ** 2 + (y - 20) ** 2 < 64] = 0.6
    return clean + 0.1 * cases.rng(1).standard_normal(shape)


def g0(shape: tuple[int, ...]) -> gr.GridGraph:
    return gr.GridGraph(shape, 1, "cityblock")


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_energy_never_rises(data: st.DataObject) -> None:
    """At every single iteration, for every p, gamma, norm, fidelity (0 and infinity among them) and damping.

    1e-12 is the rounding that test_mathematics.test_descent allows for the plain sweep. Where data are the minimiser
    (no edges), the energy is that of their roundings: lam n m |f|^2 u^2 <= 10 60 1e-32.
    """
    n = data.draw(st.integers(3, 30))
    graph = cases.irregular(n, 3 * n, isolated=n - 1, seed=data.draw(st.integers(0, 99)))
    f0 = cases.function(graph, 2, seed=data.draw(st.integers(0, 99)))
    kind = data.draw(st.sampled_from(["sqrt", "combinatorial", "normalized", "degree", "array"]))
    model = {
        "p": data.draw(st.sampled_from([0.05, 0.5, 1.0, 1.3, 2.0, 2.5, 3.0, 6.0])),
        "lam": data.draw(st.sampled_from([0.0, 0.01, 1.0, 10.0, cases.fidelity(graph)[:, 0]])),
        "gamma": cases.rng(5).random(graph.n_edges) if kind == "array" else kind,
        "norm": data.draw(st.sampled_from(["vertex", "edge"])),
        "coupled": data.draw(st.booleans()),
        "eps": data.draw(st.sampled_from([0.05, 1e-3])),
    }
    solver = gr.Jacobi(accelerate=True, check_every=1, damping=data.draw(st.sampled_from([None, 0.7])))
    result = gr.regularize(f0, graph, solver=solver, max_iter=40, **model, **ORACLE)
    assert np.diff(result.energy).max() <= max(1e-12 * result.energy[0], 1e-29)
    assert np.isfinite(result.value).all()


def test_a_mix_that_raises_the_energy_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """With nothing but wrong mixes it is the plain process, to the bit."""
    f0 = picture()
    model = {"p": 1, "lam": 5, "max_iter": 25, **ORACLE}
    plain = gr.regularize(f0, g0(f0.shape), **model)
    monkeypatch.setattr(scalars, "coefficients", lambda gram, products, ridge: np.full(len(products), 1e3))
    result = gr.regularize(f0, g0(f0.shape), solver=FAST, **model)
    assert np.array_equal(result.value, plain.value)
    assert np.array_equal(result.energy, plain.energy)
    assert "5 of 5 mixes rejected" in result.method  # at 8, 12, 16, 20, 24


def test_values_that_are_not_finite_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    f0 = picture()
    monkeypatch.setattr(scalars, "coefficients", lambda gram, products, ridge: np.full(len(products), np.nan))
    result = gr.regularize(f0, g0(f0.shape), p=1, lam=5, max_iter=16, solver=FAST, **ORACLE)
    assert np.isfinite(result.value).all()
    assert "3 of 3 mixes rejected" in result.method


@pytest.mark.parametrize(("p", "lam", "eps", "dtype", "factor"), [
    (1.0, 14.0, 1e-3, "float64", 5), (1.0, 14.0, 1e-3, "float32", 5), (1.5, 4.0, 1e-3, "float64", 2),
    (2.0, 0.1, None, "float64", 4), (0.7, 20.0, 1e-2, "float64", 4),
])  # fmt: skip
def test_it_takes_far_fewer_sweeps(p: float, lam: float, eps: float | None, dtype: str, factor: int) -> None:
    """To a distance of 1e-4 of |f* - f0|; `factor` times as many plain sweeps are farther away.

    In float32 1e-3: an energy is above the least by lam/2 |f - f*|^2 at least, which at 1e-4 is 5e-9 of it here, less
    than its rounding, so that which mixes are kept is up to chance. For p < 1 the limit is the accelerated one, here
    that of the plain process too.
    """
    goal = 1e-4 if dtype == "float64" else 1e-3
    f0, grid = picture(), g0((40, 40))
    model = {"p": p, "lam": lam, "eps": eps, "backend": "numpy"}
    exact = gr.regularize(
        f0, grid, solver=gr.Jacobi(accelerate=True, stop="gradient", tol=1e-9), max_iter=3000, dtype=float, **model
    )
    assert exact.stop is gr.Stop.GRADIENT
    size = np.linalg.norm(exact.value - f0)
    if p >= 1:  # the certificate says that this is the minimiser
        assert exact.error_bound is not None
        assert exact.error_bound < 1e-5 * size

    def distance(value: np.ndarray) -> float:
        return float(np.linalg.norm(value.reshape(f0.shape) - exact.value) / size)

    def close(check: gr.Check) -> bool:
        return distance(check.value()) <= goal

    solver = gr.Jacobi(accelerate=True, check_every=1)
    fast = gr.regularize(f0, grid, solver=solver, max_iter=1000, dtype=dtype, callback=close, **model)
    assert fast.stop is gr.Stop.CALLBACK
    plain = gr.regularize(f0, grid, max_iter=factor * fast.iterations, dtype=dtype, **model)
    assert distance(plain.value) > goal
    if p < 1:
        more = gr.regularize(f0, grid, max_iter=4000, dtype=dtype, **model)
        assert distance(more.value) < goal


@pytest.mark.parametrize("p", [0.7, 1.0, 2.0, 3.0])
def test_devices_agree(device: str, p: float) -> None:
    """Some vertices pinned, others without data: the same limit on every device, and what is pinned to the bit."""
    grid = cases.graph("small grid")
    f0 = cases.function(grid).astype(np.float32)
    lam = cases.fidelity(grid)[:, 0] + 0.1
    lam[5:15] = 0
    model = {"p": p, "lam": lam, "eps": 0.05, "max_iter": 300}
    found = gr.regularize(f0, grid, solver=FAST, backend=device, **model)
    assert np.array_equal(found.value[lam == np.inf], f0[lam == np.inf])
    oracle = gr.regularize(f0, grid, solver=FAST, **{**model, **ORACLE})
    # Both have converged, so that rounding of a sweep (TOLERANCES) is magnified by 1/(1 - rate): measured below 1e-5.
    assert np.abs(found.value - oracle.value).max() <= cases.TOLERANCES["float32"]
    assert found.energy[-1] == pytest.approx(oracle.energy[-1], rel=10 * cases.TOLERANCES["float32"])


def test_no_data_at_all_on_a_bipartite_graph() -> None:
    """lam = 0 on G_0 is damped lazily, and ends in a constant per component, the degree-weighted mean at p = 2."""
    f0, grid = picture((12, 9)), g0((12, 9))
    result = gr.regularize(f0, grid, p=2, lam=0, max_iter=400, solver=FAST, **ORACLE)
    degree = np.full(grid.shape, 4.0)
    degree[[0, -1]] -= 1
    degree[:, [0, -1]] -= 1
    assert "lazy" in result.method
    assert np.ptp(result.value) < 1e-9
    # a mix keeps the weighted mean, as its coefficients sum to 1
    assert result.value.mean() == pytest.approx((degree * f0).sum() / degree.sum(), rel=1e-12)


def test_an_interruption_keeps_the_last_whole_iterate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pressed in the middle of the third mix, the sixteenth iterate."""
    f0 = picture()
    model = {"p": 1, "lam": 5, "solver": FAST, **ORACLE}
    fifteen = gr.regularize(f0, g0(f0.shape), max_iter=15, **model)
    found, calls = scalars.coefficients, []

    def pressed(gram: np.ndarray, products: np.ndarray, ridge: float) -> np.ndarray:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return found(gram, products, ridge)

    monkeypatch.setattr(scalars, "coefficients", pressed)
    with pytest.raises(gr.Interrupted) as caught:
        gr.regularize(f0, g0(f0.shape), max_iter=100, **model)
    assert caught.value.result.iterations == 15
    assert np.array_equal(caught.value.result.value, fifteen.value)


def test_new_weights_begin_it_anew() -> None:
    f0, weights = picture(), gr.weights.bilateral(1.5, 0.3)
    model = {"p": 1, "lam": 2, "eps": 0.01, "solver": FAST, **ORACLE}
    twice = gr.regularize(f0, g0(f0.shape), weights=weights, update_weights=13, max_iter=26, **model)
    first = gr.regularize(f0, g0(f0.shape), weights=weights, max_iter=13, **model).value
    anew = gr.weights.guided(weights, first.ravel())
    second = gr.regularize(f0, g0(f0.shape), weights=anew, initial=first, max_iter=13, **model)
    assert np.array_equal(twice.value, second.value)


def test_coefficients_are_those_of_least_squares() -> None:
    """Also where a column is 0 or there twice, and where lengths differ by 1e12."""
    lengths = np.array([1, 1e-6, 1e6, 1])
    R, r = cases.rng(3).standard_normal((50, 4)), cases.rng(5).standard_normal(50)
    exact = np.linalg.lstsq(R, r, rcond=None)[0] / lengths
    R = R * lengths
    # of the ridge: 4e-12 times the condition number of the normal equations, some tens
    np.testing.assert_allclose(scalars.coefficients(R.T @ R, R.T @ r, 1e-12), exact, rtol=1e-9)
    wider = np.column_stack([R, R[:, 0], np.zeros(50)])
    found = scalars.coefficients(wider.T @ wider, wider.T @ r, 1e-12)
    assert found[-1] == 0
    np.testing.assert_allclose(wider @ found, R @ exact, rtol=0, atol=1e-9)


def test_wrong_settings_and_tiles() -> None:
    with pytest.raises(TypeError, match="accelerate must be True or False, got 'yes'"):
        gr.Jacobi(accelerate="yes")
    with pytest.raises(MemoryError, match=r"mix iterates of the whole \(give accelerate=False\)"):
        gr.regularize(picture(), g0((40, 40)), p=1, solver=FAST, memory=20_000, backend="numpy")
