"""An image as a function on a grid and back, and the warning for a picture in colour that is taken for a volume."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from cases import rng

import gpureg as gr
import gpureg.skimage as drop_in
from gpureg.images.raster import Raster


@pytest.mark.parametrize("axis", [None, 0, 1, 2, -1, -3])
@pytest.mark.parametrize("dtype", ["uint8", "int32", "float32", "float64"])
def test_there_and_back(axis, dtype):
    image = (100 * rng(3).random((5, 6, 7))).astype(dtype)
    raster = Raster.of(image, axis)
    assert raster.ndim == (3 if axis is None else 2)
    assert raster.channels == (1 if axis is None else image.shape[axis])
    assert raster.cells.shape == (*raster.shape, raster.channels)
    pixels = raster.pixels("float64")
    assert pixels.dtype == np.float64
    back = raster.like(pixels.copy())
    assert back.dtype == image.dtype
    assert np.array_equal(back, image)


@pytest.mark.parametrize(("dtype", "kind"), [("uint8", "f4"), ("uint16", "f4"), ("int32", "f8"), ("float64", "f4")])
def test_the_type_to_compute_in(dtype, kind):
    raster = Raster.of(np.zeros((3, 4), dtype))
    assert raster.computed_type(None) == np.dtype(kind)
    # float64 is handed over as it is: the model takes its offset out before it computes in float32
    assert raster.pixels().dtype == (np.float64 if dtype == "float64" else np.dtype(kind))


@pytest.mark.parametrize("axis", [None, 0, -1])
def test_pixels_outside_the_mask_come_back(axis):
    image = rng(5).random((6, 7) if axis is None else (6, 7, 2))
    if axis == 0:
        image = np.moveaxis(image, -1, 0)
    mask = rng(7).random((6, 7)) < 0.5
    outside = ~mask if axis is None else np.expand_dims(~mask, axis)
    torn = np.where(outside, np.nan, image)
    raster = Raster.of(torn, axis, mask)
    assert not raster.whole
    back = raster.like(np.zeros((6, 7, raster.channels)))
    assert np.array_equal(back, np.where(outside, np.nan, 0 * image), equal_nan=True)


def test_integers_are_rounded_and_clipped():
    raster = Raster.of(np.zeros((1, 4), np.uint8))
    assert raster.like(np.array([[[-3.0], [2.4], [2.6], [300.0]]])).tolist() == [[0, 2, 3, 255]]


def test_a_raster_stays_what_it_is():
    raster = Raster.of(rng(3).random((5, 6, 2)), -1)
    assert Raster.of(raster) is raster


def test_an_image_is_looked_at_once(monkeypatch):
    """Of the door and all that it calls, the first alone checks the values."""
    seen = []
    check = Raster.of.__func__

    def counted(cls, image, *args, **given):
        seen.append(isinstance(image, Raster))
        return check(cls, image, *args, **given)

    monkeypatch.setattr(Raster, "of", classmethod(counted))
    image = rng(3).random((12, 12))
    gr.denoise_tv(image, lam=3.0, max_iter=1, backend="numpy")
    assert seen.count(False) == 1
    seen.clear()
    gr.denoise_bilateral(image, sigma_value=0.3, radius=2, border="reflect", backend="numpy")
    assert seen.count(False) == 1


CALLS = {
    "denoise_image": lambda f, **k: gr.denoise_image(f, sigma=0.0, backend="numpy", **k),
    "plan_denoising": lambda f, **k: gr.plan_denoising(f, sigma=0.0, **k),
    "run_plan": lambda f, **k: gr.run_plan(gr.plan_denoising(np.zeros((5, 5))), f, backend="numpy", **k),
    "denoise_nl_means": lambda f, **k: gr.denoise_nl_means(f, h=1.0, radius=1, backend="numpy", **k),
    "denoise_bilateral": lambda f, **k: gr.denoise_bilateral(f, sigma_value=1.0, radius=1, backend="numpy", **k),
    "denoise_tv": lambda f, **k: gr.denoise_tv(f, lam=3.0, max_iter=1, backend="numpy", **k),
    "patch_graph": lambda f, **k: gr.patch_graph(f, 2, radius=1, patch_radius=0, backend="numpy", **k),
    "patch_groups": lambda f, **k: gr.patch_groups(f, radius=1, patch_radius=0, backend="numpy", **k),
    "inpaint_image": lambda f, **k: gr.inpaint_image(f, _hole(f, k), max_iter=1, backend="numpy", **k),
    "simplify_image": lambda f, **k: gr.simplify_image(f, sources=8, backend="numpy", **k),
    "skimage nl_means": lambda f, **k: drop_in.denoise_nl_means(f, 3, 1, backend="numpy", **k),
    "skimage bilateral": lambda f, **k: drop_in.denoise_bilateral(f, 3, backend="numpy", **k),
    "skimage tv": lambda f, **k: drop_in.denoise_tv_chambolle(f, max_num_iter=1, backend="numpy", **k),
    "opencv nl_means": lambda f, **k: gr.presets.opencv_nl_means(f, 1.0, 3, 3, backend="numpy", **k),
}


def _hole(image, given):
    shape = image.shape if given.get("channel_axis") is None else image.shape[:-1]
    hole = np.zeros(shape, bool)
    hole[3, 3] = True
    return hole


@pytest.mark.parametrize("name", CALLS)
def test_a_picture_in_colour_without_its_axis_is_told_once(name):
    colour = rng(3).random((32, 24, 3))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        CALLS[name](colour)
    assert [(w.category, w.filename) for w in caught] == [(UserWarning, __file__)]
    assert "(32, 24, 3) is taken for a volume: channel_axis=-1" in str(caught[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        CALLS[name](colour, channel_axis=-1)


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        ((24, 24, 3), True),
        ((32, 40, 4), True),
        ((5, 24, 24, 3), True),
        ((23, 40, 3), False),
        ((40, 31, 4), False),
        ((40, 40, 5), False),
        ((40, 40, 2), False),
        ((3, 40, 40), False),
        ((40, 3), False),
    ],
)
def test_what_looks_like_a_picture_in_colour(shape, told):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        Raster.of(np.zeros(shape))
        Raster.of(np.zeros(shape), axes_known=True)
    assert len(caught) == told
