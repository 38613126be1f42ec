"""Proximal steps and gaps at the ends of the number range: no false certificate, nothing outside the unit ball."""

from __future__ import annotations

import numpy as np
import pytest

from gpureg import backends
from gpureg.backends import Smoothness
from gpureg.graphs.grid import GridGraph

GRAPH = GridGraph((5, 7), metric="cityblock")


@pytest.mark.one_driver
@pytest.mark.parametrize("edge_norm", [False, True])
@pytest.mark.parametrize("eps", [0.0, 0.01])
@pytest.mark.parametrize(("p", "y"), [(1.01, 1.2), (1.1, 1e3), (1.001, 1.2)])
def test_a_conjugate_too_large_to_write_is_infinite(device, p, y, eps, edge_norm):
    """(y/share)^(1/(p - 1)) overflows: the true gap is beyond float32, or of that size, and never below 0."""
    on = backends.get(device, np.float32)
    weighted = on.prepare(GRAPH, None)
    f = on.put(GRAPH, np.zeros((35, 1)))
    inside = on.get_edges(GRAPH, on.difference(weighted, on.put(GRAPH, np.arange(35.0)[:, None]))) != 0
    edges = on.put_edges(GRAPH, y * inside)
    gap = on.duality_gap(weighted, f, edges, f, 1.0, Smoothness(p, eps, True, edge_norm))
    assert gap > 1e6


@pytest.mark.one_driver
@pytest.mark.parametrize("edge_norm", [False, True])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e8, 1e18])
def test_the_unit_ball_holds_at_every_size(device, size, edge_norm):
    """For p = 1: |y| <= share, and the step points as d f does."""
    on = backends.get(device, np.float32)
    weighted = on.prepare(GRAPH, None)
    f = on.put(GRAPH, size * np.arange(35.0)[:, None])
    y, previous = on.empty_edges(GRAPH, 1), on.empty_edges(GRAPH, 1)
    model = Smoothness(1.0, 0.0, edge=edge_norm)
    found = on.get_edges(GRAPH, on.dual_step(weighted, y, previous, f, f, model, beta=0.0, sigma=1.0))[..., 0]
    norms = np.abs(found) if edge_norm else np.sqrt((found.astype(float) ** 2).sum(axis=0))
    share = 0.5 if edge_norm else 1.0
    assert norms.max() <= share
    slopes = on.get_edges(GRAPH, on.difference(weighted, f))[..., 0]
    assert (found * slopes >= 0).all()
    there = slopes != 0 if edge_norm else (slopes != 0).any(axis=0)
    if size >= 1:
        # every slope is far outside: the step ends on the sphere, 32 roundings and those of a norm inside it
        assert norms[there].min() >= share * (1 - 50 * np.finfo(np.float32).eps)
