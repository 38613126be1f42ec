"""Facts with a proof, about the numpy backend itself."""

from __future__ import annotations

import itertools
import math

import cases
import numpy as np
import pytest
from literal import assert_close, small_graphs
from numpy.testing import assert_allclose

from gpureg.backends import Smoothness
from gpureg.graphs.csr import Graph


@pytest.mark.parametrize("p", cases.P_ALL)
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("name", ["small grid", "small csr"])
def test_gradient_of_the_energy_is_the_p_laplacian(oracle, name, coupled, p):
    """Property 2 and eq. 21, by central differences.

    With eps = 1/4 and steps of h = 1e-3 the five-point formula is off by h^4/30 times a fifth derivative of the order
    of eps^-4 times the gradient, 1e-11 of it, and by the energy's rounding over h, about 1e-12: 1e-8 leaves room.
    """
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f, f0 = cases.function(graph, 2), cases.function(graph, 2, seed=13)
    lam, eps, h = np.where(np.isinf(cases.fidelity(graph)), 2.0, cases.fidelity(graph)), 0.25, 1e-3

    def energy_at(index, step):
        moved = f.copy()
        moved[index] += step
        return oracle.energy(weighted, moved, f0, lam, Smoothness(p, eps, coupled))

    numeric = np.empty_like(f)
    for index in np.ndindex(f.shape):
        near = energy_at(index, h) - energy_at(index, -h)
        far = energy_at(index, 2 * h) - energy_at(index, -2 * h)
        numeric[index] = (8 * near - far) / (12 * h)
    g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=eps, coupled=coupled)
    analytic = oracle.p_laplacian(weighted, f, g) + lam * (f - f0)
    assert_allclose(numeric, analytic, rtol=0, atol=1e-8 * np.abs(analytic).max())


@pytest.mark.parametrize("p", cases.P)
@pytest.mark.parametrize("lam", [0.0, 0.5, 10.0])
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("name", ["small masked", "small csr"])
def test_a_sweep_never_raises_the_energy(oracle, name, coupled, lam, p):
    """Holds for 0 < p <= 2, eps > 0, lam >= 0: the frozen coefficients give a quadratic majoriser."""
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f0 = cases.function(graph, 2)
    f = f0
    energies = []
    for _ in range(40):
        energies.append(oracle.energy(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled)))
        out = np.full_like(f, np.nan)
        f = oracle.sweep(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled), theta=1.0, g=None, out=out)
    rises = np.diff(energies)
    assert rises.max() <= 1e-14 * energies[0]  # the rounding of a sum of a few dozen numbers
    assert energies[-1] < energies[0]


@pytest.mark.parametrize("p", cases.P_ALL)
@small_graphs
def test_constants_are_fixed_points(oracle, name, p):
    graph = cases.graph(name)
    weighted = oracle.prepare(graph, cases.weights(name))
    f = np.full((graph.n_vertices, 2), 0.7)
    g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=cases.EPS, coupled=True)
    assert_close(g, np.full((graph.n_vertices, 1), cases.EPS ** (p - 2)))
    assert not oracle.p_laplacian(weighted, f, g).any()
    stepped = [oracle.jacobi_step(weighted, f, f, g, lam) for lam in (0.0, 0.5)]
    assert_close(np.stack(stepped), np.stack([f, f]))


def minimise(oracle, graph, f0, lam, p, eps, sweeps):
    weighted = oracle.prepare(graph, None)
    f, out = f0.copy(), np.full_like(f0, np.nan)
    for _ in range(sweeps):
        oracle.sweep(weighted, f, f0, lam, Smoothness(p, eps), theta=1.0, g=None, out=out)
        f, out = out, f
    return f


@pytest.mark.parametrize(("w", "lam"), [*itertools.product([0.25, 1.0, 3.0], [0.5, 4.0])])
def test_one_edge(oracle, w, lam):
    """K2 with a gap d0: at p = 2 the gap becomes lam d0/(lam + 4 w), the mean stays.

    A sweep shrinks the error by 2 w/(lam + 2 w) <= 12/13: 400 sweeps leave 1e-14.
    """
    graph, d0 = Graph.from_edges([[0, 1]], [w]), 3.0
    f = minimise(oracle, graph, np.array([[1.0], [1.0 + d0]]), lam, 2, 0.0, 400)
    assert_allclose(f[1] - f[0], lam * d0 / (lam + 4 * w), rtol=1e-12)
    assert_allclose(f.mean(), 1 + d0 / 2, rtol=1e-12)


@pytest.mark.parametrize("p", [1.0, 1.5])
def test_one_edge_below_two(oracle, p):
    """K2: the gap d solves 2 w^(p/2) d^(p-1) = lam/2 (d0 - d).

    Smoothing by eps moves the minimiser by at most sqrt(2 eps^p/(p lam)) in the root mean square.
    """
    w, lam, d0, eps = 0.25, 4.0, 3.0, 1e-4
    f = minimise(oracle, Graph.from_edges([[0, 1]], [w]), np.array([[1.0], [1.0 + d0]]), lam, p, eps, 400)
    low, high = 0.0, d0
    for _ in range(100):  # bisection: the left side rises with d, the right side falls
        d = (low + high) / 2
        low, high = (low, d) if 2 * w ** (p / 2) * d ** (p - 1) > lam / 2 * (d0 - d) else (d, high)
    if p == 1:
        assert d == pytest.approx(d0 - 4 * math.sqrt(w) / lam)
    assert abs(f[1, 0] - f[0, 0] - d) <= 2 * math.sqrt(2 * eps**p / (p * lam))


@pytest.mark.parametrize(("n", "w", "lam"), [(3, 1.0, 2.0), (7, 0.5, 0.5)])
def test_star(oracle, n, w, lam):
    """A star of n leaves at 0 and a centre at d0: at p = 2, 2 n w d = lam n/(n + 1) (d0 - d).

    A sweep shrinks the error by at most 2 n w/(lam + 2 n w) <= 7/7.5: 600 sweeps leave 1e-18.
    """
    graph, d0 = Graph.from_edges([[0, k] for k in range(1, n + 1)], np.full(n, w)), 2.0
    f0 = np.zeros((n + 1, 1))
    f0[0] = d0
    f = minimise(oracle, graph, f0, lam, 2, 0.0, 600)
    share = lam / (n + 1)
    assert_allclose(f[0] - f[1:, 0], share * d0 / (share + 2 * w), rtol=1e-12)
    assert_allclose(f.sum(), d0, rtol=1e-12)
