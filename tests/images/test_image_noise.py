"""How the noise and the contrast of pictures are estimated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_image import blocks, noisy

import gpureg as gr
from gpureg.images import guides as pixels
from gpureg.images.noise import Noise
from gpureg.images.raster import Raster
from gpureg.noise import blocks as blocks_of_noise


@pytest.mark.parametrize("seed", [3, 5, 7])
@pytest.mark.parametrize("sigma", [5, 20, 40])
def test_noise_estimate_on_a_synthetic_scene(sigma: float, seed: int) -> None:
    """Waves of growing frequency on one half, a slope on the other: texture must not count as noise."""
    y, x = np.indices((192, 192))
    scene = np.where(x < 96, 0.5 * x + 0.2 * y, 128 + 60 * np.sin(x**2 / 150.0) * np.cos(y / 3.0))
    # Measured at three seeds: within 4 percent; the noise's own scatter over the 3,686 pixels used is about 2.
    assert gr.estimate_noise(noisy(scene, sigma, seed)) == pytest.approx(sigma, rel=0.08)


@pytest.mark.parametrize("sigma", [5, 20])
def test_noise_and_contrast_of_a_large_picture(sigma: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part of a large picture tells the noise and the contrast as well as the whole."""
    y, x = np.indices((1500, 1400))
    scene = np.where(x < 900, 0.05 * x + 0.02 * y, 128 + 60 * np.sin(x**2 / 15000.0) * np.cos(y / 9.0))
    before = noisy(scene, sigma).astype(np.float32)
    raster = Raster.of(before)
    with monkeypatch.context() as patched:
        patched.setattr(blocks_of_noise, "LARGE", before.size)
        whole, contrast = gr.estimate_noise(before), pixels.contrast(raster, Noise((20.0,)))[0]
    # the scatter of 50,000 pixels' is 0.5 percent, the scene's slopes add as much
    assert gr.estimate_noise(before) == pytest.approx(whole, rel=0.02)
    assert pixels.contrast(raster, Noise((20.0,)))[0] == pytest.approx(contrast, rel=0.02)


def test_noise_estimate_of_channels_masks_and_stacks() -> None:
    clean = blocks((96, 96), 32)
    colour = np.stack([noisy(clean, s, 3 + i) for i, s in enumerate((10, 20, 30))])
    expected = math.sqrt((10**2 + 20**2 + 30**2) / 3)
    assert gr.estimate_noise(colour, channel_axis=0) == pytest.approx(expected, rel=0.1)
    assert gr.estimate_noise(colour) == gr.estimate_noise(colour, channel_axis=0)  # a stack of three slices
    mask = np.ones(clean.shape, bool)
    mask[:, 48:] = False
    torn = np.where(mask, noisy(clean, 10), np.nan)
    assert gr.estimate_noise(torn, mask=mask) == pytest.approx(10, rel=0.15)
    for wrong in (np.full((9, 9), np.nan), np.zeros(5)):
        with pytest.raises(ValueError, match="must"):
            gr.estimate_noise(wrong)
    with pytest.raises(TypeError, match="real numbers"):
        gr.estimate_noise(np.zeros((5, 5), complex))
