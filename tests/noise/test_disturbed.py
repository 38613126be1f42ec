"""The noise of pictures that are unlike a textbook picture: right, or said that it cannot be told."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from cases import rng
from scipy import ndimage

import gpureg as gr

SCENE = np.kron(rng(0).uniform(60, 200, (8, 8)), np.ones((32, 32)))
NOISY = SCENE + rng(1).normal(0, 20, SCENE.shape)
BYTES = np.clip(NOISY, 0, 255).round().astype(np.uint8)
R = np.hypot(*(np.indices(SCENE.shape) - 128))
VOLUME = rng(2).normal(0, 20, (40, 48, 48))
AWAY = np.sqrt(sum((x - c) ** 2 for x, c in zip(np.indices(VOLUME.shape), (20, 24, 24), strict=True)))


def boxed(side: int, value: float, picture: np.ndarray = BYTES) -> np.ndarray:
    image = np.full((side, side), value, picture.dtype)
    begin = (side - 256) // 2
    image[begin : begin + 256, begin : begin + 256] = picture
    return image


def changed(share: float, value: float) -> np.ndarray:
    return np.where(rng(3).random(SCENE.shape) < share, value, NOISY)


def salted(share: float) -> np.ndarray:
    at = rng(4).random(SCENE.shape)
    return np.where(at < share / 2, 0, np.where(at < share, 255, BYTES)).astype(np.uint8)


DISTURBED = {
    "letterbox": (boxed(340, 114), None),
    "letterbox of 87 percent": (boxed(700, 114), None),
    "letterbox of another value, floats": (boxed(340, -7.25, NOISY), None),
    "field of view": (np.where(R < 110, NOISY - 100, 0), None),
    "field of view, NaN": (np.where(R < 110, NOISY, np.nan), R < 110),
    "scattered nodata": (changed(0.03, -9999), None),
    "block of nodata": (np.where((np.abs(np.indices(SCENE.shape) - 70) < 30).all(axis=0), -9999, NOISY), None),
    "hot pixel": (np.where(np.arange(65536).reshape(256, 256) == 4321, 65535, NOISY), None),
    "hot row": (np.where(np.arange(256)[:, None] == 50, 60000.0, NOISY), None),
    "half without noise": (np.where(np.arange(256) < 128, 100.0, NOISY), None),
    "20 percent missing": (NOISY, rng(5).random(SCENE.shape) > 0.2),
    "80 percent missing": (NOISY, rng(5).random(SCENE.shape) > 0.8),
    "lines of 3": (NOISY, np.arange(256) % 4 < 3 + 0 * np.arange(256)[:, None]),
    "shell of 4 voxels": (VOLUME, (AWAY > 14) & (AWAY < 18)),
    "half of a volume missing": (VOLUME, rng(6).random(VOLUME.shape) > 0.5),
    "one slice of a volume": (VOLUME, np.arange(40)[:, None, None] == 5 + 0 * VOLUME),
    "zeros around a cube": (np.where(np.abs(AWAY) < 18, VOLUME + 100, 0), None),
    "salt and pepper, 1 percent": (salted(0.01), None),
    "salt and pepper, 20 percent": (salted(0.2), None),
    "very small": (NOISY * 1e-22 * (20 / 20), None),
    "very large": (NOISY * 1e20, None),
    "far from 0": (NOISY + 1e8, None),
    "tiny, float32": ((NOISY * 1e-37).astype(np.float32), None),
}
UNITS = {"very small": 1e-22, "very large": 1e20, "tiny, float32": 1e-37}


@pytest.mark.parametrize("name", DISTURBED)
def test_a_disturbance_does_not_decide(name: str) -> None:
    """Measured: at most 5 percent off, with 80 percent missing too."""
    image, mask = DISTURBED[name]
    mask = None if mask is None else np.broadcast_to(mask, image.shape)
    assert gr.estimate_noise(image, mask=mask) == pytest.approx(20 * UNITS.get(name, 1.0), rel=0.08)


THIN = [(64, 64, 1), (64, 64, 2), (1, 64, 64), (32, 32, 1, 20), (2, 64), (1, 200), (20, 1, 32), (5, 64), (64, 1, 64)]


@pytest.mark.parametrize("shape", THIN)
def test_thin_axes(shape: tuple[int, ...]) -> None:
    """The standard error of an estimate from n values is 1.4 / sqrt(n); half of the smallest, 62, are measured."""
    assert gr.estimate_noise(rng(7).normal(0, 20, shape)) == pytest.approx(20, rel=2 * 1.4 / 62**0.5)


@pytest.mark.parametrize("mean", [0.05, 0.1, 0.3, 1.0, 3.0, 10.0])
def test_counts_that_are_mostly_zero(mean: float) -> None:
    counts = rng(8).poisson(mean, (256, 256)).astype(np.uint16)
    assert gr.estimate_noise(counts) == pytest.approx(np.sqrt(mean), rel=0.08)
    assert not gr.describe_noise(counts).channels[0].has_impulses


@pytest.mark.parametrize(
    ("image", "mask", "why"),
    [
        (rng(0).normal(size=(4, 4)), None, "only 16 pixels count"),
        (np.kron(rng(0).normal(size=(40, 40)), np.ones((2, 2))), None, "every pixel is written twice"),
        (NOISY, np.indices(SCENE.shape).sum(axis=0) % 2 + np.arange(256) % 2 == 0, "no pixel has neighbours"),
        (NOISY, np.zeros(SCENE.shape, bool), "no pixel counts"),
        (rng(0).normal(size=(2, 2, 2, 2, 2, 2)), None, "no axis has three pixels"),
    ],
)
def test_what_cannot_be_told_is_said(image: np.ndarray, mask: np.ndarray | None, why: str) -> None:
    with pytest.warns(UserWarning, match=f"cannot be told, the estimate is NaN: .*{why}"):
        assert np.isnan(gr.estimate_noise(image, mask=mask))
    report = gr.describe_noise(image, mask=mask)
    assert report.state == "cannot tell" and why in str(report)
    with pytest.warns(UserWarning, match="cannot be told"):
        after = gr.denoise_image(image, mask=mask, backend="numpy")
    assert np.array_equal(after, image)


@pytest.mark.parametrize(
    "image", [np.full((64, 64), 7.0), np.kron(rng(0).integers(0, 9, (9, 9)), np.ones((8, 8), int)), np.zeros((3, 3))]
)
def test_no_noise_is_another_state(image: np.ndarray) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert gr.estimate_noise(image) == 0
        assert gr.describe_noise(image).state == "no noise"
        assert np.array_equal(gr.denoise_image(image, backend="numpy"), image)


def blurred(std: float) -> np.ndarray:
    noise = ndimage.gaussian_filter(rng(9).normal(0, 1, SCENE.shape), std)
    return SCENE + noise * 20 / noise.std()


@pytest.mark.parametrize(
    ("image", "name", "says"),
    [
        (blurred(1.0), "correlated", "neighbouring pixels are alike"),
        (NOISY + rng(10).normal(0, 6, (256, 1)), "stripe_rows", "whole rows are offset"),
        (NOISY + rng(10).normal(0, 6, (1, 256)), "stripe_columns", "whole columns are offset"),
        (NOISY + 25 * (np.indices(SCENE.shape) % 2).prod(axis=0), "period", "every second row or column"),
        (salted(0.05), "has_impulses", "salt and pepper"),
        (np.where(rng(3).random(SCENE.shape) < 0.02, NOISY + 300, NOISY), "has_impulses", "are impulses"),
        (100 + 3.0 * rng(11).poisson(SCENE / 2), "grows", "grows with the value"),
        (np.hypot(rng(12).normal(0, 20, SCENE.shape), rng(13).normal(0, 20, SCENE.shape)), "rayleigh", "Rician"),
    ],
)
def test_what_is_not_white_is_named(image: np.ndarray, name: str, says: str) -> None:
    report = gr.describe_noise(image)
    assert getattr(report.channels[0], name)
    assert says in str(report)
    white = gr.describe_noise(NOISY)
    assert not getattr(white.channels[0], name)
    assert white.warnings() == ()


def test_the_numbers_of_a_report() -> None:
    stripes = gr.describe_noise(NOISY + rng(10).normal(0, 6, (256, 1))).channels[0]
    assert stripes.stripe_rows == pytest.approx(6, rel=0.3)  # 256 rows in products of pieces: measured 5.3
    alike = gr.describe_noise(blurred(1.0)).channels[0]
    assert alike.blur == pytest.approx(1.0, rel=0.35)  # measured 0.73: the smoothest places are chosen
    assert alike.sigma < 8 < alike.long_sigma  # the noise is 20, and 6 after the second differences
    photons = gr.describe_noise(100 + 3.0 * rng(11).poisson(SCENE / 2)).channels[0]
    assert photons.gain == pytest.approx(3, rel=0.1)
    data = gr.describe_noise(boxed(340, 114)).as_json()
    assert data["state"] == "measured" and data["channels"][0]["flat"] == pytest.approx(1 - 256**2 / 340**2, abs=0.01)


def test_a_mosaic_keeps_its_colours() -> None:
    """Its steps are neither noise nor impulses: pixels 6 apart, of one colour, tell the noise."""
    colours = np.stack([SCENE, 0.6 * SCENE, np.where(SCENE > 180, 255, 0.3 * SCENE)])
    row, column = np.indices(SCENE.shape) % 2
    clean = np.choose(row + column, colours)
    mosaic = clean + rng(16).normal(0, 10, clean.shape)
    with pytest.warns(UserWarning, match=r"image\[i::2, j::2\]"):
        plan = gr.plan_denoising(mosaic)
    assert plan.sigma == pytest.approx(10, rel=0.1)
    assert not plan.replaces_impulses and not plan.photon


def test_channels() -> None:
    both = rng(14).multivariate_normal([0, 0, 0], [[400, 320, 0], [320, 400, 0], [0, 0, 4]], SCENE.shape)
    report = gr.describe_noise(SCENE[..., None] + both, channel_axis=-1)
    assert report.sigma == pytest.approx((20, 20, 2), rel=0.06)
    assert np.array(report.covariance)[0, 1] / 400 == pytest.approx(0.8, rel=0.1)
    assert report.groups == ((0,), (1,), (2,))
    same = gr.describe_noise(np.stack([NOISY, NOISY], -1), channel_axis=-1)
    assert same.same == (0, 0) and same.groups == ((0,),)
    assert same.correlation == 0 and same.lines()[-1] == "channel 1: the same values as channel 0"
    independent = gr.describe_noise(SCENE[..., None] + rng(15).normal(0, 20, (*SCENE.shape, 3)), channel_axis=-1)
    assert independent.groups == ((0, 1, 2),)
