"""The numpy backend (float64) against the paper's equations as literal loops."""

from __future__ import annotations

import math

import cases
import numpy as np
import paper
import pytest
from literal import Form, assert_close, both_forms, channel_kinds, literal, small_graphs

import gpureg as gr
from gpureg.backends import PatchForm, Smoothness
from gpureg.graphs.csr import Graph


@small_graphs
def test_the_small_graphs_are_small_and_have_edges(name):
    assert literal(name).graph.n_vertices < 30
    assert literal(name).graph.n_edges > 0 or name in ("pixel", "csr, one vertex")


@small_graphs
def test_degree(oracle, name):
    case = literal(name)
    expected = [[paper.degree(case.E, case.w, u)] for u in case.V]
    assert_close(oracle.degree(case.weighted(oracle, name)), expected)


@small_graphs
@channel_kinds
def test_local_variation(oracle, name, channels, coupled):
    """Eq. 9 and 15; power 1/2 of |grad f|^2 + eps^2 is the norm."""
    case = literal(name)
    f = cases.function(case.graph, channels)
    norms = paper.norms(case.V, case.E, case.gamma, case.functions(f), cases.EPS, coupled)
    actual = oracle.gradient_norm(case.weighted(oracle, name), f, power=0.5, eps=cases.EPS, coupled=coupled)
    assert_close(actual, case.array(norms[:1] if coupled else norms))


@pytest.mark.parametrize("p", cases.P_ALL)
@small_graphs
@channel_kinds
def test_p_laplacian_and_energy(oracle, name, channels, coupled, p):
    """Eq. 12, 19 and 20, with lam per vertex: some without data, some pinned."""
    case = literal(name)
    weighted = case.weighted(oracle, name)
    f, f0 = cases.function(case.graph, channels), cases.function(case.graph, channels, seed=13)
    lam = cases.fidelity(case.graph)
    fs, f0s, (lams,) = case.functions(f), case.functions(f0), case.functions(lam)
    norms = paper.norms(case.V, case.E, case.gamma, fs, cases.EPS, coupled)

    g = None
    if p != 2:
        g = oracle.gradient_norm(weighted, f, power=(p - 2) / 2, eps=cases.EPS, coupled=coupled)
    laplacian = [
        {u: paper.p_laplace(case.E, case.gamma, one, u, p, norm) for u in case.V}
        for one, norm in zip(fs, norms, strict=True)
    ]
    assert_close(oracle.p_laplacian(weighted, f, g), case.array(laplacian))

    energy = paper.energy(case.V, case.E, case.gamma, fs, f0s, lams, p, cases.EPS, coupled)
    actual = oracle.energy(weighted, f, f0, lam, Smoothness(p, cases.EPS, coupled))
    assert_close(actual, energy)


@pytest.mark.parametrize("theta", [1.0, 0.625])
@pytest.mark.parametrize("p", cases.P_ALL)
@small_graphs
@channel_kinds
def test_sweep(oracle, name, channels, coupled, p, theta):
    """Eq. 25 and 31, with lam per vertex, from the conductances and with them."""
    case = literal(name)
    weighted, model = case.weighted(oracle, name), Smoothness(p, cases.EPS, coupled)
    f, f0 = cases.function(case.graph, channels), cases.function(case.graph, channels, seed=13)
    lam = cases.fidelity(case.graph)
    fs, f0s, (lams,) = case.functions(f), case.functions(f0), case.functions(lam)
    expected = case.array(paper.jacobi_step(case.V, case.E, case.gamma, fs, f0s, lams, p, cases.EPS, coupled, theta))
    g = oracle.conductances(weighted, f, model)
    assert_close(oracle.jacobi_step(weighted, f, f0, g, lam, theta=theta), expected)
    swept = oracle.sweep(weighted, f, f0, lam, model, theta=theta, g=None, out=np.full_like(f, np.nan))
    assert_close(swept, expected)


@pytest.fixture
def form(oracle, name, directed):
    return Form(oracle, name, directed)


@both_forms
@small_graphs
@pytest.mark.parametrize("channels", [1, 3])
def test_difference_and_adjoint(oracle, form, channels):
    """Eq. 4 and 7, and eq. 6, which makes one the adjoint of the other."""
    case = form.case
    f = cases.function(case.graph, channels)
    fs = case.functions(f)
    d = oracle.difference(form.weighted, f)
    expected = [[paper.difference(form.gamma, one, u, v) for one in fs] for u, v in form.edges]
    assert_close(form.from_host(d), np.array(expected).reshape(len(form.edges), channels))
    H = cases.rng(37).random((len(form.edges), channels)) - 0.5
    Hs = [dict(zip(form.edges, column, strict=True)) for column in H.T.tolist()]
    expected = [[paper.adjoint(form.E, form.gamma, one, u) for one in Hs] for u in case.V]
    adjoint = oracle.adjoint(form.weighted, form.to_host(H))
    assert_close(adjoint, expected)
    products = (form.from_host(d) * H).sum(), (f * adjoint).sum()
    assert_close(products[0], products[1], scale=np.abs(f).sum() * np.abs(adjoint).max(initial=0))


@pytest.mark.parametrize("p", (0.5, 1.0, 1.5, 2.0, 3.0))
@both_forms
@small_graphs
@channel_kinds
def test_lp_norm(oracle, form, channels, coupled, p):
    """Eq. 10, for gamma = sqrt(w) and for gamma as an array."""
    case = form.case
    f = cases.function(case.graph, channels)
    on_edges = paper.edge_norms(form.E, form.gamma, case.functions(f), 0.0, coupled)
    expected = [{u: paper.lp_norm(form.E, norm, u, p) for u in case.V} for norm in on_edges]
    actual = oracle.gradient_norm(form.weighted, f, power=1 / p, eps=0.0, coupled=coupled, edge_power=p / 2)
    assert_close(actual, case.array(expected[:1] if coupled else expected))


@pytest.mark.parametrize("edge", [False, True], ids=["vertex", "edge"])
@pytest.mark.parametrize("p", (0.5, 1.0, 1.5, 2.0, 3.0))
@both_forms
@small_graphs
@channel_kinds
def test_both_norms_and_processes(oracle, form, channels, coupled, p, edge):
    """Eq. 12, 20, 24, 25 and 30, for gamma = sqrt(w) and for gamma as an array."""
    case, E, gamma, weighted = form.case, form.E, form.gamma, form.weighted
    f, f0 = cases.function(case.graph, channels), cases.function(case.graph, channels, seed=13)
    lam, tau = cases.fidelity(case.graph), 0.25 + cases.rng(3).random((case.graph.n_vertices, 1))
    fs, f0s = case.functions(f), case.functions(f0)
    (lams,), (taus,) = case.functions(lam), case.functions(tau)
    eps = cases.EPS

    norms = paper.norms(case.V, E, gamma, fs, eps, coupled)
    model = Smoothness(p, eps, coupled, edge)
    g = oracle.conductances(weighted, f, model)
    if edge:
        slopes = [
            {u: paper.edge_p_laplace(E, gamma, one, u, p, norm) for u in case.V}
            for one, norm in zip(fs, paper.edge_norms(E, gamma, fs, eps, coupled), strict=True)
        ]
    else:
        slopes = [
            {u: paper.p_laplace(E, gamma, one, u, p, norm) for u in case.V} for one, norm in zip(fs, norms, strict=True)
        ]
    assert_close(oracle.p_laplacian(weighted, f, g), case.array(slopes))
    energy = paper.energy(case.V, E, gamma, fs, f0s, lams, p, eps, coupled, edge)
    assert_close(oracle.energy(weighted, f, f0, lam, model), energy)
    stepped = paper.jacobi_step(case.V, E, gamma, fs, f0s, lams, p, eps, coupled, 0.625, edge)
    assert_close(oracle.jacobi_step(weighted, f, f0, g, lam, theta=0.625), case.array(stepped))
    stepped = paper.euler_step(case.V, E, gamma, fs, f0s, lams, taus, p, eps, coupled, edge)
    assert_close(oracle.euler_step(weighted, f, f0, g, lam, tau), case.array(stepped))


@small_graphs
@pytest.mark.parametrize("lam", [0.0, 0.75, math.inf])
def test_one_lam_for_all_vertices(oracle, name, lam):
    case = literal(name)
    weighted = case.weighted(oracle, name)
    f, f0 = cases.function(case.graph), cases.function(case.graph, seed=13)
    lams = dict.fromkeys(case.V, lam)
    fs, f0s = case.functions(f), case.functions(f0)
    expected = paper.jacobi_step(case.V, case.E, case.gamma, fs, f0s, lams, 2, cases.EPS, True)
    assert_close(oracle.jacobi_step(weighted, f, f0, None, lam), case.array(expected))
    energy = paper.energy(case.V, case.E, case.gamma, fs, f0s, lams, 2, cases.EPS, True)
    assert_close(oracle.energy(weighted, f, f0, lam, Smoothness(2, cases.EPS)), energy)


def test_a_vertex_that_nothing_reaches_keeps_its_data(oracle):
    """0/0 in eq. 25 (lam 0, no weight around the vertex) is defined as f0, not as f."""
    graph = Graph.from_edges([[0, 1], [2, 3]], [1.0, 0.0], n_vertices=5)
    f, f0 = cases.function(graph, seed=5), cases.function(graph, seed=7)
    step = oracle.jacobi_step(oracle.prepare(graph, None), f, f0, None, 0.0)
    assert_close(step, [f[1], f[0], f0[2], f0[3], f0[4]])


@pytest.mark.parametrize("block", [1, 7])
def test_blocks_of_edges_do_not_show(oracle, monkeypatch, block):
    """The oracle takes a stored graph some rows at a time; a row longer than a block is one block."""
    graph = cases.graph("small csr")
    f, f0 = cases.function(graph, 2), cases.function(graph, 2, seed=13)
    weighted = oracle.prepare(graph, None)
    whole = oracle.jacobi_step(weighted, f, f0, None, 0.0)
    form = PatchForm(np.ones(1), scale=1.0)
    whole_weights = oracle.get_weights(oracle.patch_distance(graph, f, form))
    monkeypatch.setattr("gpureg.backends.numpy.edges._BLOCK", block)
    assert_close(oracle.jacobi_step(weighted, f, f0, None, 0.0), whole)
    assert_close(oracle.get_weights(oracle.patch_distance(graph, f, form)), whole_weights)


GAMMAS = {
    "sqrt": paper.gamma_sqrt,
    "combinatorial": paper.gamma_combinatorial,
    "normalized": paper.gamma_normalized,
    "degree": paper.gamma_degree,
}


@pytest.mark.parametrize("name", ["small grid", "small masked", "small csr", "pixel", "csr, one vertex"])
@pytest.mark.parametrize("gamma", GAMMAS)
@pytest.mark.parametrize("edge", [False, True], ids=["vertex", "edge"])
@pytest.mark.parametrize("p", (1.0, 2.0, 3.0))
def test_named_gammas(name, gamma, edge, p):
    """Table I, and sqrt(w/deg u): the p-Laplacian, the energy and a step that the operators and the solver take."""
    case, half = literal(name), cases.weights(name)
    weights = None if half is None else case.graph.edges.gather_half(half)
    values = GAMMAS[gamma](case.E, case.w)
    f, f0, lam, eps = cases.function(case.graph, 2), cases.function(case.graph, 2, seed=13), 0.75, cases.EPS
    fs, f0s, lams = case.functions(f), case.functions(f0), dict.fromkeys(case.V, lam)
    given = {"gamma": gamma, "weights": weights, "backend": "numpy", "dtype": np.float64, "eps": eps}
    given["norm"] = "edge" if edge else "vertex"
    if edge:
        found = paper.edge_norms(case.E, values, fs, eps, True)
        slopes = [
            {u: paper.edge_p_laplace(case.E, values, one, u, p, norm) for u in case.V}
            for one, norm in zip(fs, found, strict=True)
        ]
    else:
        found = paper.norms(case.V, case.E, values, fs, eps, True)
        slopes = [
            {u: paper.p_laplace(case.E, values, one, u, p, norm) for u in case.V}
            for one, norm in zip(fs, found, strict=True)
        ]
    assert_close(gr.operators.p_laplacian(f, case.graph, p, **given), case.array(slopes))
    energy = paper.energy(case.V, case.E, values, fs, f0s, lams, p, eps, True, edge)
    assert_close(gr.operators.energy(f, f0, case.graph, p, lam, **given), energy)
    stepped = paper.jacobi_step(case.V, case.E, values, fs, f0s, lams, p, eps, True, 1.0, edge)
    solver = gr.Jacobi(damping=1)
    moved = gr.regularize(f0, case.graph, initial=f, p=p, lam=lam, max_iter=1, solver=solver, **given)
    assert_close(moved.value, case.array(stepped))
