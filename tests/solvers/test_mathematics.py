"""The propositions, properties and closed forms of sections 2 to 4, for every gamma, both norms and both processes.

Equation numbers are the paper's; E1 to E24 are the errata of docs/mathematics.md.
"""

from __future__ import annotations

import cases
import numpy as np
import pytest
from numpy.testing import assert_allclose

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
    dtype, u = ("float64", 2.0**-53) if kind == "grid" else ("float32", 2.0**-24)
    where = {**given, "backend": device, "dtype": dtype}
    try:
        d, adjoint = ops.difference(f, graph, **where), ops.adjoint(H, graph, **where)
    except gr.BackendUnavailable as error:
        pytest.skip(str(error))
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
    f, d, G = pairwise(kind, gamma)
    laplacian = ops.laplacian(f, graph, **given)[:, 0]
    assert_allclose(laplacian, -2 * (G * d).sum(axis=1), rtol=0, atol=1e-13 * np.abs(laplacian).max())
    d_norm = ops.gradient_norm(f, graph, **given)
    assert_allclose(d_norm, np.sqrt((d**2).sum(axis=1)), rtol=0, atol=1e-13)  # eq. 9


@every_gamma
@pytest.mark.parametrize("q", (0.5, 1.0, 3.0))
def test_lq_norm(kind: str, gamma: str, q: float) -> None:
    """Eq. 10."""
    graph, given = setup(kind, gamma)
    f, d, _ = pairwise(kind, gamma)
    lq = ops.gradient_norm(f, graph, q, **given)
    assert_allclose(lq, (np.abs(d) ** q).sum(axis=1) ** (1 / q), rtol=1e-12, atol=1e-13)


def pairwise(kind: str, gamma: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A function, its differences and gamma, the latter two as matrices over pairs of vertices."""
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
    return f, d, G


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
    numeric = []
    for u in range(0, graph.n_vertices, 3):
        step = np.zeros_like(f)
        step[u, 1] = h
        numeric.append((energy(f + step) - energy(f - step)) / (2 * h))
    assert_allclose(numeric, slope[::3, 1], rtol=0, atol=1e-6 * np.abs(slope).max())


def test_table_1() -> None:
    """E6, E7: gamma_1 gives L, gamma_2 gives L_n, sqrt(w) gives 2 L; <f, L f> is the energy of gamma = sqrt(w)."""
    graph = graphs()["stored"]
    f = cases.function(graph)
    W = graph.to_scipy().astype(float)
    degree = np.asarray(W.sum(axis=1)).ravel()
    L = np.diag(degree) - W.toarray()
    root = np.where(degree > 0, 1 / np.sqrt(np.where(degree > 0, degree, 1)), 0)
    matrices = {"combinatorial": L, "normalized": root[:, None] * L * root, "sqrt": 2 * L}
    found = np.stack([ops.laplacian(f, graph, gamma=gamma, **ORACLE) for gamma in matrices])
    assert_allclose(found, np.stack([matrix @ f for matrix in matrices.values()]), atol=1e-13)
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


@both_norms
@pytest.mark.parametrize("p", P)
def test_scale_of_gamma(p: float, norm: str) -> None:
    """E8: gamma -> c gamma scales the energy and the p-Laplacian by c^p, eps by c."""
    graph, c, eps = graphs()["stored"], 3.0, 0.1
    f = cases.function(graph)
    root = np.sqrt(graph.to_scipy().data.astype(float))
    plain = ops.p_laplacian(f, graph, p, eps=eps, norm=norm, gamma=root, **ORACLE)
    scaled = ops.p_laplacian(f, graph, p, eps=c * eps, norm=norm, gamma=c * root, **ORACLE)
    assert_allclose(scaled, c**p * plain, rtol=0, atol=1e-13 * np.abs(scaled).max())
    assert_allclose(plain, ops.p_laplacian(f, graph, p, eps=eps, norm=norm, **ORACLE), rtol=1e-10, atol=1e-12)
