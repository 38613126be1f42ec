"""The command line, from the outside: files in, files out, words on the terminal, exit codes.

Most calls run inside this process; those that need signals, pipes or a bare interpreter run in their own. The numpy
backend does the work, since which device runs changes nothing here; GPUREG_BACKEND of the outer world is taken away.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commands import SIGMA, call, clean_picture, denoise, done, environment, failed, noisy_picture, process, report
from PIL import Image
from users import needs_users, no_root

import gpureg
from gpureg.cli import main
from gpureg.files.pictures import Picture, read_picture, write_picture
from gpureg.images.run import run_plan

KEYS = {
    *("input", "output", "width", "height", "channels", "dtype", "alpha", "sigma", "sigma_estimated", "filter", "p"),
    *("lam", "lam_reason", "radius", "metric", "iterations", "stop", "energy", "eps", "backend", "seconds", "version"),
}


@pytest.fixture(autouse=True)
def _no_backend_from_outside(monkeypatch):
    monkeypatch.delenv("GPUREG_BACKEND", raising=False)


@pytest.fixture
def noisy(tmp_path) -> Path:
    path = tmp_path / "noisy.png"
    write_picture(path, noisy_picture()[0])
    return path


@pytest.fixture
def flat(tmp_path) -> Path:
    """A picture without any noise."""
    path = tmp_path / "flat.png"
    write_picture(path, Picture(np.full((20, 30), 77, np.uint8)))
    return path


# --- denoising --------------------------------------------------------------------------------------------------------


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
    for name in ("b.tif", "b.jpg", "b.png"):
        done(denoise(tmp_path / "a.png", tmp_path / name))
        assert read_picture(tmp_path / name).pixels.shape == picture.pixels.shape
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "b.tif"), np.asarray(Image.open(tmp_path / "b.png")))


def test_onto_itself(noisy):
    before = noisy.read_bytes()
    done(denoise(noisy, noisy))
    assert noisy.read_bytes() != before
    assert os.listdir(noisy.parent) == [noisy.name]


def test_the_door_and_the_command_agree(noisy, tmp_path):
    """The command line adds nothing to what a caller of the library gets."""
    done(denoise(noisy, tmp_path / "o.png"))
    want = gpureg.denoise_image(read_picture(noisy).pixels, backend="numpy")
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, want)


def test_a_clean_picture_comes_back_as_it_was(flat, tmp_path):
    for options in ((), ("--p", "1")):
        out = done(denoise(flat, tmp_path / "o.png", *options))
        assert "no noise" in out
        np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, read_picture(flat).pixels)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (2, 2), (3, 3)])
def test_tiny_pictures(tmp_path, size):
    write_picture(tmp_path / "a.png", Picture(np.random.default_rng(0).integers(0, 255, size, np.uint8)))
    for options in ((), ("--sigma", "9"), ("--sigma", "9", "--p", "1")):
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


# --- what it says -----------------------------------------------------------------------------------------------------


def test_three_lines(noisy, tmp_path):
    lines = done(denoise(noisy, tmp_path / "o.png")).splitlines()
    assert [line.split()[0] for line in lines] == ["noise", "filter", "done"]
    estimate = re.match(r"noise +sigma = ([\d.]+) of 255, estimated$", lines[0])
    assert estimate is not None and abs(float(estimate[1]) - SIGMA) < 0.2 * SIGMA
    assert "p = 2" in lines[1] and "lam" in lines[1] and "iteration" in lines[1]
    for word in (" s on numpy", "64 x 64", str(tmp_path / "o.png")):
        assert word in lines[2]


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


# --- overrides --------------------------------------------------------------------------------------------------------


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
    for word in words:
        assert word in got["filter"]
    clean = clean_picture(1, 255)
    before, after = (np.abs(read_picture(path).pixels - clean).mean() for path in (noisy, tmp_path / "o.png"))
    assert after < before


# The options that the door does not have, as a plan says them.
ONE_SWEEP = [
    (("--centre", "once"), {}),
    (("--centre", "largest"), {"centre": "largest"}),
    (("--centre", "none"), {"centre": "none", "lam": 0.0}),
    (("--average-patches", "none"), {"average_patches": False}),
    (("--average-patches", "plain"), {"average_patches": True}),
    (("--average-patches", "weighted", "--centre", "largest"), {"average_patches": "weighted", "centre": "largest"}),
]


@pytest.mark.parametrize("kind", [None, "patch", "bilateral"])
@pytest.mark.parametrize(("options", "changes"), ONE_SWEEP, ids=str)
def test_one_sweep(noisy, tmp_path, kind, options, changes):
    """The plan and no more: what the library makes of it is held against the equations elsewhere."""
    averages = changes.get("average_patches")
    if kind == "bilateral" and averages:
        refused(tmp_path, 2, noisy, tmp_path / "o.png", "--weights", kind, *options, words=("--average-patches",))
        return
    pixels = read_picture(noisy).pixels
    sigma = gpureg.estimate_noise(pixels)
    function = {
        None: None,
        "patch": gpureg.weights.patch(2, 3 * sigma, sigma=sigma),
        "bilateral": gpureg.weights.bilateral(3, 3 * sigma),
    }[kind]
    plan = replace(gpureg.plan_denoising(pixels, weights=function), **changes)
    solver = gpureg.Jacobi(damping=1)  # the plain sweep, also without data
    got = report(noisy, tmp_path / "o.png", *(() if kind is None else ("--weights", kind)), *options)
    assert got["filter"] == plan.describe() and got["lam"] == plan.lam
    want = run_plan(plan, pixels, solver=solver, backend="numpy").value
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, want)


def test_options_of_one_sweep_differ(noisy, tmp_path):
    """Each of them does something."""
    pictures = set()
    for options in ((), ("--weights", "patch", "--lam", 2)):
        for more in (
            *((("--centre", "largest"), ("--centre", "none")) if not options else ()),
            *(("--average-patches", word) for word in ("none", "plain", "weighted")),
        ):
            report(noisy, tmp_path / "o.png", *options, *more)
            pictures.add((tmp_path / "o.png").read_bytes())
    assert len(pictures) == 8


def test_norm(noisy, tmp_path):
    options = ("--p", 1, "--max-iter", 5)
    got = report(noisy, tmp_path / "o.png", *options, "--norm", "edge")
    assert got["norm"] == "edge" and "norm" not in report(noisy, tmp_path / "v.png", *options)
    pixels = read_picture(noisy).pixels
    for name, norm in (("o.png", "edge"), ("v.png", "vertex")):
        want = gpureg.denoise_image(pixels, p=1, max_iter=5, norm=norm, backend="numpy")
        np.testing.assert_array_equal(read_picture(tmp_path / name).pixels, want)
    assert (tmp_path / "o.png").read_bytes() != (tmp_path / "v.png").read_bytes()
    assert "; edge norm\n" in done(denoise(noisy, tmp_path / "o.png", *options, "--norm", "edge"))


@pytest.mark.parametrize("options", [("--p", 1), ("--weights", "patch"), ("--weights", "patch", "--p", 1.5)], ids=str)
def test_nearest(noisy, tmp_path, options):
    got = report(noisy, tmp_path / "o.png", *options, "--k", 6, "--radius", 4)
    assert ", 6 nearest" in got["filter"]
    pixels, p = read_picture(noisy).pixels, got["p"]
    sigma = gpureg.estimate_noise(pixels)
    weights = gpureg.weights.patch(2, 3 * sigma, sigma=sigma) if "patch" in options else None
    want = gpureg.denoise_image(pixels, p=p, weights=weights, k=6, radius=4, backend="numpy")
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, want)
    assert np.abs(want - clean_picture(1, 255)).mean() < np.abs(pixels - clean_picture(1, 255)).mean()


@pytest.mark.parametrize("method", ["discrepancy", "sure", "J-Invariance"])
def test_lam_is_searched_for(noisy, tmp_path, method):
    got = report(noisy, tmp_path / "o.png", "--p", 1, "--max-iter", 20, "--lam", method)
    pixels = read_picture(noisy).pixels
    plan = gpureg.plan_denoising(pixels, p=1, max_iter=20, lam=method.lower(), backend="numpy")
    assert (got["lam"], got["lam_search"], got["lam_reason"]) == (plan.lam, method.lower(), plan.reasons["lam"])
    np.testing.assert_array_equal(
        read_picture(tmp_path / "o.png").pixels, run_plan(plan, pixels, backend="numpy").value
    )
    lines = done(denoise(noisy, tmp_path / "o.png", "--p", 1, "--max-iter", 20, "--lam", method)).splitlines()
    assert lines[2] == f"lam      {plan.lam:.4g}; {plan.reasons['lam']}"


def test_why_lam_is_what_it_is(noisy, flat, tmp_path):
    plain = report(noisy, tmp_path / "o.png")
    assert plain["lam_reason"].startswith("rule") and "lam_search" not in plain
    assert report(noisy, tmp_path / "o.png", "--lam", 3)["lam_reason"] == "given"
    out = done(denoise(flat, tmp_path / "o.png", "--lam", "sure"))
    assert "no noise" in out and "lam  " not in out


def test_dtype(noisy, tmp_path):
    for dtype in ("float32", "float64"):
        assert dtype in report(noisy, tmp_path / "o.png", "--dtype", dtype)["backend"]


def test_memory(noisy, tmp_path):
    """Enough for a part of the picture: the same bytes come out."""
    report(noisy, tmp_path / "whole.png", "--p", 1, "--max-iter", 5)
    report(noisy, tmp_path / "tiles.png", "--p", 1, "--max-iter", 5, "--memory", "200KiB")
    assert (tmp_path / "whole.png").read_bytes() == (tmp_path / "tiles.png").read_bytes()


def test_environment_names_the_backend(noisy, tmp_path):
    assert report(noisy, tmp_path / "o.png", env={"GPUREG_BACKEND": "numpy"})["backend"].startswith("numpy")


def test_option_beats_the_environment(noisy, tmp_path):
    env = {"GPUREG_BACKEND": "opencl:99"}
    assert report(noisy, tmp_path / "o.png", "--backend", "numpy", env=env)["backend"].startswith("numpy")
    failed(denoise(noisy, tmp_path / "p.png", env=env), 1, "opencl")


# --- wrong calls and failures -----------------------------------------------------------------------------------------


def refused(folder: Path, code: int, source: Path, target: Path, *options: object, words: tuple[str, ...] = ()) -> None:
    """A denoising that must fail, and must leave the folder as it was: no output, no temporary, old files unchanged."""

    def content() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}

    before = content()
    failed(denoise(source, target, *options), code, *words)
    assert content() == before


@pytest.fixture(params=["new", "old"])
def target(request, tmp_path) -> Path:
    """A place for the output: a free one, or one where a file lies that a failure must not harm."""
    path = tmp_path / "out.png"
    if request.param == "old":
        path.write_bytes(b"what was there before")
    return path


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
        (["--lam", "sure", "--centre", "largest"], ["--lam sure searches without --centre", "number"]),
        (["--lam", "sure", "--average-patches", "none"], ["without --average-patches"]),
        (["--lam", "sure", "--norm", "edge", "--p", "1"], ["without --norm edge"]),
        (["--lam", "sure", "--guide", "nowhere.png"], ["without --guide"]),
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


@pytest.mark.parametrize(("data", "word"), [(b"", "empty"), (b"a letter, not a picture", "is not a PNG, TIFF or JPEG")])
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


@pytest.mark.parametrize("name", ["o.bmp", "o", "o.png.txt"])
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
    for word in ("unknown backend 'cuda'", "GPUREG_BACKEND=cuda", "numpy"):  # the table is there all the same
        assert word in got.output
    failed(denoise(noisy, noisy.parent / "o.png", env={"GPUREG_BACKEND": "cuda"}), 2, "unknown backend 'cuda'")
    assert os.listdir(noisy.parent) == [noisy.name]


# An interpreter without OpenCL and Warp: what is None in sys.modules cannot be imported.
WITHOUT_DEVICES = (
    "import sys; sys.modules['pyopencl'] = sys.modules['warp'] = None; "
    "from gpureg.cli import main; main(sys.argv[1:], prog_name='gpureg')"
)


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
    for word in ("gpureg[opencl]", "gpureg[warp]", "auto takes numpy"):
        assert word in table.stdout


# --- the other commands -----------------------------------------------------------------------------------------------


def test_backends():
    lines = done(call("backends")).splitlines()
    for heading in ("name", "device", "driver", "memory", "vector", "float64"):
        assert heading in lines[0]
    assert any(line.split()[0] == "numpy" or line.split()[:2] == ["*", "numpy"] for line in lines if line.split())
    assert sum(line.startswith("*") for line in lines[1:]) == 2, "the device auto takes, and the sentence that says why"


def test_backends_json():
    got = json.loads(done(call("backends", "--json")))
    assert set(got) == {"devices", "absent", "auto"}
    for device in got["devices"]:
        keys = {"id", "device", "driver", "kind", "memory_bytes", "vector_width", "float64", "auto"}
        assert set(device) >= keys
    assert sum(device["auto"] for device in got["devices"]) == 1
    assert "numpy" in {device["id"] for device in got["devices"]}
    for name, why in got["absent"].items():
        assert f"gpureg[{name}]" in why or "does not start" in why


def test_backends_says_what_the_environment_forces():
    out = done(call("backends", env={"GPUREG_BACKEND": "numpy"}))
    assert "GPUREG_BACKEND=numpy overrides auto" in out
    got = json.loads(done(call("backends", "--json", env={"GPUREG_BACKEND": "numpy"})))
    assert [device["id"] for device in got["devices"] if device["auto"]] == ["numpy"]


def _needs_plot() -> None:
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")


def test_demo(tmp_path):
    _needs_plot()
    out = done(call("demo", tmp_path / "demo.png", "--backend", "numpy"))
    assert [line.split()[0] for line in out.splitlines()] == ["noise", "filter", "done", "picture"]
    psnr = re.search(r"PSNR ([\d.]+) -> ([\d.]+) dB", out)
    assert psnr is not None and float(psnr[2]) > float(psnr[1]) + 5
    assert str(tmp_path / "demo.png") in out
    with Image.open(tmp_path / "demo.png") as opened:
        opened.load()
        width, height = opened.size
        pixels = np.asarray(opened.convert("L"), float)
    assert width > 1000 and 300 < height < width
    # Three panels with something in each of them.
    for third in np.array_split(pixels, 3, axis=1):
        assert third.std() > 5
    assert os.listdir(tmp_path) == ["demo.png"]


def test_demo_refuses(tmp_path):
    _needs_plot()
    for code, words, arguments in (
        (2, ("sigma", "-1"), (tmp_path / "a.png", "--sigma", "-1")),
        (2, ("sigma", "nan"), (tmp_path / "a.png", "--sigma", "nan")),
        (2, ("unknown backend 'cuda'",), (tmp_path / "a.png", "--backend", "cuda")),
        (1, ("extension",), (tmp_path / "a.bmp",)),
        (1, ("nowhere", "does not exist"), (tmp_path / "nowhere" / "a.png",)),
    ):
        failed(call("demo", *arguments), code, *words)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("missing", ["matplotlib", "skimage"])
def test_demo_without_its_libraries(tmp_path, missing):
    """A sentence with the extra to install, and no picture."""
    code = WITHOUT_DEVICES.replace("'warp'", f"'{missing}'")
    got = process("demo", tmp_path / "demo.png", "--backend", "numpy", code=code)
    assert got.returncode == 1, got.stderr
    assert "gpureg[plot]" in got.stderr and missing in got.stderr and "Traceback" not in got.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("command", sorted(main.commands))
@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_has_an_example(command, flag):
    out = done(call(command, flag))
    assert out.startswith(f"Usage: gpureg {command}")
    # each on a line of its own
    assert re.search(
        rf"^  Examples?:\n(    .*\n)*    .*gpureg {'denoise' if command == 'backends' else command}", out, re.M
    )


def test_help_lists_every_option_with_words():
    out = done(call("denoise", "--help"))
    for parameter in main.commands["denoise"].params:
        if parameter.param_type_name == "option":
            assert parameter.opts[0] in out
            assert parameter.help, f"{parameter.opts[0]} has no help"


def test_overview_and_version():
    out = done(call("--help"))
    for command in main.commands:
        # what it does fits the line
        assert re.search(rf"^  {command} +[A-Z].*\.$", out, re.M)
    assert done(call("--version")).strip() == f"gpureg, version {gpureg.__version__}"
    got = process("--version")
    assert (got.returncode, got.stdout.strip()) == (0, f"gpureg, version {gpureg.__version__}")


# --- from a shell -----------------------------------------------------------------------------------------------------


def test_from_a_shell(noisy):
    got = process("denoise", "noisy.png", "clean.png", "--backend", "numpy", cwd=noisy.parent)
    assert got.returncode == 0, got.stderr
    assert len(got.stdout.splitlines()) == 3 and got.stderr == ""
    assert sorted(os.listdir(noisy.parent)) == ["clean.png", "noisy.png"]
    for code, arguments in ((1, ("denoise", "missing.png", "a.png")), (2, ("denoise", "noisy.png", "a.png", "--p", 0))):
        got = process(*arguments, cwd=noisy.parent)
        assert got.returncode == code
        assert got.stdout == "" and got.stderr and "Traceback" not in got.stderr
    assert sorted(os.listdir(noisy.parent)) == ["clean.png", "noisy.png"]


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
@pytest.mark.parametrize(
    "options",
    [
        ("--p", "1", "--max-iter", "1000000", "--tol", "0"),
        ("--radius", "40", "--weights", "patch"),
        ("--p", "1", "--lam", "sure"),
    ],
    ids=["iterations", "weights", "search"],
)
def test_interrupt_while_working(tmp_path, options):
    """Ctrl-C in the loop, in the making of weights, in a search: code 130, a word, the old output, no half."""
    rng = np.random.default_rng(0)
    pixels = np.clip(rng.normal(128, 20, (1500, 1500)), 0, 255).astype(np.uint8)
    write_picture(tmp_path / "in.png", Picture(pixels))
    (tmp_path / "out.png").write_bytes(b"what was there before")
    # The process says when it has started, so that the signal falls into the work, and takes SIGINT even where the
    # tests run in the background of a shell, which has its children ignore it.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from gpureg.cli import main; print('ready', flush=True); main(sys.argv[1:], prog_name='gpureg')"
    )
    command = [sys.executable, "-c", code, "denoise", str(tmp_path / "in.png"), str(tmp_path / "out.png")]
    with subprocess.Popen(
        [*command, "--backend", "numpy", *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(),
    ) as running:  # fmt: skip
        try:
            assert running.stdout.readline() == "ready\n"
            time.sleep(1.5)
            assert running.poll() is None, "it ended before it could be interrupted"
            running.send_signal(signal.SIGINT)
            out, error = running.communicate(timeout=120)
        finally:
            running.kill()
    assert running.returncode == 130, error
    assert "interrupted" in error and "nothing was written" in error
    assert "Traceback" not in error and out == ""
    assert (tmp_path / "out.png").read_bytes() == b"what was there before"
    assert sorted(os.listdir(tmp_path)) == ["in.png", "out.png"]


@pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")
@pytest.mark.parametrize("command", ["backends", "backends --json", "denoise --help"])
def test_reader_that_goes_away(command):
    """`gpureg backends | head -c 1`: no traceback, and none of the interpreter's complaints at its end."""
    got = subprocess.run(
        ["sh", "-c", f'"$PYTHON" -m gpureg {command} | true'],
        capture_output=True, text=True, timeout=300, env=environment({"PYTHON": sys.executable}),
    )  # fmt: skip
    assert "Traceback" not in got.stderr and "BrokenPipe" not in got.stderr
    assert got.stderr == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_report_onto_a_full_disk(noisy):
    with open("/dev/full", "w") as full:
        got = subprocess.run(
            [sys.executable, "-m", "gpureg", "denoise", str(noisy), str(noisy.parent / "o.png"), "--backend", "numpy"],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=300, env=environment(),
        )  # fmt: skip
    assert got.returncode == 1
    assert "Traceback" not in got.stderr and "No space left" in got.stderr
