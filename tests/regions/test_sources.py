"""Sources of a partition: extrema, valleys of the gradient, seeds."""

from __future__ import annotations

import cases
import numpy as np
import paper_zones
import pytest
from scipy import ndimage

import gpureg as gr


@pytest.mark.parametrize("name", cases.SMALL)
@pytest.mark.parametrize("height", [1, 2, 4])
def test_extrema_are_those_of_the_definition(name, height):
    graph = cases.graph(name)
    csr = graph if isinstance(graph, gr.Graph) else graph.to_graph()
    E = set(zip(csr.edge_rows().tolist(), csr.indices.tolist(), strict=True))
    inside = getattr(graph, "mask", None)
    V = range(graph.n_vertices) if inside is None else np.flatnonzero(inside.ravel()).tolist()
    f = cases.rng(19).integers(0, height, graph.n_vertices)
    minima, maxima = paper_zones.regional_extrema(V, E, dict(enumerate(f.tolist())))
    wanted = {"minima": minima, "maxima": maxima, "both": minima + [m for m in maxima if m not in minima]}
    found = {kind: gr.sources.extrema(f, graph, kind=kind, backend="numpy").ravel() for kind in wanted}
    # in the order of their first vertices
    assert {
        kind: [set(np.flatnonzero(labels == i)) for i in range(labels.max() + 1)] for kind, labels in found.items()
    } == {kind: sorted(extrema, key=min) for kind, extrema in wanted.items()}


@pytest.mark.parametrize("kind", ["minima", "maxima"])
@pytest.mark.parametrize(
    ("shape", "metric"), [((23, 31), "cityblock"), ((23, 31), "chebyshev"), ((5, 6, 7), "chebyshev")]
)
def test_extrema_are_those_of_scikit_image(device, shape, metric, kind):
    morphology = pytest.importorskip("skimage.morphology")
    f = cases.rng(23).integers(0, 5, shape)
    connectivity = 1 if metric == "cityblock" else len(shape)
    grid = gr.GridGraph(shape, 1, metric)
    expected = getattr(morphology, f"local_{kind}")(f, connectivity=connectivity)
    labels = gr.sources.extrema(f, grid, kind=kind, backend=device)
    structure = ndimage.generate_binary_structure(len(shape), connectivity)
    assert np.array_equal(labels >= 0, expected)
    assert labels.max() + 1 == ndimage.label(expected, structure)[1]


def test_extrema_of_several_channels_are_those_of_their_mean():
    grid = gr.GridGraph((9, 11))
    f = cases.rng(3).integers(0, 9, (9, 11, 3))
    assert np.array_equal(gr.sources.extrema(f, grid), gr.sources.extrema(f.sum(axis=-1), grid))


def test_every_part_of_a_mask_has_an_extremum():
    mask = np.ones((6, 9), bool)
    mask[:, 4] = False
    grid = gr.GridGraph((6, 9), mask=mask)
    f = np.where(mask, np.broadcast_to(np.arange(9.0), (6, 9)), np.nan)
    labels = gr.sources.extrema(f, grid)
    assert np.unique(labels[:, :4]).tolist() == [-1, 0, 1]
    assert (labels[:, 4] == -1).all()
    assert np.unique(labels[:, 5:]).tolist() == [-1, 2, 3]


@pytest.mark.parametrize("name", ["small grid", "small masked", "small csr", "small volume"])
def test_the_gradients_minima(name):
    """Extrema of the paper's gradient norm, with w = 1."""
    graph = cases.graph(name)
    csr = graph if isinstance(graph, gr.Graph) else graph.to_graph()
    f = cases.rng(31).integers(0, 4, (graph.n_vertices, 2))
    squared = np.zeros(graph.n_vertices)
    for u, v in zip(csr.edge_rows(), csr.indices, strict=True):
        squared[u] += ((f[v] - f[u]) ** 2).sum()
    assert np.array_equal(gr.sources.gradient_minima(f, graph), gr.sources.extrema(squared, graph, kind="minima"))


def test_seeds():
    grid = gr.GridGraph((10, 7))
    labels = gr.sources.seeds(grid, 4)
    assert np.argwhere(labels >= 0).tolist() == [[2, 2], [2, 6], [6, 2], [6, 6]]
    assert labels[labels >= 0].tolist() == [0, 1, 2, 3]
    assert (gr.sources.seeds(grid, 1).ravel() == np.arange(70)).all()
    assert gr.sources.seeds(grid, 1000).max() == 0
    mask = np.zeros((10, 7), bool)
    mask[6] = True
    assert gr.sources.seeds(gr.GridGraph((10, 7), mask=mask), 4).max() == 1


def test_wrong_calls():
    with pytest.raises(ValueError, match='kind must be "both", "minima" or "maxima", got '):
        gr.sources.extrema([0, 1], gr.GridGraph(2), kind="saddles")
    with pytest.raises(TypeError, match="seeds need a GridGraph, got Graph"):
        gr.sources.seeds(gr.GridGraph(4).to_graph(), 2)
    with pytest.raises(TypeError, match=r"step must be an integer, got 2\.0"):
        gr.sources.seeds(gr.GridGraph(4), 2.0)
    with pytest.raises(ValueError, match="step must be >= 1, got 0"):
        gr.sources.seeds(gr.GridGraph(4), 0)
    with pytest.raises(ValueError, match="no seed lies inside the mask"):
        gr.sources.seeds(gr.GridGraph(4, mask=[True, False, False, False]), 4)
