"""The absolutely minimal Lipschitz extension, p = infinity: closed forms, plain sweeps, all pairs, invariances."""

import itertools
import math
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label, maximum_filter, minimum_filter
from scipy.sparse.csgraph import dijkstra

import gpureg as gr
from gpureg.solvers.lipschitz import extend
from gpureg.solvers.slopes import Slopes, least_constant

EPS = np.finfo(float).eps


def extended(f0, graph, known, **options):
    """The result of p = infinity with the known values pinned."""
    lam = np.where(known, np.inf, 0.0)
    run = {"p": math.inf, "norm": "edge", "solver": "certified", "backend": "numpy"}
    return gr.regularize(f0, graph, lam=lam, **run | options)


def drawn(seed, n=12, extra=8, weighted=True):
    """A connected graph, its dense gamma, values and which of them are known."""
    rng = np.random.default_rng(seed)
    pairs = {(int(rng.integers(k)), k) for k in range(1, n)}
    pairs |= {tuple(sorted(map(int, rng.choice(n, 2, replace=False)))) for _ in range(extra)}
    edges = np.array(sorted(pairs))
    w = rng.uniform(0.1, 3, len(edges)) if weighted else np.ones(len(edges))
    gamma = np.zeros((n, n))
    gamma[edges[:, 0], edges[:, 1]] = gamma[edges[:, 1], edges[:, 0]] = np.sqrt(w)
    known = np.zeros(n, bool)
    known[rng.choice(n, 4, replace=False)] = True
    values = rng.normal(size=n) if weighted else rng.integers(0, 3, n).astype(float)
    return gr.Graph.from_edges(edges, w, n_vertices=n), gamma, values, known


def imbalance(f, gamma, known):
    """The largest difference of the steepest slopes up and down at an unknown vertex."""
    d = gamma * (f[None, :] - f[:, None])
    return np.abs(d.max(axis=1) - (-d).max(axis=1))[~known].max()


def all_pairs(values, gamma, known):
    """The least Lipschitz constant from all pairs of known vertices."""
    with np.errstate(divide="ignore"):
        length = dijkstra(np.where(gamma > 0, 1 / gamma, 0))
    at = np.flatnonzero(known)
    return max(abs(values[a] - values[b]) / length[a, b] for a, b in itertools.combinations(at, 2))


def test_a_path_is_linear_between_its_data():
    lengths = np.array([1.0, 2.0, 0.5, 4.0, 1.0, 1.0])
    graph = gr.Graph.from_edges([[k, k + 1] for k in range(6)], lengths**-2)
    known = np.array([1, 0, 0, 1, 0, 0, 1], bool)
    f0 = np.array([2.0, 9, 9, -5, 9, 9, 1])
    at = np.concatenate([[0], np.cumsum(lengths)])
    result = extended(f0, graph, known)
    # rounding of some sums and quotients of values up to 5
    np.testing.assert_allclose(result.value, np.interp(at, at[known], f0[known]), atol=100 * EPS)
    assert result.energy[-1] == pytest.approx(2.0, rel=10 * EPS)
    assert 0 <= result.gap < 1e-13
    assert result.stop is gr.Stop.BALANCED
    assert "No error bound" in result.error_bound_note and result.error_bound is None


def test_a_star_is_as_the_steepest_pair_says():
    # the centre lies on the shortest path of the steepest pair, (4 + 1)/(1 + 2)
    graph = gr.Graph.from_edges([[0, 1], [0, 2], [0, 3]], [1.0, 0.25, 1.0])
    result = extended([0.0, 4, -1, 2], graph, np.array([0, 1, 1, 1], bool))
    assert result.value[0] == pytest.approx(4 - 5 / 3, rel=10 * EPS)
    assert result.energy[-1] == pytest.approx(5 / 3, rel=10 * EPS)


def test_a_branch_of_a_tree_without_data_is_constant():
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [1, 3], [3, 4], [3, 5]])
    result = extended([0.0, 7, 2, 7, 7, 7], graph, np.array([1, 0, 1, 0, 0, 0], bool))
    np.testing.assert_allclose(result.value, [0, 1, 2, 1, 1, 1], atol=10 * EPS)


@pytest.mark.parametrize("seed", range(12))
def test_small_graphs_against_plain_sweeps_and_all_pairs(seed):
    graph, gamma, values, known = drawn(seed, weighted=seed % 3 > 0)
    result = extended(values, graph, known)
    f = np.where(known, values, values[known].mean())
    for _ in range(20_000):
        d = gamma * (f[None, :] - f[:, None])
        up = np.where(gamma > 0, d, -np.inf).argmax(axis=1)
        down = np.where(gamma > 0, d, np.inf).argmin(axis=1)
        rows = np.arange(len(f))
        step = (d[rows, up] + d[rows, down]) / (gamma[rows, up] + gamma[rows, down])
        g = np.where(known, values, f + step)
        if np.array_equal(f, g):
            break
        f = g
    # sweeps that no longer change a value have an error of some 1e4 of their last change, one machine epsilon
    np.testing.assert_allclose(result.value, f, atol=1e-11)
    assert imbalance(result.value, gamma, known) <= 100 * EPS * gamma.max() * np.ptp(values[known])
    K = all_pairs(values, gamma, known)
    assert result.energy[-1] == pytest.approx(K, rel=1e-13, abs=1e-15)
    assert result.lower_bound <= K * (1 + 10 * EPS)


def test_a_large_p_tends_to_it():
    # for two values a bound: the edge norm of p has at most E^(1/p) times the least constant, E edges
    graph, _gamma, values, known = drawn(3)
    limit = extended(values, graph, known)
    near = gr.interpolate(np.where(known, values, math.nan), graph, p=24, backend="numpy", dtype=float, tol=1e-3)
    edges = graph.edge_rows() < graph.indices
    u, v = graph.edge_rows()[edges], graph.indices[edges]
    slope = (np.sqrt(graph.weights[edges]) * np.abs(near.value[u] - near.value[v])).max()
    assert limit.energy[-1] * (1 - 1e-12) <= slope <= limit.energy[-1] * (1.001 * edges.sum()) ** (1 / 24)


@given(st.integers(0, 10_000), st.floats(-100, 100), st.floats(0.01, 100))
@settings(max_examples=15, deadline=None)
def test_shift_and_scale(seed, shift, scale):
    graph, _gamma, values, known = drawn(seed)
    plain, other = extended(values, graph, known), extended(scale * values + shift, graph, known)
    size = abs(shift) + scale * np.abs(values).max()
    np.testing.assert_allclose(other.value[~known], (scale * plain.value + shift)[~known], atol=1e-12 * size)
    mirrored = extended(-values, graph, known)
    np.testing.assert_allclose(mirrored.value, -plain.value, atol=1e-12 * np.abs(values).max())


@pytest.mark.parametrize("gamma", ["combinatorial", "normalized", "degree"])
def test_a_gamma_with_a_factor_per_vertex(gamma):
    graph, root, values, known = drawn(5)
    degree = (root**2).sum(axis=1)
    s = {"combinatorial": np.full(12, 0.5**0.5), "normalized": (2 * degree) ** -0.5, "degree": degree**-0.5}[gamma]
    result = extended(values, graph, known, gamma=gamma)
    plain = extended(s * values, graph, known).value / s
    np.testing.assert_allclose(result.value, plain, atol=1e-13)
    assert np.array_equal(result.value[known], values[known])


def test_arrays_of_gamma():
    graph, root, values, known = drawn(5)
    gamma = root[graph.edge_rows(), graph.indices]
    plain = extended(values, graph, known)
    np.testing.assert_allclose(extended(values, graph, known, gamma=gamma).value, plain.value, atol=1e-13)
    gamma[0] *= 2
    with pytest.raises(ValueError, match="symmetric gamma"):
        extended(values, graph, known, gamma=gamma)


def test_channels_masks_types_and_starts():
    rng = np.random.default_rng(2)
    mask = rng.random((9, 7)) > 0.15
    mask[:2] = mask[:, :2] = True
    grid = gr.GridGraph((9, 7), mask=mask)
    known = np.zeros((9, 7), bool)
    known[0, 0] = known[0, 6] = known[8, 0] = True
    f0 = np.where(known[..., None], rng.normal(size=(9, 7, 2)), 0).astype(np.float32)
    f0[~mask] = np.nan
    lam = known.ravel()
    with pytest.warns(RuntimeWarning, match="without data") if _cut_off(mask, known) else nullcontext():
        both = extended(f0, grid, lam)
    assert both.value.dtype == np.float32 and np.isnan(both.value[~mask]).all()
    for c in range(2):
        one = extended(f0[..., c], grid, lam, initial=np.ones((9, 7)))
        np.testing.assert_allclose(one.value[mask], both.value[..., c][mask], atol=1e-6)
    # float32 values have slopes that are off by their rounding
    assert both.gap <= 1e-6 * np.nanmax(np.abs(f0)) + 1e-13


def _cut_off(mask, known):
    return len(set(label(mask)[0][mask]) - set(label(mask)[0][known])) > 0


def test_edge_cases():
    path = gr.GridGraph(4)
    f0 = np.array([1.0, 5, 5, 3])
    assert np.array_equal(extended(f0, path, np.ones(4, bool)).value, f0)
    one = extended(f0, path, np.array([1, 0, 0, 0], bool))
    assert np.array_equal(one.value, np.ones(4)) and one.energy[-1] == one.gap == 0
    with pytest.warns(RuntimeWarning, match="no data at all"):
        none = extended(f0, path, np.zeros(4, bool))
    assert np.array_equal(none.value, np.zeros(4)) and none.stop is gr.Stop.BALANCED_NO_DATA
    apart = gr.Graph.from_edges([[0, 1], [2, 3]], n_vertices=5)
    with pytest.warns(RuntimeWarning, match="1 vertices in 1 component"):
        parts = extended([1, 0, 3, 0, 9], apart, np.array([1, 0, 1, 0, 0], bool))
    assert parts.value.tolist() == [1, 1, 3, 3, 2] and parts.gap == 0
    tied = extended([0.0, 9, 9, 9, 1], gr.Graph.from_edges([[0, 1], [1, 4], [0, 2], [2, 4], [0, 3], [3, 4]]),
                    np.array([1, 0, 0, 0, 1], bool))  # fmt: skip
    assert tied.value.tolist() == [0, 0.5, 0.5, 0.5, 1]
    with pytest.warns(RuntimeWarning, match="not converged"):
        early = extended(*[drawn(1)[k] for k in (2, 0, 3)], max_iter=1)
    assert early.stop is gr.Stop.MAX_ITER


def test_many_vertices_reach_rounding():
    # sweeps before the systems, and a residual far below any tolerance
    shape = (40, 40)
    rng = np.random.default_rng(0)
    grid = gr.GridGraph(shape)
    known = rng.random(1600) < 0.01
    result = extended(rng.normal(size=1600), grid, known)
    square = result.value.reshape(shape)
    # 8 neighbours; the value itself is neither the largest nor the smallest where they are balanced
    middle = (maximum_filter(square, 3, mode="nearest") + minimum_filter(square, 3, mode="nearest")) / 2
    assert np.abs(middle.ravel() - result.value)[~known].max() < 1e-12
    assert result.gap < 1e-12


def test_a_singular_system_is_shifted():
    # the unknown vertices 1 and 2 are joined by 1, to the data by 1e-20
    slopes = Slopes.of(
        np.array([0, 1, 2]), np.array([1, 2, 3]), np.array([1e-20, 1, 1e-20]), np.array([1, 0, 0, 1], bool)
    )
    f = np.array([0.0, 0, 0, 1])
    found = extend(slopes, f, least_constant(slopes, f), most=50)
    assert ((found.f >= 0) & (found.f <= 1)).all()


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"norm": "vertex"}, "norm='edge'"),
        ({"solver": "jacobi"}, "solver='certified'"),
        ({"eps": 0.1}, "eps must be None or 0"),
        ({"callback": print}, "callback is not called"),
        ({"update_weights": 2}, "update_weights"),
        ({"p": -math.inf}, "p must be"),
        ({"initial": np.ones(3)}, "initial must have"),
    ],
)
def test_what_it_does_not_take(options, match):
    graph, _gamma, values, known = drawn(0)
    with pytest.raises(ValueError, match=match):
        extended(values, graph, known, **options)


def test_other_functions_say_that_p_is_finite():
    graph, _gamma, values, known = drawn(0)
    with pytest.raises(ValueError, match="0 or infinite at every vertex"):
        gr.regularize(values, graph, p=math.inf, norm="edge", solver="certified", lam=1, backend="numpy")
    for function in (
        lambda: gr.operators.p_laplacian(values, graph, math.inf),
        lambda: gr.operators.dirichlet_energy(values, graph, math.inf),
        lambda: gr.regularization_path(values, graph, lam=[1, 2], p=math.inf, backend="numpy"),
        lambda: gr.denoise_image(np.eye(8), p=math.inf, lam=1),
        lambda: gr.memory_needed(graph, p=math.inf),
    ):
        with pytest.raises(ValueError, match=r"\bp\b.* must be finite"):
            function()
    assert known.any()
