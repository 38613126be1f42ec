"""Closed forms (docs/mathematics.md, section 4), reached by the solvers.

Equation numbers are the paper's; E1 to E24 are the errata of docs/mathematics.md.
"""

from __future__ import annotations

import itertools
import math

import cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import fft
from test_mathematics import ORACLE, both_norms, ops

import gpureg as gr


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


@pytest.mark.parametrize(("shape", "lam", "radius"), [("12-gon", 1.7, 2.5693819), ("icosahedron", 6.0, 2.6081432)])
def test_numbers_from_convex_programming(shape: str, lam: float, radius: float) -> None:
    """12-gon of radius 3, lam 1.7, icosahedron of radius 3, lam 6, p = 1: known from convex programming."""
    unit, graph, _ = ngon(12) if shape == "12-gon" else solid(shape)
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


@pytest.mark.parametrize("p", (1.5, 2.0, 3.0, 6.0))
@pytest.mark.parametrize("unit", [False, True], ids=["weights", "w = 1"])
def test_dirichlet_path(p: float, unit: bool) -> None:
    """Increments proportional to w^(-p/(2(p-1))) with the edge norm; straight for w = 1 and every p > 1."""
    n, rng = 9, cases.rng(7)
    w = np.ones(n - 1) if unit else 0.5 + rng.random(n - 1)
    edges = [[k, k + 1] for k in range(n - 1)]
    f0, lam = np.linspace(0, 1, n) * 0, np.zeros(n)
    f0[-1], lam[[0, -1]] = 1.0, np.inf
    f = solve(f0, gr.Graph.from_edges(edges, w), p=p, lam=lam, norm="edge", eps=1e-8)
    steps = w ** (-p / (2 * (p - 1)))
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


TRIANGLES = gr.Graph.from_edges([[0, 1], [1, 2], [0, 2], [3, 4], [4, 5], [3, 5]], n_vertices=7)
ON_TRIANGLES = np.array([1.0, 2.0, 6.0, -1.0, 0.0, 4.0, 5.0])


@pytest.mark.parametrize("p", (1.0, 2.0, 3.0))
def test_large_lam(p: float) -> None:
    assert_allclose(solve(ON_TRIANGLES, TRIANGLES, p=p, lam=1e9), ON_TRIANGLES, atol=1e-7)
    assert np.array_equal(solve(ON_TRIANGLES, TRIANGLES, p=p, lam=np.inf), ON_TRIANGLES)


def test_without_data() -> None:
    """E23: the limit is the mean of each part (of equal degrees here), and an isolated vertex stays."""
    assert_allclose(solve(ON_TRIANGLES, TRIANGLES, p=2, lam=0), [3, 3, 3, 1, 1, 1, 5], atol=1e-9)
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
    slopes = [ops.p_laplacian(f, graph, 0.3, eps=1e-3, **ORACLE) + 4.0 * (f - f0) for f in (apart, together)]
    assert np.abs(slopes).max() < 1e-6  # both are stationary
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
    exact, beyond = solve(f0, graph, p=p, lam=lam, eps=1e-9, max_iter=50_000), []
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
        beyond.append(error - math.sqrt(2 * max(gap, 0) / lam))
    assert max(beyond) <= 1e-6
