"""gr.operators against the equations with gamma(u, v) written out, on every device."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from cases import EPS, TOLERANCES, function, graph, irregular

import gpureg as gr

GAMMAS = ("sqrt", "combinatorial", "normalized", "degree")


def gamma_matrix(made: gr.Graph, gamma: str) -> np.ndarray:
    W = made.to_scipy().toarray().astype(np.float64)
    degree = W.sum(axis=1)
    inverse = np.divide(1, degree, out=np.zeros_like(degree), where=degree > 0)[:, None]
    return np.sqrt({"sqrt": W, "combinatorial": W / 2, "normalized": W * inverse / 2, "degree": W * inverse}[gamma])


class Dense:
    """Eq. 4, 9, 12 and 20 over the full matrix gamma, without p = 2 or gamma = sqrt(w) as special cases."""

    def __init__(self, made: gr.Graph, gamma: str, f: np.ndarray, eps: float, coupled: bool) -> None:
        G = gamma_matrix(made, gamma)[:, :, None]
        self.d = G.swapaxes(0, 1) * f[None] - G * f[:, None]  # d[u, v] = gamma_vu f(v) - gamma_uv f(u)
        self.G, square = G, (self.d**2).sum(axis=1)
        self.norm = np.sqrt((square.sum(axis=1, keepdims=True) if coupled else square) + eps**2)

    def p_laplacian(self, p: float) -> np.ndarray:
        g = self.norm ** (p - 2)
        return -(self.G * (g[:, None] + g[None]) * self.d).sum(axis=1)

    def dirichlet_energy(self, p: float) -> float:
        return (self.norm**p).sum() / p


@functools.cache
def dense(gamma: str, coupled: bool) -> tuple[gr.Graph, np.ndarray, Dense, dict]:
    """A graph, a function, what the equations make of them, and settings."""
    made = irregular(23, 80, isolated=7)
    f = function(made, 3)
    settings = {"gamma": gamma, "eps": EPS, "coupled": coupled, "backend": "numpy", "dtype": np.float64}
    return made, f, Dense(made, gamma, f, EPS, coupled), settings


either_coupling = pytest.mark.parametrize("coupled", [True, False])
every_gamma = pytest.mark.parametrize("gamma", GAMMAS)


@either_coupling
@every_gamma
def test_gradient_norm_for_every_gamma(gamma: str, coupled: bool) -> None:
    made, f, known, settings = dense(gamma, coupled)
    norm = gr.operators.gradient_norm(f, made, **settings)
    assert np.abs(norm - (known.norm[:, 0] if coupled else known.norm)).max() < 1e-14


@either_coupling
@every_gamma
@pytest.mark.parametrize("p", [0.5, 1, 1.5, 2, 3])
def test_operators_for_every_gamma(gamma: str, coupled: bool, p: float) -> None:
    made, f, known, settings = dense(gamma, coupled)
    f0, expected = function(made, 3, seed=13), known.p_laplacian(p)
    assert np.abs(gr.operators.p_laplacian(f, made, p, **settings) - expected).max() < 1e-13 * np.abs(expected).max()
    energy = known.dirichlet_energy(p)
    assert gr.operators.dirichlet_energy(f, made, p, **settings) == pytest.approx(energy, rel=1e-13)
    whole = energy + 0.35 * ((f - f0) ** 2).sum()
    assert gr.operators.energy(f, f0, made, p, 0.7, **settings) == pytest.approx(whole, rel=1e-13)


@pytest.mark.parametrize("gamma", ["sqrt", "combinatorial", "normalized"])
def test_laplacians_of_the_literature(gamma: str) -> None:
    made = irregular(23, 80, isolated=7)
    f = function(made)
    W = made.to_scipy().toarray().astype(np.float64)
    degree = W.sum(axis=1)
    L = np.diag(degree) - W
    scale = np.where(degree > 0, 1 / np.sqrt(np.where(degree > 0, degree, 1)), 0)
    # the normalized one is 0 at the isolated vertex
    matrix = {"sqrt": 2 * L, "combinatorial": L, "normalized": scale[:, None] * L * scale}[gamma]
    found = gr.operators.laplacian(f, made, gamma=gamma, backend="numpy", dtype=np.float64)
    assert np.abs(found - matrix @ f).max() < 1e-13


def test_curvature_is_the_laplacian_of_1() -> None:
    made = irregular(23, 80, isolated=7)
    f, settings = function(made), {"eps": 0.1, "backend": "numpy", "dtype": np.float64}
    curvature = gr.operators.curvature(f, made, **settings)
    assert np.array_equal(curvature, gr.operators.p_laplacian(f, made, 1, **settings))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_every_device(device: str, dtype: str) -> None:
    grid = graph("grid")
    f = function(grid, 3)
    settings = {"eps": EPS, "weights": gr.weights.bilateral(2.0, 0.5), "gamma": "degree", "dtype": dtype}
    try:
        found = gr.operators.p_laplacian(f, grid, 0.7, backend=device, **settings)
    except gr.BackendUnavailable:
        return  # a device without float64
    oracle = gr.operators.p_laplacian(f, grid, 0.7, backend="numpy", **{**settings, "dtype": "float64"})
    assert found.dtype == dtype
    assert np.abs(found - oracle).max() <= TOLERANCES[dtype] * np.abs(oracle).max()


@pytest.mark.parametrize(
    ("shape", "coupled", "expected"),
    [
        ((4, 5), True, (4, 5)),
        ((4, 5), False, (4, 5)),
        ((4, 5, 3), True, (4, 5)),
        ((4, 5, 3), False, (4, 5, 3)),
        ((4, 5, 1), True, (4, 5)),
        ((20,), True, (20,)),
        ((20, 3), True, (20,)),
    ],
)
def test_shapes(shape: tuple[int, ...], coupled: bool, expected: tuple[int, ...]) -> None:
    grid, f = gr.GridGraph((4, 5)), np.zeros(shape)
    assert gr.operators.gradient_norm(f, grid, coupled=coupled, backend="numpy").shape == expected
    assert gr.operators.laplacian(f, grid, backend="numpy").shape == shape


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda f, g: gr.operators.energy(f, f, g, 2, 1, eps="0"), "energy: eps must be a number, got '0'"),
        (lambda f, g: gr.operators.dirichlet_energy(f, g, "2"), "dirichlet_energy: p must be a number, got '2'"),
        (lambda f, g: gr.operators.laplacian(f, g, coupled=1), "laplacian: coupled must be True or False, got 1"),
        (lambda f, g: gr.operators.laplacian(f, g, lam=1), r"laplacian\(\) got an unexpected keyword argument 'lam'"),
        (lambda f, g: gr.operators.curvature(f, g, eps=None), "curvature: eps must be a number, got None"),
        (
            lambda f, g: gr.operators.edge_derivative(f, "g", [[0, 1]]),
            "edge_derivative: graph must be a Graph, a GridGraph",
        ),
        (lambda f, g: gr.operators.divergence(f, "g"), "divergence: graph must be a Graph, a GridGraph, .*, got str"),
        (
            lambda f, g: gr.operators.markov_matrix("g"),
            "markov_matrix: graph must be a Graph, a GridGraph, .*, got str",
        ),
    ],
)
def test_an_error_names_the_operator_that_was_called(call, says: str) -> None:
    with pytest.raises(TypeError, match=says):
        call(np.arange(20.0), gr.GridGraph((4, 5)))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda f, g: gr.operators.p_laplacian(f, g, 1, backend="numpy"), "eps = 0 is too small for p = 1"),
        (lambda f, g: gr.operators.p_laplacian(f, g, 0, backend="numpy"), "p must be finite and > 0"),
        (lambda f, g: gr.operators.laplacian(f[:5], g, backend="numpy"), "f0 must have shape"),
        (lambda f, g: gr.operators.energy(f, np.zeros((20, 2)), g, 2, 1, backend="numpy"), "same shape"),
        (lambda f, g: gr.operators.energy(f, f, g, 2, -1, backend="numpy"), "lam must be >= 0"),
        (lambda f, g: gr.operators.laplacian(f, g, dtype=int), "dtype must be float32 or float64, got int64"),
        (lambda f, g: gr.operators.laplacian(f, g, dtype="word"), "dtype must be float32 or float64, got 'word'"),
    ],
)
def test_wrong_arguments(call, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        call(np.arange(20.0), gr.GridGraph((4, 5)))
