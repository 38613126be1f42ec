"""The graph of nearest patches: against loops over the window, on every device, and what is done with it."""

from __future__ import annotations

import numpy as np
import paper
import pytest
from cases import rng
from numpy.testing import assert_array_equal
from test_filters import functions, picture

import gpureg as gr
from gpureg.images import patch_graph as door


def chosen(
    image, k, *, radius, patch_radius, metric="chebyshev", patch_sigma=None, mask=None, spacing=None, channel_axis=None
):
    """The k nearest of every pixel, as directed edges between row-major numbers; noise leaves no ties."""
    f0s = functions(image, channel_axis)
    shape = image.shape if channel_axis is None else tuple(np.delete(image.shape, channel_axis))
    if patch_sigma is None:
        g = paper.flat_patch(patch_radius, len(shape))
    else:
        g = paper.gaussian_patch(patch_radius, len(shape), patch_sigma)
    pixels = [p for p in np.ndindex(shape) if mask is None or mask[p]]
    number = {p: i for i, p in enumerate(np.ndindex(shape))}
    edges = set()
    for u in pixels:
        around = paper.k_neighbourhood(pixels, u, radius, metric, spacing)
        near = sorted(around, key=lambda v: paper.rho(u, v, f0s, shape, g))[:k]
        edges |= {(number[u], number[v]) for v in near}
    return edges


def edges_of(graph):
    return set(zip(graph.edge_rows().tolist(), graph.indices.tolist(), strict=True))


CASES = [
    ((9, 10), None, {"radius": 2, "patch_radius": 1}),
    ((9, 10), None, {"radius": 3, "patch_radius": 2, "metric": "euclidean", "patch_sigma": 0.9}),
    ((7, 8, 2), 2, {"radius": 2, "patch_radius": 1, "metric": "cityblock"}),
    ((3, 5, 6), None, {"radius": 2, "patch_radius": 1, "spacing": (2.0, 1.0, 1.0)}),
]


@pytest.mark.parametrize("symmetrize", ["max", "mutual"])
@pytest.mark.parametrize(("shape", "channel_axis", "options"), CASES)
def test_the_nearest_of_the_window(device, shape, channel_axis, options, symmetrize):
    image = picture(*shape)
    directed = chosen(image, 4, channel_axis=channel_axis, **options)
    back = {(v, u) for u, v in directed}
    expected = directed | back if symmetrize == "max" else directed & back
    graph = gr.patch_graph(image, 4, channel_axis=channel_axis, symmetrize=symmetrize, backend=device, **options)
    assert edges_of(graph) == expected
    assert graph.weights is None
    assert graph.grid is not None
    assert len(graph.positions) == graph.n_vertices


def test_masked_pixels_have_no_edges(device):
    image = picture(9, 10)
    mask = rng(13).random(image.shape) < 0.7
    holes = np.where(mask, image, np.nan)
    graph = gr.patch_graph(holes, 3, radius=2, patch_radius=1, mask=mask, backend=device)
    assert set(np.unique(graph.edge_rows())) <= set(np.flatnonzero(mask))
    assert np.diff(graph.indptr)[mask.ravel()].min() >= 3 or mask.sum() < 4


def test_bands_do_not_show(monkeypatch, device):
    image = picture(37, 23)
    whole = gr.patch_graph(image, 5, radius=3, patch_radius=2, backend=device)
    monkeypatch.setattr(door, "_TABLE", 1)
    assert edges_of(gr.patch_graph(image, 5, radius=3, patch_radius=2, backend=device)) == edges_of(whole)


def test_a_window_smaller_than_k_gives_all():
    image = picture(6, 7)
    graph = gr.patch_graph(image, 100, radius=1, patch_radius=1, backend="numpy")
    assert graph.n_edges == gr.GridGraph(image.shape, 1).n_edges


def test_a_guide_is_compared():
    image, guide = picture(12, 13), picture(12, 13, seed=17)
    by_guide = gr.patch_graph(image, 4, radius=2, guide=guide, backend="numpy")
    assert edges_of(by_guide) == edges_of(gr.patch_graph(guide, 4, radius=2, backend="numpy"))
    assert edges_of(by_guide) != edges_of(gr.patch_graph(image, 4, radius=2, backend="numpy"))


@pytest.mark.parametrize("channel_axis", [None, 0])
def test_denoise_image_on_the_nearest(device, channel_axis):
    """The door is the graph and the process on it."""
    image = picture(20, 21) if channel_axis is None else np.stack([picture(20, 21), picture(20, 21, seed=3)])
    weights = gr.weights.patch(1, 0.6, sigma=0.1)
    settings = {"p": 1, "lam": 5.0, "max_iter": 3, "weights": weights, "backend": device}
    result = gr.denoise_image(image, k=6, radius=3, channel_axis=channel_axis, **settings)
    graph = gr.patch_graph(image, 6, radius=3, patch_radius=1, channel_axis=channel_axis, backend=device)
    f0 = image.reshape(-1, 1) if channel_axis is None else image.reshape(2, -1).T
    by_hand = gr.regularize(f0.astype(np.float32), graph, **settings).value
    expected = by_hand.reshape(image.shape) if channel_axis is None else by_hand.T.reshape(image.shape)
    # eps is a share of the range of all values either way; the door computes in float32
    assert_array_equal(result.astype(np.float32), expected)
    assert np.std(result) < np.std(image)
