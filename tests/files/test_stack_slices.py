"""TIFF stacks slice by slice, spacings, axes, sets of files, and what is refused."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import tifffile
from commands import call, denoise, done, failed, report
from made_stacks import values, write_named

import gpureg
from gpureg.files.picture import AxesError, checked_axes
from gpureg.files.pictures import Picture, PictureError, read_picture, write_picture


def test_each_slice_is_a_picture_of_its_own(tmp_path):
    array = values("TYX", "uint8")
    array[2] //= 2  # less noise in one of them
    tifffile.imwrite(tmp_path / "in.tif", array, photometric="minisblack", metadata={"axes": "TYX"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T")
    assert (got["each"], len(got["slices"])) == ("T", 5)
    want = np.stack([gpureg.denoise_image(page, backend="numpy", quality="fast") for page in array])
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "out.tif"), want)
    sigmas = [one["sigma"] for one in got["slices"]]
    assert sigmas == [gpureg.plan_denoising(page).sigma for page in array]
    text = done(denoise(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T"))
    assert "estimated in each of 5 slices along T" in text and "(first slice)" in text
    assert f"sigma = {min(sigmas):.4g} to {max(sigmas):.4g} of 255" in text


def test_each_of_two_axes_with_channels(tmp_path):
    array = values("TZCYX", "uint8")
    tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, metadata={"axes": "TZCYX"})
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", "--each", "T", "--each", "Z", "--sigma", 40)
    assert (got["each"], len(got["slices"])) == ("TZ", 20)
    out = tifffile.imread(tmp_path / "out.tif")
    want = gpureg.denoise_image(array[3, 1], sigma=40, channel_axis=0, backend="numpy", quality="fast")
    np.testing.assert_array_equal(out[3, 1], want)


def test_each_wants_an_axis_that_is_there(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), photometric="minisblack", metadata=None)
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "T")
    failed(result, 2, "--each T", "in.tif are ZYX", "names none", "--axes TYX makes it a series")
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", "TYX", "--each", "Z")
    failed(result, 2, "--each Z", "in.tif are TYX")
    assert "names none" not in result.output
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "C"), 2, "--each", "C")


def test_spacing_is_that_of_the_door(tmp_path):
    array = values("ZCYX", "float32")
    tifffile.imwrite(tmp_path / "in.tif", array, imagej=True, metadata={"axes": "ZCYX"})
    options = ("--spacing", "3,1,1", "--sigma", 40, "--radius", 2.5)
    got = report(tmp_path / "in.tif", tmp_path / "out.tif", *options)
    assert got["spacing"] == {"Z": 3, "Y": 1, "X": 1} and "1x5x5 window" in got["filter"]
    want = gpureg.denoise_image(
        array, sigma=40, radius=2.5, spacing=(3, 1, 1), channel_axis=1, backend="numpy", quality="fast"
    )
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
        failed(denoise(volume, out, "--spacing", text), 2, "--spacing has", "the graph has 3 axes", "Z, Y, X")
    for text in ("3;1;1", "a", "", "1,0,1", "-1,1,1", "nan,1,1", "inf,1,1", "1,,1"):
        failed(denoise(volume, out, "--spacing", text), 2, "finite numbers > 0", "3,1,1", "file", repr(text))
    failed(denoise(plain, out, "--spacing", "file"), 1, "plain.tif names no size", "Z, Y, X", "--spacing 1,1,1")
    failed(denoise(volume, out, "--spacing", "file"), 1, "volume.tif names no size of a voxel along Z;")
    failed(denoise(series, out, "--spacing", "file"), 1, "series.tif", "time has no size", "--each T")
    assert not out.exists()
    assert report(series, out, "--spacing", "file", "--each", "T")["spacing"] == {"Y": 1, "X": 1}


@pytest.mark.parametrize("axes", ["ZYQ", "ZYXX", "ZX", "ZY", "", "Z Y X"])
def test_letters_that_are_no_axes(tmp_path, axes):
    with pytest.raises(AxesError, match="letters of T"):
        checked_axes(axes)
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    failed(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", axes), 2, "axes must be letters", repr(axes))


def test_letters_that_do_not_fit(tmp_path):
    tifffile.imwrite(tmp_path / "in.tif", values("ZYX"), imagej=True, metadata={"axes": "ZYX"})
    result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--axes", "TZYX")
    failed(result, 2, "TZYX name 4", "in.tif have 3", "(4, 13, 17)")
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
        failed(denoise(tmp_path / "in.tif", tmp_path / name), 1, name, f"{kind} stores one picture", "ZYX", "TIFF")


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
    told = ("--axes", "--each", "--spacing", "--mask", "--guide", "--reference", "--explain", "raw/*.tif")
    assert [words for words in told if words not in out] == []
