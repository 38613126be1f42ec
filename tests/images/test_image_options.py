"""What the doors of images are told: names of weights, what one sweep does besides, old names, wrong values."""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest
from cases import rng
from click.testing import CliRunner

import gpureg as gr
from gpureg.cli import main

HOST = {"backend": "numpy"}


def picture(*shape, seed=3):
    clean = np.where(np.indices(shape[:2]).sum(axis=0) // 8 % 2, 0.8, 0.2)
    clean = clean if len(shape) == 2 else np.stack([clean] * shape[2], -1)
    return clean + 0.1 * rng(seed).standard_normal(shape)


@pytest.mark.parametrize("name", ["constant", "bilateral", "patch"])
@pytest.mark.parametrize("channel_axis", [None, -1])
def test_weights_by_name_are_made_of_the_noise(channel_axis, name):
    image = picture(24, 27)
    if channel_axis is not None:  # a scene with smooth places, so that the noise of the channels is seen as independent
        clean = np.where(np.indices((72, 81)).sum(axis=0) // 36 % 2, 0.8, 0.2)[..., None]
        image = clean + 0.1 * rng(3).standard_normal((72, 81, 2))
        assert not gr.plan_denoising(image, channel_axis=-1).groups
    sigma = gr.estimate_noise(image, channel_axis=channel_axis)
    samples = 25 * (1 if channel_axis is None else 2)
    by_hand = {
        "constant": gr.weights.constant(),
        "bilateral": gr.weights.bilateral(3.0, 3 * sigma),
        "patch": gr.weights.patch(2, 0.6 * sigma * math.sqrt(samples), sigma=sigma),
    }
    named = gr.denoise_image(image, weights=name, channel_axis=channel_axis, **HOST)
    given = gr.denoise_image(image, weights=by_hand[name], channel_axis=channel_axis, **HOST)
    assert np.array_equal(named, given)


@pytest.mark.parametrize(
    ("given", "weights"),
    [
        ({"weights": "patch", "h": 0.7, "patch_radius": 1}, gr.weights.patch(1, 0.7, sigma=0.1)),
        ({"weights": "patch", "patch_sigma": 0.8}, gr.weights.patch(2, 0.6 * 0.1, sigma=0.1, patch_sigma=0.8)),
        ({"weights": "bilateral", "sigma_space": 2.0}, gr.weights.bilateral(2.0, 3 * 0.1)),
        ({"weights": "bilateral", "sigma_value": 0.5}, gr.weights.bilateral(3.0, 0.5)),
        ({"weights": "bilateral", "sigma_value": 0.5, "spacing": (2.0, 3.0)}, gr.weights.bilateral(6.0, 0.5)),
    ],
)
def test_what_belongs_to_a_name(given, weights):
    image = picture(20, 22)
    by_hand = {name: value for name, value in given.items() if name == "spacing"}
    expected = gr.denoise_image(image, sigma=0.1, weights=weights, **by_hand, **HOST)
    assert np.array_equal(gr.denoise_image(image, sigma=0.1, **given, **HOST), expected)


def test_a_map_of_the_noise_makes_maps_of_named_weights():
    image, sigma = picture(20, 22), np.where(np.arange(22) < 11, 0.05, 0.2) * np.ones((20, 1))
    mean = math.sqrt(np.mean(sigma**2))
    by_hand = gr.weights.patch(2, 0.6 * 5 * sigma.ravel(), sigma=sigma.ravel())
    named = gr.denoise_image(image, sigma=sigma, weights="patch", dtype="float64", **HOST)
    expected = gr.denoise_image(image, sigma=mean, weights=by_hand, dtype="float64", **HOST)
    assert np.abs(named - expected).max() < 1e-9


def test_the_radius_of_the_rules_patches():
    image = picture(24, 27)
    plans = {r: gr.plan_denoising(image, sigma=0.1, patch_radius=r) for r in (None, 1, 3)}
    assert [plans[r].compared()[0].patch_radius for r in (1, 3)] == [1, 3]
    assert "3x3 Gaussian" in plans[1].describe() and "7x7 Gaussian" in plans[3].describe()
    nearest = gr.plan_denoising(image, sigma=0.1, p=1, k=4, patch_radius=1)
    assert "3x3 flat patches" in nearest.describe()
    assert nearest.compared()[0].h == pytest.approx(0.1 * 3)
    scene = np.where(np.indices((72, 81)).sum(axis=0) // 36 % 2, 0.8, 0.2)[..., None]
    scene = scene + 0.1 * rng(3).standard_normal((72, 81, 3))
    colour = gr.plan_denoising(scene, sigma=0.1, patch_radius=2, channel_axis=-1)
    usual = gr.plan_denoising(scene, sigma=0.1, channel_axis=-1)
    assert colour.compared()[0].h == pytest.approx(usual.compared()[0].h * 5 / 3)


@pytest.mark.parametrize("centre", ["once", "largest", "none"])
@pytest.mark.parametrize("average_patches", [False, True, "weighted"])
def test_what_one_sweep_does_besides_is_that_of_nl_means(centre, average_patches):
    image = picture(20, 22)
    given = {"patch_radius": 1, "h": 0.4, "centre": centre, "average_patches": average_patches}
    whole = gr.denoise_image(image, sigma=0.1, weights="patch", radius=3, **given, **HOST)
    expected = gr.denoise_nl_means(image, sigma=0.1, radius=3, **given, **HOST)
    assert np.array_equal(whole, expected)
    plan = gr.plan_denoising(image, sigma=0.1, weights="patch", radius=3, **given)
    assert (plan.centre, plan.average_patches) == (centre, average_patches)
    assert np.array_equal(gr.run_plan(plan, image, **HOST).value, whole)


def test_a_search_for_lam_sees_what_one_sweep_does():
    image = picture(24, 27)
    plan = gr.plan_denoising(image, sigma=0.1, lam="sure", centre="largest", average_patches=False, **HOST)
    assert plan.centre == "largest" and not plan.average_patches
    assert "SURE" in plan.reasons["lam"]


def test_memory_of_a_graph_of_patches():
    image = picture(24, 27)
    whole, small = (gr.patch_graph(image, 4, radius=3, memory=memory, **HOST) for memory in (None, 1000))
    assert np.array_equal(whole.indices, small.indices)


def test_the_same_names_on_the_command_line():
    words = CliRunner().invoke(main, ["denoise", "--help"]).output
    known = {word.strip("-,").replace("-", "_") for word in words.split() if word.startswith("--")}
    door = set(inspect.signature(gr.denoise_image).parameters)
    assert door - known == {"image", "gamma", "coupled", "update_weights", "callback", "channel_axis"}
    words = CliRunner().invoke(main, ["simplify", "--help"]).output
    known = {word.strip("-,").replace("-", "_") for word in words.split() if word.startswith("--")}
    door = set(inspect.signature(gr.simplify_image).parameters)
    assert door - known == {"image", "gamma", "coupled", "memory", "callback", "channel_axis"}


f = picture(10, 9)
RENAMED = [
    (lambda: gr.denoise_image(f, nearest=3), "denoise_image: 'nearest' is called k now"),
    (lambda: gr.plan_denoising(f, nearest=3), "plan_denoising: 'nearest' is called k now"),
    (lambda: gr.denoise_nl_means(f, a=1), "denoise_nl_means: 'a' is called patch_sigma now"),
    (lambda: gr.patch_graph(f, 3, a=1), "patch_graph: 'a' is called patch_sigma now"),
    (lambda: gr.inpaint_image(f, mask=f > 0), "inpaint_image: 'mask' is called missing now"),
    (lambda: gr.weights.patch(radius=1, h=1), "patch: 'radius' is called patch_radius now"),
    (lambda: gr.weights.patch(1, 1, a=1), "patch: 'a' is called patch_sigma now"),
    (lambda: gr.simplify_image(f, merge=1), "simplify_image: 'merge' is called merge_tol now"),
    (lambda: gr.simplify_image(f).merged(tol=1), "Regions.merged: 'tol' is called merge_tol now"),
    (lambda: gr.simplify_image(f).hierarchy(lams=[1]), "Regions.hierarchy: 'lams' is called lam now"),
    (lambda: gr.simplify_image(f).hierarchy(lam=[1], tol=1), "Regions.hierarchy: 'tol' is called merge_tol now"),
]


@pytest.mark.parametrize(("call", "sentence"), RENAMED)
def test_an_old_name_says_the_new_one(call, sentence):
    with pytest.raises(TypeError, match=f"^{sentence}$"):
        call()


WRONG = [
    ({"max_iter": True}, TypeError, "max_iter must be an integer, got True"),
    ({"max_iter": "3"}, TypeError, "max_iter must be an integer, got '3'"),
    ({"sigma": 0.1, "max_iter": 0, "tol": -1}, ValueError, "tol must be finite and >= 0, got -1"),
    ({"sigma": 0.1, "max_iter": 0, "eps": -1}, ValueError, "eps must be finite and >= 0, got -1"),
    ({"max_iter": 0, "lam": -1}, ValueError, "lam must be >= 0, got -1"),
    ({"max_iter": 0, "update_weights": 0}, ValueError, "update_weights must be >= 1, got 0"),
    ({"lam": True}, TypeError, "lam must be a number, got True"),
    ({"radius": "2"}, TypeError, "radius must be a number, got '2'"),
    ({"k": 2.5}, TypeError, "k must be an integer, got 2.5"),
    ({"progress": 1}, TypeError, "progress must be True or False, got 1"),
    ({"coupled": 1}, TypeError, "coupled must be True or False, got 1"),
    ({"callback": 3}, TypeError, "callback must be callable, got 3"),
    ({"dtype": "int32"}, ValueError, "dtype must be float32 or float64, got int32"),
    ({"weights": "gauss"}, ValueError, 'weights must be "constant", "bilateral" or "patch", got \'gauss\''),
    ({"h": 1.0}, ValueError, "h needs weights='patch'"),
    ({"weights": "patch", "sigma_value": 1.0}, ValueError, "sigma_value needs weights='bilateral'"),
    ({"weights": "bilateral", "patch_radius": 1}, ValueError, "patch_radius needs weights='patch'"),
    ({"centre": "twice"}, ValueError, 'centre must be "once", "largest" or "none", got \'twice\''),
    ({"centre": "none", "lam": 2.0}, ValueError, "centre='none' leaves the pixel itself out"),
    ({"centre": "largest", "lam": 0}, ValueError, "lam = 0 leaves the pixel itself out"),
    ({"centre": "once", "p": 1}, ValueError, "centre needs one sweep at p = 2"),
    ({"centre": "none", "max_iter": 3}, ValueError, "centre needs one sweep at p = 2"),
    ({"average_patches": True, "tol": 1e-3}, ValueError, "average_patches needs one sweep at p = 2"),
    ({"average_patches": True, "weights": "bilateral"}, ValueError, "average_patches needs patch weights"),
    ({"average_patches": 1}, ValueError, "average_patches must be True, False or 'weighted', got 1"),
    ({"no_such": 1}, TypeError, r"denoise_image\(\) got an unexpected keyword argument 'no_such'"),
]


@pytest.mark.parametrize(("given", "error", "sentence"), WRONG, ids=str)
def test_wrong_options_get_a_sentence(given, error, sentence):
    start = "" if "no_such" in given else "denoise_image: "
    with pytest.raises(error, match=f"^{start}{sentence}"):
        gr.denoise_image(f, **given, **HOST)


def test_errors_name_the_door_that_was_called():
    with pytest.raises(ValueError, match=r"^denoise_tv: lam must be >= 0, got -1$"):
        gr.denoise_tv(f, lam=-1)
    with pytest.raises(ValueError, match=r"^run_plan: memory must be >= 1, got 0$"):
        gr.run_plan(gr.plan_denoising(f), f, memory=0)
    with pytest.raises(TypeError, match=r"^Regions\.merged: merge_tol must be a number, got True$"):
        gr.simplify_image(f, **HOST).merged(True)
