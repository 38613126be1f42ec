"""Many files through `gpureg denoise`: patterns, a folder for the results, a broken one in the middle, Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from commands import clean_picture, denoise, done, environment, failed, noisy_picture, on_terminal, process
from users import needs_users, no_root

import gpureg
from gpureg.files.pictures import Picture, PictureError, read_picture, write_picture
from gpureg.jobs import batch
from gpureg.jobs.batch import expand, is_pattern, targets_in
from gpureg.jobs.denoise_settings import Settings, rehearse

HOST = ("--backend", "numpy", "--quality", "fast")


@pytest.fixture
def raw(tmp_path, monkeypatch) -> Path:
    """A folder with three pictures, inside the current one."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "raw"
    folder.mkdir()
    pixels = noisy_picture()[0].pixels
    for i, name in enumerate(("a.png", "b.png", "c.tif")):
        write_picture(folder / name, Picture(np.ascontiguousarray(np.roll(pixels, 5 * i, axis=0)[:40, :30])))
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def is_denoised(source: Path, target: Path) -> bool:
    want = gpureg.denoise_image(read_picture(source).pixels, backend="numpy", quality="fast")
    return np.array_equal(read_picture(target).pixels, want)


# --- what goes where --------------------------------------------------------------------------------------------------


def test_several_files_into_a_new_folder(raw):
    out = done(denoise(raw / "a.png", raw / "c.tif", "out"))
    (line,) = out.splitlines()
    assert line.startswith("done     2 of 2 files in ") and " on numpy" in line and line.endswith(" -> out")
    assert sorted(os.listdir("out")) == ["a.png", "c.tif"]
    assert [name for name in os.listdir("out") if not is_denoised(raw / name, Path("out", name))] == []


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["raw/*.png"], ["a.png", "b.png"]),
        (["raw/c.tif", "raw/[ab].png"], ["a.png", "b.png", "c.tif"]),
        (["raw/?.tif"], ["c.tif"]),
        (["**/*.png"], ["a.png", "b.png"]),
        (["raw/*.png", "raw/a.png", "./raw/a.png"], ["a.png", "b.png"]),
    ],
    ids=" ".join,
)
def test_patterns_are_ours_too(raw, names, found):
    """The shell of Windows does not expand them, nor does one that is given them in quotes."""
    done(denoise(*names, "out"))
    assert sorted(os.listdir("out")) == found


def test_one_file_into_a_folder_that_is_there(raw):
    Path("out").mkdir()
    Path("out", "old.txt").write_bytes(b"stays")
    got = json.loads(done(denoise("raw/a.png", "out", "--json")))
    assert list(got) == ["files", "failed"] and [report["output"] for report in got["files"]] == ["out/a.png"]
    assert is_denoised(raw / "a.png", Path("out/a.png")) and Path("out/old.txt").read_bytes() == b"stays"


def test_a_name_with_brackets_is_a_file(raw):
    (raw / "a.png").rename("x[1].png")
    assert not is_pattern("x[1].png") and is_pattern("x[12].png")
    done(denoise("x[1].png", "o.png"))
    assert is_denoised(Path("x[1].png"), Path("o.png"))


def test_expand_keeps_the_order_of_names_and_sorts_each_pattern(raw):
    assert [path.name for path in expand(["raw/c.tif", "raw/*.png"])] == ["c.tif", "a.png", "b.png"]
    (raw / "d.png").mkdir()
    assert [path.name for path in expand(["raw/*.png"])] == ["a.png", "b.png"], "a folder is no file"


def refused(code: int, *arguments: object, words: tuple[str, ...]) -> None:
    """A call that must end with a sentence before any work."""
    before = files(Path.cwd())
    failed(denoise(*arguments), code, *words)
    assert files(Path.cwd()) == before
    assert not Path("out").exists()


def test_sentences_before_any_work(raw):
    (raw / "sub").mkdir()
    write_picture(raw / "sub" / "a.png", noisy_picture()[0])
    refused(1, "raw/*.jpg", "out", words=("raw/*.jpg: no file matches",))
    refused(2, "raw/a.png", "raw/sub/a.png", "out", words=("raw/a.png and raw/sub/a.png", "out/a.png", "two calls"))
    refused(2, "raw/*.png", "raw", words=("raw/a.png would overwrite", "another folder"))
    refused(2, "raw/b.png", "raw/sub/a.png", "raw", words=("raw/b.png would overwrite raw/b.png",))
    refused(2, "raw/a.png", "raw/b.png", "raw/c.tif", words=("c.tif is a file", "need a folder as OUT"))
    refused(2, "raw/*.png", "new.PNG", words=("new.PNG is named like a picture", "need a folder as OUT"))
    refused(1, "raw/*.png", "no/where", words=("no/where cannot be created", "the folder no does not exist"))


def test_a_file_by_another_name_is_found_out(raw):
    """An input through a link, and a reference in the folder of results."""
    Path("link").mkdir()
    os.symlink(raw / "a.png", Path("link", "a.png"))
    refused(2, "raw/*.png", "link", words=("link/a.png would overwrite raw/a.png",))
    Path("other").mkdir()
    for name in ("a.png", "b.png"):
        write_picture(Path("other", name), read_picture(raw / name))
    for option in ("--reference", "--mask", "--guide"):
        words = ("other/a.png would overwrite other/a.png", "which is read")
        refused(2, "raw/*.png", "other", option, "other", words=words)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--p", 0), "p must"),
        (("--lam", -1), "lam must"),
        (("--tol", -1), "tol must"),
        (("--weights", "patch", "--h", 0), "h must"),
        (("--backend", "cuda"), "unknown backend"),
        (("--spacing", "a"), "spacing must"),
        (("--axes", "Q"), "axes must"),
        (("--memory", "much"), "memory must"),
        (("--lam", "shure"), "discrepancy, sure, j-invariance"),
        (("--guide", "raw", "--p", 1), "--guide needs"),
        (("--norm", "edge"), "--norm edge needs"),
        (("--k", 5), "--k needs"),
        (("--k", 0, "--p", 1), "must be >= 1, got 0"),
    ],
    ids=str,
)
def test_a_wrong_option_is_told_once_and_before_any_work(raw, options, word):
    refused(2, "raw/*", "out", *options, words=(word,))


def test_rehearsal_refuses_no_right_option():
    """What fits some picture passes."""
    for settings in (
        Settings(),
        Settings(p=1, max_iter=10**9, tol=0),
        Settings(weights="bilateral", sigma_space=0.1, sigma_value=1e-9),
        Settings(weights="patch", patch_radius=9, radius=30),
        Settings(radius=0.3, spacing=(0.2, 0.1, 0.1), axes="ZYX"),
        Settings(sigma=1e9, dtype="float64"),
        Settings(weights="constant"),
        Settings(p=1, lam="sure", sigma=1e-3),
        Settings(p=1.5, norm="edge", k=10**6),
        Settings(centre="none", average_patches="plain"),
        Settings(weights="bilateral", centre="largest", guide=Path("guide.png")),
    ):
        rehearse(settings)


def test_a_device_that_is_not_there(raw):
    refused(1, "raw/*", "out", "--backend", "opencl:99", words=("opencl",))


@needs_users
def test_a_folder_that_may_not_be_created():
    with no_root() as folder:
        source = folder / "a.png"
        write_picture(source, noisy_picture()[0])
        (folder / "locked").mkdir()
        (folder / "locked").chmod(0o500)
        pattern = str(folder / "*.png")
        failed(denoise(pattern, folder / "locked" / "out"), 1, "out cannot be created", "Permission denied")


# --- a broken one in the middle ---------------------------------------------------------------------------------------


@pytest.fixture
def with_broken(raw) -> Path:
    """Four inputs of which the second is cut and the last holds what cannot be treated."""
    data = (raw / "b.png").read_bytes()
    (raw / "b.png").write_bytes(data[: len(data) // 2])
    tifffile.imwrite(raw / "d.tif", np.full((9, 9), np.inf, np.float32))
    return raw


def test_a_broken_file_stops_nobody(with_broken):
    got = process("denoise", "raw/*", "out", *HOST, cwd=with_broken.parent)
    assert got.returncode == 1
    lines = got.stderr.splitlines()
    assert lines[0] == "gpureg: 2 of 4 files failed:"
    assert lines[1].startswith("  raw/b.png is truncated or damaged")
    assert lines[2].startswith("  raw/d.tif holds infinite values, at 81 pixel(s)") and "--nodata inf" in lines[2]
    assert len(lines) == 3 and "Traceback" not in got.stderr
    assert got.stdout.startswith("done     2 of 4 files in ") and len(got.stdout.splitlines()) == 1
    assert sorted(os.listdir("out")) == ["a.png", "c.tif"]
    assert is_denoised(with_broken / "c.tif", Path("out/c.tif"))


def test_a_broken_file_in_json(with_broken):
    got = process("denoise", "raw/*", "out", *HOST, "--json", cwd=with_broken.parent)
    assert got.returncode == 1 and got.stderr.startswith("gpureg: 2 of 4 files failed:")
    outcome = json.loads(got.stdout)
    assert [report["input"] for report in outcome["files"]] == ["raw/a.png", "raw/c.tif"]
    assert [failure["input"] for failure in outcome["failed"]] == ["raw/b.png", "raw/d.tif"]
    assert "truncated" in outcome["failed"][0]["error"] and "infinite" in outcome["failed"][1]["error"]
    single = json.loads(done(denoise("raw/a.png", "o.png", "--json")))
    assert list(outcome["files"][0]) == list(single)


def test_a_missing_file_is_a_failure_of_its_own(raw):
    result = denoise("raw/a.png", "raw/x.png", "raw", "out")
    failed(result, 1, "2 of 3 files failed", "  raw/x.png: no such file", "  raw is a folder", "1 of 3 files")
    assert os.listdir("out") == ["a.png"]


def test_quiet_tells_failures_alone(with_broken):
    got = process("denoise", "raw/*", "out", *HOST, "--quiet", cwd=with_broken.parent)
    assert (got.returncode, got.stdout) == (1, "") and "2 of 4 files failed" in got.stderr
    fine = process("denoise", "raw/a.png", "raw/c.tif", "out", *HOST, "--quiet", cwd=with_broken.parent)
    assert (fine.returncode, fine.stdout, fine.stderr) == (0, "", "")


def test_memory_that_does_not_suffice_is_a_failure_of_its_own(raw, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(batch, "denoise_file", refuse)
    failed(denoise("raw/*", "out"), 1, "3 of 3 files failed", "raw/a.png: not enough memory", "0 of 3 files")


# --- what it says -----------------------------------------------------------------------------------------------------


def test_axes_nan_and_quality_of_many(raw):
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")
    for folder in ("stacks", "clean"):
        Path(folder).mkdir()
    board = clean_picture(1, 1.0)[20:44, 20:50]
    rng = np.random.default_rng(1)
    for name in ("a.tif", "b.tif"):
        stack = (board + rng.normal(0, 0.06, (3, *board.shape))).astype(np.float32)
        stack[0, :2, :3] = np.nan
        clean = np.stack([board] * 3).astype(np.float32)
        for folder, array in (("stacks", stack), ("clean", clean)):
            tifffile.imwrite(Path(folder, name), array, photometric="minisblack", metadata=None)
    options = ("stacks/*.tif", "out", "--reference", "clean")
    lines = done(denoise(*options)).splitlines()
    assert [line[:9].strip() for line in lines] == ["axes", "left out", "quality", "done"]
    assert "--axes TYX" in lines[0] and lines[0].endswith("(2 file(s))")
    assert lines[1] == "left out 12 pixel(s) NaN"
    reports = json.loads(done(denoise(*options, "--json")))["files"]
    means = [np.mean([report["psnr"][which] for report in reports]) for which in ("input", "output")]
    assert f"PSNR {means[0]:.2f} -> {means[1]:.2f} dB" in lines[2] and lines[2].endswith("on average")
    assert means[1] > means[0] + 3


def test_one_reference_for_all_and_a_missing_one(raw):
    pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")
    write_picture("clean.png", read_picture(raw / "a.png"))
    reports = json.loads(done(denoise("raw/*", "out", "--reference", "clean.png", "--json")))["files"]
    assert reports[0]["psnr"]["input"] == "inf"
    assert all(np.isfinite(report["psnr"]["input"]) for report in reports[1:])
    Path("clean").mkdir()
    for name in ("a.png", "c.tif"):
        write_picture(Path("clean", name), read_picture(raw / "a.png"))
    result = denoise("raw/*", "out", "--reference", "clean")
    failed(result, 1, "1 of 3 files failed", f"  raw/b.png: {Path('clean', 'b.png')}: no such file")


def test_plans_of_many_carry_their_names(raw):
    out = done(denoise("raw/*", "out", "--explain")).splitlines()
    assert [line for line in out if line.startswith("raw")] == ["raw/a.png", "raw/b.png", "raw/c.tif"]
    expected = []
    for name in ("raw/a.png", "raw/b.png", "raw/c.tif"):
        expected += [
            name,
            *gpureg.plan_denoising(read_picture(Path(name)).pixels, quality="fast").explain().splitlines(),
        ]
    assert out[out.index("raw/a.png") : -1] == expected
    assert out[-1].startswith("done")


def test_one_bar_over_the_files(raw):
    """On the error stream, gone at the end, and nothing of it in the report."""
    got = process("denoise", "raw/*", "out", *HOST, "--progress", "--json", cwd=raw.parent)
    assert got.returncode == 0 and len(json.loads(got.stdout)["files"]) == 3
    arguments = ("denoise", "raw/*", "out", *HOST)
    code, shown, out = on_terminal(*arguments, cwd=raw.parent, stdout=subprocess.PIPE)
    assert code == 0 and out.startswith(b"done     3 of 3 files")
    assert b"files" in shown and b"3/3" in shown and b"iterations" not in shown


# --- Ctrl-C -----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
def test_interrupt_in_the_middle(raw):
    """The first is done and whole, the second is being worked on, the third is not begun."""
    rng = np.random.default_rng(0)
    pixels = np.clip(rng.normal(128, 20, (1200, 1200)), 0, 255).astype(np.uint8)
    write_picture(raw / "b.png", Picture(pixels))
    Path("out").mkdir()
    Path("out", "b.png").write_bytes(b"what was there before")
    # It says when the first file is written, and takes SIGINT where a shell's background would have it ignored.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from gpureg import cli\n"
        "from gpureg.jobs import batch\n"
        "work = batch.denoise_file\n"
        "def told(source, *a, **k):\n"
        "    if source.name == 'b.png': print('ready', flush=True)\n"
        "    return work(source, *a, **k)\n"
        "batch.denoise_file = told\n"
        "cli.main(sys.argv[1:], prog_name='gpureg')"
    )
    options = [*HOST, "--p", "1", "--max-iter", "100000", "--tol", "0", "--lam", "0.1"]
    small = Picture(np.full((3, 3), 7, np.uint8))
    for name in ("a.png", "c.tif"):
        write_picture(raw / name, small)
    command = [sys.executable, "-c", code, "denoise", "raw/*", "out", *options]
    with subprocess.Popen(
        command, cwd=raw.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    ) as running:
        try:
            assert running.stdout.readline() == "ready\n"
            with pytest.raises(subprocess.TimeoutExpired):
                running.wait(1.0)
            running.send_signal(signal.SIGINT)
            out, error = running.communicate(timeout=120)
        finally:
            running.kill()
    assert running.returncode == 130, error
    assert error == "gpureg: interrupted, 1 of 3 files were done\n" and out == ""
    assert sorted(os.listdir("out")) == ["a.png", "b.png"]
    assert Path("out", "b.png").read_bytes() == b"what was there before"
    np.testing.assert_array_equal(read_picture("out/a.png").pixels, small.pixels)


def test_targets_are_named_as_their_sources(tmp_path):
    sources = [Path("x/a.png"), Path("y/b.tif")]
    assert targets_in(tmp_path / "out", sources, Settings()) == [tmp_path / "out" / "a.png", tmp_path / "out" / "b.tif"]
    with pytest.raises(PictureError, match="does not exist"):
        targets_in(tmp_path / "no" / "out", sources, Settings())
