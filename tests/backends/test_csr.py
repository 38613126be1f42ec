"""Stored graphs on the devices: what is uploaded once."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest
from cases import function, irregular
from numpy.testing import assert_array_equal

import gpureg as gr
from gpureg import backends


@pytest.mark.parametrize("weights", [None, gr.weights.inverse_distance(1)], ids=["own", "of the positions"])
def test_a_graph_is_uploaded_once(device: str, weights: gr.weights.Weights | None, monkeypatch) -> None:
    """Calls that differ in p, lam or the data bring the data and the start over, and nothing else."""
    kind = type(backends.get(device))
    if not hasattr(kind, "upload"):
        pytest.skip("numpy works in the host's memory")
    sizes, upload = [], kind.upload

    def counted(self, host, *rest):
        sizes.append(host.size)
        return upload(self, host, *rest)

    monkeypatch.setattr(kind, "upload", counted)
    graph = irregular(613, 2400, isolated=311)
    f0, other = function(graph), function(graph, seed=13)

    def run(values, **settings):
        sizes.clear()
        return gr.regularize(values, graph, weights=weights, max_iter=2, backend=device, **settings).value

    first = run(f0, p=1, lam=0.5)
    assert graph.n_edges in sizes
    brought = []
    for values, settings in ((f0, {"p": 2, "lam": 0.5}), (other, {"p": 1, "lam": 2.0}), (f0, {"p": 1, "lam": 0.5})):
        again = run(values, **settings)
        brought.append(list(sizes))
    assert brought == [[f0.size, f0.size]] * 3
    assert_array_equal(first, again)


def test_weights_that_can_be_written_to_are_read_anew(device: str) -> None:
    graph = irregular(41, 120, isolated=7)
    backend = backends.get(device)
    weights = np.ones(graph.n_edges)
    one = backend.get_weights(backend.prepare(graph, weights))
    weights *= 2
    assert_array_equal(backend.get_weights(backend.prepare(graph, weights)), 2 * one)
    shown = weights[:]
    shown.flags.writeable = False
    backend.prepare(graph, shown)
    weights *= 2
    assert_array_equal(backend.get_weights(backend.prepare(graph, shown)), 4 * one)


@pytest.mark.parametrize(("of_data", "expected"), [(False, 2), (True, 3)], ids=["of the positions", "of the data"])
def test_weights_of_the_positions_are_computed_once_a_graph(of_data: bool, expected: int) -> None:
    class Counted(gr.weights.EdgeWeights):
        reads_data = of_data
        calls = 0

        def between(self, graph, f0, u, v):
            self.calls += 1
            return np.full(len(u), 0.5)

    graph, twin = (irregular(41, 120, isolated=7) for _ in range(2))
    weights = Counted()
    for made in (graph, graph, twin):
        gr.regularize(function(made), made, weights=weights, max_iter=1, backend="numpy")
    assert weights.calls == expected
    # what is kept does not keep the graph
    gone = weakref.ref(twin)
    del twin, made
    gc.collect()
    assert gone() is None
