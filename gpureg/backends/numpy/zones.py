"""Partitions by Dijkstra's algorithm from scipy: the reference for the devices."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import numpy.typing as npt

from ...arrays import IntArray
from ...graphs.csr import Graph
from ...graphs.grid import AnyGraph
from ..zones import Distances, Labels, Lengths, Zones


def _directed(graph: AnyGraph, lengths: Lengths) -> tuple[IntArray, IntArray, Lengths]:
    """Return start, end and length of the directed edges that paths can use, (edges,) each."""
    if isinstance(graph, Graph):
        there = lengths >= 0
        return graph.edge_rows()[there], graph.indices[there].astype(np.int64), lengths[there]
    starts, ends, along = [], [], []
    for h, jump in enumerate(graph.steps):
        u = np.flatnonzero(lengths[:, h] >= 0)
        starts += [u, u + jump]
        ends += [u + jump, u]
        along += [lengths[u, h]] * 2
    none = [np.empty(0, np.int64)]
    return np.concatenate(starts or none), np.concatenate(ends or none), np.concatenate(along or none).astype(np.int32)


def _matrix(n: int, u: IntArray, v: IntArray, values: npt.NDArray[Any]) -> Any:
    from scipy import sparse

    # explicit zeros remain, as edges of length 0; no edge occurs twice, so none are summed
    return sparse.coo_array((values, (u, v)), shape=(n, n)).tocsr()


class NumpyZones(Zones):
    """Zones by Dijkstra's algorithm in float64, in which sums of integers up to 2^53 are exact."""

    def influence_zones(self, graph: AnyGraph, lengths: Lengths, sources: Labels) -> tuple[Distances, Labels]:
        from scipy.sparse.csgraph import dijkstra

        n = graph.n_vertices
        u, v, length = _directed(graph, lengths)
        first = np.flatnonzero(sources >= 0)
        labels: Labels = np.full(n, -1, np.int32)
        if not len(first):
            return np.full(n, -1), labels
        labels[first] = sources[first]
        mu = dijkstra(_matrix(n, u, v, length.astype(np.float64)), indices=first, min_only=True)
        # the edges of shortest paths, and the smallest number of them from a source to each vertex
        tight = np.isfinite(mu[u]) & (mu[u] + length == mu[v])
        u, v = u[tight], v[tight]
        edges = dijkstra(_matrix(n, u, v, np.ones(len(u))), indices=first, min_only=True, unweighted=True)
        fewest = edges[u] + 1 == edges[v]
        u, v = u[fewest], v[fewest]
        # A vertex takes the smallest label of its predecessors, which already have their labels.
        order = np.argsort(edges[v], kind="stable")
        u, v = u[order], v[order]
        ends = np.searchsorted(edges[v], np.arange(1, int(edges[v].max(initial=0)) + 2))
        unset = np.iinfo(np.int32).max
        labels[labels < 0] = unset
        for begin, end in itertools.pairwise(ends):
            np.minimum.at(labels, v[begin:end], labels[u[begin:end]])
        reached = np.isfinite(mu)
        return np.where(reached, mu, -1).astype(np.int64), np.where(reached, labels, -1).astype(np.int32)

    def flat_zones(self, graph: AnyGraph, lengths: Lengths) -> Labels:
        from scipy.sparse.csgraph import connected_components

        u, v, length = _directed(graph, lengths)
        flat = length == 0
        part = connected_components(_matrix(graph.n_vertices, u[flat], v[flat], np.ones(flat.sum())), directed=False)[1]
        smallest: Labels = np.unique(part, return_index=True)[1].astype(np.int32)[part]
        return smallest
