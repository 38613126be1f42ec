"""Noise: of volumes, one value per channel, and that of photons."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest
from cases import rng
from scipy import ndimage

import gpureg as gr
from gpureg.noise import blocks


def field(shape: tuple[int, ...], smooth: float, seed: int = 1) -> np.ndarray:
    """A smooth random scene of mean 0 and standard deviation 1."""
    scene = ndimage.gaussian_filter(rng(seed).standard_normal(shape), smooth)
    return scene / scene.std()


@pytest.mark.parametrize("sigma", [5, 20])
@pytest.mark.parametrize("scene", ["texture", "regions", "smooth"])
def test_a_volume_is_seen_along_all_its_axes(scene: str, sigma: float) -> None:
    """Measured: at most 1.5 percent off. Slices one by one, which see texture as noise, are 11 off at sigma 5."""
    shape = (32, 64, 64)
    regions = np.digitize(field(shape, 3), [-0.5, 0.3])
    clean = {"texture": 30 * field(shape, 1), "regions": 70.0 * regions, "smooth": 40 * field(shape, 3)}[scene]
    found = gr.estimate_noise(clean + rng(0).normal(0, sigma, shape))
    assert found == pytest.approx(sigma, rel=0.03)


def test_a_thin_stack_is_one_of_planes() -> None:
    """Seven slices, each another picture with noise of its own: the root mean square over the slices."""
    planes = [rng(i).normal(50 * i, 5 + i, (96, 96)) for i in range(7)]
    expected = np.sqrt(np.mean([gr.estimate_noise(plane) ** 2 for plane in planes]))
    assert gr.estimate_noise(np.stack(planes)) == pytest.approx(expected, rel=1e-12)


def test_a_large_volume_is_looked_at_in_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    volume = 40 * field((40, 60, 70), 3) + rng(0).normal(0, 10, (40, 60, 70))
    whole = gr.estimate_noise(volume)
    monkeypatch.setattr(blocks, "LARGE", 1 << 14)
    monkeypatch.setattr(blocks, "TILES", {2: (8, 256), 3: (3, 20)})
    parts = list(blocks.tiles(volume.shape))
    assert len(parts) == 27
    assert all(volume[part].shape == (20, 20, 20) for part in parts)
    assert gr.estimate_noise(volume) == pytest.approx(whole, rel=0.03)  # 5,000 voxels measured: 1 percent of scatter
    assert gr.estimate_noise(volume) != whole


def test_one_value_per_channel() -> None:
    levels = (5, 20, 0)
    image = np.stack([np.add.outer(np.arange(80.0), np.arange(90.0)) + rng(s).normal(0, s, (80, 90)) for s in levels])
    each = gr.estimate_noise(image, channel_axis=0, per_channel=True)
    assert each.shape == (3,)
    # 1000 pixels are measured: 4 percent of scatter; float32 rounds a ramp of 170 without noise by 1e-5
    assert each == pytest.approx(levels, rel=0.1, abs=1e-5)
    assert gr.estimate_noise(image, channel_axis=0) == pytest.approx(np.sqrt(np.mean(each**2)), rel=1e-12)
    assert gr.estimate_noise(image[0], per_channel=True) == pytest.approx([each[0]], rel=1e-12)
    with pytest.warns(UserWarning, match="3 of 3 channels cannot be told, the estimate is NaN: no pixel counts"):
        masked = gr.estimate_noise(image, channel_axis=0, per_channel=True, mask=np.zeros((80, 90), bool))
    assert np.isnan(masked).all()


def microscope(seed: int) -> np.ndarray:
    """Expected photons of cells with texture on a dark ground, 512 x 512."""
    r, (y, x) = rng(seed), np.indices((512, 512))
    light = np.full((512, 512), 3.0)
    for _ in range(40):
        (cy, cx), reach = r.uniform(0, 512, 2), r.uniform(8, 25)
        light += r.uniform(20, 150) / (1 + np.exp(np.minimum(8 * (np.hypot(y - cy, x - cx) / reach - 1), 50)))
    return light * (1 + 0.1 * field((512, 512), 1.5, seed))


@pytest.mark.parametrize(("gain", "read_noise"), [(2.2, 4.0), (20.0, 30.0)])
def test_photon_noise_of_a_microscope(gain: float, read_noise: float) -> None:
    """A 16-bit camera with an offset of 100. Measured at eight seeds: gain and read noise at most 4 percent off."""
    light = microscope(3)
    counts = 100 + gain * rng(5).poisson(light) + rng(6).normal(0, read_noise, light.shape)
    image = np.clip(np.rint(counts), 0, 65535).astype(np.uint16)
    found = gr.estimate_photon_noise(image, offset=100)
    assert found.gain == pytest.approx(gain, rel=0.08)
    assert found.read_noise == pytest.approx(read_noise, rel=0.08)
    # The map, at a smoothed image, against the truth: median of what is off
    sigma = found.sigma(ndimage.gaussian_filter(image.astype(float), 1.5))
    truth = np.sqrt(gain**2 * light + read_noise**2)
    assert np.median(np.abs(sigma / truth - 1)) < 0.08
    # a saturated part says nothing: 50 of the image's brightest pixels in a square
    burnt = image.copy()
    burnt[100:180, 100:180] = 65535
    assert gr.estimate_photon_noise(burnt, offset=100).gain == pytest.approx(found.gain, rel=0.05)
    mask = np.ones(image.shape, bool)
    mask[:, :200] = False
    torn = np.where(mask, image, np.nan)
    assert gr.estimate_photon_noise(torn, offset=100, mask=mask).gain == pytest.approx(gain, rel=0.1)


def test_photon_noise_of_channels_is_that_of_one_camera() -> None:
    """Measured at six seeds: within 10 percent; few pixels are bright in this quarter."""
    light = microscope(3)[:256, :256]
    image = np.stack([100 + 2.0 * rng(s).poisson(light * s) + rng(9 + s).normal(0, 5, light.shape) for s in (1, 2)])
    assert gr.estimate_photon_noise(image, offset=100, channel_axis=0).gain == pytest.approx(2, rel=0.1)


def test_white_noise_has_no_gain_to_speak_of() -> None:
    ramp = np.add.outer(np.linspace(0, 200, 256), np.zeros(256))
    found = gr.estimate_photon_noise(ramp + rng(2).normal(0, 10, ramp.shape))
    # the slope's scatter: 2 percent of 100 in each of some 40 classes over a range of 200
    assert found.gain < 0.05
    assert found.sigma(ramp) == pytest.approx(np.full(ramp.shape, 10.0), rel=0.05)


def test_below_the_offset_there_is_read_noise_alone() -> None:
    found = gr.PhotonNoise(gain=2.0, read_noise=3.0, offset=100.0)
    assert found.sigma([0, 100, 108]).tolist() == [3.0, 3.0, 5.0]


@pytest.mark.parametrize(
    ("image", "call", "error", "says"),
    [
        (np.zeros((5, 5)), {}, ValueError, "at least 2400 of several brightnesses are needed"),
        (rng(0).normal(100, 1e-9, (99, 99)) // 1e9, {}, ValueError, "pixels are left|one brightness"),
        (np.zeros(5), {}, ValueError, "two or more axes"),
        (np.zeros((50, 50)), {"offset": np.nan}, ValueError, "offset must be finite"),
        (np.full((50, 50), np.inf), {}, ValueError, "must be finite"),
        (np.zeros((50, 50), complex), {}, TypeError, "real numbers"),
        (np.zeros((50, 50)), {"mask": np.ones(3, bool)}, ValueError, "mask must have the image's shape"),
    ],
)
def test_wrong_arguments_get_a_sentence(image: np.ndarray, call: dict, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        gr.estimate_photon_noise(image, **call)


@functools.cache
def photograph(path: Path) -> np.ndarray:
    io = pytest.importorskip("skimage.io", reason="scikit-image is not installed")
    return io.imread(path).astype(np.float64)


@pytest.mark.parametrize("name", ["camera", "brick", "kodim19", "bsd68_033"])
@pytest.mark.parametrize(("sigma", "share"), [(10, 0.035), (40, 0.015)])
def test_photographs(name: str, sigma: float, share: float, data_folder) -> None:
    """Measured on ten: at most 4.3 percent off at sigma 10 and 1.0 at 40, scikit-image's estimate_sigma 27 and 2.0."""
    clean = photograph(data_folder / "images" / f"{name}.png")
    image = clean + rng(0).standard_normal(clean.shape) * sigma
    found = gr.estimate_noise(image, channel_axis=-1 if clean.ndim == 3 else None)
    assert found == pytest.approx(sigma, rel=share)
