"""`gpureg denoise` with files beside the picture: masks, references; NaN left out; plans that explain themselves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commands import SIGMA, clean_picture, denoise, done, failed, noisy_picture, on_terminal, process, report

import gpureg
from gpureg.files.pictures import Picture, read_picture, write_picture


@pytest.fixture
def noisy(tmp_path) -> Path:
    path = tmp_path / "noisy.png"
    write_picture(path, noisy_picture()[0])
    return path


@pytest.fixture
def clean(tmp_path) -> Path:
    path = tmp_path / "clean.png"
    write_picture(path, Picture(np.rint(clean_picture(1, 255)).astype(np.uint8)))
    return path


def half(tmp_path: Path, value: int = 1) -> tuple[Path, np.ndarray]:
    """A mask that leaves the upper quarter out."""
    inside = np.ones((64, 64), bool)
    inside[:16] = False
    write_picture(tmp_path / "mask.png", Picture(inside * np.uint8(value)))
    return tmp_path / "mask.png", inside


# --- masks and NaN ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1, 255])
def test_mask_is_that_of_the_door(tmp_path, noisy, value):
    path, inside = half(tmp_path, value)
    got = report(noisy, tmp_path / "o.png", "--mask", path)
    assert (got["mask"], got["outside_mask"], "nan" in got) == (str(path), 16 * 64, False)
    before = read_picture(noisy).pixels
    after = read_picture(tmp_path / "o.png").pixels
    np.testing.assert_array_equal(after, gpureg.denoise_image(before, mask=inside, backend="numpy", quality="fast"))
    np.testing.assert_array_equal(after[:16], before[:16])
    assert "left out 1024 pixel(s) outside the mask\n" in done(denoise(noisy, tmp_path / "o.png", "--mask", path))


def test_a_colour_of_a_mask_is_enough(tmp_path, noisy):
    inside = np.zeros((64, 64, 3), np.uint8)
    inside[:32, :, 0] = inside[32:40, :, 2] = 9
    write_picture(tmp_path / "mask.png", Picture(inside))
    assert report(noisy, tmp_path / "o.png", "--mask", tmp_path / "mask.png")["outside_mask"] == 24 * 64


@pytest.mark.parametrize("layout", ["grey", "rgb"])
def test_nan_is_left_out(tmp_path, layout):
    pixels = noisy_picture(layout, "float32")[0].pixels
    pixels[30:33, 20:24, ...] = np.nan
    if layout == "rgb":
        pixels[0, 0, 1] = np.nan  # one channel is enough
    write_picture(tmp_path / "in.tif", Picture(pixels))
    got = report(tmp_path / "in.tif", tmp_path / "o.tif")
    assert got["nan"] == (13 if layout == "rgb" else 12)
    missing = np.isnan(pixels) if layout == "grey" else np.isnan(pixels).any(axis=2)
    axis = None if layout == "grey" else 2
    want = gpureg.denoise_image(pixels, mask=~missing, channel_axis=axis, backend="numpy", quality="fast")
    after = tifffile.imread(tmp_path / "o.tif")
    np.testing.assert_array_equal(after, want)
    np.testing.assert_array_equal(np.isnan(after), np.isnan(pixels))
    assert f"left out {got['nan']} pixel(s) NaN\n" in done(denoise(tmp_path / "in.tif", tmp_path / "o.tif"))


def test_nan_under_a_mask_is_counted_once(tmp_path):
    path, _ = half(tmp_path)
    pixels = noisy_picture("grey", "float32")[0].pixels
    pixels[15:17, :5] = np.nan
    write_picture(tmp_path / "in.tif", Picture(pixels))
    got = report(tmp_path / "in.tif", tmp_path / "o.tif", "--mask", path)
    assert (got["nan"], got["outside_mask"]) == (5, 1024)
    out = done(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--mask", path))
    assert "left out 5 pixel(s) NaN, 1024 pixel(s) outside the mask\n" in out


def test_a_slice_that_is_all_nan_comes_back(tmp_path):
    pixels = np.stack([noisy_picture("grey", "float32")[0].pixels[:20, :20]] * 3)
    pixels[1] = np.nan
    tifffile.imwrite(tmp_path / "in.tif", pixels, photometric="minisblack", metadata={"axes": "TYX"})
    got = report(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "T")
    assert (got["nan"], len(got["slices"])) == (400, 2)
    after = tifffile.imread(tmp_path / "o.tif")
    np.testing.assert_array_equal(after[2], gpureg.denoise_image(pixels[2], backend="numpy", quality="fast"))
    assert np.isnan(after[1]).all()


def test_masks_that_do_not_fit(tmp_path, noisy):
    out = tmp_path / "o.png"
    write_picture(tmp_path / "small.png", Picture(np.ones((9, 9), np.uint8)))
    write_picture(tmp_path / "black.png", Picture(np.zeros((64, 64), np.uint8)))
    (tmp_path / "folder").mkdir()
    for name, words in {
        "small.png": ("the mask", "small.png has the shape (9, 9)", "noisy.png has (64, 64)"),
        "black.png": ("noisy.png: no pixel is left", "outside the mask"),
        "nowhere.png": ("nowhere.png: no such file",),
        "folder": ("folder", "noisy.png: no such file"),
    }.items():
        failed(denoise(noisy, out, "--mask", tmp_path / name), 1, *words)
    assert not out.exists()
    before = (tmp_path / "black.png").read_bytes()
    failed(
        denoise(noisy, tmp_path / "black.png", "--mask", tmp_path / "black.png"), 2, "black.png would overwrite", "read"
    )
    assert (tmp_path / "black.png").read_bytes() == before


# --- guides -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["grey", "rgb"])
@pytest.mark.parametrize("weights", [(), ("--weights", "bilateral", "--sigma-value", 60)], ids=["rule", "bilateral"])
def test_guide_is_that_of_the_door(tmp_path, noisy, weights, layout):
    """A guide of the picture's channels or of others."""
    guide = noisy_picture(layout)[0].pixels[:, ::-1]
    write_picture(tmp_path / "guide.png", Picture(np.ascontiguousarray(guide)))
    got = report(noisy, tmp_path / "o.png", *weights, "--guide", tmp_path / "guide.png")
    assert got["guide"] == str(tmp_path / "guide.png")
    how = {"weights": gpureg.weights.bilateral(3, 60)} if weights else {}
    want = gpureg.denoise_image(read_picture(noisy).pixels, guide=guide, backend="numpy", quality="fast", **how)
    np.testing.assert_array_equal(read_picture(tmp_path / "o.png").pixels, want)
    assert (want != gpureg.denoise_image(read_picture(noisy).pixels, backend="numpy", quality="fast", **how)).any()
    out = done(denoise(noisy, tmp_path / "o.png", *weights, "--guide", tmp_path / "guide.png"))
    assert f"; guided by {tmp_path / 'guide.png'}\n" in out


def test_guide_of_a_stack(tmp_path):
    """Slice by slice, from a file whose channels lie elsewhere; by name out of a folder."""
    rng = np.random.default_rng(0)
    stack, guide = rng.normal(90, 9, (3, 20, 24)), rng.normal(90, 9, (3, 2, 20, 24))
    stack, guide = stack.astype(np.float32), guide.astype(np.float32)
    (tmp_path / "guides").mkdir()
    tifffile.imwrite(tmp_path / "in.tif", stack, imagej=True, metadata={"axes": "TYX"})
    tifffile.imwrite(tmp_path / "guides" / "in.tif", guide, imagej=True, metadata={"axes": "TCYX"})
    options = ("--each", "T", "--sigma", 9, "--guide", tmp_path / "guides")
    report(tmp_path / "in.tif", tmp_path / "o.tif", *options)
    for t, page in enumerate(tifffile.imread(tmp_path / "o.tif")):
        one = np.moveaxis(guide[t], 0, -1)
        np.testing.assert_array_equal(page, gpureg.denoise_image(stack[t], sigma=9, guide=one, backend="numpy"))


def test_guides_that_do_not_fit(tmp_path, noisy):
    write_picture(tmp_path / "small.png", Picture(np.ones((9, 9), np.uint8)))
    write_picture(tmp_path / "nan.tif", Picture(np.full((64, 64), np.nan, np.float32)))
    for name, code, words in (
        ("small.png", 1, ("the guide", "small.png has the shape (9, 9)", "noisy.png has (64, 64)")),
        ("nowhere.png", 1, ("nowhere.png: no such file",)),
        ("nan.tif", 2, ("guide must be finite",)),
    ):
        failed(denoise(noisy, tmp_path / "o.png", "--guide", tmp_path / name), code, *words)
    result = denoise(noisy, tmp_path / "small.png", "--guide", tmp_path / "small.png")
    failed(result, 2, "small.png would overwrite", "give another OUT")
    assert not (tmp_path / "o.png").exists()


# --- references -------------------------------------------------------------------------------------------------------


def _needs_skimage() -> None:
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")


def test_reference(tmp_path, noisy, clean):
    _needs_skimage()
    from skimage.metrics import peak_signal_noise_ratio, structural_similarity

    got = report(noisy, tmp_path / "o.png", "--reference", clean)
    assert got["reference"] == str(clean)
    want = read_picture(clean).pixels
    pixels = {"input": read_picture(noisy).pixels, "output": read_picture(tmp_path / "o.png").pixels}
    peers = {"psnr": peak_signal_noise_ratio, "ssim": structural_similarity}
    theirs = {
        (name, which): peer(want, x, data_range=255) for name, peer in peers.items() for which, x in pixels.items()
    }
    assert {(name, which): got[name][which] for name, which in theirs} == pytest.approx(theirs, abs=1e-9)
    assert got["psnr"]["output"] > got["psnr"]["input"] + 5
    text = done(denoise(noisy, tmp_path / "o.png", "--reference", clean))
    (line,) = (line for line in text.splitlines() if line.startswith("quality "))
    assert line == (
        f"quality  PSNR {got['psnr']['input']:.2f} -> {got['psnr']['output']:.2f} dB, "
        f"SSIM {got['ssim']['input']:.3f} -> {got['ssim']['output']:.3f}"
    )


def test_reference_that_is_the_picture(tmp_path, noisy):
    """A PSNR that JSON has no number for."""
    _needs_skimage()
    got = report(noisy, tmp_path / "o.png", "--reference", noisy, "--max-iter", 0)
    assert got["psnr"] == {"input": "inf", "output": "inf"} and got["ssim"] == {"input": 1.0, "output": 1.0}


def test_reference_of_a_float_picture_gives_the_range(tmp_path):
    _needs_skimage()
    picture, without = noisy_picture("grey", "float32")
    write_picture(tmp_path / "in.tif", picture)
    write_picture(tmp_path / "clean.tif", Picture(without))
    got = report(tmp_path / "in.tif", tmp_path / "o.tif", "--reference", tmp_path / "clean.tif", "--max-iter", 0)
    error = np.sqrt(np.mean((picture.pixels - without) ** 2))
    # 1e-4: the report's PSNR is of float32 pixels
    assert got["psnr"]["input"] == pytest.approx(20 * np.log10(np.ptp(without) / error), abs=1e-4)
    assert got["psnr"]["output"] == got["psnr"]["input"]


def test_reference_counts_pixels_that_take_part(tmp_path, noisy, clean):
    _needs_skimage()
    path, inside = half(tmp_path)
    got = report(noisy, tmp_path / "o.png", "--reference", clean, "--mask", path, "--max-iter", 0)
    error = read_picture(noisy).pixels.astype(float) - read_picture(clean).pixels
    assert got["psnr"]["input"] == pytest.approx(20 * np.log10(255 / np.sqrt(np.mean(error[inside] ** 2))), abs=1e-9)


@pytest.mark.parametrize("axes", ["TZYX", "TZCYX", "TYX"])
@pytest.mark.parametrize("each", [(), ("--each", "T")])
def test_reference_of_a_stack(tmp_path, axes, each):
    _needs_skimage()
    shape = tuple({"T": 4, "Z": 5, "C": 2, "Y": 16, "X": 18}[letter] for letter in axes)
    ramps = np.add.outer(np.arange(int(np.prod(shape[:-1]))), 3.0 * np.arange(shape[-1])).reshape(shape) % 200
    noise = np.random.default_rng(0).normal(0, SIGMA, shape)
    for name, array in (("in", ramps + noise), ("clean", ramps)):
        stored = np.clip(np.rint(array), 0, 255).astype(np.uint8)
        tifffile.imwrite(tmp_path / f"{name}.tif", stored, imagej=True, metadata={"axes": axes})
    got = report(tmp_path / "in.tif", tmp_path / "o.tif", "--reference", tmp_path / "clean.tif", *each)
    pixels, want = (tifffile.imread(tmp_path / name).astype(float) for name in ("o.tif", "clean.tif"))
    assert got["psnr"]["output"] == pytest.approx(20 * np.log10(255 / np.sqrt(np.mean((pixels - want) ** 2))), abs=1e-9)
    assert 0 < got["ssim"]["output"] <= 1


def test_a_sliver_has_no_ssim(tmp_path):
    _needs_skimage()
    write_picture(tmp_path / "in.png", Picture(np.arange(40, dtype=np.uint8).reshape(2, 20)))
    write_picture(tmp_path / "clean.png", Picture(np.arange(1, 41, dtype=np.uint8).reshape(2, 20)))
    options = ("--reference", tmp_path / "clean.png", "--sigma", 5)
    assert report(tmp_path / "in.png", tmp_path / "o.png", *options)["ssim"] == {"input": "nan", "output": "nan"}
    text = done(denoise(tmp_path / "in.png", tmp_path / "o.png", *options))
    assert "PSNR" in text and "SSIM" not in text


def test_references_that_do_not_fit(tmp_path, noisy, clean):
    _needs_skimage()
    out = tmp_path / "o.png"
    write_picture(tmp_path / "small.png", Picture(np.ones((9, 9), np.uint8)))
    write_picture(tmp_path / "deep.png", Picture(np.ones((64, 64), np.uint16)))
    for name, words in {
        "small.png": ("the reference", "small.png has the shape (9, 9)", "noisy.png has (64, 64)"),
        "deep.png": ("deep.png holds uint16", "noisy.png uint8", "convert"),
        "nowhere.png": ("nowhere.png: no such file",),
    }.items():
        failed(denoise(noisy, out, "--reference", tmp_path / name), 1, *words)
    write_picture(tmp_path / "in.tif", noisy_picture("grey", "float32")[0])
    write_picture(tmp_path / "flat.tif", Picture(np.ones((64, 64), np.float32)))
    write_picture(tmp_path / "nan.tif", Picture(np.full((64, 64), np.nan, np.float32)))
    for name in ("flat.tif", "nan.tif"):
        result = denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--reference", tmp_path / name)
        failed(result, 1, f"{name} has no range", "constant or not finite")
    before = clean.read_bytes()
    failed(denoise(noisy, clean, "--reference", clean), 2, "clean.png would overwrite", "give another OUT")
    assert clean.read_bytes() == before and not out.exists() and not (tmp_path / "o.tif").exists()


def test_reference_without_its_library(tmp_path, noisy, clean):
    code = (
        "import sys; sys.modules['skimage'] = None; from gpureg.cli import main; main(sys.argv[1:], prog_name='gpureg')"
    )
    got = process("denoise", noisy, tmp_path / "o.png", "--backend", "numpy", "--reference", clean, code=code)
    assert got.returncode == 1, got.stderr
    assert "--reference" in got.stderr and "gpureg[plot]" in got.stderr and "Traceback" not in got.stderr
    assert not (tmp_path / "o.png").exists()


# --- plans ------------------------------------------------------------------------------------------------------------


def test_explain_comes_first(tmp_path, noisy):
    plain = done(denoise(noisy, tmp_path / "o.png")).splitlines()
    explained = done(denoise(noisy, tmp_path / "o.png", "--explain")).splitlines()
    assert [line.split()[0] for line in explained[-3:]] == ["noise", "filter", "done"]
    assert explained[-3:-1] == plain[:2]
    assert explained[:-3] == gpureg.plan_denoising(read_picture(noisy).pixels, quality="fast").explain().splitlines()


def test_explain_in_json(tmp_path, noisy):
    """The plan is told on the error stream too, before the run and out of the way of the JSON."""
    result = denoise(noisy, tmp_path / "o.png", "--explain", "--json")
    done(result)
    plan = gpureg.plan_denoising(read_picture(noisy).pixels, quality="fast").explain()
    assert json.loads(result.stdout)["explain"] == plan.splitlines()
    assert result.stderr == plan + "\n"
    assert "explain" not in report(noisy, tmp_path / "o.png")


def test_explain_of_slices(tmp_path):
    pixels = np.stack([noisy_picture()[0].pixels[:20, :20]] * 2)
    tifffile.imwrite(tmp_path / "in.tif", pixels, photometric="minisblack", metadata={"axes": "TYX"})
    out = done(denoise(tmp_path / "in.tif", tmp_path / "o.tif", "--each", "T", "--explain"))
    assert "slice 1 of 2 along T\n" in out and "slice 2 of 2 along T\n" in out


@pytest.mark.parametrize(
    ("options", "rows"),
    [
        (("--weights", "patch"), ("patch 5x5, flat default", "h {:.4g} rule: 0.6 sigma sqrt(samples)")),
        (("--weights", "patch", "--h", 40, "--patch-radius", 1), ("patch 3x3, flat given", "h 40 given")),
        (("--weights", "bilateral"), ("reach 3 in space, {:.4g} in value 3 of the finest pixels, 3 sigma",)),
        (("--weights", "bilateral", "--sigma-space", 2, "--sigma-value", 9), ("reach 2 in space, 9 in value given",)),
        (("--average-patches", "plain"), ("averaging 3x3 patches, plainly given",)),
        (("--centre", "none"), ("lam 0 the centre is left out, as given",)),
        (("--lam", 3), ("lam 3 given",)),
    ],
    ids=str,
)
def test_explain_tells_what_the_command_chose(tmp_path, noisy, options, rows):
    """0.6 sigma sqrt(25) and 3 sigma are the same number."""
    three_sigma = 3 * gpureg.estimate_noise(read_picture(noisy).pixels)
    told = [
        " ".join(line.split()) for line in done(denoise(noisy, tmp_path / "o.png", "--explain", *options)).split("\n")
    ]
    expected = [row.format(three_sigma) for row in rows]
    assert [row for row in expected if row not in told] == []


@pytest.mark.parametrize("columns", [80, 120])
def test_explain_on_a_terminal(tmp_path, noisy, columns):
    """No line is wider than the terminal; what is broken goes on under its column, and no word is lost."""
    options = ("--backend", "numpy", "--quality", "fast", "--explain", "--no-progress")
    code, shown, _ = on_terminal("denoise", "noisy.png", "o.png", *options, columns=columns, cwd=tmp_path)
    assert code == 0
    lines = shown.decode().splitlines()
    wanted = gpureg.plan_denoising(read_picture(noisy).pixels, quality="fast").explain()
    table = lines[: next(i for i, line in enumerate(lines) if line.startswith("noise    s"))]
    assert max(map(len, lines)) < columns
    assert " ".join(table).split() == wanted.split()
    column = max(len(line) - len(line.split("  ")[-1]) for line in wanted.splitlines())
    broken = [line for line in table if line.startswith(" ")]
    assert all(line.startswith(" " * column) and line[column] != " " for line in broken)
    assert bool(broken) == (columns == 80)


def test_explain_and_quiet(tmp_path, noisy):
    failed(denoise(noisy, tmp_path / "o.png", "--explain", "--quiet"), 2, "--explain and --quiet")
    assert not (tmp_path / "o.png").exists()


def test_explain_is_told_before_the_run(tmp_path, noisy):
    """A device that is not there stops the run, not the plan."""
    result = denoise(noisy, tmp_path / "o.png", "--explain", "--backend", "opencl:99")
    failed(result, 1, "rule: nonlocal means", "opencl")
    assert result.output.index("nonlocal") < result.output.index("opencl:99")


def test_the_report_of_one_picture_has_no_new_keys(tmp_path, noisy):
    got = json.loads(done(denoise(noisy, tmp_path / "o.png", "--json")))
    assert list(got) == [
        *("input", "output", "width", "height", "channels", "dtype", "alpha", "sigma", "sigma_estimated"),
        *("noise", "filter"),
        *(
            "p",
            "lam",
            "lam_reason",
            "radius",
            "metric",
            "passes",
            "iterations",
            "stop",
            "energy",
            "eps",
            "backend",
            "seconds",
            "version",
        ),
    ]
