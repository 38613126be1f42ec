"""Region adjacency graphs, rings, and values of regions: against loops, scipy.ndimage and scikit-image."""

from __future__ import annotations

import copy
import pickle

import cases
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import gpureg as gr


def literal(labels, metric="cityblock", spacing=None, background=None):
    """Borders, sizes and centroids, cell by cell."""
    sides = np.ones(labels.ndim) if spacing is None else np.array(spacing, float)
    regions = sorted({int(i) for i in labels.ravel() if i >= 0 and i != background})
    borders, cells = {}, {i: [] for i in regions}
    for u in np.ndindex(labels.shape):
        a = int(labels[u])
        if a in cells:
            cells[a].append(np.array(u) * sides)
        for step in np.ndindex((3,) * labels.ndim):
            jump = np.array(step) - 1
            if not jump.any() or (metric == "cityblock" and np.abs(jump).sum() > 1):
                continue
            v = tuple(np.array(u) + jump)
            if any(x < 0 or x >= s for x, s in zip(v, labels.shape, strict=True)):
                continue
            b = int(labels[v])
            if a in cells and b in cells and a != b:
                axis = np.flatnonzero(jump)
                face = np.prod(np.delete(sides, axis)) if len(axis) == 1 else 0.0
                borders[a, b] = borders.get((a, b), 0.0) + face
    sizes = {i: len(found) * np.prod(sides) for i, found in cells.items()}
    return regions, borders, sizes, {i: np.mean(found, axis=0) for i, found in cells.items()}


def assert_literal(labels, **settings):
    rag = gr.region_graph(labels, **settings)
    regions, borders, sizes, centroids = literal(np.asarray(labels), **settings)
    assert rag.labels.tolist() == regions
    ends = zip(rag.labels[rag.edge_rows()].tolist(), rag.labels[rag.indices].tolist(), strict=True)
    assert dict(zip(ends, rag.borders.tolist(), strict=True)) == pytest.approx(borders)
    assert rag.sizes == pytest.approx([sizes[i] for i in regions])
    assert rag.positions == pytest.approx(np.array([centroids[i] for i in regions]))
    return rag


@pytest.mark.parametrize("metric", ["cityblock", "chebyshev"])
@pytest.mark.parametrize(
    ("shape", "spacing"), [((17,), None), ((9, 8), (2.0, 0.5)), ((4, 5, 6), (3, 1, 0.5)), ((3, 2, 3, 2), None)]
)
def test_borders_sizes_and_centroids(shape, spacing, metric):
    labels = cases.rng(3).integers(0, 6, shape)
    assert_literal(labels, metric=metric, spacing=spacing)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_any_labels(seed):
    """Gaps, large numbers, none, background, all integer types."""
    random = np.random.default_rng(seed)
    shape = tuple(int(s) for s in random.integers(1, 6, random.integers(1, 4)))
    pool = np.append(random.choice([0, 1, 2, 5, 100, 70_000, 2**40], 4), random.choice([-1, -7, 3]))
    labels = random.choice(pool, shape)
    background = int(random.choice(pool)) if random.random() < 0.3 else None
    if not ((labels >= 0) & (labels != background)).any():
        with pytest.raises(ValueError, match="has no region"):
            gr.region_graph(labels, background=background)
        return
    rag = assert_literal(labels, metric=str(random.choice(["cityblock", "chebyshev"])), background=background)
    assert rag.n_vertices == len(np.unique(labels[(labels >= 0) & (labels != background)]))


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.int32, np.uint64])
def test_types_and_corners(dtype):
    labels = np.array([[0, 1], [2, 0]], dtype)
    faces, corners = gr.region_graph(labels), gr.region_graph(labels, metric="chebyshev")
    assert faces.n_edges == 4
    assert dict(zip(zip(corners.edge_rows(), corners.indices, strict=True), corners.borders, strict=True)) == {
        (0, 1): 2, (0, 2): 2, (1, 0): 2, (1, 2): 0, (2, 0): 2, (2, 1): 0,
    }  # fmt: skip
    one = gr.region_graph(np.zeros((3, 4), dtype))
    assert (one.n_vertices, one.n_edges, one.sizes.tolist()) == (1, 0, [12])


def test_superpixels_and_watersheds_of_scikit_image():
    """What people have: labels from 1, lines of 0; edges and distances of colours are those of rag_mean_color."""
    segmentation, graph = pytest.importorskip("skimage.segmentation"), pytest.importorskip("skimage.graph")
    image = cases.rng(5).random((40, 50, 3))
    image = ndimage.gaussian_filter(image, (3, 3, 0))
    labels = segmentation.slic(image, n_segments=30, start_label=1)
    rag = gr.region_graph(labels)
    assert np.array_equal(rag.labels, np.unique(labels))
    colours = gr.region_values(image, labels - 1)
    peer = graph.rag_mean_color(image, labels, connectivity=1)
    ours = {
        (int(rag.labels[u]), int(rag.labels[v])): d
        for u, v, d in zip(rag.edge_rows(), rag.indices, rag.distances(colours), strict=True)
    }
    assert {tuple(sorted(e)) for e in ours} == {tuple(sorted(map(int, e))) for e in peer.edges}
    theirs = {(int(a), int(b)): peer.edges[a, b]["weight"] for a, b in peer.edges}
    assert {edge: ours[edge] for edge in theirs} == pytest.approx(theirs, rel=1e-6)
    lines = segmentation.watershed(image.mean(axis=-1), markers=30, watershed_line=True)
    assert (lines == 0).any()
    apart = gr.region_graph(lines, background=0)
    assert 0 not in apart.labels
    assert apart.n_edges < gr.region_graph(lines).n_edges


def borders_of(graph):
    """The border of each region with each that it has an edge to."""
    found = {u: {} for u in range(graph.n_vertices)}
    for u, v, border in zip(graph.edge_rows().tolist(), graph.indices.tolist(), graph.borders.tolist(), strict=True):
        found[u][v] = border
    return found


@pytest.mark.parametrize("rings", [1, 2, 3])
def test_rings_are_neighbours_of_neighbours(rings):
    labels = gr.energy_partition(
        cases.rng(7).random((12, 13)), gr.GridGraph((12, 13)), gr.sources.seeds(gr.GridGraph((12, 13)), 3)
    )
    plain, wide = gr.region_graph(labels), gr.region_graph(labels, rings=rings)
    assert np.array_equal(wide.positions, plain.positions)
    near, expected = borders_of(plain), {}
    for u in near:
        reached = {u}
        for _ in range(rings):
            reached |= {w for v in reached for w in near[v]}
        expected[u] = {v: near[u].get(v, 0) for v in reached - {u}}
    assert borders_of(wide) == expected


def test_rings_of_any_graph():
    graph = gr.ring_graph(cases.graph("csr"), 2)
    assert np.array_equal(graph.positions, cases.graph("csr").positions)
    assert gr.ring_graph(graph, 1).n_edges == graph.n_edges


def test_it_is_a_graph():
    """Regularized on, copied, pickled; frozen like a Graph."""
    labels = cases.rng(9).integers(0, 5, (8, 9))
    rag = gr.region_graph(labels)
    assert isinstance(rag, gr.Graph)
    assert repr(rag) == f"RegionGraph(5 regions, {rag.n_edges // 2} borders)"
    values = gr.region_values(cases.rng(1).random((8, 9)), labels)
    smooth = gr.regularize(values, rag, lam=0.1, weights=rag.borders, max_iter=200).value
    assert np.ptp(smooth) < np.ptp(values)
    copies = {"pickled": pickle.loads(pickle.dumps(rag)), "copied": copy.deepcopy(rag)}
    arrays = ("borders", "labels", "indices")
    assert [
        (how, array)
        for how, other in copies.items()
        for array in arrays
        if not np.array_equal(getattr(other, array), getattr(rag, array))
    ] == []
    with pytest.raises(ValueError, match="read-only"):
        rag.sizes[0] = 3
    assert rag.distances(np.arange(5.0)) == pytest.approx(np.abs(rag.indices - rag.edge_rows()))
    assert rag.distances(np.zeros((5, 3))).shape == (rag.n_edges,)
    with pytest.raises(ValueError, match="for each of 5 regions"):
        rag.distances([1.0])
    with pytest.raises(ValueError, match=r"sizes must have shape \(2,\)"):
        gr.RegionGraph([0, 1, 2], [1, 0], sizes=[1.0])
    with pytest.raises(ValueError, match="indices must rise within each row"):
        gr.RegionGraph([0, 2, 3, 4], [2, 1, 0, 0], borders=[1.0, 2.0, 2.0, 1.0])


@pytest.mark.parametrize(
    ("labels", "settings", "sentence"),
    [
        ([[0.0, 1.0]], {}, "labels must be integers, got float64"),
        ([[True, False]], {}, "labels must be integers, got bool"),
        (np.ma.masked_array([0, 1], [0, 1]), {}, "masked array"),
        (3, {}, "an image of one cell or more"),
        (np.zeros((0, 3), int), {}, "an image of one cell or more"),
        ([[-1, -1]], {}, "has no region"),
        ([[0, 0]], {"background": 0}, "has no region"),
        ([[0, 1]], {"metric": "euclidean"}, 'metric must be "cityblock" or "chebyshev", got '),
        ([[0, 1]], {"background": 0.5}, "background must be an integer"),
        ([[0, 1]], {"spacing": (1, 2, 3)}, "spacing must hold 2 finite"),
        ([[0, 1]], {"spacing": (1, 0)}, "spacing must hold 2 finite"),
        ([[0, 1]], {"rings": 1.5}, "rings must be an integer"),
        ([[0, 1]], {"rings": 0}, "rings must be >= 1, got 0"),
    ],
)
def test_wrong_labels(labels, settings, sentence):
    with pytest.raises((ValueError, TypeError), match=sentence):
        gr.region_graph(labels, **settings)


def test_wrong_rings():
    with pytest.raises(TypeError, match="graph must be a Graph, got a GridGraph"):
        gr.ring_graph(gr.GridGraph(4), 2)
    with pytest.raises(ValueError, match="rings must be >= 1, got 0"):
        gr.ring_graph(gr.GridGraph(4).to_graph(), 0)


# --- values of regions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["mean", "median"])
@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.float32, np.float64, np.float16])
@pytest.mark.parametrize("shape", [(31,), (9, 14), (4, 5, 6)])
def test_means_and_medians_are_scipys(model, dtype, shape):
    random = cases.rng(13)
    labels = random.integers(0, 7, shape)
    f = (random.normal(0, 50, (*shape, 3)) + (100 if np.dtype(dtype).kind == "u" else 0)).clip(-120, 250).astype(dtype)
    f[labels == 2] = 0
    if np.dtype(dtype).kind == "f":
        f[labels == 3] *= -0.0  # of both signs, one value
    found = gr.region_values(f, labels, model)
    assert found.shape == (7, 3)
    expected = [getattr(ndimage, model)(f[..., c].astype(np.float64), labels, np.arange(7)) for c in range(3)]
    assert found == pytest.approx(np.stack(expected, axis=1), rel=1e-13, abs=1e-13)
    assert gr.region_values(f[..., 0], labels, model).shape == (7,)


def test_medians_of_values_that_float32_does_not_hold():
    f = np.array([2.0**40, 2.0**40 + 1, 2.0**40 + 3, 0.1, 0.2, 0.3])
    assert gr.region_values(f, [1, 1, 1, 0, 0, 0], "median").tolist() == [0.2, 2.0**40 + 1]
    assert gr.region_values([[5, 1], [2, 9]], [[0, 0], [0, 0]], "median").tolist() == [3.5]


def test_sources_are_a_model():
    f, labels, sources = np.array([1.0, 2, 3, 4, 50]), [0, 0, 1, 1, -1], [-1, 0, 1, -1, -1]
    assert gr.region_values(f, labels, "source", sources=sources).tolist() == [2, 3]


@pytest.mark.parametrize("outside", [50, np.nan])
@pytest.mark.parametrize("model", ["mean", "median"])
def test_cells_outside_do_not_count(model, outside):
    assert gr.region_values(np.array([1, 2, 3, 4, outside]), [0, 0, 1, 1, -1], model).tolist() == [1.5, 3.5]


@pytest.mark.parametrize(
    ("f", "labels", "settings", "sentence"),
    [
        ([1.0, 2], [0, 1], {"model": "mode"}, 'model must be "mean", "median" or "source", got '),
        ([1.0, 2], [0, 2], {}, "region 1 has no cell"),
        ([1.0, 2], [0, 1], {"n_regions": 3}, "region 2 has no cell"),
        ([1.0, 2], [0, 1], {"n_regions": 1}, "labels must be below n_regions = 1, got 1"),
        ([1.0, 2], [-1, -1], {}, "no cell"),
        ([1.0, 2], [0, -2], {}, "labels must be >= 0, or -1, got -2"),
        ([1.0, 2], [0.0, 1.0], {}, "labels must be integers"),
        ([1.0, 2, 3], [0, 1], {}, "f must have the shape of labels"),
        (["a", "b"], [0, 1], {}, "integers or real numbers"),
        ([1.0, 2], [0, 1], {"model": "source"}, "sources and model='source' must be given together"),
        ([1.0, 2], [0, 1], {"sources": [0, 1]}, "sources and model='source' must be given together"),
        ([1.0, 2], [0, 1], {"model": "source", "sources": [0]}, "sources must have the shape of labels"),
    ],
)
def test_wrong_values(f, labels, settings, sentence):
    with pytest.raises((ValueError, TypeError), match=sentence):
        gr.region_values(f, labels, **settings)
