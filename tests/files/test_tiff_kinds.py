"""TIFF of any numbers and colours, its tags, and its parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tifffile
from made_pictures import SIZE, picture, refuses
from made_stacks import NAMED, write_named

from gpureg.files.formats import written_otherwise
from gpureg.files.pictures import Picture, read_picture, write_picture
from gpureg.files.slabs import Slabs
from gpureg.files.spill import Spill
from gpureg.files.tiff_writing import write_pages

TYPES = ["int8", "int16", "int32", "uint32", "int64", "uint64", "float16", "float64"]


@pytest.mark.parametrize("dtype", TYPES)
def test_any_numbers_come_back(tmp_path, dtype):
    rng = np.random.default_rng(1)
    span = (-100, 100) if dtype == "int8" else (0, 200) if dtype.startswith("u") else (-2000, 2000)
    want = rng.integers(*span, (3, *SIZE)).astype(dtype)
    tifffile.imwrite(tmp_path / "a.tif", want, photometric="minisblack")
    got = read_picture(tmp_path / "a.tif")
    assert got.pixels.dtype == dtype
    write_picture(tmp_path / "b.tif", got)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "b.tif"), want)
    assert tifffile.imread(tmp_path / "b.tif").dtype == dtype


@pytest.mark.parametrize("step", [257, 1])
def test_palette(tmp_path, step):
    """Colours of 16 bits that need no more than 8 are written with 8."""
    index = picture("grey", "uint8").pixels
    colours = (np.random.default_rng(0).integers(0, 256, (3, 256)) * step).astype(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", index, photometric="palette", colormap=colours)
    got = read_picture(tmp_path / "a.tif")
    want = colours.T[index] if step == 1 else (colours.T[index] >> 8).astype(np.uint8)
    assert got.pixels.dtype == want.dtype and "palette" in got.notes[0]
    np.testing.assert_array_equal(got.pixels, want)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif", labels=True).pixels, index)


def test_cmyk(tmp_path):
    inks = np.random.default_rng(0).integers(0, 256, (*SIZE, 4), np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", inks, photometric="separated")
    got = read_picture(tmp_path / "a.tif")
    want = (255 - inks[..., :3].astype(float)) * (255 - inks[..., 3:]) / 255
    assert np.abs(got.pixels - want).max() <= 0.5 and got.channels == 3
    assert "CMYK" in got.notes[0]


@pytest.mark.parametrize("bits", [2, 4, 12])
def test_few_and_many_bits(tmp_path, bits):
    level = np.random.default_rng(4).integers(0, 2**bits, SIZE).astype(np.uint8 if bits < 8 else np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", level, bitspersample=bits, photometric="minisblack")
    got = read_picture(tmp_path / "a.tif")
    np.testing.assert_array_equal(got.pixels, level * (255 // (2**bits - 1)) if bits < 8 else level)
    assert (bits == 12) == ("12 bits" in " ".join(got.notes))


def test_tags_are_copied_or_named(tmp_path):
    extra = [(33550, 12, 3, (0.5, 0.5, 0.0), True), (315, 2, 0, "A name", True), (37500, 2, 0, "secret", True)]
    tifffile.imwrite(
        tmp_path / "a.tif",
        picture("grey", "uint16").pixels,
        photometric="minisblack",
        description="What it shows, in °C".encode(),
        resolution=(300, 150),
        resolutionunit="INCH",
        extratags=[*extra, (42113, 2, 0, "-9999", True)],
        metadata=None,
    )
    got = read_picture(tmp_path / "a.tif")
    assert got.nodata == -9999 and got.metadata.dpi == (300, 150)
    assert (len(got.notes) == 1 and "MakerNote" in got.notes[0]) or "37500" in got.notes[0]
    write_picture(tmp_path / "b.tif", got)
    with tifffile.TiffFile(tmp_path / "a.tif") as before, tifffile.TiffFile(tmp_path / "b.tif") as after:
        for code in (270, 282, 283, 296, 315, 33550, 42113):
            assert after.pages[0].tags[code].value == before.pages[0].tags[code].value


STORED = {
    "plain": {},
    "strips": {"rowsperstrip": 5},
    "deflate": {"compression": "zlib", "predictor": True, "rowsperstrip": 4},
    "lzw": {"compression": "lzw"},
    "tiles": {"tile": (16, 16), "compression": "zlib"},
    "big-endian": {"byteorder": ">"},
}


@pytest.mark.parametrize("how", STORED)
def test_parts_of_a_stack(tmp_path, how):
    want = np.random.default_rng(0).integers(0, 60000, (3, 4, 23, 37)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", want, photometric="minisblack", metadata={"axes": "TZYX"}, **STORED[how])
    with Slabs.open(tmp_path / "a.tif") as slabs:
        assert slabs.header.axes == "TZYX" and slabs.header.pixels.nbytes == want.nbytes
        assert slabs.header.pixels.strides == (0, 0, 0, 0), "the header holds no values"
        box = {"T": slice(1, 3), "Z": slice(2, 3), "Y": slice(6, 19), "X": slice(5, 30)}
        np.testing.assert_array_equal(slabs.read(box), want[1:3, 2:3, 6:19, 5:30])
        np.testing.assert_array_equal(slabs.read({}), want)


@pytest.mark.parametrize("name", NAMED)
def test_a_stack_written_in_parts_is_the_stack(tmp_path, name):
    """The same pages, axes and metadata as written at once."""
    want = write_named(tmp_path / "a.tif", name)
    whole = read_picture(tmp_path / "a.tif")
    write_picture(tmp_path / "b.tif", whole)
    slabs = Slabs.open(tmp_path / "a.tif")
    if slabs is None:
        assert whole.alpha is not None or not whole.axes.endswith(("YX", "YXC"))
        return
    with slabs, Spill(slabs.header, tmp_path) as spill:
        for start in range(0, whole.size("Y"), 5):
            box = {"Y": slice(start, min(start + 5, whole.size("Y")))}
            spill.put(box, slabs.read(box))
        write_pages(tmp_path / "c.tif", slabs.header, spill.page)
    for other in ("b.tif", "c.tif"):
        got = read_picture(tmp_path / other)
        assert (got.axes, got.tags.kind, got.tags.words) == (whole.axes, whole.tags.kind, whole.tags.words)
        np.testing.assert_array_equal(got.pixels, want)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tif", "b.tif", "c.tif"]


def test_a_large_page_is_written_in_tiles(tmp_path, monkeypatch):
    from gpureg.files import tiff_writing

    monkeypatch.setattr(tiff_writing, "_LARGEST_PAGE", 1000)
    want = Picture(np.random.default_rng(0).integers(0, 255, (300, 270, 3), np.uint8))
    with Spill(want, tmp_path) as spill:
        spill.put({}, want.pixels)
        write_pages(tmp_path / "a.tif", want, spill.page)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), want.pixels)
    with tifffile.TiffFile(tmp_path / "a.tif") as opened:
        assert opened.pages[0].is_tiled


def test_a_part_that_is_missing_is_named(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", picture("grey", "uint16", (90, 70)).pixels, photometric="minisblack")
    data = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(data[:-2000])
    refuses(tmp_path / "a.tif", "truncated or damaged")
    with Slabs.open(tmp_path / "a.tif") as slabs, pytest.raises(OSError, match=r"a\.tif is truncated or damaged"):
        slabs.read({})


def test_metadata_of_imagej_that_do_not_fit_are_named(tmp_path):
    array = np.random.default_rng(0).integers(0, 255, (3, *SIZE)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", array, imagej=True, metadata={"axes": "ZYX", "spacing": 3.0, "unit": "um"})
    got = read_picture(tmp_path / "a.tif")
    assert written_otherwise(tmp_path / "b.tif", got) == []
    wide = replace(got, pixels=got.pixels.astype(np.int16))  # which ImageJ does not read
    assert written_otherwise(tmp_path / "b.tif", wide) == ["not stored in TIFF: metadata of ImageJ"]


def test_ycbcr_without_jpeg_is_turned_into_rgb(tmp_path):
    """Pillow writes it so, and converts it back by the same formula."""
    from PIL import Image

    image = Image.fromarray(picture("rgb", "uint8").pixels).convert("YCbCr")
    image.save(tmp_path / "a.tif")
    got = read_picture(tmp_path / "a.tif")
    # Pillow's integers are within 1 of the formula
    assert np.abs(got.pixels.astype(int) - np.asarray(image.convert("RGB"))).max() <= 1
    assert "YCbCr" in got.notes[0]
