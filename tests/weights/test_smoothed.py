"""Weights that compare a blurred copy of the data: the same as a guide made by hand, in one piece or in tiles."""

from __future__ import annotations

import numpy as np
import pytest
from cases import rng
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage
from test_filters import picture

import gpureg as gr
from gpureg.weights import OPPONENT, blur_norm, patch_weights


def blurred(image, stds):
    return ndimage.gaussian_filter(image.astype(np.float32), stds, mode="mirror", truncate=4.0)


@pytest.mark.parametrize(
    ("shape", "spacing", "stds"), [((19, 23), None, (0.7, 0.7)), ((5, 9, 11), (2.0, 1.0, 1.0), (0.35, 0.7, 0.7))]
)
@pytest.mark.parametrize("settings", [{"p": 2, "max_iter": 1}, {"p": 1, "max_iter": 3}])
def test_it_is_a_guide(device, shape, spacing, stds, settings):
    image = picture(*shape)
    weights = gr.weights.patch(1, 0.5, sigma=0.05)
    grid = gr.GridGraph(shape, 2, spacing=spacing)
    guide = blurred(image, stds).reshape(-1, 1)
    settings = {"lam": 2.0, "backend": device} | settings
    by_hand = gr.regularize(image, grid, weights=gr.weights.guided(weights, guide), **settings)
    itself = gr.regularize(image, grid, weights=gr.weights.smoothed(weights, 0.7), **settings)
    assert_allclose(itself.value, by_hand.value, rtol=0, atol=1e-6)  # the data are rounded to float32 before the blur
    plain = gr.regularize(image, grid, weights=weights, **settings)
    assert np.abs(plain.value - itself.value).max() > 1e-3


@pytest.mark.parametrize(
    "options", [{"p": 2, "max_iter": 1}, {"p": 1, "lam": 5.0, "max_iter": 2, "solver": gr.Jacobi(damping=1)}]
)
def test_tiles_have_the_bits_of_the_whole(device, options):
    image = picture(90, 41)
    weights = gr.weights.smoothed(gr.weights.patch(2, 0.5), 0.8)
    call = {"weights": weights, "radius": 3, "sigma": 0.1, "lam": 2.0, "backend": device} | options
    whole = gr.denoise_image(image, **call)
    part, stored = gr.GridGraph((64, 41), 3), options["p"] != 2
    allowed = gr.memory_needed(part, p=options["p"], weights=weights, stored=stored, backend=device)
    assert_array_equal(gr.denoise_image(image, memory=allowed, **call), whole)


def test_a_stored_graph_of_pixels_knows_its_grid(device):
    """The graph of the nearest patches, and the grid itself as a stored graph."""
    image = picture(14, 15)
    weights = gr.weights.smoothed(gr.weights.patch(1, 0.5), 0.7)
    grid = gr.GridGraph(image.shape, 2)
    settings = {"weights": weights, "p": 1, "lam": 5.0, "max_iter": 2, "backend": device}
    stored = gr.regularize(image.ravel(), grid.to_graph(), **settings).value
    assert_allclose(stored.reshape(image.shape), gr.regularize(image, grid, **settings).value, rtol=0, atol=1e-5)
    assert np.std(gr.denoise_image(image, k=5, radius=3, **settings)) < np.std(image)


def test_opponent_colours():
    """Brightness, and two colours at 0.45: distances in these are those of the weights."""
    image = rng(3).random((11, 12, 3))
    seen = image @ OPPONENT.T
    assert_allclose(OPPONENT @ OPPONENT.T, np.diag([1, 0.45**2, 0.45**2]), atol=1e-15)
    grid = gr.GridGraph((11, 12), 2)
    weights = gr.weights.bilateral(3.0, 0.4)
    settings = {"lam": 2.0, "max_iter": 1, "backend": "numpy", "dtype": "float64"}
    by_hand = gr.regularize(image, grid, weights=gr.weights.guided(weights, seen.reshape(-1, 3)), **settings)
    itself = gr.regularize(image, grid, weights=gr.weights.smoothed(weights, 0, opponent=True), **settings)
    assert_allclose(itself.value, by_hand.value, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="3 channels, got 1"):
        gr.regularize(picture(9, 9), gr.GridGraph((9, 9)), weights=gr.weights.smoothed(weights, 1, opponent=True))


def test_the_innermost_is_given_what_the_outer_ones_make():
    """A guide around a blur is blurred; a blur around a guide does nothing: the guide does not look at its input."""
    guide = picture(9, 10, seed=3)
    grid, f0 = gr.GridGraph((9, 10), 2), picture(9, 10).reshape(-1, 1)
    weights = gr.weights.patch(1, 0.5)
    outer = gr.weights.guided(gr.weights.smoothed(weights, 0.8), guide.reshape(-1, 1))
    _, compared = patch_weights(outer)
    assert_allclose(compared.of(grid, f0), blurred(guide, (0.8, 0.8)).reshape(-1, 1), atol=1e-6)
    inner = gr.weights.smoothed(gr.weights.guided(weights, guide.reshape(-1, 1)), 0.8)
    _, compared = patch_weights(inner)
    assert_array_equal(compared.of(grid, f0), guide.reshape(-1, 1))


@pytest.mark.parametrize(("std", "spacing"), [(0.5, None), (0.9, (1.0, 3.0))])
def test_what_the_blur_leaves_of_noise(std, spacing):
    """White noise through the same blur: the norm within the scatter of 160,000 correlated pixels, 1 percent."""
    noise = rng(7).standard_normal((400, 400))
    left = ndimage.gaussian_filter(noise, std if spacing is None else (std, std / 3), mode="mirror").std()
    assert blur_norm(std, spacing, 2) == pytest.approx(left, rel=0.01)


def test_no_blur_leaves_all_of_noise():
    assert blur_norm(0, None, 3) == 1


@pytest.mark.parametrize(
    ("error", "message", "call"),
    [
        (TypeError, "weights must be an object of gpureg.weights", lambda: gr.weights.smoothed(1.0, 1.0)),
        (ValueError, "std must be finite and >= 0", lambda: gr.weights.smoothed(gr.weights.patch(1, 1.0), -1)),
        (TypeError, "opponent must be", lambda: gr.weights.smoothed(gr.weights.patch(1, 1.0), 1, opponent=2)),
        (
            ValueError,
            "smoothed weights need vertices on a grid",
            lambda: gr.regularize(
                np.ones(3),
                gr.Graph.from_edges([[0, 1]], n_vertices=3),
                weights=gr.weights.smoothed(gr.weights.patch(0, 1.0), 1),
            ),
        ),
    ],
)
def test_wrong_input_gets_a_sentence(error, message, call):
    with pytest.raises(error, match=message):
        call()
