"""TIFF stacks: a volume or a series goes in and comes out with its axes, its type and what its file says of it.

tifffile, which is not the code under test, writes what goes in and reads what comes out.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from commands import call, denoise, done, failed, report

import gpureg
from gpureg.files.picture import AxesError, checked_axes
from gpureg.files.pictures import Picture, PictureError, read_picture, write_picture

SIZES = {"T": 5, "Z": 4, "C": 2, "Y": 13, "X": 17, "S": 3}  # all different: exchanged axes are found out


def values(axes: str, dtype: str = "uint16", **sizes: int) -> np.ndarray:
    shape = tuple({**SIZES, **sizes}[letter] for letter in axes)
    return np.random.default_rng(3).integers(0, 250, shape).astype(dtype)


IMAGEJ: dict[str, Any] = {"imagej": True}
OME: dict[str, Any] = {"ome": True}

# name: axes for tifffile, axes for us, type, how it is written
NAMED: dict[str, tuple[str, str, str, dict[str, Any]]] = {
    "imagej-zyx": ("ZYX", "ZYX", "uint8", IMAGEJ),
    "imagej-tyx": ("TYX", "TYX", "uint16", IMAGEJ),
    "imagej-zcyx": ("ZCYX", "ZCYX", "float32", IMAGEJ),
    "imagej-tzcyx": ("TZCYX", "TZCYX", "uint8", IMAGEJ),
    "imagej-cyx": ("CYX", "CYX", "uint16", IMAGEJ),
    "imagej-colour": ("TYXS", "TYXC", "uint8", IMAGEJ | {"photometric": "rgb"}),
    "ome-zyx": ("ZYX", "ZYX", "float64", OME),
    "ome-tcyx": ("TCYX", "TCYX", "uint16", OME),
    "ome-colour": ("ZYXS", "ZYXC", "uint8", OME | {"photometric": "rgb"}),
    "shaped-tyx": ("TYX", "TYX", "float64", {"photometric": "minisblack"}),
    "shaped-zcyx": ("ZCYX", "ZCYX", "float32", {"photometric": "minisblack"}),
    "shaped-colour": ("TYXS", "TYXC", "uint16", {"photometric": "rgb"}),
    "compressed": ("TZYX", "TZYX", "uint16", {"photometric": "minisblack", "compression": "zlib"}),
    "big-endian": ("ZYX", "ZYX", "uint16", {"photometric": "minisblack", "byteorder": ">"}),
    "bigtiff": ("ZYX", "ZYX", "float32", {"photometric": "minisblack", "bigtiff": True}),
}


def write_named(path: Path, name: str) -> np.ndarray:
    axes, _, dtype, how = NAMED[name]
    array = values(axes, dtype)
    tifffile.imwrite(path, array, metadata={"axes": axes}, **how)
    return array


@pytest.mark.parametrize("name", NAMED)
def test_a_stack_goes_in_and_comes_out(tmp_path, name):
    array = write_named(tmp_path / "in.tif", name)
    got = read_picture(tmp_path / "in.tif")
    assert (got.axes, got.tags.named, got.pixels.dtype) == (NAMED[name][1], True, array.dtype)
    np.testing.assert_array_equal(got.pixels, array)
    write_picture(tmp_path / "out.tif", got)
    with tifffile.TiffFile(tmp_path / "in.tif") as before, tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert after.series[0].axes == before.series[0].axes
        assert after.series[0].kind == before.series[0].kind
        out = after.asarray()
        assert out.dtype == array.dtype
        np.testing.assert_array_equal(out, array)


@pytest.mark.parametrize("name", ["imagej-zyx", "imagej-zcyx", "ome-tcyx", "shaped-colour", "imagej-colour", "ome-zyx"])
def test_the_command_treats_a_stack_as_the_door_does(tmp_path, name):
    axes = NAMED[name][1]
    array = write_named(tmp_path / "in.tif", name)
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40)
    assert (got["axes"], got["axes_named"], got["shape"]) == (axes, True, list(array.shape))
    assert (got["width"], got["height"], got["dtype"]) == (17, 13, str(array.dtype))
    channel_axis = axes.index("C") if "C" in axes else None
    want = gpureg.denoise_image(array, sigma=40, channel_axis=channel_axis, backend="numpy")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    assert not np.array_equal(want, array)


def test_axes_in_any_order(tmp_path):
    """The graph does not depend on the order in which a file has its axes."""
    array = values("CYXZ", "float32")
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "CYXZ"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40, "--spacing", "1,2,3")
    assert (got["axes"], got["spacing"]) == ("CYXZ", {"Z": 3, "Y": 1, "X": 2})
    turned = array.transpose(3, 1, 2, 0)
    want = gpureg.denoise_image(turned, sigma=40, channel_axis=3, spacing=(3, 1, 2), backend="numpy")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want.transpose(3, 1, 2, 0))


def test_an_axis_of_one_slice_makes_no_volume(tmp_path):
    array = values("ZYX", "float32", Z=1)
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "ZYX"})
    done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40))
    want = gpureg.denoise_image(array[0], sigma=40, backend="numpy")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want[None])


@pytest.mark.parametrize("storage", ["plain", "shaped"])
def test_a_stack_without_names_is_a_volume_and_says_so(tmp_path, storage):
    array = values("ZYX")
    metadata = None if storage == "plain" else {}
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata=metadata)
    lines = done(denoise(tmp_path / "in.tif", tmp_path / "out.tif")).splitlines()
    assert lines[0].startswith("axes ") and "ZYX: a volume" in lines[0] and "--axes TYX" in lines[0]
    assert "4 Z x 13 Y x 17 X, 1 channel(s)" in lines[-1]
    with tifffile.TiffFile(tmp_path / "in.tif") as before, tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert after.series[0].axes == before.series[0].axes, "a guess is not written down as a fact"
        assert after.series[0].shape == array.shape
    named = done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--axes", "zyx"))
    assert [line.split()[0] for line in named.splitlines()] == ["noise", "filter", "done"]
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert after.series[0].axes == "ZYX", "what the caller says is"


@pytest.mark.parametrize("storage", ["contig", "separate"])
def test_colour_pages_are_a_volume_of_colours(tmp_path, storage):
    array = values("TYXS", "uint8")
    stored = array if storage == "contig" else np.moveaxis(array, -1, 1)
    tifffile.imwrite(tmp_path / "in.tif", stored, photometric="rgb", planarconfig=storage, metadata=None)
    got = read_picture(tmp_path / "in.tif")
    assert (got.axes, got.channel_axis, got.tags.named) == ("ZYXC", 3, False)
    np.testing.assert_array_equal(got.pixels, array)
    report(tmp_path / "in.tif", tmp_path / "out.tif", "--axes", "TYXC")
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert (after.series[0].axes, after.series[0].shape) == ("TYXS", array.shape)
        assert after.pages[0].photometric.name == "RGB"


@pytest.mark.parametrize("channels", [1, 3])
def test_alpha_of_a_stack_is_carried_through(tmp_path, channels):
    array = values("TYXS", "uint8", S=channels + 1)
    photometric = "rgb" if channels == 3 else "minisblack"
    how = {"photometric": photometric, "planarconfig": "contig", "extrasamples": ["unassalpha"]}
    tifffile.imwrite(tmp_path / "in.tif", array, metadata=None, **how)
    got = report(tmp_path / "in.tif", tmp_path / "out.tif")
    assert got["alpha"] and got["channels"] == channels
    out = tifffile.imread(tmp_path / "out.tif")
    assert out.shape == array.shape
    np.testing.assert_array_equal(out[..., -1], array[..., -1])


def test_a_picture_of_many_channels(tmp_path):
    array = values("YXS", "uint16", S=7)
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", planarconfig="contig")
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40)
    assert got["channels"] == 7
    want = gpureg.denoise_image(array, sigma=40, channel_axis=2, backend="numpy")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.png"), 1, "o.png", "PNG holds grey or RGB", "7 channels", "TIFF")


@pytest.mark.parametrize("orientation", [3, 6])
def test_orientation_of_a_stack(tmp_path, orientation):
    upright = values("ZYX", "uint8")
    turn = {3: 2, 6: 1}[orientation]
    stored = np.ascontiguousarray(np.rot90(upright, turn, axes=(1, 2)))
    tags = [(274, 3, 1, orientation, True)]
    tifffile.imwrite(tmp_path / "in.tif", stored, photometric="minisblack", extratags=tags, resolution=(2, 5))
    got = read_picture(tmp_path / "in.tif")
    np.testing.assert_array_equal(got.pixels, upright)
    write_picture(tmp_path / "out.tif", got)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), upright)
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert after.pages[0].resolution == ((2, 5) if orientation == 3 else (5, 2))


# --- what the file says besides --------------------------------------------------------------------------------------


def test_words_of_imagej_come_back(tmp_path):
    words = {"spacing": 3.5, "unit": "um", "finterval": 0.25, "Info": "a cell", "Ranges": (0.0, 99.0, 5.0, 60.0)}
    labels = [f"slice {i}" for i in range(5 * 4 * 2)]
    luts = [np.arange(768, dtype=np.uint8).reshape(3, 256), np.zeros((3, 256), np.uint8)]
    array = values("TZCYX")
    metadata = {**words, "axes": "TZCYX", "mode": "composite", "Labels": labels, "LUTs": luts}
    tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, resolution=(4.0, 2.0), metadata=metadata)
    done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--max-iter", 0))
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        got = after.imagej_metadata
        assert {name: got[name] for name in words} == words
        assert (got["Labels"], got["mode"]) == (labels, "composite")
        np.testing.assert_array_equal(got["LUTs"], luts)
        assert after.pages[0].resolution == (4.0, 2.0)
        np.testing.assert_array_equal(after.asarray(), array)


def test_words_of_ome_come_back(tmp_path):
    sizes = {"PhysicalSizeX": 0.2, "PhysicalSizeY": 0.25, "PhysicalSizeZ": 900.0}
    units = {"PhysicalSizeXUnit": "µm", "PhysicalSizeYUnit": "µm", "PhysicalSizeZUnit": "nm"}
    metadata = {**sizes, **units, "axes": "ZCYX", "Name": "cells & more", "Channel": {"Name": ["red", "far red"]}}
    tifffile.imwrite(tmp_path / "in.ome.tif", values("ZCYX"), ome=True, metadata=metadata)
    done(denoise(tmp_path / "in.ome.tif", tmp_path / "out.ome.tif"))
    with tifffile.TiffFile(tmp_path / "out.ome.tif") as after:
        assert after.is_ome
        image = tifffile.xml2dict(after.ome_metadata)["OME"]["Image"]
    assert image["Name"] == "cells & more"
    assert {name: image["Pixels"][name] for name in sizes} == sizes
    assert {name: image["Pixels"][name] for name in units} == units
    assert [channel["Name"] for channel in image["Pixels"]["Channel"]] == ["red", "far red"]


def test_words_of_tifffile_and_resolution_come_back(tmp_path):
    how = {"photometric": "minisblack", "resolution": (300.0, 150.0), "resolutionunit": "CENTIMETER"}
    tifffile.imwrite(tmp_path / "in.tif", values("TYX"), metadata={"axes": "TYX", "exposure": 0.5}, **how)
    done(denoise(tmp_path / "in.tif", tmp_path / "out.tif"))
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert after.shaped_metadata[0]["exposure"] == 0.5
        assert (after.pages[0].resolution, after.pages[0].resolutionunit.name) == ((300, 150), "CENTIMETER")


def test_renamed_axes_are_written_and_lose_the_words_of_the_old(tmp_path):
    """A movie that was stored as a volume."""
    metadata = {"axes": "ZYX", "spacing": 3.0, "unit": "um"}
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata=metadata)
    done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--axes", "TYX"))
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert (after.series[0].axes, after.is_imagej) == ("TYX", True)
        assert "spacing" not in after.imagej_metadata and after.imagej_metadata["unit"] == "um"


def test_what_imagej_does_not_hold_keeps_its_axes(tmp_path):
    picture = Picture(values("TYX", "float64"), axes="TYX", tags=gpureg.files.picture.Tags(kind="imagej"))
    write_picture(tmp_path / "out.tif", picture)
    with tifffile.TiffFile(tmp_path / "out.tif") as after:
        assert (after.series[0].axes, after.series[0].dtype, after.is_imagej) == ("TYX", np.float64, False)


# --- slices one by one ------------------------------------------------------------------------------------------------


def test_each_slice_is_a_picture_of_its_own(tmp_path):
    array = values("TYX", "uint8")
    array[2] //= 2  # less noise in one of them
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "TYX"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T")
    assert (got["each"], len(got["slices"])) == ("T", 5)
    want = np.stack([gpureg.denoise_image(page, backend="numpy") for page in array])
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    for page, one in zip(array, got["slices"], strict=True):
        assert one["sigma"] == gpureg.plan_denoising(page).sigma
    text = done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T"))
    assert "estimated in each of 5 slices along T" in text and "(first slice)" in text
    sigmas = [one["sigma"] for one in got["slices"]]
    assert f"sigma = {min(sigmas):.4g} to {max(sigmas):.4g} of 255" in text


def test_each_of_two_axes_with_channels(tmp_path):
    array = values("TZCYX", "uint8")
    tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, metadata={"axes": "TZCYX"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T", "--each", "Z", "--sigma", 40)
    assert (got["each"], len(got["slices"])) == ("TZ", 20)
    out = tifffile.imread(tmp_path / "out.tif")
    want = gpureg.denoise_image(array[3, 1], sigma=40, channel_axis=0, backend="numpy")
    np.testing.assert_array_equal(out[3, 1], want)


def test_each_wants_an_axis_that_is_there(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), photometric="minisblack", metadata=None)
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "T")
    failed(result, 2, "--each T", "in.tif are ZYX", "names none", "--axes TYX makes it a series")
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", "TYX", "--each", "Z")
    failed(result, 2, "--each Z", "in.tif are TYX")
    assert "names none" not in result.output
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "C"), 2, "--each", "C")


# --- spacing ----------------------------------------------------------------------------------------------------------


def test_spacing_is_that_of_the_door(tmp_path):
    array = values("ZCYX", "float32")
    tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, metadata={"axes": "ZCYX"})
    options = ("--spacing", "3,1,1", "--sigma", 40, "--radius", 2.5)
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", *options)
    assert got["spacing"] == {"Z": 3, "Y": 1, "X": 1} and "1x5x5 window" in got["filter"]
    want = gpureg.denoise_image(array, sigma=40, radius=2.5, spacing=(3, 1, 1), channel_axis=1, backend="numpy")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)


@pytest.mark.parametrize(("storage", "unit"), [("imagej", ""), ("ome", "µm"), ("ome", "nm")])
def test_spacing_of_the_file(tmp_path, storage, unit):
    array = values("ZYX")
    if storage == "imagej":
        metadata = {"axes": "ZYX", "spacing": 0.75, "unit": "um"}
        tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, resolution=(4.0, 2.0), metadata=metadata)
    else:
        sizes = {"PhysicalSizeX": 0.25, "PhysicalSizeY": 0.5, "PhysicalSizeZ": 0.75 if unit == "µm" else 750.0}
        tifffile.imwrite(
            tmp_path / "in.tif", array, ome=True, metadata={"axes": "ZYX", **sizes, "PhysicalSizeZUnit": unit}
        )
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--spacing", "file")
    # 1e-12: the rounding of one product
    assert got["spacing"] == pytest.approx({"Z": 0.75, "Y": 0.5, "X": 0.25}, rel=1e-12)


def test_bilateral_reach_follows_the_spacing(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    options = ("--weights", "bilateral", "--spacing", "1.5,.5,.5")
    assert "sigma_space = 1.5," in report(tmp_path / "in.tif", tmp_path / "out.tif", *options)["filter"]


def test_spacing_that_is_none(tmp_path):
    plain, volume, series = (tmp_path / f"{name}.tif" for name in ("plain", "volume", "series"))
    tifffile.imwrite(plain, values("ZYX"), photometric="minisblack", metadata=None)
    tifffile.imwrite(volume, values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    tifffile.imwrite(series, values("TYX"), imagej=True, metadata={"axes": "TYX", "finterval": 2.0})
    out = tmp_path / "o.tif"
    for text in ("3,1", "1,1,1,1", "2"):
        failed(denoise(volume, out, "--spacing", text), 2, "--spacing has", "volume.tif 3 axes", "Z, Y, X")
    for text in ("3;1;1", "a", "", "1,0,1", "-1,1,1", "nan,1,1", "inf,1,1", "1,,1"):
        failed(denoise(volume, out, "--spacing", text), 2, "finite numbers > 0", "3,1,1", "file", repr(text))
    failed(denoise(plain, out, "--spacing", "file"), 1, "plain.tif names no size", "Z, Y, X", "--spacing 1,1,1")
    failed(denoise(volume, out, "--spacing", "file"), 1, "volume.tif names no size of a voxel along Z;")
    failed(denoise(series, out, "--spacing", "file"), 1, "series.tif", "time has no size", "--each T")
    assert not out.exists()
    assert report(series, out, "--spacing", "file", "--each", "T")["spacing"] == {"Y": 1, "X": 1}


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axes", ["ZYQ", "ZYXX", "ZX", "ZY", "", "Z Y X"])
def test_letters_that_are_no_axes(tmp_path, axes):
    with pytest.raises(AxesError, match="letters of T"):
        checked_axes(axes)
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", axes), 2, "axes must be letters", repr(axes))


def test_letters_that_do_not_fit(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", "TZYX")
    failed(result, 2, "TZYX are 4", "in.tif have 3", "(4, 13, 17)")
    write_picture(tmp_path / "in.png", Picture(values("YX", "uint8")))
    failed(denoise(tmp_path / "in.png", tmp_path / "o.png", "--axes", "YXC"), 2, "YXC are not those of", "in.png", "YX")
    done(denoise(tmp_path / "in.png", tmp_path / "o.png", "--axes", "yx"))


def test_axes_that_nobody_names(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("TZYX"), photometric="minisblack")
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif")
    failed(result, 1, "in.tif", "(5, 4, 13, 17)", "does not say which axis is which", "--axes ZCYX")
    assert report(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", "TZYX")["axes"] == "TZYX"


def test_two_axes_of_channels(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("CYXS", "uint8"), photometric="rgb", metadata={"axes": "CYXS"})
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif"), 1, "in.tif has two axes of channels", "split it first")


def test_a_stack_into_a_picture_file(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX", "uint8"), imagej=True, metadata={"axes": "ZYX"})
    for name, kind in (("o.png", "PNG"), ("o.jpg", "JPEG")):
        failed(denoise(tmp_path / "in.tif", tmp_path / name), 1, name, f"{kind} holds one picture", "ZYX", "write TIFF")


def test_pages_of_different_kinds(tmp_path):
    with tifffile.TiffWriter(tmp_path / "in.tif") as writer:
        writer.write(values("YX", "uint8"), photometric="minisblack", metadata=None)
        writer.write(values("YX", "uint8", Y=9), photometric="minisblack", metadata=None)
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif"), 1, "in.tif holds 2 series", "(13, 17), (9, 17)", "of one")


def test_a_set_of_files(tmp_path):
    """An OME-TIFF whose second page lies in another file."""
    xml = (
        '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:a"><Image ID="Image:0">'
        '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="17" SizeY="13" SizeZ="2" SizeC="1" SizeT="1">'
        '<Channel ID="Channel:0:0" SamplesPerPixel="1"/>'
        '<TiffData IFD="0" FirstZ="0" PlaneCount="1"><UUID FileName="in.ome.tif">urn:uuid:a</UUID></TiffData>'
        '<TiffData IFD="0" FirstZ="1" PlaneCount="1"><UUID FileName="b.ome.tif">urn:uuid:b</UUID></TiffData>'
        "</Pixels></Image></OME>"
    )
    how = {"photometric": "minisblack", "metadata": None, "description": xml.encode()}
    tifffile.imwrite(tmp_path / "in.ome.tif", values("YX", "uint8"), **how)
    failed(
        denoise(tmp_path / "in.ome.tif", tmp_path / "o.tif"), 1, "in.ome.tif holds a part", "other files", "join them"
    )


@pytest.mark.parametrize("name", ["imagej-zyx", "imagej-zcyx", "ome-tcyx", "shaped-tyx", "compressed", "bigtiff"])
def test_a_cut_stack_is_found_out(tmp_path, name):
    """tifffile alone reads what is left, or another shape, and says so in its log only."""
    write_named(tmp_path / "whole.tif", name)
    data = (tmp_path / "whole.tif").read_bytes()
    for share in (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97):
        (tmp_path / "in.tif").write_bytes(data[: int(share * len(data))])
        with pytest.raises(PictureError, match="truncated or damaged"):
            read_picture(tmp_path / "in.tif")
    assert not [handler for handler in logging.getLogger("tifffile").handlers if type(handler) is logging.NullHandler]


def test_pages_that_are_missing(tmp_path):
    """The chain of pages is cut: each page that is left is whole."""
    tifffile.imwrite(
        tmp_path / "in.tif", values("ZYX"), photometric="minisblack", metadata=None, compression="zlib", byteorder="<"
    )
    with tifffile.TiffFile(tmp_path / "in.tif") as file:
        third = file.pages[2].offset
    data = bytearray((tmp_path / "in.tif").read_bytes())
    # where the second page says where the third one is
    at = data.index(third.to_bytes(4, "little"))
    data[at : at + 4] = (len(data) + 1000).to_bytes(4, "little")
    (tmp_path / "in.tif").write_bytes(bytes(data))
    with pytest.raises(PictureError, match="truncated or damaged: the page after the first 2 is missing"):
        read_picture(tmp_path / "in.tif")


def test_help_tells_of_stacks():
    out = done(call("denoise", "--help"))
    for word in ("--axes", "--each", "--spacing", "--mask", "--guide", "--reference", "--explain", "raw/*.tif"):
        assert word in out
