"""Wrong arguments of the image filters get a sentence."""

from __future__ import annotations

import numpy as np
import pytest
from test_filters import picture

import gpureg as gr

WRONG = [
    (lambda f: gr.denoise_nl_means(f, centre="twice"), 'centre must be "once", "largest" or "none"'),
    (lambda f: gr.denoise_nl_means(f, average_patches="yes"), "average_patches must be True, False or 'weighted'"),
    (lambda f: gr.denoise_nl_means(f, border="mirror"), 'border must be "clip", "reflect"'),
    (lambda f: gr.denoise_nl_means(f, h=-1), "h must be finite and > 0"),
    (lambda f: gr.denoise_nl_means(f, h=np.zeros(f.shape)), "map of h must be finite and > 0"),
    (lambda f: gr.denoise_nl_means(f, h=np.ones(3)), r"h must be a number or one value per pixel, shape \(9, 8\)"),
    (lambda f: gr.denoise_nl_means(f, h=1, sigma=-np.ones(f.shape)), "map of sigma must be finite and >= 0"),
    (lambda f: gr.denoise_nl_means(f, h=1, sigma=-1), "sigma must be finite and >= 0"),
    (lambda f: gr.denoise_nl_means(f, h=1, lam=np.ones((2, 2))), "lam must be a number or one value per pixel"),
    (lambda f: gr.denoise_nl_means(f, h=1, lam=-1), "lam must be >= 0"),
    (lambda f: gr.denoise_nl_means(f, h=1, patch_radius=-1), "radius must be >= 0"),
    (lambda f: gr.denoise_nl_means(f, h=1, average_radius=-1), "radius must be >= 0"),
    (lambda f: gr.denoise_nl_means(f, h=1, cut=2), r"cut must lie in 0\.\.1"),
    (lambda f: gr.denoise_nl_means(f, h=1, radius=0.5), "reach the nearest neighbour"),
    (lambda f: gr.denoise_nl_means(f, h=1, metric="taxi"), 'metric must be "chebyshev", "euclidean" or "cityblock"'),
    (lambda f: gr.denoise_nl_means(f, h=1, guide=np.ones((2, 3))), "guide must hold numbers on the image's"),
    (lambda f: gr.denoise_nl_means(f, h=1, guide=f * np.nan), "guide must be finite"),
    (lambda f: gr.denoise_nl_means(f, h=1, spacing=(1, 2, 3)), "spacing must hold 2"),
    (lambda f: gr.denoise_nl_means(f, h=1, mask=np.ones(3, bool)), "mask must be boolean"),
    (lambda f: gr.denoise_nl_means(f * np.nan, h=1), "image must be finite"),
    (lambda f: gr.denoise_nl_means(f[0], h=1), "two or more axes"),
    (lambda f: gr.denoise_nl_means(f, h=1, channel_axis=5), "channel_axis must lie in"),
    (lambda f: gr.denoise_bilateral(f, sigma_value=0), "sigma_value must be > 0"),
    (lambda f: gr.denoise_bilateral(f, sigma_space=-1), "sigma_space must be > 0"),
    (lambda f: gr.denoise_bilateral(f, sigma_value=np.ones(2)), "sigma_value must be a number or one value per pixel"),
    (lambda f: gr.denoise_bilateral(f, border="none"), 'border must be "clip", '),
    (lambda f: gr.denoise_bilateral(f, centre="2"), 'centre must be "once", '),
    (lambda f: gr.denoise_tv(f, lam=-1), "lam must be >= 0"),
    (lambda f: gr.denoise_tv(f, lam=1, radius=-3), "radius must be > 0, got -3"),
    (
        lambda f: gr.denoise_image(f, p=1, lam=1, k=3, weights=gr.weights.bilateral(2, 1)),
        "nearest patches need patch weights",
    ),
    (lambda f: gr.denoise_image(f, p=1, lam=1, k=0, weights=gr.weights.patch(1, 1.0)), "must be >= 1, got 0"),
    (
        lambda f: gr.denoise_image(f, p=1, lam=1, weights=np.ones((9, 8, 8)), update_weights=2, radius=1),
        "update_weights needs a weight function",
    ),
    (lambda f: gr.denoise_image(f, p=1, lam=1, norm="round", weights=gr.weights.constant()), "norm must be"),
    (lambda f: gr.denoise_image(f, p=1, lam="sure", norm="edge"), "give lam a number"),
    (lambda f: gr.denoise_image(f, lam="sure", guide=f), "give lam a number"),
    (lambda f: gr.denoise_image(f, p=1, lam="sure", coupled=False), "give lam a number"),
    (
        lambda f: gr.run_plan(gr.plan_denoising(f, sigma=0.1), f, callback=print),
        "average_patches needs one sweep at p = 2 on a grid",
    ),
    (lambda f: gr.patch_graph(f, 0), "must be >= 1"),
    (lambda f: gr.patch_graph(f, 3, symmetrize="min"), "symmetrize must be"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_wrong_input_gets_a_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call(picture(9, 8))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: gr.denoise_tv(f, p=2), r"denoise_tv\(\) got an unexpected keyword argument 'p'"),
        (lambda f: gr.denoise_nl_means(f, h="wide"), "h must be a number"),
        (lambda f: gr.denoise_nl_means(f, h=1, patch_radius=1.5), "radius must be an integer"),
        (lambda f: gr.denoise_nl_means(f.astype(str)), "integers or real numbers"),
        (lambda f: gr.denoise_image(f, p=1, lam=1, guide=f, weights=np.ones(4)), "a guide needs weights"),
        (lambda f: gr.patch_graph(f, 2.5), "must be an integer"),
    ],
)
def test_a_wrong_type_gets_a_sentence(call, message):
    with pytest.raises(TypeError, match=message):
        call(picture(9, 8))
