"""gr.operators against the equations with gamma(u, v) written out, on every device."""

from __future__ import annotations

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


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("gamma", GAMMAS)
def test_operators_for_every_gamma(gamma: str, coupled: bool) -> None:
    made = irregular(23, 80, isolated=7)
    f, f0 = function(made, 3), function(made, 3, seed=13)
    dense = Dense(made, gamma, f, EPS, coupled)
    settings = {"gamma": gamma, "eps": EPS, "coupled": coupled, "backend": "numpy", "dtype": np.float64}
    norm = gr.operators.gradient_norm(f, made, **settings)
    assert np.abs(norm - (dense.norm[:, 0] if coupled else dense.norm)).max() < 1e-14
    for p in (0.5, 1, 1.5, 2, 3):
        expected = dense.p_laplacian(p)
        assert (
            np.abs(gr.operators.p_laplacian(f, made, p, **settings) - expected).max() < 1e-13 * np.abs(expected).max()
        )
        energy = dense.dirichlet_energy(p)
        assert gr.operators.dirichlet_energy(f, made, p, **settings) == pytest.approx(energy, rel=1e-13)
        whole = energy + 0.35 * ((f - f0) ** 2).sum()
        assert gr.operators.energy(f, f0, made, p, 0.7, **settings) == pytest.approx(whole, rel=1e-13)


def test_special_cases() -> None:
    made = irregular(23, 80, isolated=7)
    f = function(made)
    settings = {"backend": "numpy", "dtype": np.float64}
    W = made.to_scipy().toarray().astype(np.float64)
    degree = W.sum(axis=1)
    L = np.diag(degree) - W
    scale = np.where(degree > 0, 1 / np.sqrt(np.where(degree > 0, degree, 1)), 0)
    Ln = scale[:, None] * L * scale  # 0 at the isolated vertex
    for gamma, matrix in (("sqrt", 2 * L), ("combinatorial", L), ("normalized", Ln)):
        assert np.abs(gr.operators.laplacian(f, made, gamma=gamma, **settings) - matrix @ f).max() < 1e-13
    curvature = gr.operators.curvature(f, made, eps=0.1, **settings)
    assert np.array_equal(curvature, gr.operators.p_laplacian(f, made, 1, eps=0.1, **settings))


def test_every_device(device: str) -> None:
    grid = graph("grid")
    f = function(grid, 3)
    for dtype in ("float32", "float64"):
        settings = {"eps": EPS, "weights": gr.weights.bilateral(2.0, 0.5), "gamma": "degree", "dtype": dtype}
        try:
            found = gr.operators.p_laplacian(f, grid, 0.7, backend=device, **settings)
        except gr.BackendUnavailable:
            continue  # a device without float64
        oracle = gr.operators.p_laplacian(f, grid, 0.7, backend="numpy", **{**settings, "dtype": "float64"})
        assert found.dtype == dtype
        assert np.abs(found - oracle).max() <= TOLERANCES[dtype] * np.abs(oracle).max()


def test_shapes() -> None:
    grid = gr.GridGraph((4, 5))
    for shape, coupled, expected in (
        ((4, 5), True, (4, 5)),
        ((4, 5), False, (4, 5)),
        ((4, 5, 3), True, (4, 5)),
        ((4, 5, 3), False, (4, 5, 3)),
        ((4, 5, 1), True, (4, 5)),
        ((20,), True, (20,)),
        ((20, 3), True, (20,)),
    ):
        f = np.zeros(shape)
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


def test_wrong_arguments() -> None:
    grid = gr.GridGraph((4, 5))
    f = np.arange(20.0)
    for call, says in (
        (lambda: gr.operators.p_laplacian(f, grid, 1, backend="numpy"), "eps = 0 is too small for p = 1"),
        (lambda: gr.operators.p_laplacian(f, grid, 0, backend="numpy"), "p must be finite and > 0"),
        (lambda: gr.operators.laplacian(f[:5], grid, backend="numpy"), "f0 must have shape"),
        (lambda: gr.operators.energy(f, np.zeros((20, 2)), grid, 2, 1, backend="numpy"), "same shape"),
        (lambda: gr.operators.energy(f, f, grid, 2, -1, backend="numpy"), "lam must be >= 0"),
        (lambda: gr.operators.laplacian(f, grid, dtype=int), "dtype must be float32 or float64, got int64"),
        (lambda: gr.operators.laplacian(f, grid, dtype="word"), "dtype must be float32 or float64, got 'word'"),
    ):
        with pytest.raises(ValueError, match=says):
            call()
