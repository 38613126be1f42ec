"""Graphs and functions as the literal loops of paper.py take them, and how their results compare with arrays."""

from __future__ import annotations

import functools

import cases
import numpy as np
import paper
import pytest
from numpy.testing import assert_allclose

from gpureg.graphs.grid import GridGraph

# Both sides compute in float64 (u = 1.1e-16) and differ in the order of their sums alone. The counting of
# cases.TOLERANCES gives 1498 u = 1.7e-13 for 80 neighbours and 3 channels; the graphs here have at most 26. All
# comparisons are relative to the largest number of the compared array, because sums cancel at some vertices.
RTOL = 1e-12


def assert_close(actual, expected, scale=None):
    expected = np.asarray(expected)
    largest = np.abs(expected).max(initial=0) if scale is None else scale
    assert_allclose(actual, expected, rtol=0, atol=RTOL * largest + 1e-300)


class Literal:
    """A case as the loops take it: vertices and edges found without gpureg, values under the vertices' names."""

    def __init__(self, name):
        self.graph = cases.graph(name)
        weights = cases.weights(name)
        if isinstance(self.graph, GridGraph):
            grid = self.graph
            self.V = paper.pixels(grid.shape)
            inside = [u for u in self.V if grid.mask is None or grid.mask[u]]
            self.E = paper.k_graph(inside, grid.radius, grid.metric, grid.spacing)
            self.w = dict.fromkeys(self.E, 1.0)
            if weights is not None:
                # A weight is stored once, at the end of the edge that comes first, under the number of its step.
                numbers = {tuple(step): h for h, step in enumerate(grid.forward_offsets.tolist())}
                for u, v in self.E:
                    if u < v:
                        step = tuple(b - a for a, b in zip(u, v, strict=True))
                        self.w[u, v] = self.w[v, u] = float(weights[numbers[step]][u])
        else:
            matrix = self.graph.to_scipy().toarray()
            stored = (self.graph.to_scipy() != 0).toarray()
            self.V = list(range(len(matrix)))
            # edges of weight 0 are left out here: they must not matter
            self.E = {(int(u), int(v)) for u, v in np.argwhere(stored)}
            self.w = {(u, v): float(matrix[u, v]) for u, v in self.E}
        self.gamma = paper.gamma_sqrt(self.E, self.w)

    def functions(self, f):
        """An array (n, m) as a list of m dictionaries."""
        return [dict(zip(self.V, column, strict=True)) for column in f.T.tolist()]

    def array(self, functions):
        """The reverse, (n, m)."""
        return np.array([[function[u] for function in functions] for u in self.V])

    def weighted(self, oracle, name):
        return oracle.prepare(self.graph, cases.weights(name))


@functools.cache
def literal(name):
    return Literal(name)


CHANNELS = [pytest.param(1, True, id="1"), pytest.param(3, True, id="3"), pytest.param(3, False, id="3 uncoupled")]

small_graphs = pytest.mark.parametrize("name", cases.SMALL)
channel_kinds = pytest.mark.parametrize(("channels", "coupled"), CHANNELS)


class Form:
    """A graph with gamma = sqrt(w), or with random values of gamma, one per directed edge, some of them 0."""

    def __init__(self, oracle, name, directed):
        self.case = case = literal(name)
        self.edges = sorted(case.E) if isinstance(case.graph, GridGraph) else list(self._stored(case.graph))
        if not directed:
            self.gamma, self.weighted = case.gamma, case.weighted(oracle, name)
            if not isinstance(case.graph, GridGraph):
                # stored edges of weight 0 are edges for d_w, with gamma = 0
                self.gamma = {e: self.gamma.get(e, 0.0) for e in self.edges}
            return
        values = cases.rng(31).random(len(self.edges))
        values[::6] = 0
        self.gamma = dict(zip(self.edges, values.tolist(), strict=True)) | dict.fromkeys(case.E - set(self.edges), 0.0)
        self.weighted = oracle.prepare_gamma(case.graph, self.to_host(values[:, None]))

    @staticmethod
    def _stored(graph):
        return zip(graph.edge_rows().tolist(), graph.indices.tolist(), strict=True)

    @property
    def E(self):
        return set(self.edges)

    def to_host(self, values):
        """One row per edge, in the form that a backend takes."""
        graph = self.case.graph
        return graph.edges.scatter(values) if isinstance(graph, GridGraph) else values

    def from_host(self, values):
        graph = self.case.graph
        return graph.edges.gather(values) if isinstance(graph, GridGraph) else values


both_forms = pytest.mark.parametrize("directed", [False, True], ids=["sqrt(w)", "gamma"])
