"""The V-cycle of multigrid as a preconditioner: symmetric, positive definite, good for any weights."""

import cases
import numpy as np

import gpureg as gr
from gpureg import backends
from gpureg.model.on_device import DeviceProblem
from gpureg.model.problem import Problem
from gpureg.solvers.systems import Multigrid, System

LAM = 1e-3


def stored() -> gr.Graph:
    """A grid of 3000 vertices, with weights over four decades: levels of 3000, 1300, ... vertices."""
    grid = gr.GridGraph((60, 50), 1, "cityblock").to_graph()
    ends = np.stack([grid.edge_rows(), grid.indices], axis=1)
    ends = ends[ends[:, 0] < ends[:, 1]]
    return gr.Graph.from_edges(ends, 10.0 ** cases.rng(2).uniform(-4, 0, len(ends)), n_vertices=grid.n_vertices)


def test_a_cycle_is_symmetric_and_positive_definite() -> None:
    graph = stored()
    x = cases.rng(3).standard_normal((graph.n_vertices, 6))
    problem = Problem.make(x, graph, lam=LAM, dtype=np.dtype(np.float64))
    on = DeviceProblem.put(problem, backends.get("numpy", np.float64))
    by = System.of(on).preconditioner
    assert isinstance(by, Multigrid)
    # one of them is solved by two cycles
    assert [level.again is not None for level in by.cycle.levels] == [False, False, True]
    y = np.empty_like(x)
    by.cycle.solve(on.backend, x, y)
    products = x.T @ y
    assert np.abs(products - products.T).max() <= 1e-10 * np.abs(products).max()
    assert np.linalg.eigvalsh((products + products.T) / 2).min() > 0


def test_few_steps_and_levels_that_are_found_again() -> None:
    graph, f0 = stored(), cases.rng(4).standard_normal(3000)
    given = {"lam": LAM, "backend": "numpy", "dtype": np.float64, "solver": gr.Certified(tol=1e-8)}
    first, again = (gr.regularize(f0, graph, **given) for _ in range(2))
    assert "multigrid" in first.method and first.stop is gr.Stop.GAP
    # measured: 11
    assert first.iterations <= 14
    assert first.value.tobytes() == again.value.tobytes()
    W = graph.to_scipy().toarray()
    A = np.diag(LAM + 2 * W.sum(axis=1)) - 2 * W
    assert np.linalg.norm(first.value - np.linalg.solve(A, LAM * f0)) <= first.error_bound
