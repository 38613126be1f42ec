"""Paths: many lam or p on the same data, each run from where the last one ended."""

from __future__ import annotations

from typing import Any

import cases
import numpy as np
import pytest
from test_certified import noisy, ring

import gpureg as gr
from gpureg import tuning

ORACLE: dict[str, Any] = {"backend": "numpy", "dtype": "float64"}
GRID = gr.GridGraph((24, 20), 1, "cityblock")
LAM = (16.0, 8.0, 4.0, 2.0)


def cold(f0, graph, lam: float, p: float, **settings) -> gr.Result:
    return gr.regularize(f0, graph, lam=lam, p=p, **{**ORACLE, **settings})


def apart(path, single) -> list[tuple[float, float]]:
    """How far runs are from single ones, and how far their bounds reach, where they are too far."""
    far = [
        (float(np.linalg.norm(a.value - b.value)), a.error_bound + b.error_bound)
        for a, b in zip(path, single, strict=True)
    ]
    return [(distance, bound) for distance, bound in far if not distance <= bound]


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("p", [1.0, 1.5, 2.0, 3.0])
def test_along_lam(p: float, norm: str) -> None:
    """The minimisers of single runs, within the bounds of either."""
    settings = {"solver": "certified", "norm": norm, "tol": 1e-6, **ORACLE}
    path = gr.regularization_path(noisy(), GRID, lam=LAM, p=p, **settings)
    assert path.parameter == "lam"
    assert path.values.tolist() == list(LAM)
    assert len(path) == 4
    assert [result.stop for result in path] == [gr.Stop.GAP] * 4
    assert apart(path, [cold(noisy(), GRID, lam, p, **settings) for lam in LAM]) == []
    # less fidelity, further from the data
    assert (np.diff([np.linalg.norm(result.value - noisy()) for result in path]) > 0).all()
    assert path[1] is path.results[1]


def test_along_p() -> None:
    """Through p = 2 and down to 1, whose dual variable must be one of p = 1."""
    f0, degrees = noisy(), [3.0, 2.0, 1.5, 1.2, 1.0, 1.5]
    path = gr.regularization_path(f0, GRID, lam=4.0, p=degrees, solver="certified", tol=1e-6, **ORACLE)
    assert path.parameter == "p"
    assert [result.stop for result in path] == [gr.Stop.GAP] * 6
    assert apart(path, [cold(f0, GRID, 4.0, p, solver="certified", tol=1e-6) for p in degrees]) == []


@pytest.mark.parametrize("p", [1.0, 1.5])
def test_a_warm_start_pays(device: str, p: float) -> None:
    """Fewer iterations in all."""
    graph = ring()
    f0 = cases.function(graph, 2)
    many = np.geomspace(20, 5, 8).tolist()
    settings = {"solver": "certified", "tol": 1e-4, "backend": device}
    path = gr.regularization_path(f0, graph, lam=many, p=p, **settings)
    single = [gr.regularize(f0, graph, lam=lam, p=p, **settings) for lam in many]
    assert apart(path, single) == []
    # measured: 210 of 361 for p = 1, 80 of 120 for p = 1.5
    assert sum(result.iterations for result in path) < 0.8 * sum(result.iterations for result in single)


@pytest.mark.parametrize("gamma", ["sqrt", "normalized"])
def test_weights_of_the_data(gamma: str) -> None:
    """Weights are those of f0, in every run; and gamma's change of variable goes along with lam."""
    weights = gr.weights.bilateral(2.0, 0.5)
    settings = {"weights": weights, "gamma": gamma, "solver": "certified", "tol": 1e-6, **ORACLE}
    grid = gr.GridGraph((24, 20), 2)
    path = gr.regularization_path(noisy(), grid, lam=[4, 1], p=1.5, **settings)
    assert apart(path, [cold(noisy(), grid, lam, 1.5, **settings) for lam in (4.0, 1.0)]) == []


def test_below_1() -> None:
    """With the paper's process: a local minimum for p = 0.5, and following p down from 1 leads to one as low."""
    f0, degrees = noisy(), [1.0, 0.8, 0.65, 0.5]
    settings = {"lam": 8.0, "eps": 0.01, "max_iter": 3000, "tol": 1e-7}
    path = gr.regularization_path(f0, GRID, p=degrees, solver="jacobi", **settings, **ORACLE)
    last = path[-1]
    assert last.stop is gr.Stop.TOLERANCE
    assert last.gap is None
    # a minimum: nothing near is lower
    near = [last.value + 1e-3 * cases.rng(seed).standard_normal(f0.shape) for seed in (3, 5, 7)]
    energies = [cold(f0, GRID, p=0.5, initial=f, **{**settings, "max_iter": 0}).energy[0] for f in near]
    assert min(energies) > last.energy[-1]
    direct = cold(f0, GRID, p=0.5, **settings)
    assert last.energy[-1] <= direct.energy[-1]
    with pytest.raises(ValueError, match="needs p >= 1"):
        gr.regularization_path(f0, GRID, p=[1.0, 0.5], solver="certified", **ORACLE)


@pytest.mark.parametrize("p", [1.0, 2.0, 3.0])
def test_discrepancy(p: float) -> None:
    """As much is taken away as there is noise, by minimisers."""
    sigma = 0.2
    found = tuning.discrepancy(noisy(sigma=sigma), GRID, sigma, p=p, solver="certified", tol=1e-6, **ORACLE)
    assert found.result.stop is gr.Stop.GAP
    single = cold(noisy(sigma=sigma), GRID, found.lam, p, solver="certified", tol=1e-6)
    assert np.linalg.norm(single.value - found.result.value) <= single.error_bound + found.result.error_bound
    taken = np.mean((single.value - noisy(sigma=sigma)) ** 2) / sigma**2
    # 0.01 is the search's; twice the distance of the two runs from one another is the rest
    apart = 2 * (single.error_bound + found.result.error_bound) / np.linalg.norm(single.value - noisy(sigma=sigma))
    assert abs(taken - 1) <= 0.011 + apart


def test_in_tiles() -> None:
    """A job that does not fit goes through regularize, tiles and all; one that cannot says so."""
    f0, grid = cases.rng(3).random((64, 64)), gr.GridGraph((64, 64), 1, "cityblock")
    settings = {"p": 2.0, "max_iter": 5, "memory": 400_000, **ORACLE}
    path = gr.regularization_path(f0, grid, lam=[2.0, 1.0], solver="jacobi", **settings)
    assert len(path[0].energy) == 0  # tiles report none
    again = gr.regularize(f0, grid, lam=1.0, initial=path[0].value, **{**settings, "memory": None})
    assert np.array_equal(path[1].value, again.value)
    with pytest.raises(MemoryError, match="whole graph"):
        gr.regularization_path(f0, grid, lam=[2.0, 1.0], solver="certified", **settings)


def test_a_callback_sees_every_run_and_stops_one() -> None:
    seen: list[int] = []

    def look(check: gr.Check) -> bool:
        seen.append(check.iteration)
        return len(seen) == 2

    path = gr.regularization_path(noisy(), GRID, lam=[2.0, 1.0], max_iter=20, callback=look, progress=True, **ORACLE)
    assert [result.stop for result in path] == [gr.Stop.CALLBACK, gr.Stop.MAX_ITER]
    assert seen == [0, 10, 0, 10, 20]


def test_wrong_paths() -> None:
    f0 = noisy()
    with pytest.raises(ValueError, match="must be a sequence of values, got neither"):
        gr.regularization_path(f0, GRID)
    with pytest.raises(ValueError, match="must be a sequence of values, got both"):
        gr.regularization_path(f0, GRID, lam=[1, 2], p=[1, 2])
    with pytest.raises(ValueError, match="must be a list of numbers, got an array of shape"):
        gr.regularization_path(f0, GRID, lam=np.ones((24, 20)))
    with pytest.raises(TypeError, match="unexpected keyword argument 'initial'"):
        gr.regularization_path(f0, GRID, lam=[1.0], initial=f0)
    with pytest.raises(TypeError, match="regularization_path: 'lams' is called lam now"):
        gr.regularization_path(f0, GRID, lams=[1.0])
    with pytest.raises(TypeError, match="lam must be a list of numbers"):
        gr.regularization_path(f0, GRID, lam=["1"])
    with pytest.raises(TypeError, match="progress must be True or False, got 1"):
        gr.regularization_path(f0, GRID, lam=[1.0], progress=1)
    with pytest.raises(ValueError, match="needs p >= 1"):
        gr.regularization_path(f0, GRID, p=[1.0, 0.9], solver="certified", **ORACLE)
    with pytest.raises(ValueError, match="max_iter must be >= 0"):
        gr.regularization_path(f0, GRID, lam=[1.0], max_iter=-1)
    with pytest.raises(ValueError, match="tol must be finite and >= 0"):
        gr.regularization_path(f0, GRID, lam=[1.0], tol=-1.0)
    with pytest.raises(ValueError, match="dtype must be float32 or float64"):
        gr.regularization_path(f0, GRID, lam=[1.0], dtype="int32")
    assert len(gr.regularization_path(f0, GRID, lam=[], **ORACLE)) == 0
