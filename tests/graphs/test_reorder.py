"""Vertices in another order: the same graph, the same results, and nearer neighbours."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import gpureg as gr


@pytest.mark.parametrize("name", ["csr", "csr of grid", "csr of disk", "csr, one vertex"])
@pytest.mark.parametrize("given", [False, True])
def test_the_same_graph(name, given):
    graph = cases.graph(name)
    order = cases.rng(31).permutation(graph.n_vertices) if given else None
    new, found = gr.reordered(graph, order)
    assert_array_equal(np.sort(found), np.arange(graph.n_vertices))
    before, after = graph.to_scipy(), new.to_scipy()
    assert_array_equal(after.toarray(), before[found][:, found].toarray())
    if graph.positions is not None:
        assert_array_equal(new.positions, graph.positions[found])
    back, _ = gr.reordered(new, np.argsort(found))
    assert_array_equal(back.indices, graph.indices)
    assert_array_equal(back.indptr, graph.indptr)
    if given:
        assert_array_equal(found, order)


def test_neighbours_come_nearer():
    grid = gr.GridGraph((30, 30)).to_graph()
    mixed, _ = gr.reordered(grid, cases.rng(7).permutation(900))
    found, _ = gr.reordered(mixed)

    def reach(graph):
        return np.abs(graph.edge_rows() - graph.indices).max()

    # a front of one row and its neighbours; row by row it is 31
    assert reach(mixed) > 600 and reach(found) <= 2 * 31


def test_results_come_back(device):
    graph = cases.graph("csr")
    f0, lam = cases.function(graph, 3), cases.fidelity(graph)[:, 0]
    new, order = gr.reordered(graph)
    run = dict(p=1.5, max_iter=20, backend=device, dtype=np.float64)
    plain = gr.regularize(f0, graph, lam=lam, **run).value
    there = gr.regularize(f0[order], new, lam=lam[order], **run).value
    back = np.empty_like(there)
    back[order] = there
    assert_allclose(back, plain, rtol=0, atol=cases.TOLERANCES["float64"] * np.abs(plain).max())


def test_a_grid_is_refused():
    with pytest.raises(TypeError, match="graph must be a Graph, got a GridGraph"):
        gr.reordered(gr.GridGraph((3, 3)))


@pytest.mark.parametrize("order", [np.zeros(613, int), np.arange(612), np.arange(613.0)])
def test_wrong_orders(order):
    with pytest.raises(ValueError, match="each of the 613 vertices once"):
        gr.reordered(cases.graph("csr"), order)
