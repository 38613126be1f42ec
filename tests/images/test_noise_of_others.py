"""Noise that is said of other images or channels, or by the caller, and noise far from 0."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gpureg as gr
from gpureg.jobs.noise import NoiseOptions, noise_of_file

RNG = np.random.default_rng(0)
FLAT = np.kron(RNG.uniform(60, 200, (6, 6)), np.ones((12, 12)))
NOISY = FLAT + RNG.normal(0, 10, FLAT.shape)
LIGHT = 3 * np.kron(RNG.uniform(20, 400, (6, 6)), np.ones((12, 12)))
PHOTONS = 3.0 * RNG.poisson(LIGHT / 3) + RNG.normal(0, 2, LIGHT.shape)
COLOURS = np.stack([FLAT, 0.5 * FLAT + 20, 255 - FLAT], axis=-1)
NOISY_COLOURS = COLOURS + RNG.normal(0, 10, COLOURS.shape)
pytestmark = pytest.mark.filterwarnings("ignore:blocks of 8 x 8")  # the tiles have sides of 12


def rms(image: np.ndarray, clean: np.ndarray = FLAT) -> float:
    return float(np.sqrt(np.mean((np.asarray(image, np.float64) - clean) ** 2)))


def image_of(values: np.ndarray, **options: Any) -> np.ndarray:
    return gr.denoise_image(values, channel_axis=-1, backend="numpy", **options)


def bilateral_of(values: np.ndarray, **options: Any) -> np.ndarray:
    return gr.denoise_bilateral(values, channel_axis=-1, backend="numpy", **options)


@pytest.mark.parametrize(("offset", "unit"), [(2.0**40, 1.0), (0.0, 1e37), (0.0, 1e60)])
def test_the_map_of_photon_noise_in_any_units(offset: float, unit: float) -> None:
    """float32 held the map: at an offset of 2^40 it rounds to 65536, beyond 1e38 it is infinite."""
    photons = gr.PhotonNoise(3.0, 2.0)
    expected = rms(gr.denoise_image(PHOTONS, sigma=photons, backend="numpy"), LIGHT)
    there = gr.PhotonNoise(3.0 * unit, 2.0 * unit, offset * unit)
    values = PHOTONS * unit + offset
    found = (gr.denoise_image(values, sigma=there, backend="numpy") - offset) / unit
    # the values are rounded to 2^-12 by the offset, and the weights compare them in float32
    assert rms(found, LIGHT) == pytest.approx(expected, rel=1e-3)
    bilateral = (gr.denoise_bilateral(values, sigma=there, backend="numpy") - offset) / unit
    assert rms(bilateral, LIGHT) < 0.5 * rms(PHOTONS, LIGHT)


def test_a_hot_pixel_does_not_decide_the_photon_noise() -> None:
    hot = PHOTONS.copy()
    hot[36, 36] = 1e9
    far = np.hypot(*(np.indices(hot.shape) - 36)) > 28
    found, expected = (
        rms(gr.denoise_image(x, sigma=gr.PhotonNoise(3.0, 2.0), backend="numpy")[far], LIGHT[far])
        for x in (hot, PHOTONS)
    )
    assert found == pytest.approx(expected, rel=0.02)  # 0.2 percent of the clipped values changed; it was 2 times


def test_photon_noise_is_checked() -> None:
    with pytest.raises(ValueError, match="PhotonNoise: gain must be finite and >= 0, got -1"):
        gr.PhotonNoise(-1, 2)
    with pytest.raises(TypeError, match="PhotonNoise: read_noise must be a number"):
        gr.PhotonNoise(1, "2")  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match=r"no value of the image is above the offset 1e\+06"):
        unchanged = gr.denoise_image(PHOTONS, sigma=gr.PhotonNoise(3, 0, 1e6), backend="numpy")
    assert np.array_equal(unchanged, PHOTONS)


@pytest.mark.parametrize("denoise", [image_of, bilateral_of])
def test_a_report_on_another_image_does_not_say_which_channels_are_equal(denoise: Callable[..., np.ndarray]) -> None:
    grey = gr.describe_noise(np.stack([NOISY] * 3, axis=-1), channel_axis=-1)
    assert grey.same == (0, 0, 0)
    found = denoise(NOISY_COLOURS, sigma=grey)
    for channel in range(3):
        assert rms(found[..., channel], COLOURS[..., channel]) < 6  # as each alone; channels 1 and 2 were channel 0


def test_a_plan_of_a_grey_image_on_colours() -> None:
    """As in a file whose middle is grey, where the parameters are chosen."""
    plan = gr.plan_denoising(np.stack([NOISY] * 3, axis=-1), channel_axis=-1)
    found = gr.run_plan(plan, NOISY_COLOURS, channel_axis=-1, backend="numpy").value
    for channel in range(3):
        assert rms(found[..., channel], COLOURS[..., channel]) < 6


@pytest.mark.parametrize("denoise", [image_of, bilateral_of])
def test_equal_channels_may_have_another_sigma(denoise: Callable[..., np.ndarray]) -> None:
    both = np.stack([NOISY, NOISY], axis=-1)
    found = denoise(both, sigma=[0, 10])
    assert np.array_equal(found[..., 0], NOISY)
    assert rms(found[..., 1]) < 6


@pytest.mark.parametrize("options", [{}, {"p": 1, "weights": "constant", "max_iter": 5}])
def test_a_channel_without_noise_leaves_the_others_together(options: dict[str, Any]) -> None:
    """The alpha of RGBA kept the colours apart, and lam could not be chosen for it."""
    alpha = np.full(FLAT.shape, 255.0)
    found = image_of(np.concatenate([NOISY_COLOURS, alpha[..., None]], axis=-1), **options)
    assert np.array_equal(found[..., 3], alpha)
    assert np.array_equal(found[..., :3], image_of(NOISY_COLOURS, **options))
    report = gr.describe_noise(np.concatenate([NOISY_COLOURS, alpha[..., None]], axis=-1), channel_axis=-1)
    assert report.groups == ((0, 1, 2), (3,))
    assert json.loads(json.dumps(report.as_json(), allow_nan=False))["covariance"][3] == [None] * 4


@pytest.mark.parametrize("denoise", [image_of, bilateral_of])
def test_a_guide_leaves_a_channel_without_noise(denoise: Callable[..., np.ndarray]) -> None:
    found = denoise(NOISY_COLOURS, sigma=[10, 0, 10], guide=COLOURS)
    assert np.array_equal(found[..., 1], NOISY_COLOURS[..., 1])
    assert rms(found[..., 0], COLOURS[..., 0]) < 5


def test_the_values_of_a_guide_are_in_its_units() -> None:
    unit = np.array([1.0, 1.0, 5.0])
    found = image_of(NOISY_COLOURS * unit, guide=COLOURS * unit)
    assert rms(found[..., 0], FLAT) < rms(image_of(NOISY_COLOURS)[..., 0], FLAT)  # 3.3 where 0.9 is right


@pytest.mark.parametrize("axis", [0, 1])
def test_channels_beside_thin_axes(axis: int) -> None:
    both = np.stack([NOISY, 3 * NOISY])
    thin = np.moveaxis(both[:, :, None, :, None], 0, axis)
    expected = np.moveaxis(gr.denoise_image(both, channel_axis=0, backend="numpy")[:, :, None, :, None], 0, axis)
    assert np.array_equal(gr.denoise_image(thin, channel_axis=axis, backend="numpy"), expected)


@pytest.mark.parametrize("denoise", [gr.denoise_image, gr.denoise_bilateral, gr.denoise_nl_means])
def test_a_callback_with_groups_of_channels(denoise: Callable[..., np.ndarray]) -> None:
    both, calls = np.stack([NOISY, 20 * NOISY]), 0

    def interrupt(check: Any) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise KeyboardInterrupt

    with pytest.raises(gr.Interrupted) as caught:
        denoise(both, channel_axis=0, callback=interrupt, backend="numpy")
    value = caught.value.result.value
    assert value.shape == both.shape
    assert rms(value[0]) < 6  # done, the other not
    assert np.array_equal(value[1], both[1])


@pytest.mark.parametrize(
    ("sigma", "error"),
    [([[1], [1, 2]], "rows of different lengths"), (np.ones(3, bool), "got bool"), ([None] * 3, "got object")],
)
def test_a_wrong_sigma_is_refused_in_a_sentence(sigma: Any, error: str) -> None:
    with pytest.raises((TypeError, ValueError), match=f"denoise_image: sigma must be a number or an array.*{error}"):
        image_of(NOISY_COLOURS, sigma=sigma)


def test_a_dark_frame_does_not_end_the_report_on_a_series(tmp_path: Path) -> None:
    tifffile = pytest.importorskip("tifffile")
    series = np.stack([PHOTONS, np.full_like(PHOTONS, 100)]).astype(np.float32)
    tifffile.imwrite(tmp_path / "series.tif", series, metadata={"axes": "TYX"})
    with pytest.warns(UserWarning, match="the gain of the camera cannot be told in slice 2"):
        found = noise_of_file(tmp_path / "series.tif", NoiseOptions(offset=0.0, each=("T",)))
    assert found.cameras[0] is not None
    assert found.cameras[1] is None


def test_integers_that_float64_rounds_are_said() -> None:
    with pytest.warns(UserWarning, match="integers beyond 2"):
        gr.denoise_image(NOISY.astype(np.int64) + 2**62, sigma=0, backend="numpy")


@pytest.mark.parametrize("share", [0.15, 0.2])
def test_many_impulses(share: float) -> None:
    """So many that no test of the noise has enough pixels: the image was returned nearly unchanged, rms 40 to 60."""
    rng = np.random.default_rng(1)
    clean = np.kron(FLAT[::6, ::6], np.ones((12, 12)))
    noisy = clean + rng.normal(0, 10, clean.shape)
    hit = np.where(rng.random(noisy.shape) < share, rng.choice([0.0, 255.0], noisy.shape), noisy)
    found = gr.denoise_image(hit.clip(0, 255).astype(np.uint8), backend="numpy")
    # half of the Gaussian noise: 5 percent of impulses leave a quarter
    assert rms(found, clean) < 0.5 * rms(noisy, clean)
