"""A step length per vertex in the dual method: within the bound that its convergence needs, and used where it helps."""

from __future__ import annotations

import math

import cases
import numpy as np
import pytest

import gpureg as gr
from gpureg import backends
from gpureg.model.on_device import DeviceProblem
from gpureg.model.problem import Problem
from gpureg.solvers.dual import smallest_around, step_size


def on_numpy(graph, lam, edge_norm):
    f0 = cases.rng(3).random((graph.n_vertices, 1))
    norm = "edge" if edge_norm else "vertex"
    problem = Problem.make(f0, graph, lam=lam, p=1.0, eps=0.0, norm=norm, dtype=np.dtype(float), smoothed=False)
    return DeviceProblem.put(problem, backends.get("numpy", np.float64))


def star_and_path():
    """A hub of 12 neighbours at one end of a path of 30 vertices: the degrees are 12, 2 and 1."""
    edges = [[0, k] for k in range(1, 13)] + [[k, k + 1] for k in range(12, 42)]
    return gr.Graph.from_edges(edges, np.ones(len(edges)))


@pytest.mark.parametrize("edge_norm", [False, True])
def test_the_steps_are_within_their_bound(edge_norm):
    """|sigma^(1/2) d lam^(-1/2)| <= 1 by singular values of the matrix, and at least that of one step for all."""
    graph = star_and_path()
    lam = 0.5 + cases.rng(5).random((graph.n_vertices, 1))
    problem = on_numpy(graph, lam.ravel(), edge_norm)
    sigma = step_size(problem)
    assert isinstance(sigma, np.ndarray)
    units = np.eye(graph.n_vertices)
    d = np.stack([problem.backend.difference(problem.weighted, x[:, None])[:, 0] for x in units], axis=1)
    starts, ends = graph.edge_rows(), graph.indices
    of_edges = np.minimum(sigma[starts, 0], sigma[ends, 0]) if edge_norm else sigma[starts, 0]
    steep = d / np.sqrt(problem.lam[:, 0])
    norm = np.linalg.norm(np.sqrt(of_edges)[:, None] * steep, 2)
    one = np.linalg.norm(math.sqrt(of_edges.min()) * steep, 2)
    assert one <= norm <= 1
    assert np.median(of_edges) > 2 * of_edges.min()  # or nothing is gained


def test_minimum_around_each_vertex():
    for graph in (cases.graph("csr"), gr.GridGraph((5, 7), metric="cityblock")):
        x = cases.rng(7).random((graph.n_vertices, 1))
        stored = graph.to_graph() if isinstance(graph, gr.GridGraph) else graph
        near = np.split(stored.indices, stored.indptr[1:-1])
        expected = [[min([x[u, 0], *x[vs, 0]])] for u, vs in enumerate(near)]
        np.testing.assert_array_equal(smallest_around(graph, x), expected)


def test_one_step_for_all_on_a_grid():
    """Border vertices alone have other degrees, and a pinned vertex bounds nothing."""
    lam = np.full(20 * 20, 3.0)
    assert step_size(on_numpy(gr.GridGraph((20, 20), 1, "cityblock"), 3.0, False)) == pytest.approx(3 / 16)
    lam[7] = np.inf
    assert step_size(on_numpy(gr.GridGraph((20, 20), 1, "cityblock"), lam, True)) == pytest.approx(3 / 16)


@pytest.mark.parametrize("norm", ["vertex", "edge"])
@pytest.mark.parametrize("p", [1.0, 1.5])
def test_the_gap_closes(p, norm):
    graph = star_and_path()
    f0 = cases.rng(11).standard_normal(graph.n_vertices)
    solver = gr.Certified(tol=1e-8, method="dual")
    result = gr.regularize(f0, graph, p=p, lam=0.7, norm=norm, solver=solver, backend="numpy", dtype=np.float64)
    assert "a step length per vertex" in result.method
    assert 0 <= result.gap <= 1e-8 * result.energy[-1]
