"""Passes on groups of similar patches: when they are made, and what they make of the filter's result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import rng
from scipy import ndimage
from small_passes import with_small_passes

import gpureg as gr
from gpureg import backends
from gpureg.images import on_device, parts, run
from gpureg.images.prepare import relative_noise
from gpureg.images.raster import Raster
from gpureg.regularization.tiling import cut

HOST = {"backend": "numpy", "dtype": "float64"}
# Three implementations of one sum in float64, of values up to 255: a few hundred roundings of 255 * 2^-53.
CLOSE = 1e-10


def scene(shape: tuple[int, int] = (40, 44)) -> np.ndarray:
    y, x = np.indices(shape)
    return 100.0 + 60 * (y // 8 % 2) + 30 * np.sin(x / 4.0)


def noisy(sigma: float = 15.0, shape: tuple[int, int] = (40, 44)) -> np.ndarray:
    return scene(shape) + rng(3).normal(0, sigma, shape)


def plan_of(image: np.ndarray, **options) -> gr.DenoisePlan:
    return with_small_passes(gr.plan_denoising(image, radius=3, **{"passes": 2, **options}))


def by_hand(
    plan: gr.DenoisePlan, f0: np.ndarray, pilot: np.ndarray, sigma, level=None, mask=None, compared=None
) -> np.ndarray:
    """The passes of a plan in the units of the image, without a frame; all arrays (..., m)."""
    device, shape = backends.get("numpy", np.float64), f0.shape
    grid = gr.GridGraph(shape[:-1], mask=mask)
    f0, guide = f0.reshape(-1, shape[-1]), pilot.reshape(-1, shape[-1])
    variance = sigma**2 if level is None else sigma**2 * level
    for each in plan.passes:
        groups = device.patch_groups(grid, guide[:, :compared], each.form(sigma), level=level)
        guide = device.get(grid, device.group_step(groups, f0, guide, variance))
    return guide.reshape(shape)


# --- when -------------------------------------------------------------------------------------------------------------

WHEN = {
    "nothing": ({}, 3, "default"),
    "one": ({"passes": 1}, 1, "given"),
    "two": ({"passes": 2}, 2, "given"),
    "three": ({"passes": 3}, 3, "given"),
    "fast": ({"quality": "fast"}, 1, "quality='fast'"),
    "best": ({"quality": "best"}, 3, "quality='best'"),
    "the number goes before": ({"quality": "fast", "passes": 2}, 2, "given"),
    "total variation": ({"p": 1}, 1, "only after one sweep at p = 2"),
    "total variation, asked": ({"p": 1, "max_iter": 2, "passes": 2}, 2, "given"),
    "given lam": ({"lam": 2.0}, 1, "only after one sweep at p = 2"),
    "searched lam": ({"lam": "sure", "backend": "numpy", "radius": 2}, 1, "only after one sweep at p = 2"),
    "given weights": ({"weights": "patch"}, 1, "only after one sweep at p = 2"),
    "nearest patches": ({"k": 5, "weights": "patch"}, 1, "only after one sweep at p = 2"),
    "guide": ({"guide": scene((32, 34))}, 1, "only after one sweep at p = 2"),
    "several sweeps": ({"max_iter": 2}, 1, "only after one sweep at p = 2"),
    "no noise": ({"sigma": 0.0, "weights": "bilateral", "sigma_value": 9.0, "passes": 2}, 1, "no noise"),
}


@pytest.mark.parametrize("name", WHEN)
def test_when_there_are_passes(name):
    options, count, why = WHEN[name]
    plan = gr.plan_denoising(noisy(15.0, (32, 34)), **{"sigma": 15.0, **options})
    assert 1 + len(plan.passes) == count and why in plan.reasons["groups"]
    assert ("on groups of similar patches" in plan.describe()) == (count > 1)
    (row,) = [line for line in plan.explain().splitlines() if line.startswith("groups")]
    assert (f"{count - 1} pass" in row) == (count > 1)
    assert (plan.noise is None) == (count == 1)


def test_the_last_passes_are_those_that_remain():
    image = noisy(15.0, (32, 34))
    three = gr.plan_denoising(image, sigma=15.0, passes=3).passes
    assert gr.plan_denoising(image, sigma=15.0, passes=2).passes == three[1:]
    assert [each.patch_radius for each in three] == [(2, 2), (3, 3)]
    best = gr.plan_denoising(image, sigma=15.0, quality="best").passes
    assert sum(map(sum, (each.step for each in best))) < sum(map(sum, (each.step for each in three)))
    volume = gr.plan_denoising(np.stack([image] * 4), sigma=15.0)
    assert [len(each.radius) for each in volume.passes] == [3, 3]
    # an axis of length 1 is none
    assert gr.plan_denoising(image[None], sigma=15.0).passes == three


def test_small_images_stay_with_the_filter():
    small = gr.plan_denoising(noisy(15.0, (31, 60)), sigma=15.0)
    assert not small.passes and "fewer than 32 pixels" in small.reasons["groups"]
    assert len(gr.plan_denoising(noisy(15.0, (31, 60)), sigma=15.0, quality="balanced").passes) == 2
    assert len(gr.plan_denoising(noisy(15.0, (12, 12))[None].repeat(4, 0), sigma=15.0).passes) == 2


def test_noise_that_is_not_white_stays_with_the_filter():
    clean = np.add.outer(np.linspace(50, 150, 128), np.linspace(0, 80, 128))
    blurred = ndimage.gaussian_filter(rng(5).normal(0, 60, clean.shape), 1.0)
    with pytest.warns(UserWarning, match="correlated"):
        plan = gr.plan_denoising(clean + blurred)
    assert not plan.passes and "correlated" in plan.reasons["groups"] and "passes=3" in plan.reasons["groups"]
    report = plan.report
    assert report is not None and not gr.plan_denoising(clean + blurred, sigma=report).passes
    assert len(gr.plan_denoising(clean + blurred, sigma=report, passes=3).passes) == 2
    for found, says in (({"period": 2}, "mosaic"), ({"period": 8}, "JPEG"), ({"stripe_rows": 3.0}, "whole rows")):
        channel = replace(report.channels[0], correlated=False, **found)
        other = replace(report, channels=(channel,))
        assert says in gr.plan_denoising(clean + blurred, sigma=other).reasons["groups"]
    saved = replace(report, channels=(replace(report.channels[0], period=8),))
    assert report.channels[0].correlated and len(gr.plan_denoising(clean + blurred, sigma=saved).passes) == 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"passes": 0}, "passes must lie in 1..3, got 0"),
        ({"passes": 4}, "passes must lie in 1..3, got 4"),
        ({"passes": 2, "guide": np.zeros((9, 9))}, "passes=2 does not work with a guide"),
        ({"passes": 2, "max_iter": 0}, "passes=2 needs the result of at least one iteration"),
        ({"quality": "good"}, 'quality must be "fast", "balanced" or "best"'),
    ],
    ids=str,
)
def test_wrong_passes_get_a_sentence(options, says):
    with pytest.raises(ValueError, match=says):
        gr.denoise_image(np.zeros((9, 9)), sigma=1.0, **options)


def test_other_numbers_of_axes():
    four = rng(3).normal(0, 1, (3, 3, 3, 3))
    assert "only for 2 or 3 axes" in gr.plan_denoising(four, sigma=1.0).reasons["groups"]
    with pytest.raises(ValueError, match="passes=2 needs an image of 2 or 3 axes, got 4"):
        gr.plan_denoising(four, sigma=1.0, passes=2)


# --- what -------------------------------------------------------------------------------------------------------------


def test_passes_follow_the_filter():
    image = noisy()
    plan = plan_of(image, sigma=15.0, passes=3)
    pilot = gr.run_plan(replace(plan, passes=()), image, **HOST).value
    result = gr.run_plan(plan, image, **HOST)
    expected = by_hand(plan, image[..., None], pilot[..., None], 15.0)[..., 0]
    assert np.abs(result.value - expected).max() < CLOSE
    assert "2 passes on groups of similar patches: 3x3 every 3, 3x3 every 3 pixels" in result.method


def test_passes_remove_more_noise():
    clean = np.kron(rng(1).uniform(40, 200, (3, 3)), np.ones((18, 18)))
    image = clean + rng(3).normal(0, 20, clean.shape)
    one, three = (np.std(gr.denoise_image(image, passes=n, backend="numpy") - clean) for n in (1, 3))
    assert three < 0.95 * one  # measured at five seeds: 0.85 to 0.92


def test_a_map_and_light_give_the_variance_of_each_pixel():
    image, line = noisy(), gr.PhotonNoise(2.0, 0.0, 0.0)
    spread = np.linspace(0.5, 1.5, image.size).reshape(image.shape)
    of_map = plan_of(image, sigma=15.0 * spread)
    of_light = plan_of(image, sigma=line)
    light = relative_noise(Raster.of(image), image[..., None], (line,), of_light.sigmas, of_light.sigmas)
    for plan, profile in ((of_map, spread / np.sqrt(np.mean(spread**2))), (of_light, light)):
        pilot = gr.run_plan(replace(plan, passes=()), image, **HOST).value
        expected = by_hand(plan, image[..., None], pilot[..., None], plan.sigma, profile.ravel() ** 2)[..., 0]
        assert np.abs(gr.run_plan(plan, image, **HOST).value - expected).max() < CLOSE
    # a map of one value is a number
    alike = [gr.run_plan(plan_of(image, sigma=s), image, **HOST).value for s in (15.0, np.full(image.shape, 15.0))]
    assert np.abs(alike[0] - alike[1]).max() < CLOSE


def test_three_channels_are_turned_to_opponent_colours():
    image = np.stack([noisy(), 200 - noisy(14.0), noisy(16.0)], -1)
    given = {"weights": gr.weights.bilateral(2.0, 60.0), "lam": 2.0, "channel_axis": -1}
    plan = plan_of(image, sigma=15.0, **given)
    pilot = gr.run_plan(replace(plan, passes=()), image, channel_axis=-1, **HOST).value
    turn = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])
    # the groups compare the first two of them
    expected = by_hand(plan, image @ turn.T, pilot @ turn.T, 15.0, compared=2) @ turn
    assert np.abs(gr.run_plan(plan, image, channel_axis=-1, **HOST).value - expected).max() < CLOSE


def test_channels_with_other_noise_are_brought_to_one_scale():
    """Two channels filtered together with given weights, which know nothing of their noise."""
    image = np.stack([noisy(5.0), noisy(30.0)], -1)
    given = {"weights": gr.weights.bilateral(2.0, 60.0), "lam": 2.0, "channel_axis": -1}
    plan = plan_of(image, sigma=[5.0, 30.0], **given)
    pilot = gr.run_plan(replace(plan, passes=()), image, channel_axis=-1, **HOST).value
    units = np.array([5.0, 30.0])
    expected = by_hand(plan, image / units, pilot / units, 1.0) * units
    assert np.abs(gr.run_plan(plan, image, channel_axis=-1, **HOST).value - expected).max() < CLOSE


@pytest.mark.parametrize(("scale", "offset"), [(2.0**-90, 0.0), (2.0**90, 0.0), (1.0, 2.0**20)])
def test_any_range_of_values_keeps_its_digits(scale, offset):
    """A power of two changes no bit in float32; an offset costs those of the image itself alone."""
    image = np.rint(16 * noisy()) / 16
    plan = plan_of(image, sigma=15.0)
    other = plan_of(image * scale + offset, sigma=15.0 * scale)
    want = gr.run_plan(plan, image, backend="numpy").value
    got = gr.run_plan(other, image * scale + offset, backend="numpy").value
    # measured: 0 bits for a scale; 255 * 2^-24 in each of about ten steps for an offset
    assert np.abs((got - offset) / scale - want).max() <= (0 if offset == 0 else 1e-3)


def test_pixels_without_data_and_those_that_stay():
    """Where lam is infinite pixels stay; where it is 0 the filter's result is all that counts."""
    image = noisy()
    lam = np.full(image.shape, 2.0)
    lam[5:9, 5:9], lam[20:23, 20:23] = np.inf, 0.0
    plan = plan_of(image, sigma=15.0, lam=lam, weights="bilateral")
    pilot = gr.run_plan(replace(plan, passes=()), image, **HOST).value
    got = gr.run_plan(plan, image, **HOST).value
    assert np.array_equal(got[5:9, 5:9], image[5:9, 5:9])
    data = np.where(lam == 0, pilot, image)
    expected = by_hand(plan, data[..., None], pilot[..., None], 15.0)[..., 0]
    assert np.abs(got - np.where(lam == np.inf, image, expected)).max() < CLOSE


def test_pixels_outside_the_mask_count_nothing():
    image, mask = noisy(), rng(9).random((40, 44)) < 0.8
    plan = plan_of(image, sigma=15.0, mask=mask, passes=3)
    holes, other = np.where(mask, image, np.nan), np.where(mask, image, 1e6)
    got = gr.run_plan(plan, holes, mask=mask, **HOST).value
    assert np.isnan(got[~mask]).all() and np.isfinite(got[mask]).all()
    assert np.array_equal(gr.run_plan(plan, other, mask=mask, **HOST).value[mask], got[mask])


def test_a_run_that_is_stopped_returns_the_filter(monkeypatch):
    image = noisy(15.0, (20, 22))
    plan = plan_of(image, sigma=15.0, p=1, max_iter=3)
    pilot = gr.run_plan(replace(plan, passes=()), image, callback=lambda *_: True, **HOST)
    stopped = gr.run_plan(plan, image, callback=lambda *_: True, **HOST)
    assert stopped.stop is gr.Stop.CALLBACK and np.array_equal(stopped.value, pilot.value)

    def interrupt(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "after_passes", interrupt)
    monkeypatch.setattr(on_device, "after_filter", interrupt)
    for each in (plan, plan_of(image, sigma=15.0)):
        with pytest.raises(gr.Interrupted) as caught:
            gr.run_plan(each, image, **HOST)
        assert np.array_equal(caught.value.result.value, gr.run_plan(replace(each, passes=()), image, **HOST).value)


def test_a_run_in_parts_that_is_stopped_returns_the_whole_image(monkeypatch):
    """The parts that are done, the filter's result in the one that was begun, and the image in the others."""
    image = noisy(15.0)
    plan = plan_of(image, sigma=15.0)
    tiles = cut(image.shape, (20, 22), (8, 8), (1, 1))
    monkeypatch.setattr(parts, "tiles_of", lambda *args, **options: tiles)
    raster = Raster.of(image)
    done = parts.run_in_parts(plan, raster, **HOST).value
    filtered = parts.run_in_parts(replace(plan, passes=()), raster, **HOST).value
    made = iter([on_device.after_filter])

    def interrupt(*args, **options):
        for make in made:
            return make(*args, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(on_device, "after_filter", interrupt)
    with pytest.raises(gr.Interrupted) as caught:
        parts.run_in_parts(plan, raster, **HOST)
    expected = image.copy()
    for tile, of in zip(tiles[:2], (done, filtered), strict=True):
        expected[tile.own] = of[tile.own]
    assert np.array_equal(caught.value.result.value, expected)


@pytest.mark.parametrize("sigma", [1e-25, 1e25])
def test_noise_far_from_the_contrast_is_still_a_number(sigma):
    """Its square is none of float32: tiny noise leaves an area of equal values, large noise the mean of a group."""
    image = np.float32(noisy())
    image[:20] = 50
    value = gr.denoise_image(image, sigma=sigma, passes=3, radius=3, backend="numpy")
    assert np.isfinite(value).all()
    assert np.ptp(value) <= np.ptp(image)
    if sigma < 1:
        # a few roundings of float32
        assert np.abs(value - image).max() <= 1e-4
