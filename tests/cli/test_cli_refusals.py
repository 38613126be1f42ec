"""`gpureg denoise`: wrong calls and broken files get a sentence and an exit code, and lose nothing."""

from __future__ import annotations

import os

import numpy as np
import pytest
import tifffile
from commands import call, denoise, done, failed, noisy_picture, process
from refusing import WITHOUT_DEVICES, refused
from users import needs_users, no_root

from gpureg.cli import main
from gpureg.cli.group import RENAMED
from gpureg.files.pictures import read_picture, write_picture


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--p", "0"], ["p must", "0"]),
        (["--p", "-1"], ["p must", "-1"]),
        (["--p", "nan"], ["p must", "nan"]),
        (["--p", "inf"], ["p must", "inf"]),
        (["--p", "one"], ["--p", "one"]),
        (["--lam", "-1"], ["lam must", "-1"]),
        (["--lam", "nan"], ["lam must", "nan"]),
        (["--lam", "shure"], ["--lam", "'shure'", "number", "discrepancy, sure, j-invariance"]),
        (["--lam", ""], ["--lam", "''", "number"]),
        (["--lam", "sure", "--sigma", "0", "--weights", "constant"], ["without noise", "lam"]),
        (["--lam", "sure", "--centre", "largest"], ["--lam sure does not work with --centre", "number"]),
        (["--lam", "sure", "--average-patches", "none"], ["does not work with --average-patches"]),
        (["--lam", "sure", "--norm", "edge", "--p", "1"], ["does not work with --norm edge"]),
        (["--lam", "sure", "--guide", "nowhere.png"], ["does not work with --guide"]),
        (["--norm", "edges"], ["--norm", "edges", "vertex"]),
        (["--norm", "edge"], ["--norm edge needs", "--p"]),
        (["--norm", "edge", "--p", "2"], ["--norm edge needs", "--p"]),
        (["--k", "0", "--p", "1"], [">= 1, got 0"]),
        (["--k", "2.5", "--p", "1"], ["--k", "2.5"]),
        (["--k", "5"], ["--k needs", "--weights patch"]),
        (["--k", "5", "--p", "1", "--weights", "bilateral"], ["--k needs", "--weights patch"]),
        (["--guide", "nowhere.png", "--p", "1"], ["--guide needs", "bilateral or patch"]),
        (["--guide", "nowhere.png", "--weights", "constant"], ["--guide needs", "bilateral or patch"]),
        (["--centre", "twice"], ["--centre", "twice", "largest"]),
        (["--centre", "largest", "--p", "1"], ["--centre needs", "bilateral or patch"]),
        (["--centre", "largest", "--p", "1", "--weights", "patch"], ["--centre", "one sweep"]),
        (["--centre", "once", "--max-iter", "3"], ["--centre", "one sweep"]),
        (["--centre", "once", "--tol", "0.1"], ["--centre", "one sweep"]),
        (["--centre", "none", "--lam", "2"], ["--centre none", "--lam"]),
        (["--centre", "largest", "--lam", "0"], ["--lam 0", "--centre none"]),
        (["--average-patches", "all"], ["--average-patches", "all", "weighted"]),
        (["--average-patches", "plain", "--weights", "bilateral"], ["--average-patches plain needs --weights patch"]),
        (["--average-patches", "plain", "--max-iter", "2"], ["--average-patches plain", "one sweep"]),
        (["--average-patches", "weighted", "--weights", "patch", "--k", "5"], ["one sweep", "--k"]),
        (["--average-patches", "plain", "--lam", "0"], ["--lam 0", "--centre none"]),
        (["--sigma", "-5"], ["sigma must", "-5"]),
        (["--sigma", "nan"], ["sigma must", "nan"]),
        (["--radius", "0"], ["radius must", "0"]),
        (["--radius", "-3"], ["radius must", "-3"]),
        (["--radius", "nan"], ["radius must", "nan"]),
        (["--metric", "manhattan"], ["--metric", "manhattan", "cityblock"]),
        (["--weights", "gauss"], ["--weights", "gauss", "bilateral"]),
        (["--weights", "patch", "--patch-radius", "-1"], ["radius must", "-1"]),
        (["--weights", "patch", "--h", "0"], ["h must", "0"]),
        (["--weights", "patch", "--patch-sigma", "-1"], ["must", "-1"]),
        (["--weights", "bilateral", "--sigma-space", "0"], ["sigma_space must", "0"]),
        (["--weights", "bilateral", "--sigma-value", "-2"], ["sigma_value must", "-2"]),
        (["--max-iter", "-1"], ["max_iter must", "-1"]),
        (["--max-iter", "1.5"], ["--max-iter", "1.5"]),
        (["--tol", "-1"], ["tol must", "-1"]),
        (["--tol", "nan"], ["tol must", "nan"]),
        (["--eps", "-1"], ["eps must", "-1"]),
        (["--dtype", "float16"], ["--dtype", "float16", "float32"]),
        (["--backend", "cuda"], ["unknown backend 'cuda'", "numpy", "gpureg backends"]),
        (["--backend", ""], ["unknown backend"]),
        (["--colour"], ["--colour"]),
    ],
    ids=" ".join,
)
def test_wrong_option(noisy, target, options, words):
    refused(noisy.parent, 2, noisy, target, *options, words=tuple(words))


@pytest.mark.parametrize(("options", "word"), [(["--p", "0"], "p"), (["--max-iter", "-1"], "max_iter")], ids=str)
def test_wrong_option_for_a_clean_picture(flat, target, options, word):
    """What is wrong does not depend on what is in the file."""
    refused(flat.parent, 2, flat, target, *options, words=(word,))


@pytest.mark.parametrize("options", [["--h", "-1"], ["--patch-radius", "-1"], ["--sigma-space", "0"]], ids=" ".join)
def test_wrong_option_of_weights_that_are_not_taken(noisy, target, options):
    refused(noisy.parent, 2, noisy, target, *options, words=(options[0],))


def test_wrong_number_of_arguments(noisy):
    failed(call("denoise"), 2, "IN")
    failed(call("denoise", noisy), 2, "Missing OUT", "noisy.png")
    failed(call("denoise", noisy, "a.png", "b.png"), 2, "b.png")
    failed(call("sharpen"), 2, "sharpen")
    assert os.listdir(noisy.parent) == [noisy.name]


def test_missing_input(tmp_path, target):
    refused(tmp_path, 1, tmp_path / "nothing.png", target, words=("nothing.png", "no such file"))


def test_input_is_a_folder(tmp_path, target):
    (tmp_path / "sub").mkdir()
    refused(tmp_path, 1, tmp_path / "sub", target, words=("sub is a folder",))


@pytest.mark.parametrize(("data", "word"), [(b"", "empty"), (b"a letter, not a picture", "is not a PNG, TIFF, JPEG")])
def test_input_is_no_picture(tmp_path, target, data, word):
    (tmp_path / "in.png").write_bytes(data)
    refused(tmp_path, 1, tmp_path / "in.png", target, words=("in.png", word))


@pytest.mark.parametrize(
    ("name", "layout", "dtype"),
    [("in.png", "grey", "uint8"), ("in.png", "rgb", "uint16"), ("in.jpg", "rgb", "uint8"), ("in.tif", "rgb", "uint16")],
)
def test_truncated_input(tmp_path, target, name, layout, dtype):
    write_picture(tmp_path / name, noisy_picture(layout, dtype)[0])
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    refused(tmp_path, 1, tmp_path / name, target, words=(name, "truncated or damaged"))


def test_values_that_are_infinite(tmp_path):
    pixels = noisy_picture("grey", "float32")[0].pixels
    pixels[5, 5] = np.inf
    tifffile.imwrite(tmp_path / "in.tif", pixels)
    result = denoise(tmp_path / "in.tif", tmp_path / "out.tif")
    failed(result, result.exit_code, "finite", "inf")
    assert result.exit_code in (1, 2)
    assert os.listdir(tmp_path) == ["in.tif"]


def test_output_folder_is_missing(noisy):
    refused(noisy.parent, 1, noisy, noisy.parent / "nowhere" / "o.png", words=("nowhere", "does not exist"))


@needs_users
def test_output_may_not_be_written():
    with no_root() as folder:
        source = folder / "noisy.png"
        write_picture(source, noisy_picture()[0])
        (folder / "locked").mkdir()
        (folder / "locked" / "old.png").write_bytes(b"what was there before")
        (folder / "locked").chmod(0o500)
        refused(folder, 1, source, folder / "locked" / "o.png", words=("o.png", "no permission"))
        refused(folder, 1, source, folder / "locked" / "old.png", words=("old.png", "no permission"))
        (folder / "locked").chmod(0o700)
        (folder / "locked" / "old.png").chmod(0o400)
        refused(folder, 1, source, folder / "locked" / "old.png", words=("old.png", "no permission"))


@needs_users
def test_input_may_not_be_read():
    with no_root() as folder:
        source = folder / "noisy.png"
        write_picture(source, noisy_picture()[0])
        source.chmod(0)
        failed(denoise(source, folder / "o.png"), 1, "noisy.png", "cannot be read")
        assert os.listdir(folder) == ["noisy.png"]


@pytest.mark.parametrize("name", ["o.xyz", "o", "o.png.txt"])
def test_unknown_extension(noisy, name):
    refused(noisy.parent, 1, noisy, noisy.parent / name, words=(name, "extension", ".png", ".tif", ".jpg"))


def test_format_that_does_not_hold_the_picture(tmp_path):
    write_picture(tmp_path / "rgba.png", noisy_picture("rgba", "uint8")[0])
    write_picture(tmp_path / "deep.png", noisy_picture("rgb", "uint16")[0])
    write_picture(tmp_path / "float.tif", noisy_picture("grey", "float32")[0])
    refused(tmp_path, 1, tmp_path / "rgba.png", tmp_path / "o.jpg", words=("alpha",))
    refused(tmp_path, 1, tmp_path / "deep.png", tmp_path / "o.jpg", words=("8 bits",))
    refused(tmp_path, 1, tmp_path / "float.tif", tmp_path / "o.png", words=("float32",))


def test_device_that_is_not_there(noisy, target):
    for name in ("opencl:99", "warp:cuda:99"):
        refused(noisy.parent, 1, noisy, target, "--backend", name, words=(name.partition(":")[0],))


def test_disk_refuses(noisy, target, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    refused(noisy.parent, 1, noisy, target, words=("out.png", "cannot be written", "No space left on device"))


def test_file_name_that_is_too_long(noisy):
    refused(noisy.parent, 1, noisy, noisy.parent / ("x" * 300 + ".png"), words=("too long",))


def test_no_iterations_are_not_called_no_noise(noisy, tmp_path):
    out = done(denoise(noisy, tmp_path / "o.png", "--max-iter", 0))
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, read_picture(noisy).pixels)
    assert "no noise was found" not in out


def test_wrong_backend_in_the_environment(noisy):
    got = call("backends", env={"GPUREG_BACKEND": "cuda"})
    assert got.exit_code == 2
    told = ("unknown backend 'cuda'", "GPUREG_BACKEND=cuda", "numpy")  # the table is there all the same
    assert [words for words in told if words not in got.output] == []
    failed(denoise(noisy, noisy.parent / "o.png", env={"GPUREG_BACKEND": "cuda"}), 2, "unknown backend 'cuda'")
    assert os.listdir(noisy.parent) == [noisy.name]


@pytest.mark.parametrize("backend", ["opencl", "warp"])
def test_absent_backend_names_its_extra(noisy, backend):
    got = process("denoise", noisy, noisy.parent / "o.png", "--backend", backend, code=WITHOUT_DEVICES)
    assert got.returncode == 1, got.stderr
    assert f"gpureg[{backend}]" in got.stderr and "Available: numpy" in got.stderr
    assert "Traceback" not in got.stderr and got.stdout == ""
    assert os.listdir(noisy.parent) == [noisy.name]


def test_numpy_alone_is_enough(noisy):
    got = process("denoise", noisy, noisy.parent / "o.png", code=WITHOUT_DEVICES)
    assert got.returncode == 0, got.stderr
    assert " on numpy" in got.stdout and got.stderr == ""
    table = process("backends", code=WITHOUT_DEVICES)
    assert table.returncode == 0, table.stderr
    told = ("gpureg[opencl]", "gpureg[warp]", "auto takes numpy")
    assert [words for words in told if words not in table.stdout] == []


@pytest.mark.parametrize(("old", "new"), sorted(RENAMED.items()))
def test_an_old_option_gets_its_new_name(old, new, tmp_path):
    command = {"--merge": "simplify", "--free-ends": "curve", "--function": "curve"}.get(old, "denoise")
    result = call(command, "in.png", tmp_path / "out.png", old, "1")
    assert result.exit_code == 2
    assert f"Error: {old} is called {new} now" in result.stderr
    assert new in {option for each in main.commands[command].params for option in (*each.opts, *each.secondary_opts)}
