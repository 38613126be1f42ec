"""Section 4.1: the Markov matrix, its powers and eigenvectors, and filtering by projection."""

from __future__ import annotations

import math

import cases
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse
from scipy.spatial import cKDTree
from test_closed_forms import ngon, solid

import gpureg as gr

spectral = gr.spectral
ORACLE = {"backend": "numpy", "dtype": np.float64}


def cloud(n: int = 150, k: int = 6) -> gr.Graph:
    """A point cloud's nearest neighbours, either way, with Gaussian weights."""
    points = cases.rng(7).random((n, 3))
    distance, near = cKDTree(points).query(points, k + 1)
    pairs = np.unique(np.sort(np.stack([np.repeat(np.arange(n), k), near[:, 1:].ravel()], axis=1), axis=1), axis=0)
    length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return gr.Graph.from_edges(pairs, np.exp(-((length / distance[:, -1].mean()) ** 2)), positions=points)


GRAPHS = {
    "image": lambda: gr.GridGraph((13, 17)),
    "mesh": lambda: solid("icosahedron")[1],
    "cloud": cloud,
    "irregular": lambda: cases.irregular(90, 300, isolated=5),
    "masked": lambda: cases.graph("small masked"),
}
every_graph = pytest.mark.parametrize("kind", GRAPHS)


def weight_matrix(graph: gr.Graph | gr.GridGraph) -> np.ndarray:
    return (graph.to_graph() if isinstance(graph, gr.GridGraph) else graph).to_scipy().toarray().astype(float)


@every_graph
def test_markov_matrix(kind: str) -> None:
    """Rows sum to 1, P = D^-1 W, the spectrum lies in [-1, 1]; an isolated vertex stays where it is."""
    graph = GRAPHS[kind]()
    P, W = gr.operators.markov_matrix(graph), weight_matrix(graph)
    degree = W.sum(axis=1)
    expected = np.where(degree[:, None] > 0, W / np.where(degree > 0, degree, 1)[:, None], np.eye(len(W)))
    assert_allclose(P.toarray(), expected, rtol=0, atol=1e-15)
    assert_allclose(P.sum(axis=1), 1, atol=1e-14)
    a = np.linalg.eigvals(P.toarray())
    assert np.abs(a.imag).max() < 1e-7
    assert a.real.max() <= 1 + 1e-12
    assert a.real.min() >= -1 - 1e-12


@pytest.mark.parametrize(
    ("make", "bipartite"),
    [
        pytest.param(lambda: gr.GridGraph((4, 5), 1, "cityblock"), True, id="cityblock"),
        pytest.param(lambda: gr.GridGraph(9), True, id="path"),
        pytest.param(lambda: gr.GridGraph((4, 5)), False, id="chebyshev"),
        pytest.param(lambda: ngon(6)[1], True, id="hexagon"),
        pytest.param(lambda: ngon(7)[1], False, id="heptagon"),
    ],
)
def test_minus_one_is_an_eigenvalue_of_bipartite_graphs(make, bipartite: bool) -> None:
    """E16: the paper's "a_i >= 0" is false; -1 is there on G_0, and only on bipartite graphs."""
    lowest = np.linalg.eigvals(gr.operators.markov_matrix(make()).toarray()).real.min()
    assert lowest < 0
    assert (lowest < -1 + 1e-12) == bipartite


@every_graph
@pytest.mark.parametrize("p", (0.5, 1.0, 2.0))
def test_averaging_form_is_a_sweep(kind: str, p: float) -> None:
    """Eq. 26 (with phi_uu for the printed phi_vv, E13) is a sweep of eq. 25, lam 0 and infinite included."""
    graph = GRAPHS[kind]()
    f0, f = cases.function(graph, 3), cases.function(graph, 3, seed=13)
    lam = cases.fidelity(graph)[:, 0]
    data, neighbours = spectral.averaging_filter(graph, f, p=p, lam=lam, eps=0.1)
    assert_allclose(data + neighbours.sum(axis=1), 1, atol=1e-13)
    sweep = gr.regularize(f0, graph, p=p, lam=lam, eps=0.1, initial=f, max_iter=1, **ORACLE).value
    inside = np.ones(graph.n_vertices, bool) if getattr(graph, "mask", None) is None else graph.mask.ravel()
    assert_allclose((data[:, None] * f0 + neighbours @ f)[inside], sweep[inside], atol=1e-12)


def test_matrix_of_other_p_depends_on_f() -> None:
    """(28) holds for p = 2 alone (E16)."""
    graph, f = cloud(60), cases.function(cloud(60))
    P = gr.operators.markov_matrix(graph, f, p=1, eps=0.1)
    assert_allclose(P.sum(axis=1), 1, atol=1e-13)
    once = gr.regularize(f, graph, p=1, lam=0, eps=0.1, max_iter=1, **ORACLE).value
    twice = gr.regularize(f, graph, p=1, lam=0, eps=0.1, max_iter=2, **ORACLE).value
    assert_allclose(P @ f, once, atol=1e-13)
    assert np.abs(P @ (P @ f) - twice).max() > 1e-4


@every_graph
def test_powers(kind: str) -> None:
    """P^t f0 is t plain sweeps, and the expansion sum a_i^t <f0, phi_i>_delta phi_i over all n eigenpairs."""
    graph = GRAPHS[kind]()
    f0, t, n = cases.function(graph, 2), 7, graph.n_vertices
    found = spectral.diffuse(f0, graph, t)
    sweeps = gr.regularize(f0, graph, p=2, lam=0, max_iter=t, solver=gr.Jacobi(damping=1), **ORACLE).value
    inside = np.ones(n, bool) if getattr(graph, "mask", None) is None else graph.mask.ravel()
    assert_allclose(found[inside], sweeps[inside], atol=1e-12)
    a, phi, degree = spectral.eigenpairs(graph, n)
    assert_allclose(phi @ (a[:, None] ** t * (phi.T @ (degree[:, None] * f0))), found, atol=1e-11)
    assert np.array_equal(spectral.diffuse(f0, graph, 0), f0)


@every_graph
def test_eigenvectors(kind: str) -> None:
    """P phi = a phi, orthonormal with the degree as weight to rounding, and not in the Euclidean product (E16)."""
    graph, k = GRAPHS[kind](), 9
    a, phi, degree = spectral.eigenpairs(graph, k)
    assert (np.diff(a) <= 1e-12).all()
    assert a[0] == pytest.approx(1, abs=1e-12)
    assert_allclose(gr.operators.markov_matrix(graph) @ phi, a * phi, atol=1e-11)
    assert_allclose(phi.T @ (degree[:, None] * phi), np.eye(k), atol=1e-12)
    again = spectral.eigenpairs(graph, k)
    assert again.vectors.tobytes() == phi.tobytes()
    if kind == "irregular":
        euclid = phi / np.linalg.norm(phi, axis=0)
        assert np.abs(euclid.T @ euclid - np.eye(k)).max() > 0.05


def test_known_spectra() -> None:
    """Ring: cos(2 pi j/n). Icosahedron: 1 - mu/5, mu = 0, 5 - sqrt5 (3), 6 (5), 5 + sqrt5 (3)."""
    n = 11
    a = spectral.eigenpairs(ngon(n)[1], n).values
    assert_allclose(a, sorted(np.cos(2 * np.pi * np.arange(n) / n), reverse=True), atol=1e-13)
    mu = np.array([0] + [5 - math.sqrt(5)] * 3 + [6] * 5 + [5 + math.sqrt(5)] * 3)
    assert_allclose(spectral.eigenpairs(solid("icosahedron")[1], 12).values, 1 - mu / 5, atol=1e-13)


@pytest.mark.parametrize("radius", [1, 4], ids=["factorised", "plain"])
def test_sparse_and_dense_solvers_agree(monkeypatch: pytest.MonkeyPatch, radius: int) -> None:
    """ARPACK finds what the dense solver does, equal eigenvalues (a square's) as often as they come."""
    grid = gr.GridGraph((18, 18), radius)
    dense = spectral.eigenpairs(grid, 20)
    monkeypatch.setattr("gpureg.spectral.spectrum._DENSE", 0)
    few = spectral.eigenpairs(grid, 20)
    assert_allclose(few.values, dense.values, atol=1e-10)
    f0 = cases.function(grid)
    k = 8 + int(np.argmax(-np.diff(dense.values)[7:]))  # between two different eigenvalues
    whole = spectral.spectral_filter(f0, grid, k, pairs=dense)
    assert_allclose(spectral.spectral_filter(f0, grid, k, pairs=few), whole, atol=1e-8)


def test_as_many_ones_as_parts() -> None:
    graph = gr.Graph.from_edges([[0, 1], [1, 2], [3, 4], [4, 5], [3, 5]], [1, 1, 1, 1, 1], n_vertices=8)
    assert_allclose(spectral.eigenpairs(graph, 5).values[:4], 1, atol=1e-14)  # two parts, two isolated vertices
    assert spectral.eigenpairs(graph, 5).values[4] < 0.99
    assert_allclose(spectral.eigenpairs(graph, 2).values, 1)


@every_graph
def test_filter_keeps_its_span(kind: str) -> None:
    """A function made of the first k eigenvectors comes back to rounding; the rest of a function goes."""
    graph, k = GRAPHS[kind](), 8
    pairs = spectral.eigenpairs(graph, k)
    f = pairs.vectors @ cases.rng(3).standard_normal((k, 2))
    assert_allclose(spectral.spectral_filter(f, graph, k), f, atol=1e-13 * np.abs(f).max() * k)
    noisy = f + cases.rng(5).standard_normal(f.shape) * np.abs(f).max()
    filtered = spectral.spectral_filter(noisy, graph, k, pairs=pairs)
    assert np.linalg.norm(filtered - f) < np.linalg.norm(noisy - f)
    residual = pairs.vectors.T @ (pairs.degree[:, None] * (noisy - filtered))
    assert np.abs(residual).max() < 1e-10
    if isinstance(graph, gr.GridGraph):
        image = f[:, 0].reshape(graph.shape)
        assert spectral.spectral_filter(image, graph, k, pairs=pairs).shape == graph.shape


def test_weights_from_data() -> None:
    grid = gr.GridGraph((9, 12))
    step = np.where(np.arange(12) < 6, 0.0, 1.0) * np.ones((9, 1))
    noisy = step + 0.05 * cases.rng(3).standard_normal(step.shape)
    kept = spectral.spectral_filter(noisy, grid, 2, weights=gr.weights.bilateral(math.inf, 0.3))
    plain = spectral.spectral_filter(noisy, grid, 2)
    assert np.abs(kept - step).max() < 0.1  # the cut between the two sides is the second eigenvector
    assert np.abs(plain - step).max() > 0.3


def test_luxembourg(data_folder) -> None:
    """114,599 street corners: residuals and orthogonality as on small graphs."""
    from scipy.io import mmread

    graph = gr.Graph.from_scipy(mmread(data_folder / "graphs" / "luxembourg_osm.mtx.gz").tocsr())
    a, phi, degree = spectral.eigenpairs(graph, 8)
    P = gr.operators.markov_matrix(graph)
    assert_allclose(np.linalg.norm(np.sqrt(degree)[:, None] * (P @ phi - a * phi), axis=0), 0, atol=1e-9)
    assert_allclose(phi.T @ (degree[:, None] * phi), np.eye(8), atol=1e-11)


def test_the_markov_matrix_is_an_operator() -> None:
    with pytest.raises(AttributeError, match=r"is gpureg\.operators\.markov_matrix"):
        _ = spectral.markov_matrix
    assert not hasattr(spectral, "laplacian")
    assert "markov_matrix" in gr.operators.__all__


@pytest.mark.parametrize(
    ("call", "error", "says"),
    [
        (lambda graph, f: gr.operators.markov_matrix(graph, p=1), ValueError, "depends on f for p = 1: give f"),
        (lambda graph, f: gr.operators.markov_matrix(graph, weights=gr.weights.patch(0, 1)), ValueError, "give f"),
        (lambda graph, f: gr.operators.markov_matrix("graph"), TypeError, "graph must be"),
        (lambda graph, f: spectral.diffuse(f, graph, -1), ValueError, "t must be >= 0, got -1"),
        (lambda graph, f: spectral.diffuse(f, graph, 1.5), TypeError, "t must be an integer, got 1.5"),
        (lambda graph, f: spectral.eigenpairs(graph, 0), ValueError, "k must lie in 1..17, got 0"),
        (lambda graph, f: spectral.eigenpairs(graph, 18), ValueError, "got 18"),
        (lambda graph, f: spectral.eigenpairs(graph, 2.0), TypeError, "eigenpairs: k must be an integer"),
        (lambda graph, f: spectral.eigenpairs([[0, 1]], 2), TypeError, "eigenpairs: graph must be"),
        (
            lambda graph, f: spectral.averaging_filter(graph, f, p="2"),
            TypeError,
            "averaging_filter: p must be a number",
        ),
        (lambda graph, f: spectral.diffuse(f, graph, True), TypeError, "diffuse: t must be an integer, got True"),
        (
            lambda graph, f: spectral.spectral_filter(f, graph, 1.5),
            TypeError,
            "spectral_filter: k must be an integer, got 1.5",
        ),
        (
            lambda graph, f: spectral.spectral_filter(f, graph, 3, pairs=spectral.eigenpairs(graph, 2)),
            ValueError,
            "at least k = 3",
        ),
        (lambda graph, f: spectral.spectral_filter(np.zeros(16), graph, 3), ValueError, "f0 must have shape"),
    ],
)
def test_wrong_arguments(call, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        call(cases.irregular(17, 60, isolated=5), np.zeros(17))


def test_matrix_powers_of_scipy() -> None:
    graph, f = cloud(50), cases.function(cloud(50))
    P = gr.operators.markov_matrix(graph)
    assert_allclose(sparse.linalg.matrix_power(P, 3) @ f, spectral.diffuse(f, graph, 3), atol=1e-13)
