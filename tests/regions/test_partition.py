"""The energy partition: against its definition as loops, scipy's Dijkstra, on every device, bit for bit."""

from __future__ import annotations

import cases
import numpy as np
import paper_zones
import pytest
from checking import as_gpu
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.sparse import csgraph

import gpureg as gr
from gpureg import backends
from gpureg.backends import zones
from gpureg.regions.partition import edge_lengths, vertex_values

# Small sizes of blocks, so that paths cross many of them in both directions; None: what the device takes.
SIZES = (1, 7, 64, None)


def stored(graph):
    """The same graph in CSR form."""
    return graph if isinstance(graph, gr.Graph) else graph.to_graph()


def inside(graph):
    whole = np.ones(graph.n_vertices, bool)
    return graph.mask.ravel() if isinstance(graph, gr.GridGraph) and graph.mask is not None else whole


def levels(graph, channels, height, seed=5):
    """A function of a few integers: plateaus and ties everywhere."""
    return cases.rng(seed).integers(0, height, (graph.n_vertices, channels))


def some_sources(graph, share=20, seed=7):
    """Labels at one vertex in so many, in random order, some of them twice."""
    random, sources = cases.rng(seed), np.full(graph.n_vertices, -1, np.int32)
    free = np.flatnonzero(inside(graph))
    chosen = random.permutation(free)[: max(1, len(free) // share)]
    sources[chosen] = random.permutation(len(chosen)) // 2 * 3
    return sources


@pytest.mark.parametrize("name", cases.SMALL)
@pytest.mark.parametrize("height", [1, 3, 50])
def test_the_oracle_is_the_definition(name, height):
    """numpy's zones are those of the paper's definition; whole numbers, so that nothing is rounded."""
    graph = cases.graph(name)
    csr = stored(graph)
    E = set(zip(csr.edge_rows().tolist(), csr.indices.tolist(), strict=True))
    f, sources = levels(graph, 1, height), some_sources(graph, 5)
    members = {int(i): np.flatnonzero(sources == i).tolist() for i in np.unique(sources[sources >= 0])}
    V = range(graph.n_vertices)
    expected = paper_zones.influence_zones(V, E, [dict(enumerate(f[:, 0].tolist()))], members)
    labels, energy = gr.energy_partition(f, graph, sources, return_energy=True, backend="numpy")
    assert labels.tolist() == [expected[u][2] if u in expected else -1 for u in V]
    assert energy.tolist() == [expected[u][0] if u in expected else np.inf for u in V]


@pytest.mark.every_driver
@pytest.mark.parametrize("name", [name for name in cases.GRAPHS if not name.startswith("small")])
@pytest.mark.parametrize(("channels", "height"), [(1, 1), (1, 4), (1, 1000), (3, 4)])
def test_devices_agree_with_dijkstra(device, name, channels, height, monkeypatch):
    """The same labels and the same energies, to the bit, whatever the blocks."""
    graph = cases.graph(name)
    f, sources = levels(graph, channels, height), some_sources(graph)
    lengths, _ = edge_lengths(vertex_values(f, graph), graph)
    mu, labels = backends.get("numpy", np.float64).influence_zones(graph, lengths, sources)
    on = backends.get(device, np.float32)
    wrong = []
    for least in SIZES:
        with monkeypatch.context() as patch:
            if least is not None:
                patch.setattr(zones, "_LEAST_BLOCK", least)
            found_mu, found = on.influence_zones(graph, lengths, sources)
        if not np.array_equal(found, labels) or not np.array_equal(found_mu, mu):
            wrong.append(least)
    assert wrong == []


@pytest.mark.parametrize("name", ["masked", "volume", "csr", "row"])
def test_a_gpus_tiles(device, name, monkeypatch):
    """The tiles of a GPU, on the devices at hand."""
    graph = cases.graph(name)
    on = as_gpu(device, "float32", monkeypatch)
    if on.name == "warp":
        monkeypatch.setattr(on, "_settle_blocks", on._settle_tiles)
    else:
        on._options += ("-cl-opt-disable",)  # a driver for CPUs takes long for loops with barriers
    f, sources = levels(graph, 1, 4), some_sources(graph)
    lengths, _ = edge_lengths(vertex_values(f, graph), graph)
    oracle = backends.get("numpy", np.float64)
    assert np.array_equal(
        on.influence_zones(graph, lengths, sources)[1], oracle.influence_zones(graph, lengths, sources)[1]
    )
    assert np.array_equal(on.flat_zones(graph, lengths), oracle.flat_zones(graph, lengths))


@pytest.mark.every_driver
@pytest.mark.parametrize("name", cases.GRAPHS)
def test_flat_zones(device, name):
    graph = cases.graph(name)
    f = levels(graph, 1, 2)
    lengths, _ = edge_lengths(vertex_values(f, graph), graph)
    csr = stored(graph)
    rows = csr.edge_rows()
    flat = f[rows, 0] == f[csr.indices, 0]
    links = np.zeros((graph.n_vertices,) * 2, bool) if graph.n_vertices < 700 else None
    found = backends.get(device, np.float32).flat_zones(graph, lengths)
    assert (found[rows[flat]] == found[csr.indices[flat]]).all()
    assert (found <= np.arange(graph.n_vertices)).all()
    assert (found[found] == found).all()  # each zone is known by a vertex of it
    if links is not None:
        links[rows[flat], csr.indices[flat]] = True
        part = csgraph.connected_components(links, directed=False)[1]
        assert np.array_equal(found, np.array([np.flatnonzero(part == p)[0] for p in part]))


@pytest.mark.parametrize("name", ["grid", "masked", "csr", "volume"])
@pytest.mark.parametrize("compactness", [0.0, 0.75])
def test_zones_are_a_connected_partition(name, compactness):
    """Every vertex that can be reached is in one zone, which is connected and holds its source."""
    graph = cases.graph(name)
    sources = np.full(graph.n_vertices, -1)
    chosen = cases.rng(3).permutation(np.flatnonzero(inside(graph)))[:30]
    sources[chosen] = np.arange(30)
    labels = gr.energy_partition(levels(graph, 1, 3), graph, sources, compactness=compactness)
    assert np.array_equal(labels[chosen], np.arange(30))
    W = stored(graph).to_scipy()
    reachable = np.isin(
        csgraph.connected_components(W, directed=False)[1], csgraph.connected_components(W, directed=False)[1][chosen]
    )
    assert np.array_equal(labels >= 0, reachable)
    members = [np.flatnonzero(labels == i) for i in range(30)]
    parts = [csgraph.connected_components(W[zone][:, zone], directed=False)[0] for zone in members]
    assert parts == [1] * 30


def test_ties_go_to_the_nearest_in_edges_then_to_the_smallest_label():
    """On a plateau zones meet halfway; in the very middle the smaller label has the cell, wherever it comes from."""
    line = gr.GridGraph(7)
    sources = np.full(7, -1)
    sources[[0, 6]] = [4, 2]
    assert gr.energy_partition(np.zeros(7), line, sources, backend="numpy").tolist() == [4, 4, 4, 2, 2, 2, 2]


def test_a_constant_image_and_a_checkerboard(device):
    grid = gr.GridGraph((8, 9), 1, "cityblock")
    constant = gr.sources.extrema(np.full((8, 9), 3.0), grid, backend=device)
    assert (constant == 0).all()
    assert (gr.energy_partition(np.full((8, 9), 3.0), grid, constant, backend=device) == 0).all()
    board = np.indices((8, 9)).sum(axis=0) % 2
    every = gr.sources.extrema(board, grid, backend=device)
    assert np.array_equal(every, np.arange(72).reshape(8, 9))
    assert np.array_equal(gr.energy_partition(board, grid, every, backend=device), every)


def test_a_labyrinth_of_one_path(device):
    """A path through all of a picture, down and up its columns, right and left: against its length, cell by cell."""
    size = 41
    mask = np.zeros((size, size), bool)
    mask[:, ::2] = True
    mask[-1, 1::4] = mask[0, 3::4] = True
    grid = gr.GridGraph(mask.shape, 1, "cityblock", mask=mask)
    along = csgraph.dijkstra(grid.to_graph().to_scipy(), indices=0, unweighted=True).reshape(mask.shape)
    sources = np.full(mask.shape, -1)
    sources[0, 0] = 5
    # one more a cell: every step of the path costs 1
    f = np.where(mask, np.where(np.isfinite(along), along, 0), np.nan)
    labels, energy = gr.energy_partition(f, grid, sources, return_energy=True, backend=device)
    assert np.array_equal(energy[mask], along[mask])
    assert along[mask].max() == mask.sum() - 1
    assert np.array_equal(labels, np.where(mask, 5, -1))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_any_grid(seed):
    """Random axes, metric, mask, channels, heights, floats or integers: the best device against numpy."""
    random = np.random.default_rng(seed)
    shape = tuple(int(s) for s in random.integers(1, 9, random.integers(1, 5)))
    mask = random.random(shape) < 0.8 if random.random() < 0.5 else None
    if mask is not None and not mask.any():
        mask = None
    grid = gr.GridGraph(
        shape, float(random.choice([1, 1.5, 2])), str(random.choice(["chebyshev", "cityblock"])), mask=mask
    )
    f = random.integers(0, random.choice([1, 2, 9, 10**6]), (grid.n_vertices, random.integers(1, 4))).astype(float)
    f *= random.choice([1.0, 0.1, 1e-30, 1e30, 5e-324, 1e300])
    sources = some_sources(grid, random.integers(1, 12), seed)
    toll = float(random.choice([0, 0.01])) * float(np.ptp(f)) if len(f) else 0.0
    best = gr.energy_partition(f, grid, sources, compactness=toll, return_energy=True)
    exact = gr.energy_partition(f, grid, sources, compactness=toll, return_energy=True, backend="numpy")
    assert np.array_equal(best[0], exact[0])
    assert np.array_equal(best[1], exact[1])


def test_level_function_takes_any_compactness():
    """Where f is level, the zones of any compactness are those of the distance in edges."""
    line = gr.GridGraph(5)
    labels, energy = gr.energy_partition(
        np.full(5, 3.0), line, [0, -1, -1, -1, 1], compactness=7e300, return_energy=True, backend="numpy"
    )
    assert labels.tolist() == [0, 0, 0, 1, 1]
    # lengths are whole numbers of 24 bits
    assert energy / 7e300 == pytest.approx([0, 1, 2, 1, 0], rel=2.0**-24)


def test_level_inside_a_mask():
    """What stands under the mask has no say, however far it is from what is inside."""
    f = np.array([[1e30, 1e30, 5.0], [1e30, 1e30, 1e35]])
    grid = gr.GridGraph((2, 3), mask=f == 1e30)
    sources = np.array([[0, -1, -1], [-1, -1, -1]])
    labels, energy = gr.energy_partition(f, grid, sources, return_energy=True, backend="numpy")
    assert labels.tolist() == [[0, 0, -1], [0, 0, -1]]
    assert np.array_equal(energy[grid.mask], np.zeros(4))


def test_a_photograph(device, data_folder):
    """camera: the zones of all its extrema, as scipy's Dijkstra has them; each is one piece."""
    from skimage.io import imread

    image = imread(data_folder / "images" / "camera.png")[:256, :256]
    grid = gr.GridGraph(image.shape, 1, "cityblock")
    sources = gr.sources.extrema(image, grid, backend=device)
    labels, energy = gr.energy_partition(image, grid, sources, return_energy=True, backend=device)
    expected, mu = gr.energy_partition(image, grid, sources, return_energy=True, backend="numpy")
    assert np.array_equal(labels, expected)
    assert np.array_equal(energy, mu)
    assert labels.min() == 0
    # labels that touch are different zones: as many pieces as labels, all in all
    pieces = sum(ndimage.label(labels[s] == i)[1] for i, s in enumerate(ndimage.find_objects(labels + 1)))
    assert pieces == labels.max() + 1 == sources.max() + 1


def test_differences_are_exact_up_to_24_bits_of_the_range():
    """Float32 images and integers lose nothing; others at most half a unit an edge, 2^-25 of the range or less."""
    line = gr.GridGraph(4)
    start = [0, -1, -1, -1]
    whole = [0, 2**24 - 1, 2**23, 5]
    energy = gr.energy_partition(whole, line, start, return_energy=True, backend="numpy")[1]
    assert energy.tolist() == np.cumsum(np.abs(np.diff(whole, prepend=0))).tolist()
    fine = np.array([0, 1 / 3, 1 / 7, 1.0])
    energy = gr.energy_partition(fine, line, start, return_energy=True, backend="numpy")[1]
    assert np.abs(energy - np.cumsum(np.abs(np.diff(fine, prepend=0)))).max() <= 3 * 2.0**-25


@pytest.mark.parametrize(
    ("f", "sources", "settings", "sentence"),
    [
        (np.zeros(6), [0, 1], {}, r"sources must have shape \(6,\) or \(2, 3\), got \(2,\)"),
        (np.zeros(6), [0.0] * 6, {}, "sources must be integers"),
        (np.zeros(6), [-1] * 6, {}, "a label >= 0 at one vertex at least"),
        (np.zeros(6), [-2] * 6, {}, "or be -1, got -2"),
        (np.zeros(6), [2**31] * 6, {}, "got 2147483648"),
        (np.zeros(5), [0] * 6, {}, r"for each of 6 vertices, got shape \(5,\)"),
        (np.zeros((6, 0)), [0] * 6, {}, "one row of channels"),
        (np.array([1e308, -1e308, 0, 0, 0, 0]), [0] * 6, {}, "the range of f must be below"),
        (np.full(6, np.nan), [0] * 6, {}, "f must be finite"),
        (np.zeros(6, complex), [0] * 6, {}, "integers or real numbers, got complex128"),
        (np.arange(6), [0] * 6, {"compactness": -1}, "compactness must be finite and >= 0, got -1"),
        (np.arange(6), [0] * 6, {"compactness": 1e9}, "32 times the range of f"),
        (np.arange(6), [0] * 6, {"compactness": "a"}, "compactness must be a number, got 'a'"),
    ],
)
def test_wrong_calls(f, sources, settings, sentence):
    with pytest.raises((ValueError, TypeError), match=sentence):
        gr.energy_partition(f, gr.GridGraph((2, 3)), sources, **settings)


def test_wrong_graphs_and_masks():
    with pytest.raises(TypeError, match=r"graph must be a Graph, a GridGraph, .* or a graph of networkx, got int"):
        gr.energy_partition([0], 3, [0])
    masked = gr.GridGraph(3, mask=[True, True, False])
    with pytest.raises(ValueError, match="inside the grid's mask, 1 of their cells do not"):
        gr.energy_partition([0, 0, np.nan], masked, [0, -1, 1])
    with pytest.raises(TypeError, match="masked array"):
        gr.energy_partition(np.ma.masked_array([0, 0, 0], [0, 0, 1]), gr.GridGraph(3), [0, -1, -1])
    assert gr.energy_partition([0, 0, np.nan], masked, [0, -1, -1]).tolist() == [0, 0, -1]
