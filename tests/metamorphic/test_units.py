"""No hidden scale: no single sample, channel, offset, size or unit of length decides for the rest."""

from __future__ import annotations

import numpy as np
import pytest
from subjects import picture

import gpureg as gr
from gpureg import skimage
from gpureg.frame import Frame, spread

ON = {"backend": "numpy"}


def rms(image: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(image, dtype=np.float64))))


def test_no_single_value_decides_the_spread():
    values = np.random.default_rng(3).uniform(10, 20, (500, 1))
    # twice the middle 90 percent of 10, rounded to 4 bits
    assert spread(values) == pytest.approx(18, rel=0.1)
    for far in (1e5, -1e30, 1e300):
        hot = values.copy()
        hot[7] = far
        assert spread(hot) == spread(values)


@pytest.mark.parametrize("many", [1, 2, 9, 60])
def test_spread_of_values_that_are_mostly_equal(many):
    """It is never 0, follows the scale exactly, and one value far beyond the others counts little."""
    values = np.full((1000, 1), 3.0)
    values[:many] = np.linspace(4, 5, many)[:, None]
    found = spread(values)
    assert 1e-2 < found <= 4
    assert spread(3 + 2.0**40 * (values - 3)) == 2.0**40 * found
    assert spread(np.full((1000, 1), 3.0)) == 0


@pytest.mark.parametrize(
    ("dtype", "offset", "size"),
    [
        (np.uint8, 100, 1),
        (np.float32, 100, 2**-5),
        (np.float32, 0, 2.0**90),
        (np.float64, 1e8, 1),
        (np.float64, 0, 2.0**-400),
        (np.float64, -1e8, 2.0**-10),
    ],
)
def test_frame_there_and_back(dtype, offset, size):
    values = (offset + size * np.random.default_rng(5).integers(0, 100, (200, 2)).astype(np.float64)).astype(dtype)
    frame = Frame.of(values)
    function = frame.into(values, np.dtype(np.float32))
    # the values need 7 bits, and are near 1 in size
    assert 2.0**-8 < np.abs(function).max() < 2.0**8
    assert np.array_equal(frame.back(function, np.dtype(dtype if dtype is not np.uint8 else np.float32)), values)


@pytest.mark.parametrize(
    "options",
    [{"lam": 8.0}, {"lam": 6.0, "norm": "edge"}, {}, {"p": 0.7}, {"lam": "sure", "sigma": 0.08, "max_iter": 40}],
)
def test_a_hot_pixel_changes_nothing_elsewhere(options):
    """Total variation with settings that follow the data: within 3 percent of the error without the hot pixel."""
    clean = np.kron(np.random.default_rng(3).uniform(0.3, 1, (4, 4)), np.ones((16, 16)))
    noisy = clean + np.random.default_rng(4).normal(0, 0.08, clean.shape)
    hot = noisy.copy()
    hot[20, 21] = 300.0
    far = np.abs(np.indices(clean.shape) - 20).max(axis=0) > 8
    door = gr.denoise_image if "p" in options else gr.denoise_tv
    errors = [rms((door(image, **options, **ON) - clean)[far]) for image in (noisy, hot)]
    assert errors[1] == pytest.approx(errors[0], rel=0.03)


def test_a_hot_pixel_changes_no_fill():
    image, holes = picture(5), np.zeros((24, 26), bool)
    holes[4:7, 5:15] = True
    hot = image.copy()
    hot[20, 20] = 1e6
    fills = [gr.inpaint_image(x, holes, p=1, **ON)[holes] for x in (image, hot)]
    # eps and the tolerance follow the spread, which changes by a sixteenth at most
    assert np.abs(fills[0] - fills[1]).max() < 1e-3


def test_certified_is_exact_in_every_door():
    image = picture(7)
    plan = gr.plan_denoising(image, p=1, lam=8.0, solver="certified")
    assert gr.run_plan(plan, image, solver="certified", **ON).eps == 0
    exact = gr.regularize(image, gr.GridGraph(image.shape, 1, "cityblock"), p=1, lam=8.0, solver="certified", **ON)
    assert np.array_equal(gr.denoise_tv(image, lam=8.0, solver="certified", **ON), exact.value)


@pytest.mark.parametrize("solver", ["jacobi", "euler", "certified"])
@pytest.mark.parametrize("gamma", ["sqrt", "combinatorial", "normalized", "degree"])
def test_pinned_values_come_back_to_the_bit(gamma, solver):
    rng = np.random.default_rng(11)
    f0 = 1e5 + 1e-3 * rng.random((9, 8))
    lam = np.where(rng.random(f0.shape) < 0.3, np.inf, 2.0)
    result = gr.regularize(f0, gr.GridGraph(f0.shape), p=1, lam=lam, gamma=gamma, solver=solver, max_iter=30, **ON)
    assert np.array_equal(result.value[np.isinf(lam)], f0[np.isinf(lam)])
    assert not np.array_equal(result.value, f0)


def test_weak_channels_are_denoised_as_strong_ones():
    """With coupled=False and in gpureg.skimage each channel is what it gives alone; a channel can be far weaker."""
    weak = picture(9)
    both = np.stack([weak * 2.0**-10, weak], axis=-1)
    alone = skimage.denoise_tv_chambolle(weak, weight=0.1, **ON)
    found = skimage.denoise_tv_chambolle(both, weight=0.1, channel_axis=-1, **ON)
    assert found.dtype == np.float64
    assert np.array_equal(found[..., 1], alone)
    line = gr.skimage.denoise_tv_chambolle(weak[0], **ON)
    assert np.array_equal(line, skimage.denoise_tv_chambolle(weak[:1], **ON)[0])
    model = {"p": 1, "lam": 8.0, "tol": 1e-4, "max_iter": 400, "coupled": False, **ON}
    grid = gr.GridGraph(weak.shape, 1, "cityblock")
    result = gr.regularize(both, grid, **model)
    parts = [gr.regularize(both[..., c], grid, **model) for c in range(2)]
    assert result.iterations == max(part.iterations for part in parts)
    assert result.energy[-1] == pytest.approx(sum(part.energy[-1] for part in parts), rel=1e-14)
    assert np.array_equal(result.value, np.stack([part.value for part in parts], axis=-1))


@pytest.mark.parametrize("size", [1.0, 0.1, 0.01])
def test_the_unit_of_length_has_no_effect(size):
    image = picture(13)
    expected = gr.denoise_bilateral(image, sigma_value=0.3, **ON)
    assert np.array_equal(gr.denoise_bilateral(image, sigma_value=0.3, spacing=(size, size), **ON), expected)
    given = {"sigma_space": 3 * size, "sigma_value": 0.3, "spacing": (size, size)}
    assert np.array_equal(gr.denoise_bilateral(image, **given, **ON), expected)
    plan = gr.plan_denoising(image, weights="bilateral", sigma_value=0.3, spacing=(size, size))
    assert plan.weights.sigma_space == pytest.approx(3 * size)


def test_a_window_over_the_whole_image_is_a_warning():
    image = np.zeros((40, 40))
    with pytest.warns(UserWarning, match="covers the whole image of 0.4 x 0.4"):
        gr.denoise_bilateral(image, sigma_space=3, sigma_value=1, spacing=(0.01, 0.01), radius=None, **ON)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("p", [1.0, 2.0])
def test_the_lower_bound_is_below_every_energy(seed, p):
    """In float32: of the caller's data, with the energy summed in float64, at the minimiser."""
    grid = gr.GridGraph((12, 14), 1, "cityblock")
    f0 = 30 + 10 * np.random.default_rng(seed).standard_normal(grid.shape)
    model = {"p": p, "lam": 0.7, **ON}
    rough = gr.regularize(f0, grid, solver=gr.Certified(tol=1e-9), dtype=np.float32, **model)
    best = gr.regularize(f0, grid, solver=gr.Certified(tol=1e-13), dtype=np.float64, max_iter=3000, **model)
    energy = gr.operators.energy(best.value, f0, grid, eps=0.0, dtype=np.float64, **model)
    assert rough.lower_bound <= energy
    assert rough.lower_bound > energy * (1 - 1e-3)
    assert best.lower_bound <= gr.operators.energy(rough.value, f0, grid, eps=0.0, dtype=np.float64, **model)
