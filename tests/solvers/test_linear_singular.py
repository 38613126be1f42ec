"""The linear system of p = 2 where it is singular up to rounding."""

import numpy as np
import pytest

import gpureg as gr


@pytest.mark.parametrize("norm", ["vertex", "edge"])
def test_free_vertices_that_hang_by_a_thread(norm: str) -> None:
    """Three of weights 1, joined to the data by weights of 1e-20: no function h certifies, but the box does."""
    ends = [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)]
    graph = gr.Graph.from_edges(ends, [1e-20, 1, 1, 3e-20, 1])
    lam, f0 = np.array([np.inf, 0, 0, 0, np.inf]), np.array([0, 7, 7, 7, 1.0])
    given = {"lam": lam, "norm": norm, "backend": "numpy", "dtype": np.float64}
    found = gr.regularize(f0, graph, solver=gr.Certified(tol=1e-12, method="linear"), **given)
    assert found.stop is gr.Stop.GAP
    # the pinned vertices have all of the energy but 1e-20 of it: of both ends of an edge, or of one
    least = 1.0 if norm == "vertex" else 0.5
    assert found.lower_bound <= least <= found.energy[-1] * (1 + 1e-15)
    assert found.gap <= 1e-12 * found.energy[-1] * 1.01
    assert found.value.min() >= 0 and found.value.max() <= 1
