"""Pictures through files and back: every kind gpureg promises, read by other libraries too, and everything that breaks.

What gpureg writes another library reads, and what another library writes gpureg reads, so that two mistakes that cancel
cannot pass.
"""

from __future__ import annotations

import os
import struct
import sys
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms
from users import needs_users, no_root

from gpureg.files import pictures as files
from gpureg.files.pictures import (
    Picture,
    PictureError,
    check_destination,
    read_picture,
    write_atomically,
    write_picture,
)

SIZE = (23, 17)  # odd, and not square: a transposed picture is found out

# name: extra channels of colour, alpha
LAYOUTS = {"grey": (1, False), "rgb": (3, False), "grey-alpha": (1, True), "rgba": (3, True)}


def picture(layout: str, dtype: str, size: tuple[int, int] = SIZE) -> Picture:
    """A picture whose channels all differ and use all bits of their type."""
    channels, has_alpha = LAYOUTS[layout]
    rng = np.random.default_rng(5)

    def plane(*shape: int) -> np.ndarray:
        if np.dtype(dtype).kind == "f":
            return rng.normal(0, 300, shape).astype(dtype)
        return rng.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)

    return Picture(plane(*size, 3) if channels == 3 else plane(*size), plane(*size) if has_alpha else None)


def joined(what: Picture) -> np.ndarray:
    """All planes as one array, as a library hands it out."""
    if what.alpha is None:
        return what.pixels
    return np.dstack([what.pixels, what.alpha])


def smooth(channels: int = 3, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Ramps, which JPEG keeps closely."""
    y, x = np.mgrid[: size[0], : size[1]]
    planes = np.dstack([5 * y + 40, 6 * x + 60, 3 * y + 3 * x + 30]).astype(np.uint8)
    return planes if channels == 3 else planes[..., 0]


def assert_same(got: Picture, want: Picture) -> None:
    assert got.pixels.dtype == want.pixels.dtype
    np.testing.assert_array_equal(got.pixels, want.pixels)
    assert (got.alpha is None) == (want.alpha is None)
    if want.alpha is not None:
        assert got.alpha.dtype == want.alpha.dtype
        np.testing.assert_array_equal(got.alpha, want.alpha)


def profile() -> bytes:
    return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def png_chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    chunks, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return chunks


def png_file(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG put together by hand, for kinds that no library here writes."""
    parts = [b"\x89PNG\r\n\x1a\n"]
    for name, body in chunks:
        parts += [struct.pack(">I", len(body)), name, body, struct.pack(">I", zlib.crc32(name + body))]
    return b"".join(parts)


# --- round trips ------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
@pytest.mark.parametrize("extension", [".png", ".tif", ".jpg"])
def test_thin_pictures(tmp_path, extension, size):
    for layout in ("grey", "rgb"):
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


# --- kinds that are read though not written ---------------------------------------------------------------------------


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


def test_bilevel_png_and_tiff(tmp_path):
    bits = np.random.default_rng(3).random(SIZE) < 0.5
    Image.fromarray(bits).save(tmp_path / "a.png")
    # tifffile alone would write True as black
    tifffile.imwrite(tmp_path / "a.tif", bits, photometric="minisblack")
    for name in ("a.png", "a.tif"):
        got = read_picture(tmp_path / name)
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


def test_colour_profile_of_another_writer(tmp_path):
    for name in ("a.png", "a.jpg", "a.tif"):
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


# --- what cannot be read ----------------------------------------------------------------------------------------------


def refuses(path, *words: str) -> str:
    """The sentence of a refusal: it names the file and the matter, in one line."""
    with pytest.raises(PictureError) as caught:
        read_picture(path)
    message = str(caught.value)
    assert os.path.basename(path) in message
    for word in words:
        assert word in message, f"{word!r} is not in {message!r}"
    assert "\n" not in message
    return message


def test_missing_file(tmp_path):
    refuses(tmp_path / "a.png", "no such file")
    refuses(tmp_path / "nowhere" / "a.png", "no such file")


def test_folder(tmp_path):
    (tmp_path / "a.png").mkdir()
    refuses(tmp_path / "a.png", "is a folder")


def test_file_as_a_folder(tmp_path):
    (tmp_path / "a").write_bytes(b"")
    refuses(tmp_path / "a" / "b.png", "cannot be read")


@needs_users
def test_permissions():
    with no_root() as folder:
        path = folder / "a.png"
        write_picture(path, Picture(smooth()))
        path.chmod(0)
        refuses(path, "cannot be read", "Permission denied")
        before = os.stat(path)
        cannot_write(path, Picture(smooth()), "no permission")
        assert os.stat(path) == before
        folder.chmod(0o500)
        cannot_write(folder / "b.png", Picture(smooth()), "no permission")


def test_empty_file(tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    refuses(tmp_path / "a.png", "not a PNG, TIFF or JPEG", "empty")


@pytest.mark.parametrize("data", [b"hello\n", b"GIF89a\x01\0\x01\0\0\0\0;", b"\x89PNG", b"\0" * 500])
def test_not_a_picture(tmp_path, data):
    (tmp_path / "a.png").write_bytes(data)
    refuses(tmp_path / "a.png", "is not a PNG, TIFF or JPEG picture")


TRUNCATED = {
    "8-bit.png": ("rgb", "uint8"),
    "16-bit.png": ("rgb", "uint16"),
    "16-bit-grey.png": ("grey", "uint16"),
    "8-bit.jpg": ("rgb", "uint8"),
    "8-bit.tif": ("rgb", "uint8"),
    "16-bit.tif": ("grey", "uint16"),
    "float.tif": ("grey", "float32"),
}


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9])
@pytest.mark.parametrize("name", TRUNCATED)
def test_truncated(tmp_path, name, share):
    """Noise, which no codec can shorten: a cut anywhere loses pixels."""
    write_picture(tmp_path / name, picture(*TRUNCATED[name], (90, 70)))
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(share * len(data))])
    refuses(tmp_path / name, "truncated or damaged")


@pytest.mark.parametrize("compression", [None, "lzw", "zlib"])
@pytest.mark.parametrize("rows", [90, 8])
def test_truncated_tiff_of_another_writer(tmp_path, compression, rows):
    """Its directory in front, as most programs write it, so that only pixels are lost."""
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, picture("grey", "uint16", (90, 70)).pixels, compression=compression, rowsperstrip=rows)
    data = path.read_bytes()
    for share in (0.5, 0.95):
        path.write_bytes(data[: int(share * len(data))])
        refuses(path, "truncated or damaged")


@pytest.mark.parametrize("name", ["8-bit.png", "16-bit.png"])
def test_damaged_png(tmp_path, name):
    """A wrong byte in the middle, which a checksum finds."""
    write_picture(tmp_path / name, picture(*TRUNCATED[name], (90, 70)))
    data = bytearray((tmp_path / name).read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / name).write_bytes(bytes(data))
    refuses(tmp_path / name, "truncated or damaged")


def test_only_the_signature(tmp_path):
    for name, data in (
        ("a.png", b"\x89PNG\r\n\x1a\n"),
        ("a.jpg", b"\xff\xd8"),
        ("a.tif", b"II*\0"),
        ("b.tif", b"MM\0*"),
    ):
        (tmp_path / name).write_bytes(data)
        refuses(tmp_path / name, "truncated or damaged")


def test_tiff_kinds_that_are_refused(tmp_path):
    grey = picture("grey", "uint8").pixels
    palette = np.random.default_rng(0).integers(0, 65536, (3, 256), np.uint16)
    tifffile.imwrite(tmp_path / "palette.tif", grey, photometric="palette", colormap=palette)
    refuses(tmp_path / "palette.tif", "palette", "convert")
    tifffile.imwrite(tmp_path / "cmyk.tif", np.dstack([grey] * 4), photometric="separated")
    refuses(tmp_path / "cmyk.tif", "separated", "convert")
    for dtype in ("int16", "uint32", "float16", "complex64"):
        tifffile.imwrite(tmp_path / "a.tif", grey.astype(dtype))
        refuses(tmp_path / "a.tif", dtype)
    samples = {"photometric": "minisblack", "planarconfig": "contig", "extrasamples": ["unassalpha"] + [0] * 5}
    tifffile.imwrite(tmp_path / "many.tif", np.dstack([grey] * 7), **samples)
    refuses(tmp_path / "many.tif", "shape")


# --- what cannot be written -------------------------------------------------------------------------------------------


def cannot_write(path, what: Picture | None, *words: str) -> None:
    before = sorted(os.listdir(path.parent)) if path.parent.is_dir() else None
    with pytest.raises(PictureError) as caught:
        check_destination(path, what)
    assert str(path) in str(caught.value)
    for word in words:
        assert word in str(caught.value)
    if what is not None:  # the writer asks again: a file may change between the check and the end of the work
        with pytest.raises(PictureError):
            write_picture(path, what)
    assert (sorted(os.listdir(path.parent)) if path.parent.is_dir() else None) == before


@pytest.mark.parametrize("name", ["a.bmp", "a", "a.png.gz", ".png"])
def test_unknown_extension(tmp_path, name):
    cannot_write(tmp_path / name, Picture(smooth()), "extension", ".png", ".tif", ".jpg")


def test_missing_folder(tmp_path):
    cannot_write(tmp_path / "nowhere" / "a.png", Picture(smooth()), "folder", "nowhere", "does not exist")


def test_destination_is_a_folder(tmp_path):
    (tmp_path / "a.png").mkdir()
    cannot_write(tmp_path / "a.png", Picture(smooth()), "is a folder")


def test_formats_that_do_not_hold_the_picture(tmp_path):
    cannot_write(tmp_path / "a.jpg", picture("rgba", "uint8"), "JPEG", "alpha", "PNG or TIFF")
    cannot_write(tmp_path / "a.jpg", picture("grey-alpha", "uint8"), "JPEG", "alpha", "PNG or TIFF")
    cannot_write(tmp_path / "a.jpeg", picture("rgb", "uint16"), "JPEG", "8 bits", "uint16", "PNG or TIFF")
    cannot_write(tmp_path / "a.jpg", picture("rgb", "float32"), "JPEG", "float32")
    cannot_write(tmp_path / "a.png", picture("rgb", "float32"), "PNG", "float32", "TIFF")


@pytest.mark.parametrize("length", [251, 300])
def test_long_name(tmp_path, length):
    """255 characters fit most systems; a longer name gets a sentence."""
    path = tmp_path / ("x" * length + ".png")
    if length > 251:
        cannot_write(path, Picture(smooth()), "too long")
        return
    write_picture(path, Picture(smooth()))
    np.testing.assert_array_equal(read_picture(path).pixels, smooth())


def test_picture_too_wide_for_jpeg(tmp_path):
    cannot_write(tmp_path / "a.jpg", Picture(np.zeros((1, 65501), np.uint8)), "65500")


def test_extensions_in_capitals(tmp_path):
    write_picture(tmp_path / "A.PNG", picture("rgb", "uint16"))
    assert_same(read_picture(tmp_path / "A.PNG"), picture("rgb", "uint16"))


# --- whole or not at all ----------------------------------------------------------------------------------------------


@pytest.fixture
def old(tmp_path):
    """An existing picture, which a failure must leave as it was."""
    path = tmp_path / "old.png"
    write_picture(path, picture("grey", "uint8"))
    return path


def unharmed(path, before: bytes) -> None:
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


def test_writing_replaces_the_old_file(old):
    write_picture(old, picture("rgb", "uint16"))
    assert_same(read_picture(old), picture("rgb", "uint16"))
    assert os.listdir(old.parent) == [old.name]


def test_failing_rename_leaves_the_old_file(old, monkeypatch):
    before = old.read_bytes()

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(PictureError, match="cannot be written: No space left on device") as caught:
        write_picture(old, picture("rgb", "uint8"))
    assert str(old) in str(caught.value)
    unharmed(old, before)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_interrupted_encoder_leaves_the_old_file(old, monkeypatch, error):
    before = old.read_bytes()

    def interrupted(*_: object) -> bytes:
        raise error

    monkeypatch.setattr(files, "_encode", interrupted)
    with pytest.raises(error):
        write_picture(old, picture("rgb", "uint8"))
    unharmed(old, before)


def test_interrupt_with_half_a_file_leaves_the_old_one(old):
    before = old.read_bytes()
    seen = []

    def half(temporary) -> None:
        temporary.write_bytes(b"half of it")
        seen.extend(os.listdir(old.parent))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(old, half)
    assert len(seen) == 2, "the temporary lies in the same folder, or the rename would not be atomic"
    unharmed(old, before)


def test_two_writers_do_not_share_a_temporary(tmp_path):
    names = []
    for _ in range(2):
        write_atomically(tmp_path / "a.png", lambda temporary: (names.append(temporary), temporary.write_bytes(b"x")))
    assert len(set(names)) == 2 and all(name.suffix == ".png" for name in names)


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX limits")
def test_full_disk_leaves_the_old_file(old):
    """A limit on the size of files stands in for a full disk: the write itself fails, half way."""
    import resource
    import signal

    before = old.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(PictureError, match="cannot be written"):
            write_picture(old, picture("rgb", "uint16", (90, 70)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    unharmed(old, before)
