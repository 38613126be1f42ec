"""The propositions, properties and closed forms of sections 2 to 4, for every gamma, both norms and both processes.

Equation numbers are the paper's; E1 to E24 are the errata of docs/mathematics.md.
"""

from __future__ import annotations

import itertools
import math
import warnings

import cases
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import fft

import gpureg as gr

P = (0.5, 1.0, 1.5, 2.0, 3.0, 6.0)
NAMES = ("sqrt", "combinatorial", "normalized", "degree")
ops = gr.operators


def graphs() -> dict[str, gr.Graph | gr.GridGraph]:
    return {"stored": cases.irregular(17, 60, isolated=5), "grid": gr.GridGraph((3, 5))}


def gammas(graph: gr.Graph | gr.GridGraph) -> dict[str, object]:
    """Every form of gamma: the names, a symmetric array, and one that is not."""
    values = cases.rng(41).random(graph.n_edges)
    stored = graph.to_graph() if isinstance(graph, gr.GridGraph) else graph
    number = {e: k for k, e in enumerate(zip(stored.edge_rows().tolist(), stored.indices.tolist(), strict=True))}
    mirror = np.array([number[v, u] for u, v in number])
    lopsided = values.copy()
    lopsided[::7] = 0
    return {**{name: name for name in NAMES}, "symmetric": (values + values[mirror]) / 2, "lopsided": lopsided}


CASES = [(kind, gamma) for kind in ("stored", "grid") for gamma in (*NAMES, "symmetric", "lopsided")]
every_gamma = pytest.mark.parametrize(("kind", "gamma"), CASES)
both_norms = pytest.mark.parametrize("norm", ["vertex", "edge"])
ORACLE = {"backend": "numpy", "dtype": np.float64}


def setup(kind: str, gamma: str) -> tuple[gr.Graph | gr.GridGraph, dict[str, object]]:
    graph = graphs()[kind]
    return graph, {"gamma": gammas(graph)[gamma], **ORACLE}


def functions(graph: gr.Graph | gr.GridGraph, m: int = 2) -> tuple[np.ndarray, np.ndarray]:
    return cases.function(graph, m), cases.rng(43).random((graph.n_edges, m)) - 0.5


# Section 2


@every_gamma
def test_proposition_1_and_property_1(device: str, kind: str, gamma: str) -> None:
    """<d f, H> = <f, d* H> on every device; the divergence sums to 0 if gamma is symmetric, and only then (E4)."""
    graph, given = setup(kind, gamma)
    f, H = functions(graph)
    # one type for each kind of graph: every kernel is compiled on every device
    for dtype, u in [("float64", 2.0**-53)] if kind == "grid" else [("float32", 2.0**-24)]:
        where = {**given, "backend": device, "dtype": dtype}
        try:
            d, adjoint = ops.difference(f, graph, **where), ops.adjoint(H, graph, **where)
        except gr.BackendUnavailable:
            continue
        # Sums of some hundred products of numbers below 1, each off by a few u.
        allowed = 100 * u * (np.abs(d).sum() + np.abs(adjoint).sum())
        assert abs((d.astype(float) * H).sum() - (f * adjoint.astype(float)).sum()) <= allowed
        total = ops.divergence(H, graph, **where).astype(float).sum(axis=0)
        if gamma in ("sqrt", "combinatorial", "symmetric"):
            assert np.abs(total).max() <= allowed
        else:
            assert np.abs(total).min() > 0.01
        at = ops.edge_derivative(f, graph, [[1, 0], [0, 1]] if kind == "grid" else edge_of(graph), **where)
        assert np.abs(at[0] + at[1]).max() <= 4 * u * np.abs(d).max()  # antisymmetric (E3)


def edge_of(graph: gr.Graph) -> list[list[int]]:
    u, v = int(graph.edge_rows()[0]), int(graph.indices[0])
    return [[u, v], [v, u]]


@every_gamma
@pytest.mark.parametrize("p", P)
def test_proposition_2(kind: str, gamma: str, p: float) -> None:
    """Eq. 12 is d*(|grad f|^(p-2) d f) (eq. 11), and so is eq. 14; with the edge norm d*(|d f|^(p-2) d f)/2 (E12)."""
    graph, given = setup(kind, gamma)
    f, _ = functions(graph)
    stored = graph.to_graph() if isinstance(graph, gr.GridGraph) else graph
    d = ops.difference(f, graph, **given)
    norm = ops.gradient_norm(f, graph, eps=cases.EPS, **given)
    composed = ops.adjoint(norm[stored.edge_rows(), None] ** (p - 2) * d, graph, **given)
    direct = ops.p_laplacian(f, graph, p, eps=cases.EPS, **given)
    assert_allclose(direct, composed, rtol=0, atol=1e-13 * np.abs(direct).max())
    square = (d**2).sum(axis=1, keepdims=True) + cases.EPS**2
    composed = ops.adjoint(square ** ((p - 2) / 2) * d, graph, **given) / 2
    direct = ops.p_laplacian(f, graph, p, eps=cases.EPS, norm="edge", **given)
    assert_allclose(direct, composed, rtol=0, atol=1e-13 * np.abs(direct).max())


@every_gamma
def test_last_form_of_17_lacks_a_factor_2(kind: str, gamma: str) -> None:
    """E1: the Laplacian of eq. 16 is -2 sum gamma_uv d_v f(u), not -sum gamma_uv d_v f(u) as eq. 17 ends."""
    graph, given = setup(kind, gamma)
    f, _ = functions(graph, 1)
    stored = graph.to_graph() if isinstance(graph, gr.GridGraph) else graph
    W = stored.to_scipy().toarray().astype(float)
    G = np.zeros_like(W)
    rows, columns = stored.edge_rows(), stored.indices
    if isinstance(given["gamma"], str):
        degree = np.where(W.sum(axis=1) > 0, W.sum(axis=1), 1)[:, None]
        G = np.sqrt({"sqrt": W, "combinatorial": W / 2, "normalized": W / (2 * degree), "degree": W / degree}[gamma])
    else:
        G[rows, columns] = given["gamma"]
    d = np.zeros_like(W)
    d[rows, columns] = ops.difference(f, graph, **given)[:, 0]
    laplacian = ops.laplacian(f, graph, **given)[:, 0]
    assert_allclose(laplacian, -2 * (G * d).sum(axis=1), rtol=0, atol=1e-13 * np.abs(laplacian).max())
    d_norm = ops.gradient_norm(f, graph, **given)
    assert_allclose(d_norm, np.sqrt((d**2).sum(axis=1)), rtol=0, atol=1e-13)  # eq. 9
    for q in (0.5, 1.0, 3.0):
        lq = ops.gradient_norm(f, graph, q, **given)
        assert_allclose(lq, (np.abs(d) ** q).sum(axis=1) ** (1 / q), rtol=1e-12, atol=1e-13)  # eq. 10


@every_gamma
@both_norms
@pytest.mark.parametrize("p", P)
def test_property_2(kind: str, gamma: str, norm: str, p: float) -> None:
    """The p-Laplacian is the derivative of the energy: central differences, to 1e-6 (E10, E15).

    With eps = 1/4 and h = 1e-4 a central difference is off by h^2/6 times a third derivative, of the order of eps^-2
    times the gradient: 3e-8 of it; the energy's rounding over h adds 1e-11.
    """
    graph, given = setup(kind, gamma)
    f, f0 = cases.function(graph, 2), cases.function(graph, 2, seed=13)
    lam, eps, h = 0.7, 0.25, 1e-4

    def energy(at: np.ndarray) -> float:
        return ops.energy(at, f0, graph, p, lam, eps=eps, norm=norm, **given)

    slope = ops.p_laplacian(f, graph, p, eps=eps, norm=norm, **given) + lam * (f - f0)
    for u in range(0, graph.n_vertices, 3):
        step = np.zeros_like(f)
        step[u, 1] = h
        numeric = (energy(f + step) - energy(f - step)) / (2 * h)
        assert abs(numeric - slope[u, 1]) <= 1e-6 * np.abs(slope).max()


def test_table_1() -> None:
    """E6, E7: gamma_1 gives L, gamma_2 gives L_n, sqrt(w) gives 2 L; <f, L f> is the energy of gamma = sqrt(w)."""
    graph = graphs()["stored"]
    f = cases.function(graph)
    W = graph.to_scipy().astype(float)
    degree = np.asarray(W.sum(axis=1)).ravel()
    L = np.diag(degree) - W.toarray()
    root = np.where(degree > 0, 1 / np.sqrt(np.where(degree > 0, degree, 1)), 0)
    for gamma, matrix in (("combinatorial", L), ("normalized", root[:, None] * L * root), ("sqrt", 2 * L)):
        assert_allclose(ops.laplacian(f, graph, gamma=gamma, **ORACLE), matrix @ f, atol=1e-13)
    assert ops.dirichlet_energy(f, graph, 2, **ORACLE) == pytest.approx((f * (L @ f)).sum(), rel=1e-13)
    # E11: (20) at p = 2 is half of J_NL of eq. 29
    double = (W.toarray() * (f - f.T) ** 2).sum()
    assert ops.dirichlet_energy(f, graph, 2, **ORACLE) == pytest.approx(double / 2, rel=1e-13)
    half = ops.dirichlet_energy(f, graph, 2, gamma="combinatorial", **ORACLE)
    assert half == pytest.approx((f * (L @ f)).sum() / 2, rel=1e-13)


def test_kernel_of_the_normalized_gradient() -> None:
    """E5: with gamma_2 constants have a gradient; sqrt(degree) has none."""
    edges = [[k, (k + j) % 16] for k in range(16) for j in (1, 3)]
    graph = gr.Graph.from_edges(edges, 0.5 + cases.rng(3).random(len(edges)))
    given = {"gamma": "normalized", **ORACLE}
    assert ops.gradient_norm(np.ones(16), graph, **given).min() > 1e-3
    assert ops.gradient_norm(np.sqrt(graph.degree()), graph, **given).max() < 1e-14


@pytest.mark.parametrize("p", P)
def test_scale_of_gamma(p: float) -> None:
    """E8: gamma -> c gamma scales the energy and the p-Laplacian by c^p, eps by c."""
    graph, c, eps = graphs()["stored"], 3.0, 0.1
    f = cases.function(graph)
    root = np.sqrt(graph.to_scipy().data.astype(float))
    for norm in ("vertex", "edge"):
        plain = ops.p_laplacian(f, graph, p, eps=eps, norm=norm, gamma=root, **ORACLE)
        scaled = ops.p_laplacian(f, graph, p, eps=c * eps, norm=norm, gamma=c * root, **ORACLE)
        assert_allclose(scaled, c**p * plain, rtol=0, atol=1e-13 * np.abs(scaled).max())
        assert_allclose(plain, ops.p_laplacian(f, graph, p, eps=eps, norm=norm, **ORACLE), rtol=1e-10, atol=1e-12)


# Closed forms (docs/mathematics.md, section 4), reached by the solvers


def solve(f0: np.ndarray, graph: gr.Graph | gr.GridGraph, **given: object) -> np.ndarray:
    return gr.regularize(f0, graph, **{**ORACLE, "max_iter": 20_000, "tol": 1e-13, **given}).value


def root_of(left: object, right: object, high: float) -> float:
    """The point of 0..high where an increasing left side meets a decreasing right side."""
    low = 0.0
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (low, middle) if left(middle) > right(middle) else (middle, high)
    return middle


def bias(p: float, lam: float, eps: float, n: int) -> float:
    """How far eps moves the minimiser at most, in the Euclidean norm (E15: sqrt(2 eps^p/(p lam)) a vertex)."""
    return math.sqrt(n * 2 * eps**p / (p * lam)) if p < 2 else 1e-10 + eps


both_solvers = pytest.mark.parametrize("solver", ["jacobi", "euler"])


@both_norms
@pytest.mark.parametrize("p", (1.0, 1.5, 2.0, 3.0, 6.0))
@pytest.mark.parametrize("w", (0.25, 3.0))
def test_one_edge(norm: str, p: float, w: float) -> None:
    """K2: c w^(p/2) d^(p-1) = lam/2 (d0 - d), c = 2 for eq. 20 and 1 for eq. 30."""
    lam, d0, eps = 8.0, 3.0, 1e-9 if p < 2 else 0.0
    f = solve(np.array([1.0, 1.0 + d0]), gr.Graph.from_edges([[0, 1]], [w]), p=p, lam=lam, norm=norm, eps=eps)
    c = 2 if norm == "vertex" else 1
    d = root_of(lambda d: c * w ** (p / 2) * d ** (p - 1), lambda d: lam / 2 * (d0 - d), d0)
    assert f[1] - f[0] == pytest.approx(d, abs=2 * bias(p, lam, eps, 2))
    assert f.mean() == pytest.approx(1 + d0 / 2, abs=1e-9)


@pytest.mark.parametrize("p", (1.0, 1.5, 2.0, 3.0))
@pytest.mark.parametrize("n", (3, 7))
def test_star(p: float, n: int) -> None:
    """n leaves: (n^(p/2) + n) w^(p/2) d^(p-1) = lam n/(n+1) (d0 - d)."""
    w, lam, d0, eps = 0.5, 9.0, 2.0, 1e-9 if p < 2 else 0.0
    f0 = np.zeros(n + 1)
    f0[0] = d0
    f = solve(f0, gr.Graph.from_edges([[0, k] for k in range(1, n + 1)], np.full(n, w)), p=p, lam=lam, eps=eps)
    share = lam * n / (n + 1)
    d = root_of(lambda d: (n ** (p / 2) + n) * w ** (p / 2) * d ** (p - 1), lambda d: share * (d0 - d), d0)
    assert_allclose(f[0] - f[1:], d, atol=2 * bias(p, lam, eps, n + 1))


def test_complete_graph() -> None:
    """k of n vertices at a, the others at b, p = 1: d = d0 - sqrt(w)[k sqrt(n-k) + (n-k) sqrt k] n/(lam k (n-k))."""
    n, k, w, lam, d0, eps = 7, 3, 0.25, 9.0, 4.0, 1e-9
    graph = gr.Graph.from_edges(list(itertools.combinations(range(n), 2)), np.full(n * (n - 1) // 2, w))
    f = solve(np.where(np.arange(n) < k, d0, 0.0), graph, p=1, lam=lam, eps=eps)
    pull = math.sqrt(w) * (k * math.sqrt(n - k) + (n - k) * math.sqrt(k)) * n / (lam * k * (n - k))
    assert pull < d0
    assert_allclose(f[:k].mean() - f[k:].mean(), d0 - pull, atol=2 * bias(1, lam, eps, n))


def ngon(n: int) -> tuple[np.ndarray, gr.Graph, float]:
    angle = 2 * np.pi * np.arange(n) / n
    graph = gr.Graph.from_edges([[k, (k + 1) % n] for k in range(n)])
    return np.stack([np.cos(angle), np.sin(angle)], axis=1), graph, 4 * math.sin(math.pi / n) ** 2


def solid(name: str) -> tuple[np.ndarray, gr.Graph, float]:
    """A regular polyhedron of circumradius 1: neighbours are the nearest vertices; L f = mu f for the coordinates."""
    phi = (1 + math.sqrt(5)) / 2
    signs = np.array(list(itertools.product([-1, 1], repeat=3)), float)
    cyclic = [np.roll([0, a, b * phi], k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]
    points, mu = {
        "tetrahedron": (signs[[0, 3, 5, 6]], 4.0),
        "cube": (signs, 2.0),
        "octahedron": (np.concatenate([np.eye(3), -np.eye(3)]), 4.0),
        "icosahedron": (np.array(cyclic), 5 - math.sqrt(5)),
        "dodecahedron": (
            np.concatenate(
                [signs, [np.roll([0, a / phi, b * phi], k) for k in range(3) for a in (-1, 1) for b in (-1, 1)]]
            ),
            3 - math.sqrt(5),
        ),
    }[name]
    points = points / np.linalg.norm(points[0])
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    nearest = distance[distance > 1e-9].min()
    return points, gr.Graph.from_edges(np.argwhere(np.triu(np.abs(distance - nearest) < 1e-9))), mu


SHAPES = ["12-gon", "tetrahedron", "cube", "octahedron", "icosahedron", "dodecahedron"]


@pytest.mark.parametrize("p", (1.0, 1.5, 2.0, 3.0))
@pytest.mark.parametrize("shape", SHAPES)
def test_regular_shapes_shrink(shape: str, p: float) -> None:
    """L f0 = mu f0, constant gradient: the minimiser is f0 at radius rho, lam (rho - rho0) + (sqrt(2 mu) rho)^p/rho=0.

    With eps, |grad f|^2 = 2 mu rho^2 becomes 2 mu rho^2 + eps^2, so that the check is sharp.
    """
    unit, graph, mu = ngon(12) if shape == "12-gon" else solid(shape)
    rho0, lam, eps = 3.0, 6.0, 1e-6 if p < 2 else 0.0
    f = solve(rho0 * unit, graph, p=p, lam=lam, eps=eps)
    slope = lambda rho: (2 * mu * rho**2 + eps**2) ** ((p - 2) / 2) * 2 * mu * rho  # noqa: E731
    rho = root_of(slope, lambda rho: lam * (rho0 - rho), rho0)
    assert_allclose(f, rho * unit, atol=1e-9)
    if p == 1:
        assert rho == pytest.approx(rho0 - math.sqrt(2 * mu) / lam, abs=1e-9)


def test_numbers_from_convex_programming() -> None:
    """12-gon of radius 3, lam 1.7, icosahedron of radius 3, lam 6, p = 1: known from convex programming."""
    for (unit, graph, _), lam, radius in ((ngon(12), 1.7, 2.5693819), (solid("icosahedron"), 6.0, 2.6081432)):
        f = solve(3 * unit, graph, p=1, lam=lam, eps=1e-6)
        assert_allclose(np.linalg.norm(f, axis=1), radius, atol=1e-7)


def test_one_plain_sweep_on_the_ngon() -> None:
    """p = 2, lam = 0: the radius times cos(2 pi/n)."""
    unit, graph, _ = ngon(7)
    f = gr.regularize(unit, graph, p=2, lam=0, max_iter=1, solver=gr.Jacobi(damping=1), **ORACLE).value
    assert_allclose(f, math.cos(2 * math.pi / 7) * unit, atol=1e-15)


@both_solvers
def test_p2_on_a_grid_is_a_cosine_transform(device: str, solver: str) -> None:
    """f = IDCT(lam/(lam + 2(4 - 2cos(pi i/h) - 2cos(pi j/w))) DCT f0) on G_0 (E9), on every device."""
    h, w, lam = 21, 34, 0.8
    f0 = cases.rng(5).random((h, w))
    mu = 4 - 2 * np.cos(np.pi * np.arange(h) / h)[:, None] - 2 * np.cos(np.pi * np.arange(w) / w)
    exact = fft.idctn(lam / (lam + 2 * mu) * fft.dctn(f0))
    grid = gr.GridGraph((h, w), 1, "cityblock")
    result = gr.regularize(f0, grid, p=2, lam=lam, solver=solver, max_iter=1000, backend=device)
    # an error shrinks by 16/(lam + 16) a sweep, and rounding (1e-7 a sweep) grows by the sum of these, 21
    assert np.abs(result.value - exact).max() < 21 * 2e-7


def test_dirichlet_path() -> None:
    """Increments proportional to w^(-p/(2(p-1))) with the edge norm; straight for w = 1 and every p > 1."""
    n, rng = 9, cases.rng(7)
    w = 0.5 + rng.random(n - 1)
    edges = [[k, k + 1] for k in range(n - 1)]
    f0, lam = np.linspace(0, 1, n) * 0, np.zeros(n)
    f0[-1], lam[[0, -1]] = 1.0, np.inf
    for p in (1.5, 2.0, 3.0, 6.0):
        for weights in (w, np.ones(n - 1)):
            f = solve(f0, gr.Graph.from_edges(edges, weights), p=p, lam=lam, norm="edge", eps=1e-8)
            steps = weights ** (-p / (2 * (p - 1)))
            assert_allclose(np.diff(f), steps / steps.sum(), atol=2e-7)


def test_one_dimensional_total_variation() -> None:
    """Eq. 30, p = 1 on a path: plateaus of n_i vertices move by 1/(lam n_i). Eq. 20 does not keep them flat (E22)."""
    lam, eps = 1.0, 1e-3
    f0 = np.repeat([0.0, 10.0], 10)
    path = gr.GridGraph(20)
    f = solve(f0, path, p=1, lam=lam, norm="edge", eps=eps, tol=1e-9)
    # sqrt(2 eps/lam) a vertex and edge: 20 vertices, 19 edges
    assert np.linalg.norm(f - np.repeat([0.1, 9.9], 10)) <= bias(1, lam, eps, 19)
    f = solve(f0, path, p=1, lam=lam, eps=eps, tol=1e-9)
    expected = np.array([0.1216] * 9 + [0.8970, 9.1030] + [9.8784] * 9)
    assert np.linalg.norm(f - expected) <= bias(1, lam, eps, 20) + 1e-4
    assert np.ptp(f[:10]) > 0.5


@pytest.mark.parametrize(("metric", "kappa"), [("cityblock", math.sqrt(2)), ("chebyshev", math.sqrt(6))])
def test_rof_disk(metric: str, kappa: float) -> None:
    """A disk of radius R and height 1 loses 2 kappa/(lam R), p = 1; the background rises as the mass says (E21)."""
    R, lam = 10, 2.0
    n = 4 * R
    y, x = np.mgrid[:n, :n] - (n - 1) / 2
    disk = x**2 + y**2 <= R**2
    grid = gr.GridGraph((n, n), 1, metric)
    f = gr.regularize(disk.astype(float), grid, p=1, lam=lam, eps=2e-3, max_iter=12_000).value
    inner, outer = (x**2 + y**2 <= (R / 2) ** 2), (x**2 + y**2 >= (1.5 * R) ** 2)
    loss = 1 - f[inner].mean()
    # A disk of pixels is one up to a share 1/R. Measured here: 0.98 and 1.07 of kappa.
    assert loss * lam * R / 2 == pytest.approx(kappa, rel=1 / R)
    assert f[outer].mean() == pytest.approx(2 * math.pi * R * kappa / (lam * (~disk).sum()), rel=1.5 / R)


def test_limits_of_lam() -> None:
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [0, 2], [3, 4], [4, 5], [3, 5]], n_vertices=7)
    f0 = np.array([1.0, 2.0, 6.0, -1.0, 0.0, 4.0, 5.0])
    for p in (1.0, 2.0, 3.0):
        assert_allclose(solve(f0, graph, p=p, lam=1e9), f0, atol=1e-7)
        assert np.array_equal(solve(f0, graph, p=p, lam=np.inf), f0)
    # E23: without data the limit is the mean of each part (of equal degrees here), and an isolated vertex stays
    assert_allclose(solve(f0, graph, p=2, lam=0), [3, 3, 3, 1, 1, 1, 5], atol=1e-9)
    star = gr.Graph.from_edges([[0, 1], [0, 2], [0, 3]])
    weighted_mean = (3 * 8.0 + 1 + 2 + 3) / 6
    assert_allclose(solve(np.array([8.0, 1, 2, 3]), star, p=2, lam=0), weighted_mean, atol=1e-9)


def test_below_1_the_start_decides() -> None:
    """E14: for p < 1 a minimum exists, but there may be several: the sweeps end near where they began."""
    graph, f0 = gr.Graph.from_edges([[0, 1]]), np.array([0.0, 3.0])
    given = {"p": 0.3, "lam": 4.0, "eps": 1e-3}
    apart = solve(f0, graph, **given)
    together = solve(f0, graph, initial=np.array([1.5, 1.5]), **given)
    assert apart[1] - apart[0] > 1
    assert together[1] - together[0] < 0.1
    for f in (apart, together):
        slope = ops.p_laplacian(f, graph, 0.3, eps=1e-3, **ORACLE) + 4.0 * (f - f0)
        assert np.abs(slope).max() < 1e-6  # both are stationary
    same = gr.regularize(f0, graph, p=1, lam=4.0, eps=1e-3, max_iter=20_000, tol=1e-13, **ORACLE).value
    other = solve(f0, graph, initial=np.array([1.5, 1.5]), p=1, lam=4.0, eps=1e-3)
    assert_allclose(same, other, atol=1e-9)  # from p = 1 on there is one


def test_infinity_laplacian_is_the_limit() -> None:
    """6x6 grid, corners 0 and 1 on one side: eq. 30 nears the values printed for p = infinity by YINSlex."""
    rows = np.array([
        [0, .1429, .2449, .3178, .3698, .4070],
        [.2, .2857, .3469, .3907, .4219, .4442],
        [.4, .4286, .4490, .4636, .4740, .4814],
    ])  # fmt: skip
    exact = np.concatenate([rows, 1 - rows[::-1]])
    lam = np.zeros((6, 6))
    lam[0, 0] = lam[5, 0] = np.inf
    f0 = np.full((6, 6), 0.5)
    f0[0, 0], f0[5, 0] = 0, 1
    grid, off = gr.GridGraph((6, 6), 1, "cityblock"), []
    for p in (2.0, 4.0, 8.0):
        f = solve(f0, grid, p=p, lam=lam, norm="edge", eps=1e-6, max_iter=30_000, tol=1e-9)
        off.append(np.abs(f - exact).max())
    assert off[0] > off[1] > off[2]
    assert off[2] < 0.05  # measured 0.03; the limit is slow in p


def test_a_posteriori_certificate() -> None:
    """The dual point y = |grad f|^(p-2) d f bounds the distance to the minimiser: sqrt(2 gap/lam)."""
    graph = cases.irregular(40, 200, isolated=5)
    f0, p, lam = cases.function(graph), 1.5, 0.8
    exact = solve(f0, graph, p=p, lam=lam, eps=1e-9, max_iter=50_000)
    for steps in (5, 20, 100):
        f = gr.regularize(f0, graph, p=p, lam=lam, eps=1e-9, max_iter=steps, **ORACLE).value
        rows, q = graph.edge_rows(), p / (p - 1)
        norm = ops.gradient_norm(f, graph, **ORACLE)
        safe = np.where(norm > 0, norm, 1) ** (p - 2)
        y = np.where(norm[rows] > 0, safe[rows], 0)[:, None] * ops.difference(f, graph, **ORACLE)
        back = ops.adjoint(y, graph, **ORACLE)
        length = np.sqrt(np.bincount(rows, (y[:, 0]) ** 2, minlength=40))
        dual = -(length**q).sum() / q - (back**2).sum() / (2 * lam) + (back * f0).sum()
        gap = ops.energy(f, f0, graph, p, lam, **ORACLE) - dual
        error = np.linalg.norm(f - exact)
        assert error <= math.sqrt(2 * max(gap, 0) / lam) + 1e-6


# Section 3: the processes


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


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_descent(data: st.DataObject) -> None:
    """No sweep raises the smoothed energy: a theorem for 0 < p <= 2, any gamma and norm; watched over for p > 2.

    Where nothing is left but rounding, that may rise: each value by the last digit of the largest, which the fidelity
    squares.
    """
    graph, f0 = draw(data)
    p = data.draw(st.sampled_from([0.05, 0.5, 1.0, 1.3, 2.0, 2.5, 3.0, 6.0, 10.0]))
    kind = data.draw(st.sampled_from([*NAMES, "array"]))
    gamma = cases.rng(data.draw(st.integers(0, 99))).random(graph.n_edges) if kind == "array" else kind
    lam = data.draw(st.sampled_from([0.0, 0.01, 1.0, 10.0]))
    for norm, coupled in itertools.product(("vertex", "edge"), (True, False)):
        result = gr.regularize(
            f0, graph, p=p, lam=lam, eps=0.05, gamma=gamma, norm=norm, coupled=coupled, max_iter=25,
            solver=gr.Jacobi(check_every=1), **ORACLE,
        )  # fmt: skip
        rounding = 0.5 * lam * f0.size * (2.0**-52 * np.abs(f0).max(initial=0)) ** 2
        assert np.diff(result.energy).max() <= 1e-12 * max(result.energy[0], 1e-20) + rounding


def test_damping_alone_is_not_enough_beyond_2() -> None:
    """1/(p - 1) by itself can raise the energy; the default then shortens the sweep, and says so."""
    generator, shortened = cases.rng(1), 0
    for _ in range(100):
        n = int(generator.integers(4, 9))
        pairs = np.array(list(itertools.combinations(range(n), 2)))
        kept = pairs[generator.random(len(pairs)) < 0.5]
        graph = gr.Graph.from_edges(kept, generator.choice([0.1, 1.0, 30.0], len(kept)), n_vertices=n)
        f0 = generator.integers(-20, 20, (n, 2)) / 10
        given = {"p": 3, "lam": 0, "eps": 0.05, "norm": "edge", "max_iter": 15, **ORACLE}
        plain = gr.regularize(f0, graph, solver=gr.Jacobi(damping=0.5, check_every=1), **given)
        safe = gr.regularize(f0, graph, solver=gr.Jacobi(check_every=1), **given)
        assert np.diff(safe.energy).max() <= 1e-12 * max(safe.energy[0], 1e-20)
        if np.diff(plain.energy).max() > 1e-6 * plain.energy[0]:
            shortened += 1
            assert "shortened" in safe.method
    assert shortened > 0


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_descent_of_euler(data: st.DataObject) -> None:
    """The step that Euler takes by itself never raises the energy, and half the bound keeps the range."""
    graph, f0 = draw(data)
    p = data.draw(st.sampled_from([0.5, 1.0, 2.0, 2.5, 4.0]))
    gamma = data.draw(st.sampled_from(["sqrt", "normalized", "array"]))
    if gamma == "array":
        gamma = cases.rng(3).random(graph.n_edges)
    lam = data.draw(st.sampled_from([0.0, 1.0, 10.0]))
    for norm in ("vertex", "edge"):
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


def test_lazy_only_where_it_would_swing() -> None:
    """An odd cycle, one pixel of data, a pinned one, or a diagonal neighbour, and the plain sweep is taken."""
    board = (np.indices((6, 7)).sum(axis=0) % 2).astype(float)
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
    for graph, lam, extra, lazy in (
        (four, 0, {}, True),
        (eight, 0, {}, False),
        (four, one, {}, False),
        (four, pinned, {}, False),
        (four, 0.1, {}, False),
        (cut, left, {}, True),
        (eight, 0, {"weights": diagonal}, True),
        (eight, 0, {"gamma": diagonal}, True),
        (four.to_graph(), 0, {}, True),
        (gr.Graph.from_edges([[0, 1], [1, 2], [0, 2]]), 0, {}, False),
        (gr.Graph.from_edges([[0, 1]], [0.0]), 0, {}, False),
        (gr.Graph([0, 0, 0], []), 0, {}, False),
    ):
        f0 = board if isinstance(graph, gr.GridGraph) else np.arange(graph.n_vertices, dtype=float)
        result = gr.regularize(f0, graph, lam=lam, max_iter=3, **extra, **ORACLE)
        assert ("lazy" in result.method) == lazy, (graph, result.method)
    assert "1/(p - 1)" in gr.regularize(board, four, p=3, lam=0, max_iter=1, **ORACLE).method


def test_all_weights_underflowed(device: str) -> None:
    """No weight is left: 0/0 is defined as the data."""
    f0 = np.arange(12.0).reshape(3, 4) * 1e3
    weights = gr.weights.bilateral(np.inf, 1.0)
    for solver in ("jacobi", "euler"):
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
    for step in (0, -1, math.inf, math.nan):
        with pytest.raises(ValueError, match="step must be finite and > 0"):
            gr.Euler(step=step)
    with pytest.raises(TypeError, match="step must be a number"):
        gr.Euler(step="fast")


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


def test_luxembourg_streets(device: str, data_folder) -> None:
    """A noisy signal on 114,599 street corners denoised; all devices agree with the oracle, and it is better."""
    from scipy.io import mmread

    graph = gr.Graph.from_scipy(mmread(data_folder / "graphs" / "luxembourg_osm.mtx.gz").tocsr())
    assert graph.n_vertices == 114_599
    n = graph.n_vertices
    # smooth: the sum of a few far corners' influence, by diffusing random values for long
    clean = gr.regularize(
        cases.rng(3).standard_normal(n), graph, p=2, lam=0, max_iter=300, solver=gr.Jacobi(damping=0.5), **ORACLE
    ).value
    clean /= clean.std()
    noisy = clean + 0.5 * cases.rng(5).standard_normal(n)
    given = {"p": 1.0, "lam": 2.0, "eps": 0.05, "max_iter": 40}
    exact = gr.regularize(noisy, graph, **given, **ORACLE).value
    found = gr.regularize(noisy, graph, backend=device, **given).value
    assert np.abs(found - exact).max() <= cases.TOLERANCES["float32"] * np.abs(noisy).max()
    assert np.std(found - clean) < 0.6 * np.std(noisy - clean)
