"""gpureg simplify, from the outside: a picture in, a simpler one and its partition out, words, exit codes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commands import call, done, environment, failed, noisy_picture, on_terminal
from scipy import ndimage

import gpureg as gr
from gpureg.cli.simplify import simplify
from gpureg.files.pictures import Picture, read_picture, write_picture


@pytest.fixture(autouse=True)
def _no_backend_from_outside(monkeypatch):
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)


@pytest.fixture
def noisy(tmp_path) -> Path:
    path = tmp_path / "noisy.png"
    write_picture(path, noisy_picture()[0])
    return path


def run(source: object, target: object, *options: object):
    backend = [] if "--backend" in options else ["--backend", "numpy"]
    return call("simplify", source, target, *backend, *options)


def report(source: object, target: object, *options: object) -> dict:
    result = run(source, target, "--json", *options)
    done(result)
    return json.loads(result.stdout, parse_constant=pytest.fail)


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("name", "layout", "dtype"),
    [
        ("a.png", "grey", "uint8"),
        ("a.png", "rgba", "uint16"),
        ("a.png", "grey-alpha", "uint8"),
        ("a.tif", "rgb", "uint16"),
        ("a.tif", "grey", "float32"),
        ("a.jpg", "rgb", "uint8"),
    ],
)
def test_every_kind_of_file(tmp_path, name, layout, dtype):
    source, target = tmp_path / name, tmp_path / f"out-{name}"
    write_picture(source, noisy_picture(layout, dtype)[0])
    told = report(source, target, "--fine", tmp_path / f"fine-{name}")
    before, after, fine = read_picture(source), read_picture(target), read_picture(tmp_path / f"fine-{name}")
    assert after.pixels.shape == fine.pixels.shape == before.pixels.shape
    assert after.pixels.dtype == before.pixels.dtype == dtype
    if before.alpha is not None:
        assert np.array_equal(after.alpha, before.alpha)
    axis = -1 if layout.startswith("rgb") else None
    found = gr.simplify_image(before.pixels, channel_axis=axis, backend="numpy")
    assert told["regions"] == found.n_regions
    assert told["smooth"] == found.smooth
    assert told["percent"] == pytest.approx(found.percent)
    if not name.endswith("jpg"):
        assert np.array_equal(after.pixels, found.value)
        assert np.array_equal(fine.pixels, found.fine)
    peak = np.ptp(before.pixels) if dtype == "float32" else np.iinfo(dtype).max
    squares = np.mean((found.fine.astype(float) - before.pixels) ** 2)
    assert told["psnr"]["fine"] == pytest.approx(10 * np.log10(peak**2 / squares), abs=1e-4)  # float32 differences
    assert told["psnr"]["output"] < told["psnr"]["fine"]
    assert told["seconds"] == pytest.approx(sum(told["stages"].values()), abs=1e-3)


def test_labels_and_colours(tmp_path, noisy):
    told = report(noisy, tmp_path / "out.png", "--labels", tmp_path / "l.tif", "--random-colours", tmp_path / "c.png")
    labels, colours = tifffile.imread(tmp_path / "l.tif"), read_picture(tmp_path / "c.png").pixels
    assert labels.dtype == np.uint16
    assert np.array_equal(np.unique(labels), np.arange(told["regions"]))
    assert colours.shape == (*labels.shape, 3)
    values = read_picture(tmp_path / "out.png").pixels
    ones, regions = [1] * told["regions"], range(told["regions"])
    assert [len(np.unique(values[labels == i])) for i in regions] == ones
    assert [len(np.unique(colours[labels == i], axis=0)) for i in regions] == ones
    assert [ndimage.label(labels == i)[1] for i in regions] == ones


def test_all_that_can_be_asked_for(tmp_path, noisy):
    told = report(
        noisy, tmp_path / "out.png",
        *("--sources", "gradient", "--smooth", 0.75, "--metric", "chebyshev", "--compactness", 1, "--model", "median"),
        *("--p", 0.5, "--lam", 0.3, "--weights", "border", "--norm", "edge", "--rings", 2, "--by-size"),
        *("--max-iter", 50, "--eps", 0.5, "--merge-tol", 4, "--dtype", "float64"),
    )  # fmt: skip
    found = gr.simplify_image(
        read_picture(noisy).pixels, sources="gradient", smooth=0.75, metric="chebyshev", compactness=1, model="median",
        p=0.5, lam=0.3, weights="border", norm="edge", rings=2, by_size=True, max_iter=50, eps=0.5, merge_tol=4,
        backend="numpy", dtype="float64",
    )  # fmt: skip
    assert np.array_equal(read_picture(tmp_path / "out.png").pixels, found.value)
    assert told["merged"] == found.n_regions < told["regions"]
    words = done(run(noisy, tmp_path / "out.png", "--weights", "bilateral", "--sigma-space", 5, "--sigma-value", 30))
    assert words.startswith("sources  regional extrema of the intensity")
    begins = ("regions  ", "filter   bilateral weights", "quality  PSNR ", "seconds  sources ", "done     ")
    assert [line for line in begins if f"\n{line}" not in words] == []
    assert run(noisy, tmp_path / "out.png", "--quiet").output == ""


def test_markers_are_the_sources(tmp_path, noisy):
    drawn = np.zeros((64, 64), np.uint8)
    drawn[5, 5], drawn[60, 60], drawn[5, 60] = 200, 7, 31
    write_picture(tmp_path / "m.png", Picture(drawn))
    told = report(noisy, tmp_path / "out.png", "--markers", tmp_path / "m.png", "--labels", tmp_path / "l.tif")
    assert told["regions"] == 3
    labels = tifffile.imread(tmp_path / "l.tif")
    assert (labels[60, 60], labels[5, 60], labels[5, 5]) == (0, 1, 2)
    seeds = report(noisy, tmp_path / "out.png", "--sources", 16)
    assert seeds["regions"] == 16
    write_picture(tmp_path / "none.png", Picture(np.zeros((64, 64), np.uint8)))
    failed(run(noisy, tmp_path / "no.png", "--markers", tmp_path / "none.png"), 1, "are all 0")
    write_picture(tmp_path / "small.png", Picture(drawn[:9]))
    failed(run(noisy, tmp_path / "no.png", "--markers", tmp_path / "small.png"), 1, "have the shape (9, 64)")
    failed(run(noisy, tmp_path / "no.png", "--markers", tmp_path / "m.png", "--sources", 4), 2, "leave --sources out")


def test_a_mask_and_values_that_are_not_there(tmp_path):
    picture = noisy_picture("grey", "float32")[0].pixels
    picture[10:20, 30:40] = np.nan
    write_picture(tmp_path / "a.tif", Picture(picture))
    mask = np.full((64, 64), 255, np.uint8)
    mask[50:] = 0
    write_picture(tmp_path / "mask.png", Picture(mask))
    told = report(
        tmp_path / "a.tif", tmp_path / "out.tif", "--mask", tmp_path / "mask.png", "--labels", tmp_path / "l.tif"
    )
    value, labels = tifffile.imread(tmp_path / "out.tif"), tifffile.imread(tmp_path / "l.tif")
    inside = (mask > 0) & np.isfinite(picture)
    assert told["pixels"] == inside.sum()
    assert labels.dtype == np.int32
    assert np.array_equal(labels >= 0, inside)
    assert np.array_equal(value[~inside], picture[~inside], equal_nan=True)


def test_a_series_slice_by_slice(tmp_path):
    """Regions of one slice are none of the next; a slice is what it would be alone."""
    frames = np.stack([noisy_picture()[0].pixels[k : k + 40] for k in (0, 12, 24)])
    tifffile.imwrite(tmp_path / "s.tif", frames, imagej=True, metadata={"axes": "TYX"})
    told = report(tmp_path / "s.tif", tmp_path / "out.tif", "--each", "T", "--labels", tmp_path / "l.tif")
    labels, value = tifffile.imread(tmp_path / "l.tif"), tifffile.imread(tmp_path / "out.tif")
    assert value.shape == labels.shape == frames.shape
    assert np.array_equal(np.unique(labels), np.arange(told["regions"]))
    alone = [gr.simplify_image(frame, backend="numpy") for frame in frames]
    begins = np.cumsum([0, *(one.n_regions for one in alone[:-1])])
    assert np.array_equal(value, [one.value for one in alone])
    assert np.array_equal(labels, [one.labels + begin for one, begin in zip(alone, begins, strict=True)])
    whole = report(tmp_path / "s.tif", tmp_path / "v.tif", "--spacing", "3,1,1")
    assert np.array_equal(
        tifffile.imread(tmp_path / "v.tif"), gr.simplify_image(frames, spacing=(3, 1, 1), backend="numpy").value
    )
    assert whole["spacing"] == {"T": 3, "Y": 1, "X": 1}


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--sources", "saddles"], 2, "neither one of extrema, gradient nor a number"),
        (["--sources", "0"], 2, "neither one of"),
        (["--p", "0"], 2, "p must be"),
        (["--lam", "-1"], 2, "lam must be"),
        (["--h", "2", "--weights", "border"], 2, "--h needs --weights similarity"),
        (["--weights", "bilateral"], 2, "needs --sigma-space"),
        (["--sigma-value", "2"], 2, "--sigma-value needs --weights bilateral"),
        (["--merge-tol", "-1"], 2, "--merge-tol must be >= 0"),
        (["--smooth", "nan"], 2, "smooth must be finite and >= 0"),
        (["--rings", "0"], 2, "rings must be >= 1, got 0"),
        (["--labels", "l.png"], 1, "labels are written as TIFF"),
        (["--labels", "out.png"], 2, "would both be written to"),
        (["--fine", "in.png"], 2, "which is read; give another file"),
        (["--random-colours", "nowhere/c.png"], 1, "nowhere"),
        (["--mask", "no.png"], 1, "no.png"),
        (["--each", "T"], 2, "the axes of in.png are YX"),
        (["--backend", "abacus"], 2, "abacus"),
        (["--p", "0.5", "--solver", "certified"], 2, "p >= 1"),
    ],
)
def test_wrong_calls_leave_no_file(tmp_path, monkeypatch, options, code, words):
    monkeypatch.chdir(tmp_path)
    write_picture(Path("in.png"), noisy_picture()[0])
    Path("out.png").write_bytes(b"old")
    failed(run("in.png", "out.png", *options), code, words)
    assert files(tmp_path) == {"in.png", "out.png"}
    assert Path("out.png").read_bytes() == b"old"


def test_a_failure_at_the_last_file_leaves_none(tmp_path, noisy, monkeypatch):
    """The disk is full when the labels are written: no output is there, not even the first."""
    real = tifffile.imwrite

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tifffile, "imwrite", full)
    result = run(noisy, tmp_path / "out.png", "--labels", tmp_path / "l.tif", "--fine", tmp_path / "f.png")
    failed(result, 1, "No space left")
    monkeypatch.setattr(tifffile, "imwrite", real)
    assert files(tmp_path) == {"noisy.png"}


def test_broken_files_get_a_sentence(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(40))
    failed(run(tmp_path / "broken.png", tmp_path / "out.png"), 1, "broken.png")
    failed(run(tmp_path / "none.png", tmp_path / "out.png"), 1, "no such file")
    assert files(tmp_path) == {"broken.png"}


@pytest.mark.skipif(sys.platform == "win32", reason="sends a POSIX signal")
def test_an_interruption_writes_nothing(tmp_path, noisy):
    command = [sys.executable, "-m", "gpureg", "simplify", str(noisy), str(tmp_path / "out.png")]
    command += ["--backend", "numpy", "--max-iter", "100000000", "--labels", str(tmp_path / "l.tif")]
    with subprocess.Popen(command, env=environment(), stderr=subprocess.PIPE, text=True) as running:
        time.sleep(2.5)  # by then it iterates; before that an interrupt ends it as well
        assert running.poll() is None
        os.kill(running.pid, signal.SIGINT)
        _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "interrupted, nothing was written" in said
    assert "Traceback" not in said
    assert files(tmp_path) == {"noisy.png"}


@pytest.mark.parametrize("columns", [80, 50])
def test_lines_fit_a_terminal(tmp_path, noisy, columns):
    code, shown, _ = on_terminal(
        *("simplify", noisy.name, "out.png", "--backend", "numpy", "--no-progress"), columns=columns, cwd=tmp_path
    )
    assert code == 0
    lines = shown.decode().splitlines()
    assert lines[0].startswith("sources  ")
    assert max(map(len, lines)) < columns


def test_help_names_every_option():
    words = done(call("simplify", "--help"))
    names = [(*parameter.opts, parameter.metavar or "-") for parameter in simplify.params]
    assert [options for options in names if not any(option in words for option in options)] == []
