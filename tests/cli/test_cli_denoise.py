"""`gpureg denoise`: what it writes and prints, its options, as a person would call it."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commands import SIGMA, clean_picture, denoise, done, failed, noisy_picture, process, report
from PIL import Image

import gpureg
from gpureg.files.pictures import Picture, read_picture, write_picture

KEYS = {
    *("input", "output", "width", "height", "channels", "dtype", "alpha", "sigma", "sigma_estimated", "filter", "p"),
    *("lam", "lam_reason", "radius", "metric", "iterations", "stop", "energy", "eps", "backend", "seconds", "version"),
}


@pytest.mark.parametrize(
    ("name", "layout", "dtype"),
    [
        *((f"a{extension}", layout, dtype)
          for extension in (".png", ".tif")
          for layout in ("grey", "rgb", "rgba")
          for dtype in ("uint8", "uint16")),
        ("a.png", "grey-alpha", "uint8"),
        ("a.tif", "grey-alpha", "uint16"),
        ("a.tiff", "rgb", "float32"),
        ("a.tif", "grey", "float32"),
        ("a.jpg", "grey", "uint8"),
        ("a.jpeg", "rgb", "uint8"),
    ],
)  # fmt: skip
def test_denoise_every_kind_of_file(tmp_path, name, layout, dtype):
    picture, clean = noisy_picture(layout, dtype)
    source, target = tmp_path / name, tmp_path / f"out-{name}"
    write_picture(source, picture)
    done(denoise(source, target))
    before, after = read_picture(source), read_picture(target)
    assert after.pixels.dtype == dtype and after.pixels.shape == before.pixels.shape
    assert (after.alpha is None) == (before.alpha is None)
    if before.alpha is not None:
        assert after.alpha.dtype == dtype
        np.testing.assert_array_equal(after.alpha, before.alpha)
    error = [float(np.sqrt(np.mean((x.pixels - clean) ** 2))) for x in (before, after)]
    assert error[1] < 0.5 * error[0], f"noise went from {error[0]:.4g} to {error[1]:.4g}"
    assert sorted(os.listdir(tmp_path)) == sorted([name, f"out-{name}"])


def test_from_one_format_to_another(tmp_path):
    picture, _ = noisy_picture("rgb", "uint8")
    write_picture(tmp_path / "a.png", picture)
    names = ("b.tif", "b.jpg", "b.png")
    for name in names:
        done(denoise(tmp_path / "a.png", tmp_path / name))
    assert [read_picture(tmp_path / name).pixels.shape for name in names] == [picture.pixels.shape] * 3
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "b.tif"), np.asarray(Image.open(tmp_path / "b.png")))


def test_onto_itself(noisy):
    before = noisy.read_bytes()
    done(denoise(noisy, noisy))
    assert noisy.read_bytes() != before
    assert os.listdir(noisy.parent) == [noisy.name]


def test_the_door_and_the_command_agree(noisy, tmp_path):
    """The command line adds nothing to what a caller of the library gets."""
    done(denoise(noisy, tmp_path / "o.png"))
    want = gpureg.denoise_image(read_picture(noisy).pixels, backend="numpy", quality="fast")
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, want)


@pytest.mark.parametrize("options", [(), ("--p", "1")], ids=str)
def test_a_clean_picture_comes_back_as_it_was(flat, tmp_path, options):
    out = done(denoise(flat, tmp_path / "o.png", *options))
    assert "no noise" in out
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, read_picture(flat).pixels)


@pytest.mark.parametrize("options", [(), ("--sigma", "9"), ("--sigma", "9", "--p", "1")], ids=str)
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 2), (3, 3)])
def test_tiny_pictures(tmp_path, size, options):
    write_picture(tmp_path / "a.png", Picture(np.random.default_rng(0).integers(0, 255, size, np.uint8)))
    done(denoise(tmp_path / "a.png", tmp_path / "o.png", *options))
    assert read_picture(tmp_path / "o.png").pixels.shape == size


def test_photograph(tmp_path):
    folder = os.environ.get("GPUREG_DATA")
    if not folder:
        pytest.skip("GPUREG_DATA does not name the folder of test data")
    clean = read_picture(Path(folder, "images", "camera.png")).pixels[150:310, 150:350].astype(float)
    pixels = np.clip(np.rint(clean + np.random.default_rng(0).normal(0, 20, clean.shape)), 0, 255).astype(np.uint8)
    write_picture(tmp_path / "a.png", Picture(pixels))
    got = report(tmp_path / "a.png", tmp_path / "o.png")
    assert got["sigma_estimated"] and abs(got["sigma"] - 20) < 3
    error = np.sqrt(np.mean((read_picture(tmp_path / "o.png").pixels - clean) ** 2))
    assert error < 10


def test_three_lines(noisy, tmp_path):
    lines = done(denoise(noisy, tmp_path / "o.png")).splitlines()
    assert [line.split()[0] for line in lines] == ["noise", "filter", "done"]
    estimate = re.match(r"noise +sigma = ([\d.]+) of 255, estimated$", lines[0])
    assert estimate is not None and abs(float(estimate[1]) - SIGMA) < 0.2 * SIGMA
    assert "p = 2" in lines[1] and "lam" in lines[1] and "iteration" in lines[1]
    told = (" s on numpy", "64 x 64", str(tmp_path / "o.png"))
    assert [words for words in told if words not in lines[2]] == []


def test_given_noise_is_said_to_be_given(noisy, tmp_path):
    assert "sigma = 12 of 255, as given" in done(denoise(noisy, tmp_path / "o.png", "--sigma", 12))


def test_16_bits_have_another_white(tmp_path):
    write_picture(tmp_path / "a.png", noisy_picture("rgba", "uint16")[0])
    out = done(denoise(tmp_path / "a.png", tmp_path / "o.png"))
    assert " of 65535" in out and "3 channel(s)" in out and "alpha" in out


def test_quiet(noisy, tmp_path):
    assert done(denoise(noisy, tmp_path / "o.png", "--quiet")) == ""
    assert (tmp_path / "o.png").is_file()


def test_json(noisy, tmp_path):
    got = report(noisy, tmp_path / "o.png")
    assert set(got) >= KEYS
    assert got["input"] == str(noisy) and got["output"] == str(tmp_path / "o.png")
    assert (got["width"], got["height"], got["channels"], got["dtype"], got["alpha"]) == (64, 64, 1, "uint8", False)
    assert got["sigma_estimated"] is True and abs(got["sigma"] - SIGMA) < 0.2 * SIGMA
    assert got["backend"].startswith("numpy") and got["version"] == gpureg.__version__
    # one step of nonlocal means stores no weights, which an energy would need
    assert got["iterations"] == 1 and got["energy"] == [] and got["seconds"] >= 0


def test_json_of_a_clean_picture(flat, tmp_path):
    """lam is infinite there, which JSON has no number for."""
    got = report(flat, tmp_path / "o.png")
    assert set(got) >= KEYS
    assert got["lam"] == "inf" and got["sigma"] == 0 and got["iterations"] == 0
    assert float(got["lam"]) == float("inf")


def test_json_with_infinite_lam_given(noisy, tmp_path):
    assert report(noisy, tmp_path / "o.png", "--lam", "inf")["lam"] == "inf"
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, read_picture(noisy).pixels)


def test_progress_goes_to_the_error_stream(noisy, tmp_path):
    got = process(
        *("denoise", noisy, tmp_path / "o.png", "--backend", "numpy", "--p", 1, "--max-iter", 30),
        *("--tol", 0, "--json", "--progress"),
    )
    assert got.returncode == 0, got.stderr
    assert json.loads(got.stdout)["iterations"] == 30
    quiet = process("denoise", noisy, tmp_path / "o.png", "--backend", "numpy", "--p", 1, "--quiet", "--progress")
    assert (quiet.returncode, quiet.stdout, quiet.stderr) == (0, "", "")


def test_total_variation(noisy, tmp_path):
    got = report(noisy, tmp_path / "o.png", "--p", 1)
    assert (got["p"], got["radius"], got["metric"]) == (1, 1, "cityblock")
    assert "constant weights, 4 neighbours" in got["filter"]
    assert 1 < got["iterations"] <= 200 and got["energy"][-1] < got["energy"][0]


def test_every_number_is_kept(noisy, tmp_path):
    got = report(
        noisy, tmp_path / "o.png",
        "--p", 1.5, "--lam", 0.25, "--radius", 2, "--metric", "euclidean", "--max-iter", 7, "--tol", 0, "--eps", 0.5,
        "--sigma", 11,
    )  # fmt: skip
    assert (got["p"], got["lam"], got["radius"], got["metric"]) == (1.5, 0.25, 2, "euclidean")
    assert (got["iterations"], got["eps"], got["sigma"], got["sigma_estimated"]) == (7, 0.5, 11, False)
    assert got["stop"] == "max_iter"


def test_certified_says_how_far_it_is_from_the_minimum(noisy, tmp_path):
    got = report(noisy, tmp_path / "o.png", "--p", 1, "--solver", "certified", "--tol", 1e-3)
    assert got["stop"] == "gap"
    assert 0 <= got["gap"] <= 1e-3 * got["energy"][-1]
    sweeps = report(noisy, tmp_path / "s.png", "--p", 1, "--lam", got["lam"], "--eps", 1e-3, "--max-iter", 300)
    # a little eps only adds to the energy: no sweep gets below the bound
    assert "gap" not in sweeps
    assert sweeps["energy"][-1] >= got["energy"][-1] - got["gap"]
    said = done(denoise(noisy, tmp_path / "o.png", "--p", 1, "--solver", "certified"))
    assert re.search(r"minimum  the energy, [\d.e+]+, is at most [\d.e+-]+ above it", said)
    failed(denoise(noisy, tmp_path / "o.png", "--p", 0.5, "--solver", "certified"), 2, "needs p >= 1")


def test_tolerance_stops(noisy, tmp_path):
    got = report(noisy, tmp_path / "o.png", "--p", 1, "--tol", 0.01, "--max-iter", 500)
    assert got["stop"] == "tolerance" and got["iterations"] < 500


@pytest.mark.parametrize("metric", ["chebyshev", "euclidean", "cityblock"])
def test_metric(noisy, tmp_path, metric):
    got = report(noisy, tmp_path / "o.png", "--metric", metric, "--radius", 3)
    assert (got["metric"], got["radius"]) == (metric, 3)
    assert "7x7 window" in got["filter"]


def test_lam_is_fidelity(noisy, tmp_path):
    """The larger, the closer to the picture."""
    away = []
    for lam in (0.01, 0.3, 1e6):
        report(noisy, tmp_path / "o.png", "--p", 1, "--lam", lam)
        away.append(np.abs(read_picture(tmp_path / "o.png").pixels.astype(float) - read_picture(noisy).pixels).mean())
    assert away[0] > away[1] > away[2] == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--weights", "constant"], ["constant weights"]),
        (["--weights", "bilateral"], ["bilateral weights", "15x15 window", "sigma_space = 3"]),
        (
            ["--weights", "bilateral", "--sigma-space", "2", "--sigma-value", "40", "--radius", "4"],
            ["bilateral weights", "9x9 window", "sigma_space = 2", "sigma_value = 40"],
        ),
        (["--weights", "patch"], ["nonlocal weights", "15x15 window", "5x5 flat patches"]),
        (
            ["--weights", "patch", "--patch-radius", "1", "--h", "33", "--patch-sigma", "0.8", "--radius", "5"],
            ["11x11 window", "3x3 Gaussian (patch_sigma = 0.8) patches", "h = 33"],
        ),
        (["--weights", "patch", "--p", "1"], ["nonlocal weights", "p = 1"]),
    ],
)
def test_weights(noisy, tmp_path, options, words):
    got = report(noisy, tmp_path / "o.png", *options)
    assert [word for word in words if word not in got["filter"]] == []
    clean = clean_picture(1, 255)
    before, after = (np.abs(read_picture(path).pixels - clean).mean() for path in (noisy, tmp_path / "o.png"))
    assert after < before
