"""Section 3 of the paper: the laws that both processes obey, for every gamma and both norms, and weights on the way.

Equation numbers are the paper's; E1 to E24 are the errata of docs/mathematics.md.
"""

from __future__ import annotations

import functools
import itertools
import math
import warnings

import cases
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from test_closed_forms import solve
from test_mathematics import NAMES, ORACLE, both_norms, ops

import gpureg as gr


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_laws(data: st.DataObject) -> None:
    """Scale, shift, permutation, maximum principle, rotation of the range, on random graphs, weights and functions."""
    graph, f0 = draw(data)
    n = graph.n_vertices
    p, norm = data.draw(st.sampled_from([0.5, 1.0, 1.5, 2.0, 3.0, 6.0])), data.draw(st.sampled_from(["vertex", "edge"]))
    lam = data.draw(st.sampled_from([0.0, 0.1, 1.0, 10.0]))
    given = {"p": p, "lam": lam, "eps": 0.1, "norm": norm, "max_iter": 12, **ORACLE}
    f = gr.regularize(f0, graph, **given).value
    # 12 sweeps of rounding (1e-13 each), magnified by (range/eps)^|p - 2| at most: 1e4 here; measured below 1e-11
    close = {"rtol": 0, "atol": 1e-9}
    c = 7.0
    scaled = gr.regularize(c * f0, graph, **{**given, "lam": lam * c ** (p - 2), "eps": c * 0.1}).value
    assert_allclose(scaled, c * f, rtol=0, atol=c * 1e-9)
    assert_allclose(gr.regularize(f0 + 3, graph, **given).value, f + 3, **close)
    assert (f.max(axis=0) <= f0.max(axis=0) + 1e-12).all()
    assert (f.min(axis=0) >= f0.min(axis=0) - 1e-12).all()
    order = np.array(data.draw(st.permutations(range(n))))
    place = np.argsort(order)
    W = graph.to_scipy()
    moved = gr.Graph.from_scipy(W[order][:, order])
    assert_allclose(gr.regularize(f0[order], moved, **given).value[place], f, **close)
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    assert_allclose(gr.regularize(f0 @ turn, graph, **given).value, f @ turn, **close)


def draw(data: st.DataObject) -> tuple[gr.Graph, np.ndarray]:
    """A random graph of 2 to 12 vertices, with weights some of which are 0, and a function of two channels."""
    n = data.draw(st.integers(2, 12))
    pairs = list(itertools.combinations(range(n), 2))
    kept = data.draw(st.lists(st.sampled_from(pairs), min_size=1, max_size=3 * n, unique=True))
    weight = st.sampled_from([0.0, 0.1, 0.5, 1.0, 2.0, 30.0])
    weights = data.draw(st.lists(weight, min_size=len(kept), max_size=len(kept)))
    values = st.integers(-20, 20)
    flat = data.draw(st.lists(values, min_size=2 * n, max_size=2 * n))
    return gr.Graph.from_edges(kept, weights, n_vertices=n), np.array(flat, float).reshape(n, 2) / 10


@both_norms
@pytest.mark.parametrize("coupled", [True, False])
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_descent(data: st.DataObject, norm: str, coupled: bool) -> None:
    """No sweep raises the smoothed energy: a theorem for 0 < p <= 2, any gamma and norm; watched over for p > 2.

    Where nothing is left but rounding, that may rise: each value by the last digit of the largest, which the fidelity
    squares.
    """
    graph, f0 = draw(data)
    p = data.draw(st.sampled_from([0.05, 0.5, 1.0, 1.3, 2.0, 2.5, 3.0, 6.0, 10.0]))
    kind = data.draw(st.sampled_from([*NAMES, "array"]))
    gamma = cases.rng(data.draw(st.integers(0, 99))).random(graph.n_edges) if kind == "array" else kind
    lam = data.draw(st.sampled_from([0.0, 0.01, 1.0, 10.0]))
    result = gr.regularize(
        f0, graph, p=p, lam=lam, eps=0.05, gamma=gamma, norm=norm, coupled=coupled, max_iter=25,
        solver=gr.Jacobi(check_every=1), **ORACLE,
    )  # fmt: skip
    rounding = 0.5 * lam * f0.size * (2.0**-52 * np.abs(f0).max(initial=0)) ** 2
    assert np.diff(result.energy).max() <= 1e-12 * max(result.energy[0], 1e-20) + rounding


def test_damping_alone_is_not_enough_beyond_2() -> None:
    """1/(p - 1) by itself can raise the energy; the default then shortens the sweep, and says so."""
    generator, raised, silent = cases.rng(1), [], []
    for _ in range(100):
        n = int(generator.integers(4, 9))
        pairs = np.array(list(itertools.combinations(range(n), 2)))
        kept = pairs[generator.random(len(pairs)) < 0.5]
        graph = gr.Graph.from_edges(kept, generator.choice([0.1, 1.0, 30.0], len(kept)), n_vertices=n)
        f0 = generator.integers(-20, 20, (n, 2)) / 10
        given = {"p": 3, "lam": 0, "eps": 0.05, "norm": "edge", "max_iter": 15, **ORACLE}
        plain = gr.regularize(f0, graph, solver=gr.Jacobi(damping=0.5, check_every=1), **given)
        safe = gr.regularize(f0, graph, solver=gr.Jacobi(check_every=1), **given)
        raised.append(np.diff(safe.energy).max() - 1e-12 * max(safe.energy[0], 1e-20))
        if np.diff(plain.energy).max() > 1e-6 * plain.energy[0]:
            silent.append("shortened" not in safe.method)
    assert max(raised) <= 0
    assert silent and not any(silent)


@both_norms
@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_descent_of_euler(data: st.DataObject, norm: str) -> None:
    """The step that Euler takes by itself never raises the energy, and half the bound keeps the range."""
    graph, f0 = draw(data)
    p = data.draw(st.sampled_from([0.5, 1.0, 2.0, 2.5, 4.0]))
    gamma = data.draw(st.sampled_from(["sqrt", "normalized", "array"]))
    if gamma == "array":
        gamma = cases.rng(3).random(graph.n_edges)
    lam = data.draw(st.sampled_from([0.0, 1.0, 10.0]))
    result = gr.regularize(
        f0, graph, p=p, lam=lam, eps=0.5, gamma=gamma, norm=norm, max_iter=25,
        solver=gr.Euler(check_every=1), **ORACLE,
    )  # fmt: skip
    assert np.diff(result.energy).max() <= 1e-12 * max(result.energy[0], 1e-20)
    if isinstance(gamma, str) and gamma == "sqrt":
        assert result.value.max() <= f0.max() + 1e-12
        assert result.value.min() >= f0.min() - 1e-12


@given(st.data())
@settings(max_examples=30, deadline=None)
def test_edge_norm_is_vertex_norm_of_twice_lam_at_p_2(data: st.DataObject) -> None:
    """E12: (30) is half of (20) at p = 2, so aniso(lam) = iso(2 lam), sweep by sweep."""
    graph, f0 = draw(data)
    kind = data.draw(st.sampled_from([*NAMES, "array"]))
    gamma = cases.rng(5).random(graph.n_edges) if kind == "array" else kind
    given = {"p": 2, "gamma": gamma, "max_iter": 9, **ORACLE}
    edge = gr.regularize(f0, graph, lam=0.6, norm="edge", **given)
    vertex = gr.regularize(f0, graph, lam=1.2, **given)
    assert_allclose(edge.value, vertex.value, rtol=0, atol=1e-13)
    assert edge.energy == pytest.approx(vertex.energy / 2, rel=1e-12)


@pytest.mark.parametrize("p", (1.0, 2.0))
def test_no_swinging_by_default(device: str, p: float) -> None:
    """The checkerboard on G_0 without data changes places for ever, on request only."""
    grid = gr.GridGraph((8, 10), 1, "cityblock")
    board = (np.indices((8, 10)).sum(axis=0) % 2).astype(float)
    given = {"p": p, "lam": 0, "eps": 0.1, "max_iter": 31, "backend": device}
    plain = gr.regularize(board, grid, solver=gr.Jacobi(damping=1), **given)
    assert_allclose(plain.value, 1 - board, atol=1e-6)
    assert "damped" not in plain.method
    lazy = gr.regularize(board, grid, **given)
    assert np.ptp(lazy.value) < 0.05
    assert "lazy" in lazy.method
    assert "swing" in lazy.method


def swinging() -> dict[str, tuple[gr.Graph | gr.GridGraph, object, dict[str, object], bool]]:
    """A graph, lam, what else `regularize` takes, and whether the plain sweep swings there."""
    four, eight = gr.GridGraph((6, 7), 1, "cityblock"), gr.GridGraph((6, 7))
    one = np.zeros((6, 7))
    one[2, 3] = 0.01
    pinned = np.where(one > 0, np.inf, 0)
    halves = np.ones((6, 7), bool)
    halves[:, 3] = False  # two parts; data on one of them alone
    left = np.zeros((6, 7))
    left[0, 0] = 1
    cut = gr.GridGraph((6, 7), 1, "cityblock", mask=halves)
    diagonal = np.zeros((eight.n_edges,))
    stored = eight.to_graph()
    step = np.abs(np.diff(stored.positions[np.stack([stored.edge_rows(), stored.indices])], axis=0)[0]).sum(axis=1)
    diagonal[step == 1] = 1  # the diagonal edges have weight 0: bipartite again
    return {
        "4 neighbours": (four, 0, {}, True),
        "8 neighbours": (eight, 0, {}, False),
        "data at one pixel": (four, one, {}, False),
        "one pinned": (four, pinned, {}, False),
        "data everywhere": (four, 0.1, {}, False),
        "data on one of two parts": (cut, left, {}, True),
        "diagonal weights 0": (eight, 0, {"weights": diagonal}, True),
        "diagonal gamma 0": (eight, 0, {"gamma": diagonal}, True),
        "stored": (four.to_graph(), 0, {}, True),
        "odd cycle": (gr.Graph.from_edges([[0, 1], [1, 2], [0, 2]]), 0, {}, False),
        "one edge of weight 0": (gr.Graph.from_edges([[0, 1]], [0.0]), 0, {}, False),
        "no edge": (gr.Graph([0, 0, 0], []), 0, {}, False),
    }


BOARD = (np.indices((6, 7)).sum(axis=0) % 2).astype(float)
SWINGING = swinging()


@pytest.mark.parametrize("name", SWINGING)
def test_lazy_only_where_it_would_swing(name: str) -> None:
    """An odd cycle, one pixel of data, a pinned one, or a diagonal neighbour, and the plain sweep is taken."""
    graph, lam, extra, lazy = SWINGING[name]
    f0 = BOARD if isinstance(graph, gr.GridGraph) else np.arange(graph.n_vertices, dtype=float)
    result = gr.regularize(f0, graph, lam=lam, max_iter=3, **extra, **ORACLE)
    assert ("lazy" in result.method) == lazy, result.method


def test_damped_beyond_2_instead() -> None:
    graph = gr.GridGraph((6, 7), 1, "cityblock")
    assert "1/(p - 1)" in gr.regularize(BOARD, graph, p=3, lam=0, max_iter=1, **ORACLE).method


@pytest.mark.parametrize("solver", ["jacobi", "euler"])
def test_all_weights_underflowed(device: str, solver: str) -> None:
    """No weight is left: 0/0 is defined as the data."""
    f0 = np.arange(12.0).reshape(3, 4) * 1e3
    weights = gr.weights.bilateral(np.inf, 1.0)
    result = gr.regularize(f0, gr.GridGraph((3, 4)), p=1, lam=0, weights=weights, solver=solver, backend=device)
    assert np.array_equal(result.value, f0)


# Explicit Euler


@both_norms
@pytest.mark.parametrize("p", (1.0, 1.5, 2.0, 3.0))
def test_euler_and_jacobi_meet(norm: str, p: float) -> None:
    graph = cases.irregular(17, 60, isolated=5)
    f0 = cases.function(graph, 2)
    given = {"p": p, "lam": 1.3, "eps": 0.2, "norm": norm}
    assert_allclose(solve(f0, graph, solver="euler", **given), solve(f0, graph, **given), atol=1e-9)


@pytest.mark.parametrize("gamma", NAMES)
def test_euler_is_equation_24(device: str, gamma: str) -> None:
    """f + tau (lam (f0 - f) - Laplacian f), also where gamma is a change of variable: tau is that of f."""
    graph = cases.irregular(17, 60, isolated=5)
    f0, tau, lam = cases.function(graph, 2), 0.01, cases.fidelity(graph)[:, 0]
    settings = {"gamma": gamma, **ORACLE}
    f = gr.regularize(f0, graph, p=2, lam=1.0, max_iter=5, **settings).value
    result = gr.regularize(
        f0,
        graph,
        p=1.5,
        lam=lam,
        eps=0.1,
        initial=f,
        gamma=gamma,
        max_iter=1,
        solver=gr.Euler(step=tau),
        backend=device,
    )
    pinned = np.isinf(lam)[:, None]
    push = np.where(pinned, 0, lam[:, None]) * (f0 - f)
    expected = f + tau * (push - ops.p_laplacian(f, graph, 1.5, eps=0.1, **settings))
    assert_allclose(result.value, np.where(pinned, f0, expected), atol=2e-6)
    assert "Euler" in result.method
    assert "0.01" in result.method


def test_unstable_steps() -> None:
    """p = 2: unstable iff tau > 2/(lam + 2 lambda_max(L)) (E24); the error names the bound, and just below it works."""
    grid = gr.GridGraph((9, 9), 1, "cityblock")
    f0 = cases.rng(3).random((9, 9))
    top = 4 + 4 * math.cos(math.pi / 9)
    limit = 2 / (0.5 + 2 * top)
    with pytest.raises(ValueError, match=r"step = 0\.2 is unstable: beyond 2/mu = 0\.12"):
        gr.regularize(f0, grid, lam=0.5, solver=gr.Euler(step=0.2), **ORACLE)
    with pytest.raises(ValueError, match="unstable"):
        gr.regularize(f0, grid, lam=0.5, solver=gr.Euler(step=1.01 * limit), **ORACLE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        near = gr.regularize(f0, grid, lam=0.5, solver=gr.Euler(0.999 * limit, check_every=1), max_iter=50, **ORACLE)
    assert np.diff(near.energy).max() <= 0
    with pytest.warns(RuntimeWarning, match=r"beyond the bound .* for p = 1 and eps = 0\.01"):
        gr.regularize(f0, grid, p=1, lam=0.5, eps=0.01, solver=gr.Euler(step=0.1), max_iter=2, **ORACLE)


@pytest.mark.parametrize(
    ("step", "error", "said"),
    [
        *((step, ValueError, "step must be finite and > 0") for step in (0, -1, math.inf, math.nan)),
        ("fast", TypeError, "step must be a number"),
    ],
)
def test_steps_that_are_none(step: object, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        gr.Euler(step=step)


@pytest.mark.parametrize("p", (1.0, 2.0, 3.0))
def test_sum_under_euler(p: float) -> None:
    """E23: lam = 0 and gamma symmetric: (24) keeps the sum of f at every step (Property 1), (25) does not."""
    graph = cases.irregular(17, 60, isolated=5)
    f0 = cases.function(graph)
    given = {"p": p, "lam": 0, "eps": 0.1, "max_iter": 7, **ORACLE}
    assert gr.regularize(f0, graph, solver="euler", **given).value.sum() == pytest.approx(f0.sum(), abs=1e-13)
    assert abs(gr.regularize(f0, graph, **given).value.sum() - f0.sum()) > 1e-3


# Weights on the way (footnote 1)


@pytest.mark.parametrize("gamma", ["sqrt", "normalized"])
def test_weights_computed_anew(device: str, gamma: str) -> None:
    """Every k iterations the weights come from the current f: the same as k iterations at a time by hand."""
    grid, f0 = gr.GridGraph((9, 11)), cases.rng(9).random((9, 11))
    weights = gr.weights.patch(1, 0.8)
    given = {"p": 1.5, "lam": 1.0, "eps": 0.1, "gamma": gamma, "backend": device}
    result = gr.regularize(f0, grid, weights=weights, update_weights=3, max_iter=8, **given)
    f, left = f0, 8
    while left:
        guide = f.reshape(-1).astype(np.float64)
        steps = min(3, left)
        f = gr.regularize(f0, grid, weights=gr.weights.guided(weights, guide), initial=f, max_iter=steps, **given).value
        left -= steps
    assert_allclose(result.value, f, atol=1e-5)
    assert np.abs(result.value - gr.regularize(f0, grid, weights=weights, max_iter=8, **given).value).max() > 1e-3
    assert result.iterations == 8
    assert "every 3" in result.method
    assert result.checks.tolist() == [0, 8]


# Real graphs


STREETS = {"p": 1.0, "lam": 2.0, "eps": 0.05, "max_iter": 40}


@functools.cache
def streets(path):
    """The graph, a smooth signal, a noisy one, and the oracle's result: once for all devices."""
    from scipy.io import mmread

    graph = gr.Graph.from_scipy(mmread(path).tocsr())
    assert graph.n_vertices == 114_599
    n = graph.n_vertices
    # smooth: the sum of a few far corners' influence, by diffusing random values for long
    clean = gr.regularize(
        cases.rng(3).standard_normal(n), graph, p=2, lam=0, max_iter=300, solver=gr.Jacobi(damping=0.5), **ORACLE
    ).value
    clean /= clean.std()
    noisy = clean + 0.5 * cases.rng(5).standard_normal(n)
    return graph, clean, noisy, gr.regularize(noisy, graph, **STREETS, **ORACLE).value


def test_luxembourg_streets(device: str, data_folder) -> None:
    """A noisy signal on 114,599 street corners denoised; all devices agree with the oracle, and it is better."""
    graph, clean, noisy, exact = streets(data_folder / "graphs" / "luxembourg_osm.mtx.gz")
    found = gr.regularize(noisy, graph, backend=device, **STREETS).value
    assert np.abs(found - exact).max() <= cases.TOLERANCES["float32"] * np.abs(noisy).max()
    assert np.std(found - clean) < 0.6 * np.std(noisy - clean)
