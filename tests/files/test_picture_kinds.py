"""Kinds of pictures that other programs write: palettes, few bits, orientations, profiles."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
import pytest
import tifffile
from made_pictures import SIZE, assert_same, joined, picture, png_chunks, png_file, profile, refuses, smooth
from PIL import Image

from gpureg.files.pictures import (
    Picture,
    PictureError,
    read_picture,
    write_picture,
)


@pytest.mark.parametrize("transparent", [False, True])
def test_palette_png(tmp_path, transparent):
    colours = np.random.default_rng(1).integers(0, 256, (256, 3), np.uint8)
    index = np.random.default_rng(2).integers(0, 256, SIZE, np.uint8)
    image = Image.fromarray(index).convert("P")
    image.putpalette(colours.tobytes())
    opacity = np.arange(256, dtype=np.uint8)[::-1]
    image.save(tmp_path / "a.png", **({"transparency": opacity.tobytes()} if transparent else {}))
    assert (b"tRNS" in dict(png_chunks((tmp_path / "a.png").read_bytes()))) == transparent
    got = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(got.pixels, colours[index])
    if transparent:
        np.testing.assert_array_equal(got.alpha, opacity[index])
    else:
        assert got.alpha is None


@pytest.mark.parametrize("extension", [".png", ".tif"])
def test_bilevel_png_and_tiff(tmp_path, extension):
    bits = np.random.default_rng(3).random(SIZE) < 0.5
    path = tmp_path / f"a{extension}"
    if extension == ".png":
        Image.fromarray(bits).save(path)
    else:
        # tifffile alone would write True as black
        tifffile.imwrite(path, bits, photometric="minisblack")
    got = read_picture(path)
    assert got.pixels.dtype == np.uint8 and got.alpha is None
    np.testing.assert_array_equal(got.pixels, bits * np.uint8(255))


def test_png_of_few_bits(tmp_path):
    """2 and 4 bits of grey spread over 0..255, so that black stays black and white white."""
    for bits, step in ((2, 85), (4, 17)):
        level = np.random.default_rng(bits).integers(0, 2**bits, (6, 8), np.uint8)
        per_byte = 8 // bits
        packed = np.zeros((6, 8 // per_byte), np.uint8)
        for i in range(per_byte):
            packed |= level[:, i::per_byte] << np.uint8(8 - bits * (i + 1))
        rows = np.hstack([np.zeros((6, 1), np.uint8), packed])
        header = struct.pack(">IIBBBBB", 8, 6, bits, 0, 0, 0, 0)
        chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b"")]
        (tmp_path / "a.png").write_bytes(png_file(chunks))
        np.testing.assert_array_equal(read_picture(tmp_path / "a.png").pixels, level * np.uint8(step))


def test_one_transparent_colour(tmp_path):
    """The tRNS chunk of a picture without a palette names one colour as transparent."""
    want = picture("rgb", "uint8").pixels
    want[3:9, 2:7] = (10, 20, 30)
    Image.fromarray(want).save(tmp_path / "a.png", transparency=(10, 20, 30))
    got = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(got.pixels, want)
    np.testing.assert_array_equal(got.alpha, np.where((want == (10, 20, 30)).all(2), 0, 255))


def test_one_transparent_grey(tmp_path):
    want = picture("grey", "uint8").pixels
    want[3:9, 2:7] = 10
    Image.fromarray(want).save(tmp_path / "a.png", transparency=10)
    got = read_picture(tmp_path / "a.png")
    assert got.alpha is not None
    np.testing.assert_array_equal(got.alpha, np.where(want == 10, 0, 255))
    planes = got.pixels if got.pixels.ndim == 3 else got.pixels[..., None]
    for channel in np.moveaxis(planes, 2, 0):
        np.testing.assert_array_equal(channel, want)


def test_cmyk_jpeg_becomes_rgb_without_its_profile(tmp_path):
    want = Image.fromarray(smooth()).convert("CMYK")
    want.save(tmp_path / "a.jpg", quality=95, subsampling=0, icc_profile=profile())
    got = read_picture(tmp_path / "a.jpg")
    assert got.pixels.shape == (*SIZE, 3) and got.alpha is None
    assert np.abs(got.pixels.astype(int) - np.asarray(want.convert("RGB"))).max() <= 8
    assert got.icc_profile is None, "a profile of CMYK does not describe RGB"


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation(tmp_path, orientation):
    """The stored picture is turned so that the reader's turning it back gives the upright one."""
    upright = smooth()
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.swapaxes(0, 1),
        6: np.rot90(upright),
        7: upright[::-1, ::-1].swapaxes(0, 1),
        8: np.rot90(upright, -1),
    }[orientation]
    tags = Image.Exif()
    tags[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(stored)).save(tmp_path / "a.jpg", quality=95, subsampling=0, exif=tags)
    got = read_picture(tmp_path / "a.jpg")
    assert got.pixels.shape == upright.shape
    assert np.abs(got.pixels.astype(int) - upright).max() <= 6
    # Written again it has no tag that would turn it a second time.
    write_picture(tmp_path / "b.jpg", got)
    with Image.open(tmp_path / "b.jpg") as opened:
        assert opened.getexif().get(0x0112, 1) == 1


@pytest.mark.parametrize("dtype", ["uint16", "float32"])
@pytest.mark.parametrize("layout", ["grey", "rgb"])
def test_big_endian_tiff(tmp_path, layout, dtype):
    want = picture(layout, dtype)
    photometric = "rgb" if layout == "rgb" else "minisblack"
    tifffile.imwrite(tmp_path / "a.tif", want.pixels, byteorder=">", photometric=photometric)
    assert (tmp_path / "a.tif").read_bytes()[:2] == b"MM"
    got = read_picture(tmp_path / "a.tif")
    assert got.pixels.dtype.isnative
    assert_same(got, want)
    write_picture(tmp_path / "b.tif", got)
    assert_same(read_picture(tmp_path / "b.tif"), want)


@pytest.mark.parametrize("layout", ["rgb", "rgba"])
def test_planar_separate_tiff(tmp_path, layout):
    want = picture(layout, "uint16")
    tifffile.imwrite(
        tmp_path / "a.tif",
        np.moveaxis(joined(want), -1, 0),
        photometric="rgb",
        planarconfig="separate",
        extrasamples=["unassalpha"] if layout == "rgba" else None,
    )
    assert_same(read_picture(tmp_path / "a.tif"), want)


@pytest.mark.parametrize(
    "settings", [{"tile": (16, 16)}, {"bigtiff": True}, {"compression": "lzw"}, {"rowsperstrip": 5}]
)
def test_tiff_storage(tmp_path, settings):
    want = picture("rgb", "uint16")
    tifffile.imwrite(tmp_path / "a.tif", want.pixels, photometric="rgb", **settings)
    assert_same(read_picture(tmp_path / "a.tif"), want)


def test_white_is_zero_tiff(tmp_path):
    want = picture("grey", "uint8")
    tifffile.imwrite(tmp_path / "a.tif", 255 - want.pixels, photometric="miniswhite")
    assert_same(read_picture(tmp_path / "a.tif"), want)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_colour_profile_is_carried_through(tmp_path, name):
    write_picture(tmp_path / name, Picture(smooth(), None, profile()))
    assert read_picture(tmp_path / name).icc_profile == profile()
    with Image.open(tmp_path / name) as opened:
        assert opened.info["icc_profile"] == profile()


@pytest.mark.parametrize(
    "name",
    ["a.tif", "a.png"],
)
def test_colour_profile_of_16_bits(tmp_path, name):
    want = Picture(picture("rgb", "uint16").pixels, None, profile())
    write_picture(tmp_path / name, want)
    got = read_picture(tmp_path / name)
    assert_same(got, want)
    assert got.icc_profile == profile()


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_colour_profile_of_another_writer(tmp_path, name):
    Image.fromarray(smooth()).save(tmp_path / name, icc_profile=profile())
    assert read_picture(tmp_path / name).icc_profile == profile()


def test_bilevel_white_is_zero_tiff(tmp_path):
    """The usual kind of a scan or a fax."""
    black = np.random.default_rng(3).random(SIZE) < 0.5
    tifffile.imwrite(tmp_path / "a.tif", black, photometric="miniswhite")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").pixels, np.where(black, 0, 255))


def test_4_bit_tiff_is_spread_or_refused(tmp_path):
    level = np.random.default_rng(4).integers(0, 16, SIZE, np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", level, bitspersample=4)
    try:
        got = read_picture(tmp_path / "a.tif")
    except PictureError as refusal:
        assert "4" in str(refusal)
    else:
        np.testing.assert_array_equal(got.pixels, level * np.uint8(17))


def test_lab_tiff_is_refused(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", smooth(), photometric="cielab")
    refuses(tmp_path / "a.tif", "cielab")


def test_multiplied_colours_stay_so_or_are_refused(tmp_path):
    rgb, alpha = np.full((8, 8, 3), 50, np.uint8), np.full((8, 8), 128, np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", np.dstack([rgb, alpha]), photometric="rgb", extrasamples=["assocalpha"])
    try:
        got = read_picture(tmp_path / "a.tif")
    except PictureError as refusal:
        assert "alpha" in str(refusal)
        return
    write_picture(tmp_path / "b.tif", got)
    with tifffile.TiffFile(tmp_path / "b.tif") as opened:
        page = opened.pages[0]
        share = 1 if page.extrasamples[0] == tifffile.EXTRASAMPLE.ASSOCALPHA else 128 / 255
        shown = page.asarray()[..., :3] * share
    assert np.abs(shown - rgb).max() <= 1, "over black it must look as before"


def test_tiff_orientation(tmp_path):
    upright = smooth(1)
    stored = np.ascontiguousarray(np.rot90(upright))
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", extratags=[(274, 3, 1, 6, True)])
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif").pixels, upright)


def test_a_large_picture_is_no_damaged_one(tmp_path, monkeypatch):
    """Pillow's limit, 89 million pixels for a warning and twice that for an error, is made small instead."""
    write_picture(tmp_path / "a.png", Picture(smooth()))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").pixels, smooth())


@pytest.mark.skipif(os.name != "posix", reason="needs symbolic links")
def test_writing_through_a_link(tmp_path):
    (tmp_path / "folder").mkdir()
    write_picture(tmp_path / "folder" / "a.png", Picture(smooth()))
    (tmp_path / "link.png").symlink_to(tmp_path / "folder" / "a.png")
    write_picture(tmp_path / "link.png", Picture(255 - smooth()))
    assert (tmp_path / "link.png").is_symlink()
    np.testing.assert_array_equal(read_picture(tmp_path / "folder" / "a.png").pixels, 255 - smooth())


@pytest.mark.parametrize(("kind", "name"), [("PNG", "a.jpg"), ("JPEG", "a.tif"), ("TIFF", "a.png"), ("PNG", "a.data")])
def test_content_decides_not_the_name(tmp_path, kind, name):
    want = smooth()
    Image.fromarray(want).save(tmp_path / name, kind)
    got = read_picture(tmp_path / name)
    assert np.abs(got.pixels.astype(int) - want).max() <= (12 if kind == "JPEG" else 0)
