"""Broken, missing and unwritable picture files: a sentence each, and the old file stays."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest
import tifffile
from made_pictures import assert_same, picture, refuses, smooth
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
    refuses(tmp_path / "a.png", "not a PNG, TIFF, JPEG", "or GIF picture", "empty")


@pytest.mark.parametrize("data", [b"hello\n", b"P9 3 3 255 ", b"\x89PNG", b"RIFF1234WAVE", b"\0" * 500])
def test_not_a_picture(tmp_path, data):
    (tmp_path / "a.png").write_bytes(data)
    refuses(tmp_path / "a.png", "is not a PNG, TIFF, JPEG", "GIF picture")


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
    tifffile.imwrite(
        tmp_path / "inks.tif", np.dstack([grey] * 5), photometric="separated", extrasamples=["unspecified"]
    )
    refuses(tmp_path / "inks.tif", "5 inks", "convert")
    tifffile.imwrite(tmp_path / "a.tif", grey.astype("complex64"))
    refuses(tmp_path / "a.tif", "complex64", "two channels")
    tifffile.imwrite(tmp_path / "a.tif", np.full((8, 8), 2**53 + 2))
    refuses(tmp_path / "a.tif", "int64", "2^53")
    samples = {"photometric": "minisblack", "planarconfig": "contig", "extrasamples": ["unassalpha"] + [0] * 5}
    tifffile.imwrite(tmp_path / "many.tif", np.dstack([grey] * 7), **samples)
    refuses(tmp_path / "many.tif", "shape")


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


@pytest.mark.parametrize("name", ["a.xyz", "a", "a.png.gz", ".png"])
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
