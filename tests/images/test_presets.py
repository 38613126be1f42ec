"""Other libraries' filters: the presets and drop-ins against the libraries, or against their kernels as loops."""

from __future__ import annotations

import functools
import inspect
import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import gpureg as gr
import gpureg.skimage as drop_in


@functools.cache
def picture(size=72):
    """A part of scikit-image's camera picture with noise of 20 grey levels, in [0, 1], not clipped."""
    data = pytest.importorskip("skimage.data")
    clean = data.camera()[100 : 100 + size, 180 : 180 + size + 8] / 255
    return clean + 20 / 255 * np.random.default_rng(0).standard_normal(clean.shape)


def grey(image):
    return np.clip(np.rint(255 * image), 0, 255).astype(np.uint8)


# Tolerances: 1e-5 on float32 data of range 1 is what the peers' tables of exponentials and float32 sums leave
# (measured: 9e-7); one grey level is what rounding leaves of a difference however small.


@pytest.mark.parametrize(("d", "color", "space"), [(9, 0.1, 2.0), (-1, 0.2, 3.0), (5, 0.5, 1.0), (3, 0.1, -1.0)])
def test_opencv_bilateral(device, d, color, space):
    cv2 = pytest.importorskip("cv2")
    image = picture().astype(np.float32)
    ours = gr.presets.opencv_bilateral(image, d, color, space, backend=device)
    assert ours.dtype == np.float32
    assert_allclose(ours, cv2.bilateralFilter(image, d, color, space), atol=1e-5)
    eight = grey(picture())
    ours = gr.presets.opencv_bilateral(eight, d, 255 * color, space, backend=device)
    assert ours.dtype == np.uint8
    assert np.abs(ours.astype(int) - cv2.bilateralFilter(eight, d, 255 * color, space)).max() <= 1
    assert (ours != eight).any() == (space > 0)


@pytest.mark.parametrize(("H", "template", "search"), [(10, 7, 21), (20, 5, 11), (30, 3, 15), (100, 7, 21), (3, 7, 21)])
def test_opencv_nl_means(device, H, template, search):
    cv2 = pytest.importorskip("cv2")
    eight = grey(picture())
    theirs = cv2.fastNlMeansDenoising(eight, None, H, template, search).astype(int)
    ours = gr.presets.opencv_nl_means(eight, H, template, search, backend=device)
    assert np.abs(ours - theirs).max() <= 1


def test_opencv_nl_means_in_colour():
    cv2 = pytest.importorskip("cv2")
    eight = np.stack([grey(picture()), grey(picture()[::-1]), grey(picture()[:, ::-1])], axis=-1)
    theirs = cv2.fastNlMeansDenoising(eight, None, 25, 5, 13).astype(int)
    ours = gr.presets.opencv_nl_means(eight, 25, 5, 13, channel_axis=-1)
    assert np.abs(ours - theirs).max() <= 1


@functools.cache
def nl_means_of_skimage(H, sigma):
    restoration = pytest.importorskip("skimage.restoration")
    return restoration.denoise_nl_means(picture(48), 7, 7, H, fast_mode=False, sigma=sigma)


@pytest.mark.parametrize("door", ["preset", "drop-in"])
@pytest.mark.parametrize(("H", "sigma"), [(0.08, 0.0), (0.06, 0.08), (0.2, 0.0)])
def test_skimage_nl_means(device, H, sigma, door):
    """What is left is its exponential of shifted bits, up to 4 percent off: measured 6.8e-3 at most, 7.4e-4 rms."""
    image, theirs = picture(48), nl_means_of_skimage(H, sigma)
    if door == "preset":
        ours = gr.presets.skimage_nl_means(image, 7, 7, H, sigma, backend=device)
    else:
        ours = drop_in.denoise_nl_means(image, 7, 7, H, False, sigma, backend=device)
    assert np.abs(ours - theirs).max() <= 7e-3
    assert np.sqrt(np.mean((ours - theirs) ** 2)) <= 1e-3
    assert np.sqrt(np.mean((theirs - image) ** 2)) > 0.05


def gputools_bilateral(f, size, sigma_p, sigma_x):
    """kernels/bilateral2.cl of gputools 0.3.1 (bilat2_float; for a volume bilat3_float), read clamped to the edge."""
    total, weight = np.zeros_like(f), np.zeros_like(f)
    padded = np.pad(f, size, mode="edge")
    for step in itertools.product(range(-size, size + 1), repeat=f.ndim):
        other = padded[tuple(slice(size + s, size + s + n) for s, n in zip(step, f.shape, strict=True))]
        w = np.exp(-sum(s * s for s in step) / sigma_x**2) * np.exp(-((f - other) ** 2) / sigma_p**2)
        total, weight = total + w * other, weight + w
    return total / weight


def gputools_nlm2(f, sigma, FS, BS):
    """kernels/nlm2.cl of gputools 0.3.1: maps of distances, box sums of them, all read clamped to the edge."""

    def read(image, *shifts):
        rows, columns = (np.clip(np.arange(n) + s, 0, n - 1) for n, s in zip(image.shape, shifts, strict=True))
        return image[np.ix_(rows, columns)]

    total, weight = np.zeros_like(f), np.zeros_like(f)
    for dx, dy in itertools.product(range(BS + 1), range(-BS, BS + 1)):
        distance = (f - read(f, dy, dx)) ** 2
        distance = sum(read(distance, 0, i) for i in range(-FS, FS + 1))
        distance = sum(read(distance, i, 0) for i in range(-FS, FS + 1))
        for way in (1, -1) if dx else (1,):
            d = distance if way > 0 else read(distance, -dy, -dx)
            w = np.exp(-d / (2 * FS + 1) ** 2 / sigma**2)
            total, weight = total + w * read(f, way * dy, way * dx), weight + w
    return total / weight


def test_gputools_bilateral(device):
    """The loops were held against gputools itself, on PoCL, once: 6e-7."""
    image = picture(40)
    ours = gr.presets.gputools_bilateral(image.astype(np.float32), 3, 0.3, 2.0, backend=device)
    assert_allclose(ours, gputools_bilateral(image, 3, 0.3, 2.0), atol=1e-5)
    volume = np.random.default_rng(3).random((6, 9, 11))
    ours = gr.presets.gputools_bilateral(volume, 2, 0.3, 1.5, backend=device)
    assert_allclose(ours, gputools_bilateral(volume, 2, 0.3, 1.5), atol=1e-5)


def test_gputools_nl_means(device):
    image, k = picture(40), 2 + 3
    ours = gr.presets.gputools_nl_means(image.astype(np.float32), 0.2, 2, 3, backend=device)
    theirs = gputools_nlm2(image, 0.2, 2, 3)
    assert_allclose(ours[k:-k, k:-k], theirs[k:-k, k:-k], atol=1e-5)
    assert np.abs(ours - image).max() > 0.1


# Drop-ins


@pytest.mark.parametrize("name", drop_in.__all__)
def test_the_signatures_are_scikit_images(name):
    restoration = pytest.importorskip("skimage.restoration")
    theirs = inspect.signature(getattr(restoration, name)).parameters
    ours = inspect.signature(getattr(drop_in, name)).parameters
    assert list(ours)[: len(theirs)] == list(theirs)
    assert [p.kind for p in ours.values()][: len(theirs)] == [p.kind for p in theirs.values()]
    assert {n: ours[n].default for n in theirs} == {n: p.default for n, p in theirs.items()}
    assert set(ours) - set(theirs) == {"backend", "dtype", "memory", "callback", "progress"}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_integers_become_floats(dtype):
    util = pytest.importorskip("skimage.util")
    image = picture(40).clip(0, 1)
    image = (image * np.iinfo(dtype).max).astype(dtype) if np.dtype(dtype).kind == "u" else image.astype(dtype)
    f = util.img_as_float(image)
    # a filter so weak that the image is what remains
    left = drop_in.denoise_nl_means(image, 3, 3, h=1e-4)
    assert left.dtype == f.dtype
    assert_allclose(left, f, atol=1e-6)
    if np.dtype(dtype).kind == "u":
        kept = drop_in.denoise_nl_means(image, 3, 3, h=1e-4, preserve_range=True)
        assert_allclose(kept, image, rtol=1e-6)


def test_fast_mode_has_whole_patches():
    """Documented: patches of patch_size x patch_size. Against loops over these, on a picture padded by reflection."""
    f, side, reach, h = picture(40)[:20, :22], 5, 3, 0.1
    k = side // 2
    patches = np.lib.stride_tricks.sliding_window_view(np.pad(f, k + reach, mode="reflect"), (side, side))
    centre = patches[reach : reach + 20, reach : reach + 22]
    total, weight = np.zeros_like(f), np.zeros_like(f)
    for dy, dx in itertools.product(range(-reach, reach + 1), repeat=2):
        there = patches[reach + dy : reach + dy + 20, reach + dx : reach + dx + 22]
        d = ((centre - there) ** 2).mean(axis=(-2, -1)) / h**2
        w = np.where(d > 5, 0, np.exp(-d))
        total, weight = total + w * there[..., k, k], weight + w
    assert_allclose(drop_in.denoise_nl_means(f, side, reach, h, backend="numpy"), total / weight, atol=1e-5)


@pytest.mark.parametrize("mode", ["constant", "edge", "symmetric", "reflect", "wrap"])
def test_bilateral_is_the_documented_one(mode):
    """A round Gaussian of standard deviations, on a picture padded as numpy pads it."""
    f, color, space, reach = picture(40)[:20, :22], 0.1, 1.5, 3
    padded = np.pad(f, reach, mode=mode)
    total, weight = np.zeros_like(f), np.zeros_like(f)
    for dy, dx in itertools.product(range(-reach, reach + 1), repeat=2):
        there = padded[reach + dy : reach + dy + 20, reach + dx : reach + dx + 22]
        w = np.exp(-(dy**2 + dx**2) / (2 * space**2)) * np.exp(-((f - there) ** 2) / (2 * color**2))
        total, weight = total + w * there, weight + w
    ours = drop_in.denoise_bilateral(f, 7, color, space, mode=mode, backend="numpy")
    assert_allclose(ours, total / weight, atol=1e-5)


def test_bilateral_chooses_as_scikit_image_does():
    f = picture(40)
    by_hand = drop_in.denoise_bilateral(f, 2 * math.ceil(3 * 1.5) + 1, float(f.std()), 1.5)
    assert_array_equal(drop_in.denoise_bilateral(f, sigma_spatial=1.5), by_hand)
    flat = np.full((9, 9), 0.3)
    assert_array_equal(drop_in.denoise_bilateral(flat), flat)


def test_chambolle_is_near_and_lower_in_the_documented_energy():
    """The functional of the docstring, with the gradient's length centred; theirs has forward differences."""
    restoration = pytest.importorskip("skimage.restoration")
    f, weight = picture(), 0.1
    grid = gr.GridGraph(f.shape, 1, "cityblock")

    def energy(x):
        gradient = gr.operators.gradient_norm(x, grid, backend="numpy", dtype="float64") / math.sqrt(2)
        return gradient.sum() + ((x - f) ** 2).sum() / (2 * weight)

    theirs = restoration.denoise_tv_chambolle(f, weight, eps=1e-7, max_num_iter=2000)
    ours = drop_in.denoise_tv_chambolle(f, weight, eps=1e-8, max_num_iter=3000)
    assert energy(ours) < energy(theirs) < energy(f)
    # what the discretisation leaves: measured 0.009 rms of a change of 0.078, on a part full of edges
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 0.15 * np.sqrt(np.mean((theirs - f) ** 2))
    sooner = drop_in.denoise_tv_chambolle(f, weight, eps=1e-2)
    assert energy(ours) < energy(sooner) < energy(f)


def test_chambolle_treats_channels_alone():
    f = np.stack([picture(40), picture(40)[::-1]], axis=0)
    both = drop_in.denoise_tv_chambolle(f, 0.1, max_num_iter=20, eps=0, channel_axis=0, backend="numpy")
    alone = drop_in.denoise_tv_chambolle(f[0], 0.1, max_num_iter=20, eps=0, backend="numpy")
    assert_allclose(both[0], alone, atol=1e-6)  # the range, which eps of eq. 15 is a share of, is the same


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda f: gr.presets.opencv_bilateral(np.stack([f] * 3, -1), 5, 1, 1, channel_axis=-1),
            "absolute differences",
        ),
        (lambda f: gr.presets.opencv_bilateral(np.stack([f] * 3), 5, 1, 1), "absolute differences"),
        (lambda f: drop_in.denoise_bilateral(f, mode="mirror"), 'mode must be "constant", "edge"'),
        (lambda f: drop_in.denoise_tv_chambolle(f, weight=0), "weight must be finite and > 0"),
        (lambda f: drop_in.denoise_nl_means(f, h=0), "h must be finite and > 0"),
        (lambda f: drop_in.denoise_nl_means(f + np.nan), "image must be finite"),
    ],
)
def test_wrong_input_gets_a_sentence(call, message):
    with pytest.raises(ValueError, match=message):
        call(picture(40))


def test_complex_numbers_are_no_image():
    with pytest.raises(TypeError, match="integers or real numbers"):
        drop_in.denoise_nl_means(picture(40) * 1j)
