"""The numpy backend's patches and zones (float64) against section 5.2 of the paper as literal loops."""

from __future__ import annotations

import math

import cases
import numpy as np
import paper
import paper_zones
import pytest
from literal import assert_close, literal

from gpureg.backends import PatchForm
from gpureg.graphs.csr import Graph
from gpureg.graphs.grid import GridGraph
from gpureg.regions.partition import edge_lengths, vertex_values

PATCHES = [
    pytest.param(0, None, id="one pixel"),
    pytest.param(1, None, id="flat 1"),
    pytest.param(2, 0.75, id="gaussian 2"),
    pytest.param(4, None, id="wider than the image"),
]


def profile_of(radius, a):
    if a is None:
        return np.ones(2 * radius + 1)
    line = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * a * a))
    return line / line.sum()


def literal_patch(radius, a, ndim):
    return paper.flat_patch(radius, ndim) if a is None else paper.gaussian_patch(radius, ndim, a)


@pytest.mark.parametrize(("radius", "a"), PATCHES)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", ["small grid", "small masked", "small row", "small volume"])
@pytest.mark.parametrize("similar", [False, True], ids=["rho", "w2"])
def test_patch_distance_and_w2(oracle, name, channels, radius, a, similar):
    """rho_a and w_2 of section 5.2 on grids of one to three axes, patches filled by reflection."""
    case, grid = literal(name), cases.graph(name)
    if radius == 4 and grid.ndim == 3:
        radius = 3  # 343 offsets are enough for loops
    f0 = cases.function(grid, channels)
    f0s, g = case.functions(f0), literal_patch(radius, a, grid.ndim)
    h = 0.5 * math.sqrt(len(g)) if a is None else 0.5
    form = PatchForm(profile_of(radius, a), scale=1 / h**2 if similar else None)
    half = np.zeros((grid.half_window, *grid.shape))
    for plane, step in zip(half, grid.forward_offsets.tolist(), strict=True):
        for u in case.V:
            v = tuple(a + b for a, b in zip(u, step, strict=True))
            if (u, v) in case.E:
                given = (u, v, f0s, grid.shape, g)
                plane[u] = paper.w2(*given, h) if similar else paper.rho(*given)
    assert_close(oracle.get_weights(oracle.patch_distance(grid, f0, form)), half)


def test_the_same_patches_on_a_stored_graph(oracle):
    grid = cases.graph("small grid")
    twin, f0 = grid.to_graph(), cases.function(grid, 3)
    form = PatchForm(profile_of(2, 0.75), shift=0.125, scale=2.0)
    on_grid = oracle.get_weights(oracle.patch_distance(grid, f0, form))
    assert_close(oracle.get_weights(oracle.patch_distance(twin, f0, form)), grid.edges.gather_half(on_grid))


@pytest.mark.parametrize("channels", [1, 3])
def test_w1(oracle, channels):
    """w_1 of section 5.2 is a patch of one pixel with a factor for each step."""
    case, grid = literal("small grid"), cases.graph("small grid")
    f0 = cases.function(grid, channels)
    sigma_space, sigma_value = 1.5, 0.4
    spatial = np.exp(-(grid.forward_offsets**2).sum(axis=1) / sigma_space**2)
    form = PatchForm(np.ones(1), scale=1 / sigma_value**2, spatial=spatial)
    edges = grid.edges.gather_half(oracle.get_weights(oracle.patch_distance(grid, f0, form)))
    expected = [paper.w1(u, v, case.functions(f0), sigma_space, sigma_value) for u, v in sorted(case.E)]
    assert_close(edges, expected)


def test_noise_taken_off_the_distance_stops_at_zero(oracle):
    """exp(-max(rho - shift, 0) scale): a distance below the noise's share counts as none."""
    graph = Graph.from_edges([[0, 1], [1, 2]])
    f0 = np.array([[0.0], [1.0], [3.0]])
    form = PatchForm(np.ones(1), shift=2.0, scale=0.5, spatial=np.array([1.0, 1.0, 0.5, 0.5]))
    weights = oracle.get_weights(oracle.patch_distance(graph, f0, form))
    assert_close(weights, [1, 1, 0.5 * math.exp(-1), 0.5 * math.exp(-1)])


@pytest.mark.parametrize("guided", [False, True], ids=["of f", "of a guide"])
@pytest.mark.parametrize("name", ["small grid", "small masked", "small row"])
def test_similarity_step(oracle, name, guided):
    """Eq. 25 at p = 2 with the weights w2 of f, or of a guide, where an edge is."""
    case, grid = literal(name), cases.graph(name)
    f, f0, guide = (cases.function(grid, 2, seed) for seed in (11, 13, 17))
    lam, g = cases.fidelity(grid), literal_patch(1, None, grid.ndim)
    compared = case.functions(guide if guided else f)
    w = {(u, v): paper.w2(u, v, compared, grid.shape, g, 2.0) for u, v in case.E}
    gamma, (lams,) = paper.gamma_sqrt(case.E, w), case.functions(lam)
    fs, f0s = case.functions(f), case.functions(f0)
    expected = paper.jacobi_step(case.V, case.E, gamma, fs, f0s, lams, 2, 0.0, True)
    form = PatchForm(profile_of(1, None), scale=1 / 4)
    found = oracle.similarity_step(grid, f, form, f0, lam, guide=guide if guided else None)
    assert_close(found, case.array(expected))


@pytest.mark.parametrize("name", cases.SMALL)
def test_influence_zones(oracle, name):
    """Of whole numbers, so that nothing is rounded and paths tie."""
    graph = cases.graph(name)
    csr = graph.to_graph() if isinstance(graph, GridGraph) else graph
    E = set(zip(csr.edge_rows().tolist(), csr.indices.tolist(), strict=True))
    n, random = graph.n_vertices, cases.rng(7)
    f = random.integers(0, 3, (n, 1))
    sources = np.where(random.random(n) < 0.3, random.permutation(n), -1).astype(np.int32)
    lengths, _ = edge_lengths(vertex_values(f, graph), graph)
    members = {int(i): np.flatnonzero(sources == i).tolist() for i in sources[sources >= 0]}
    expected = paper_zones.influence_zones(range(n), E, [dict(enumerate(f[:, 0].tolist()))], members)
    mu, labels = oracle.influence_zones(graph, lengths, sources)
    assert labels.tolist() == [expected[u][2] if u in expected else -1 for u in range(n)]
    assert (mu >= 0).tolist() == [u in expected for u in range(n)]
