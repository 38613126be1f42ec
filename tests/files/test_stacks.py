"""TIFF stacks: a volume or a series goes in and comes out with its axes, its type and the words of its file.

tifffile, which is not the code under test, writes what goes in and reads what comes out.
"""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from commands import denoise, done, failed, report
from made_stacks import NAMED, values, write_named

import gpureg
from gpureg.files.pictures import Picture, read_picture, write_picture


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
    want = gpureg.denoise_image(array, sigma=40, channel_axis=channel_axis, backend="numpy", quality="fast")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    assert not np.array_equal(want, array)


def test_axes_in_any_order(tmp_path):
    """The graph does not depend on the order in which a file has its axes."""
    array = values("CYXZ", "float32")
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "CYXZ"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40, "--spacing", "1,2,3")
    assert (got["axes"], got["spacing"]) == ("CYXZ", {"Z": 3, "Y": 1, "X": 2})
    turned = array.transpose(3, 1, 2, 0)
    want = gpureg.denoise_image(turned, sigma=40, channel_axis=3, spacing=(3, 1, 2), backend="numpy", quality="fast")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want.transpose(3, 1, 2, 0))


def test_an_axis_of_one_slice_makes_no_volume(tmp_path):
    array = values("ZYX", "float32", Z=1)
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "ZYX"})
    done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--sigma", 40))
    want = gpureg.denoise_image(array[0], sigma=40, backend="numpy", quality="fast")
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
    want = gpureg.denoise_image(array, sigma=40, channel_axis=2, backend="numpy", quality="fast")
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.png"), 1, "o.png", "PNG stores grey or RGB", "7 channels", "TIFF")


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
