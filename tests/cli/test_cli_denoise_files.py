"""``gpureg denoise`` on files of every format: what it reads and writes, leaves out, and says."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from commands import denoise, done, failed, noisy_picture, report
from PIL import Image

import gpureg
from gpureg.files.pictures import Picture, read_picture, write_picture

GREY, COLOUR = (noisy_picture(layout)[0].pixels[:40, :44] for layout in ("grey", "rgb"))
# a filter that numpy computes fast
FAST = ("--weights", "bilateral", "--radius", 1, "--sigma", 15)
CALL = {"weights": "bilateral", "radius": 1, "sigma": 15.0, "backend": "numpy"}


@pytest.mark.parametrize("extension", ["webp", "jp2", "bmp", "ppm", "gif", "tif", "jpg", "png"])
def test_each_format_in_and_out(tmp_path, extension):
    source, target = tmp_path / f"in.{extension}", tmp_path / f"out.{extension}"
    write_picture(source, Picture(COLOUR))
    got = report(source, target, *FAST)
    before, after = read_picture(source).pixels, read_picture(target).pixels
    want = gpureg.denoise_image(before, channel_axis=-1, **CALL)
    if extension not in ("jpg", "gif"):
        np.testing.assert_array_equal(after, want)
        assert "notes" not in got
    else:
        assert np.abs(after.astype(float) - want).mean() < 3
        told = {"jpg": ["nearly"], "gif": ["palette", "256 colours"]}[extension]
        assert [word for word, note in zip(told, got["notes"], strict=True) if word not in note] == []


@pytest.mark.parametrize("dtype", ["int8", "int16", "uint32", "int64", "float16", "float64"])
def test_each_type_is_that_of_the_array(tmp_path, dtype):
    array = (GREY.astype(float) / 2).astype(dtype)
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack")
    report(tmp_path / "in.tif", tmp_path / "out.tif", *FAST)
    after = tifffile.imread(tmp_path / "out.tif")
    assert after.dtype == dtype
    np.testing.assert_array_equal(after, gpureg.denoise_image(array, **CALL))


def test_a_palette_of_a_tiff_and_its_notes(tmp_path):
    colours = np.arange(768).reshape(3, 256).astype(np.uint16) * 85
    tifffile.imwrite(tmp_path / "in.tif", GREY, photometric="palette", colormap=colours)
    text = done(denoise(tmp_path / "in.tif", tmp_path / "out.png", *FAST))
    assert "note     its palette became colours: OUT has no palette\n" in text
    assert read_picture(tmp_path / "out.png").pixels.dtype == np.uint16


@pytest.mark.parametrize(("named", "value"), [("--nodata", -9999.0), ("--nodata", np.inf), ("the file", -9999.0)])
def test_pixels_without_data_are_left_out(tmp_path, value, named):
    array = GREY.astype(np.float32)
    array[10:20, 30:40] = value
    if np.isinf(value):
        array[10:15, 30:40] = -value
    missing = np.zeros(array.shape, bool)
    missing[10:20, 30:40] = True
    tags = [(42113, 2, 0, f"{value:g}", True)] if named == "the file" else []
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", extratags=tags)
    options = (*FAST, "--nodata", value) if named == "--nodata" else FAST
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", *options)
    assert got["nodata"] == 100
    after = tifffile.imread(tmp_path / "out.tif")
    np.testing.assert_array_equal(after[missing], array[missing])
    want = gpureg.denoise_image(array, mask=~missing, **CALL)
    np.testing.assert_array_equal(after, want)
    assert "left out 100 pixel(s) without data" in done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", *options))


def test_no_data_in_a_colour_and_in_a_type_that_does_not_hold_it(tmp_path):
    """Black is without data, not a colour without red; and no pixel of 8 bits is -9999 or 0.5."""
    array = np.maximum(COLOUR, 1)
    array[3:5, 6:9], array[20, 20, 0] = 0, 0
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="rgb")
    for value, count in ((0, 6), (-9999, 0), (0.5, 0)):
        got = report(tmp_path / "in.tif", tmp_path / "out.tif", *FAST, "--nodata", value)
        assert got.get("nodata", 0) == count


def test_infinite_values_are_an_error_that_names_the_file(tmp_path):
    array = GREY.astype(np.float32)
    array[5, 5] = -np.inf
    write_picture(tmp_path / "in.tif", Picture(array))
    failed(denoise(tmp_path / "in.tif", tmp_path / "out.tif", *FAST), 1, "in.tif holds infinite values", "--nodata inf")
    assert not (tmp_path / "out.tif").exists()


def test_an_animation_is_denoised_as_a_series(tmp_path):
    frames = [Image.fromarray(np.roll(GREY, i, 0)) for i in range(3)]
    frames[0].save(tmp_path / "in.gif", save_all=True, append_images=frames[1:])
    failed(denoise(tmp_path / "in.gif", tmp_path / "out.gif"), 1, "GIF stores one picture", "write TIFF")
    got = report(tmp_path / "in.gif", tmp_path / "out.tif", "--each", "T", *FAST)
    assert got["axes"][:3] == "TYX" and "3 frames" in got["notes"][0]
    first = read_picture(tmp_path / "in.gif").pixels[0]
    want = gpureg.denoise_image(first, channel_axis=-1 if first.ndim == 3 else None, **CALL)
    np.testing.assert_array_equal(read_picture(tmp_path / "out.tif").pixels[0], want)
