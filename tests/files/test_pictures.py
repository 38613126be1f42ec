"""Pictures in and out of files: every kind comes back as it was, and other programs read ours."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
import pytest
import tifffile
from made_pictures import LAYOUTS, SIZE, assert_same, joined, picture, png_chunks, png_file, smooth
from PIL import Image

from gpureg.files.pictures import (
    Picture,
    read_picture,
    write_picture,
)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("extension", [".png", ".tif", ".TIFF"])
def test_lossless_round_trip(tmp_path, extension, layout, dtype):
    want = picture(layout, dtype)
    path = tmp_path / f"a{extension}"
    write_picture(path, want)
    got = read_picture(path)
    assert_same(got, want)
    assert got.channel_axis == (2 if want.pixels.ndim == 3 else None)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_float_tiff_round_trip(tmp_path, layout, dtype):
    want = picture(layout, dtype)
    write_picture(tmp_path / "a.tiff", want)
    assert_same(read_picture(tmp_path / "a.tiff"), want)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tiff"), joined(want))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("extension", [".jpg", ".jpeg"])
def test_jpeg_round_trip_is_close(tmp_path, extension, channels):
    want = smooth(channels)
    write_picture(tmp_path / f"a{extension}", Picture(want))
    got = read_picture(tmp_path / f"a{extension}")
    assert got.pixels.dtype == np.uint8 and got.pixels.shape == want.shape and got.alpha is None
    assert np.abs(got.pixels.astype(int) - want).max() <= 6
    with Image.open(tmp_path / f"a{extension}") as opened:
        assert opened.format == "JPEG" and opened.mode == ("L" if channels == 1 else "RGB")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pillow_reads_our_8_bit_png_and_we_read_its(tmp_path, layout):
    want = picture(layout, "uint8")
    write_picture(tmp_path / "ours.png", want)
    with Image.open(tmp_path / "ours.png") as opened:
        assert opened.format == "PNG"
        assert opened.mode == {"grey": "L", "rgb": "RGB", "grey-alpha": "LA", "rgba": "RGBA"}[layout]
        np.testing.assert_array_equal(np.asarray(opened), joined(want))
    Image.fromarray(joined(want)).save(tmp_path / "theirs.png")
    assert_same(read_picture(tmp_path / "theirs.png"), want)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_16_bit_png_against_the_bytes_of_the_standard(tmp_path, layout):
    """Pillow narrows 16-bit colour and Matplotlib rescales it: the standard itself is the other reader and writer."""
    want = picture(layout, "uint16")
    planes = joined(want).reshape(*SIZE, -1)
    write_picture(tmp_path / "ours.png", want)
    chunks = png_chunks((tmp_path / "ours.png").read_bytes())
    colour = {"grey": 0, "rgb": 2, "grey-alpha": 4, "rgba": 6}[layout]
    assert chunks[0] == (b"IHDR", struct.pack(">IIBBBBB", SIZE[1], SIZE[0], 16, colour, 0, 0, 0))
    rows = planes.astype(">u2").reshape(SIZE[0], -1).view(np.uint8)
    plain = np.hstack([np.zeros((SIZE[0], 1), np.uint8), rows]).tobytes()  # filter 0 before each row
    theirs = [chunks[0], (b"IDAT", zlib.compress(plain)), (b"IEND", b"")]
    (tmp_path / "theirs.png").write_bytes(png_file(theirs))
    assert_same(read_picture(tmp_path / "theirs.png"), want)
    if layout == "grey":  # the one kind of 16 bits that Pillow keeps
        with Image.open(tmp_path / "ours.png") as opened:
            np.testing.assert_array_equal(np.asarray(opened), want.pixels)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_tifffile_reads_our_tiff_and_we_read_its(tmp_path, layout, dtype):
    want = picture(layout, dtype)
    write_picture(tmp_path / "ours.tif", want)
    with tifffile.TiffFile(tmp_path / "ours.tif") as opened:
        page = opened.pages[0]
        np.testing.assert_array_equal(page.asarray(), joined(want))
        assert page.photometric.name == ("RGB" if want.pixels.ndim == 3 else "MINISBLACK")
        # unassociated: the colours are not multiplied by alpha
        assert [extra.name for extra in page.extrasamples] == ([] if want.alpha is None else ["UNASSALPHA"])
    tifffile.imwrite(
        tmp_path / "theirs.tif",
        joined(want),
        photometric="rgb" if want.pixels.ndim == 3 else "minisblack",
        planarconfig=None if joined(want).ndim == 2 else "contig",
        extrasamples=None if want.alpha is None else ["unassalpha"],
    )
    assert_same(read_picture(tmp_path / "theirs.tif"), want)


@pytest.mark.parametrize("layout", ["grey", "rgb", "rgba"])
def test_pillow_reads_our_8_bit_tiff(tmp_path, layout):
    want = picture(layout, "uint8")
    write_picture(tmp_path / "a.tif", want)
    with Image.open(tmp_path / "a.tif") as opened:
        np.testing.assert_array_equal(np.asarray(opened), joined(want))


def test_skimage_reads_our_files(tmp_path):
    skimage_io = pytest.importorskip("skimage.io", reason="scikit-image is not installed")
    for extension, dtype in ((".png", "uint8"), (".png", "uint16"), (".tif", "uint16")):
        want = picture("grey", dtype)
        write_picture(tmp_path / f"a{extension}", want)
        np.testing.assert_array_equal(skimage_io.imread(tmp_path / f"a{extension}"), want.pixels)


@pytest.mark.parametrize("layout", ["grey", "rgb"])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
@pytest.mark.parametrize("extension", [".png", ".tif", ".jpg"])
def test_thin_pictures(tmp_path, extension, size, layout):
    want = picture(layout, "uint8", size)
    write_picture(tmp_path / f"a{extension}", want)
    assert read_picture(tmp_path / f"a{extension}").pixels.shape == want.pixels.shape


def test_a_view_with_any_strides_is_written(tmp_path):
    base = picture("rgb", "uint16", (40, 40))
    want = base.pixels[::-2, 1::3]
    for extension in (".png", ".tif"):
        write_picture(tmp_path / f"a{extension}", Picture(want))
        np.testing.assert_array_equal(read_picture(tmp_path / f"a{extension}").pixels, want)


def test_photographs(tmp_path):
    """Real files, where there are some: gpureg sees what scikit-image's usual reader sees."""
    folder = os.environ.get("GPUREG_DATA")
    if not folder:
        pytest.skip("GPUREG_DATA does not name the folder of test data")
    for name in ("camera.png", "kodim08.png", "horse.png"):
        path = os.path.join(folder, "images", name)
        got = read_picture(path)
        with Image.open(path) as opened:
            mode = {"1": "L", "P": "RGB"}.get(opened.mode, opened.mode)
            np.testing.assert_array_equal(joined(got), np.asarray(opened.convert(mode)))
        write_picture(tmp_path / name, got)
        assert_same(read_picture(tmp_path / name), got)
