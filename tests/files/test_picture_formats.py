"""WebP, JPEG 2000, BMP, PNM and GIF: what comes back, what is said, and what files hold beside their pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_pictures import SIZE, assert_same, joined, picture, profile, refuses, smooth
from PIL import Image

from gpureg.files.formats import FORMATS, written_otherwise
from gpureg.files.pictures import Picture, PictureError, check_destination, read_picture, write_picture

# extension: layouts and types that come back as they were
EXACT = {
    ".webp": [("rgb", "uint8"), ("rgba", "uint8")],
    ".jp2": [(layout, dtype) for layout in ("grey", "rgb", "rgba") for dtype in ("uint8", "uint16")],
    ".j2k": [("rgb", "uint16")],
    ".bmp": [("grey", "uint8"), ("rgb", "uint8")],
    ".pgm": [("grey", "uint8"), ("grey", "uint16")],
    ".ppm": [("rgb", "uint8"), ("rgb", "uint16")],
    ".pnm": [("grey", "uint16"), ("rgb", "uint8")],
    ".gif": [("grey", "uint8")],
}


@pytest.mark.parametrize(
    ("extension", "layout", "dtype"), [(name, *kind) for name, kinds in EXACT.items() for kind in kinds]
)
def test_exact_formats(tmp_path, extension, layout, dtype):
    want, path = picture(layout, dtype), tmp_path / f"a{extension}"
    write_picture(path, want)
    got = read_picture(path)
    if extension == ".gif":  # a palette of greys, which is no grey picture for every reader
        np.testing.assert_array_equal(got.pixels, want.pixels)
        return
    assert_same(got, want)
    assert got.notes == ()
    if extension not in (".pgm", ".ppm", ".pnm") and dtype == "uint8":  # another reader; Pillow scales PNM of 16 bits
        with Image.open(path) as opened:
            np.testing.assert_array_equal(np.asarray(opened), joined(want))


def test_other_readers_agree_on_pnm(tmp_path):
    """Pillow reads what we write, and we read each kind that the standard has."""
    want = picture("grey", "uint8")
    write_picture(tmp_path / "a.pgm", want)
    with Image.open(tmp_path / "a.pgm") as opened:
        np.testing.assert_array_equal(np.asarray(opened), want.pixels)
    kinds = {
        b"P1 # a comment\n3 2\n1 0 1\n0 1 0\n": [[0, 255, 0], [255, 0, 255]],
        b"P4\n3 2\n\xa0\x40": [[0, 255, 0], [255, 0, 255]],
        b"P2\n3 2\n255\n1 2 3\n# more\n4 5 6\n": [[1, 2, 3], [4, 5, 6]],
        b"P5\n3 2\n255\n\1\2\3\4\5\6": [[1, 2, 3], [4, 5, 6]],
        b"P5 3 2 1023\n\0\1\0\2\0\3\0\4\0\5\3\xff": [[1, 2, 3], [4, 5, 1023]],
        b"P3\n1 2 255\n1 2 3 4 5 6": [[[1, 2, 3]], [[4, 5, 6]]],
        b"P7\nWIDTH 1\nHEIGHT 2\nDEPTH 3\nMAXVAL 255\nTUPLTYPE RGB\nENDHDR\n\1\2\3\4\5\6": [[[1, 2, 3]], [[4, 5, 6]]],
    }
    for data, values in kinds.items():
        (tmp_path / "b.pnm").write_bytes(data)
        np.testing.assert_array_equal(read_picture(tmp_path / "b.pnm").pixels, values)
        if not data.startswith((b"P1", b"P2", b"P3")):
            (tmp_path / "b.pnm").write_bytes(data[:-1])
            refuses(tmp_path / "b.pnm", "truncated or damaged")


def test_the_white_of_a_pnm_is_kept_or_named(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 3 2 1023\n\0\1\0\2\0\3\0\4\0\5\3\xff")
    got = read_picture(tmp_path / "a.pgm")
    write_picture(tmp_path / "b.pgm", got)
    assert (tmp_path / "b.pgm").read_bytes().startswith(b"P5\n3 2\n1023\n")
    assert "white is 1023" in got.notes[0]
    assert "white is 1023" in written_otherwise(tmp_path / "b.png", got)[0]


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    for name, what, words in (
        ("a.bmp", picture("rgba", "uint8"), "alpha"),
        ("a.webp", picture("rgb", "uint16"), "8 bits"),
        ("a.jp2", picture("grey", "float32"), "float32"),
        ("a.pgm", picture("rgb", "uint8"), "name the file .ppm"),
        ("a.pbm", picture("grey", "uint8"), "black and white alone"),
        ("a.gif", Picture(np.zeros((3, 4, 5), np.uint8), axes="TYX"), "write TIFF"),
    ):
        with pytest.raises(PictureError, match=words):
            check_destination(tmp_path / name, what)


@pytest.mark.parametrize("kind", ["GIF", "WEBP", "PNG"])
def test_an_animation_is_a_series(tmp_path, kind):
    levels = [30, 90, 200]
    frames = [Image.fromarray(np.full(SIZE, level, np.uint8)) for level in levels]
    frames[0].save(tmp_path / "a.gif", kind, save_all=True, append_images=frames[1:], duration=100)
    got = read_picture(tmp_path / "a.gif")
    assert got.axes in ("TYX", "TYXC") and got.pixels.shape[:3] == (3, *SIZE)
    found = got.pixels.reshape(3, -1).astype(float)
    assert np.abs(found - np.array(levels)[:, None]).max() <= (4 if kind == "WEBP" else 0)  # WebP is lossy by default
    assert "3 frames" in got.notes[0]
    write_picture(tmp_path / "b.tif", got)
    np.testing.assert_array_equal(read_picture(tmp_path / "b.tif").pixels, got.pixels)


@pytest.mark.parametrize("extension", [".jpg", ".png", ".webp", ".bmp", ".tif"])
def test_what_lies_beside_the_pixels_is_kept_or_named(tmp_path, extension):
    """A photograph with a profile, EXIF, XMP and a resolution, written in each format."""
    tags = Image.Exif()
    tags[0x010F] = "A camera"
    Image.fromarray(smooth()).save(
        tmp_path / "in.jpg", quality=95, dpi=(300, 150), exif=tags, xmp=b"<x:xmpmeta/>", icc_profile=profile()
    )
    got = read_picture(tmp_path / "in.jpg")
    path = tmp_path / f"out{extension}"
    write_picture(path, got)
    notes = " ".join(written_otherwise(path, got))
    back = read_picture(path)
    held, again = got.metadata, back.metadata
    assert ("colour profile" in notes) == (back.icc_profile is None)
    assert back.icc_profile in (profile(), None)
    assert ("EXIF" in notes) == (again.exif is None)
    assert again.exif is None or Image.Exif.get(_exif(again.exif), 0x010F) == "A camera"
    assert ("XMP" in notes) == (again.xmp is None)
    assert ("dots per inch" in notes) == (again.dpi is None)
    if again.dpi is not None:
        np.testing.assert_allclose(again.dpi, held.dpi, atol=0.02)  # PNG and BMP count whole pixels per metre
    assert ("nearly" in notes) == (extension == ".jpg")


def _exif(data: bytes) -> Image.Exif:
    tags = Image.Exif()
    tags.load(data)
    return tags


def test_text_and_gamma_of_a_png_stay_and_are_named_elsewhere(tmp_path):
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text("Title", "A name")
    info.add(b"gAMA", (45455).to_bytes(4, "big"))
    for dtype in ("uint8", "uint16"):
        Image.fromarray(picture("grey", dtype).pixels).save(tmp_path / "a.png", pnginfo=info)
        got = read_picture(tmp_path / "a.png")
        write_picture(tmp_path / "b.png", got)
        with Image.open(tmp_path / "b.png") as opened:
            assert opened.info["Title"] == "A name" and opened.info["gamma"] == 0.45455
        assert "text" in " ".join(written_otherwise(tmp_path / "b.pgm", got))


def test_colours_of_a_gif_are_reduced_with_a_word(tmp_path):
    want = Picture(smooth())
    write_picture(tmp_path / "a.gif", want)
    assert "256 colours" in written_otherwise(tmp_path / "a.gif", want)[0]
    got = read_picture(tmp_path / "a.gif")
    assert "palette" in got.notes[0] and got.pixels.shape == want.pixels.shape


def test_every_extension_is_written_and_read(tmp_path):
    for extension in FORMATS:
        what = picture("rgb" if extension == ".ppm" else "grey", "uint8")
        if extension == ".pbm":
            continue
        write_picture(tmp_path / f"a{extension}", what)
        assert read_picture(Path(tmp_path / f"a{extension}")).pixels.shape[:2] == SIZE
