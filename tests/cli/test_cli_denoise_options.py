"""`gpureg denoise`: one sweep, norms, searches for lam, devices; what each option changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from commands import clean_picture, denoise, done, failed, report
from refusing import refused

import gpureg
from gpureg.files.pictures import read_picture
from gpureg.images.run import run_plan

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
    plan = replace(gpureg.plan_denoising(pixels, weights=function, passes=1), **changes)
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


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_dtype(noisy, tmp_path, dtype):
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
