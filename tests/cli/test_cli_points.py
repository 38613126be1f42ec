"""gpureg points, from the outside: files of points in and out, words, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import call, done, failed

import gpureg as gr
from gpureg.points.files import POINT_FORMATS

SPHERE = trimesh.creation.icosphere(3)
CLEAN = np.array(SPHERE.vertices)
RNG = np.random.default_rng(9)
NOISY = CLEAN + RNG.normal(0, 0.02, CLEAN.shape)
COLOURS = RNG.integers(0, 256, (len(CLEAN), 3), np.uint8)
CHANNELS = dict(zip(("red", "green", "blue"), COLOURS.T, strict=True))
BLOBS = np.concatenate([RNG.normal(centre, 1, (60, 2)) for centre in (0, 12)])


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def noisy() -> str:
    gr.write_points("noisy.ply", NOISY, CHANNELS)
    return "noisy.ply"


def run(source: object, target: object, *options: object):
    return call("points", source, target, "--backend", "numpy", *options)


def report(source: object, target: object, *options: object) -> dict:
    result = run(source, target, "--json", *options)
    done(result)
    return json.loads(result.stdout, parse_constant=pytest.fail)


def files() -> set[str]:
    return {path.name for path in Path.cwd().iterdir()}


@pytest.mark.parametrize("kind", POINT_FORMATS)
def test_every_kind_of_file(kind):
    gr.write_points(f"in{kind}", NOISY, {"number": np.arange(len(NOISY))})
    told = report(f"in{kind}", f"out{kind}")
    found = gr.read_points(f"out{kind}")
    expected = gr.denoise_points(NOISY, backend="numpy")
    assert np.array_equal(found.points, expected)
    assert np.array_equal(next(iter(found.columns.values())), np.arange(len(NOISY)))
    assert told["points"] == len(NOISY) and told["method"] == "surface"
    assert told["sigma"] == pytest.approx(gr.estimate_point_noise(NOISY)) and told["sigma_estimated"]
    moved = np.linalg.norm(expected - NOISY, axis=1)
    assert told["displacement"] == {"largest": pytest.approx(moved.max()), "mean": pytest.approx(moved.mean())}


def test_words(noisy):
    gr.write_points("clean.ply", CLEAN)
    result = run(noisy, "out.ply", "--reference", "clean.ply")
    lines = done(result).splitlines()
    assert [line.split()[0] for line in lines] == ["noise", "filter", "quality", "errors", "errors", "done"]
    assert "of the spacing, estimated" in lines[0] and "a scale for each point" in lines[1]
    before, after = (float(lines[4].split()[k].rstrip(",")) for k in (2, 4))
    # the noise along the surface stays
    assert 0.03 < before < 0.04 and after < 0.9 * before
    assert files() == {"noisy.ply", "clean.ply", "out.ply"}
    assert done(run(noisy, noisy, "--quiet")) == ""
    assert not np.array_equal(gr.read_points(noisy).points, NOISY)


def test_a_mesh_as_reference(noisy):
    gr.write_mesh("sphere.ply", SPHERE)
    told = report(noisy, "out.ply", "--reference", "sphere.ply")
    expected = gr.metrics.distance_to_surface(NOISY, SPHERE)
    assert told["reference"]["surface"]["before"] == pytest.approx(np.sqrt(np.mean(expected**2)))
    assert told["reference"]["surface"]["after"] < 0.6 * told["reference"]["surface"]["before"]


def test_values(noisy):
    """Colours and columns in the place of the points, in their types."""
    done(run(noisy, "out.ply", "--values", "colours", "--sigma", "40"))
    found = gr.read_points("out.ply")
    assert np.array_equal(found.points, NOISY)
    after = np.stack([found.columns[c] for c in CHANNELS], 1)
    assert after.dtype == np.uint8 and after.std() < COLOURS.std()
    expected = gr.denoise_points(NOISY, COLOURS, sigma=40, backend="numpy")
    assert np.abs(after - expected).max() <= 0.5 + 1e-9
    done(run(noisy, "out.ply", "--values", "red"))
    assert np.array_equal(gr.read_points("out.ply").columns["green"], CHANNELS["green"])
    failed(run(noisy, "x.ply", "--values", "heat"), 1, "no values 'heat'; it has colours, red, green, blue")


def test_clusters():
    gr.write_points("blobs.csv", BLOBS)
    told = report("blobs.csv", "out.csv", "--cluster")
    assert told["clusters"] == 2 and told["sizes"] == [60, 60] and not told["clusters_given"]
    assert Path("out.csv").read_text("utf-8").startswith("x,y,cluster\n")
    found = gr.read_points("out.csv")
    assert np.array_equal(found.points, BLOBS)
    assert np.array_equal(found.columns["cluster"], np.repeat([0, 1], 60))
    assert "clusters 3, as given: " in done(run("blobs.csv", "out.csv", "--n-clusters", 3, "--lam", 1))
    # without a header a column is added, and a header says what it is
    Path("bare.csv").write_text("\n".join(f"{x},{y}" for x, y in BLOBS), "utf-8")
    done(run("bare.csv", "out.csv", "--cluster"))
    assert Path("out.csv").read_text("utf-8").startswith("x,y,cluster\n")


def test_pictures(noisy):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    from PIL import Image

    assert "picture  both.png" in done(run(noisy, "out.ply", "--picture", "both.png", "--view", "30,20", "--up", "z"))
    gr.write_points("blobs.csv", BLOBS)
    done(run("blobs.csv", "out.csv", "--cluster", "--picture", "clusters.png"))
    drawn = [np.asarray(Image.open(name).convert("L"), float) for name in ("both.png", "clusters.png")]
    assert min(picture.std() for picture in drawn) > 10
    gr.write_points("ten.csv", RNG.normal(size=(40, 10)))
    failed(run("ten.csv", "no.csv", "--sigma", 1, "--picture", "no.png"), 2, "2 or 3 coordinates, these have 10")
    assert not {"no.csv", "no.png"} & files()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--cluster", "--sigma", "1"], 2, "--sigma is for denoising"),
        (["--n-clusters", "3", "--filter", "normals"], 2, "--filter is for denoising"),
        (["--min-size", "3"], 2, "--min-size is for clusters: give --cluster too"),
        (["--values", "red", "--filter", "normals"], 2, "leave --filter out"),
        (["--view", "30,20"], 2, "give --picture too"),
        (["--view", "north"], 2, "neither auto nor two angles"),
        (["--columns", "x,,z"], 2, "not a list of names"),
        (["--columns", "x,y,z"], 1, "columns are chosen in text"),
        (["--reference", "nope.ply"], 1, "nope.ply: no such file"),
        (["--picture", "a.doc"], 2, "extension must be one of"),
        (["--picture", "out.ply"], 2, "extension must be one of"),
        (["--sigma", "-1"], 2, "sigma must be finite and >= 0"),
        (["--backend", "abacus"], 2, "abacus"),
    ],
)
def test_wrong_options(noisy, options, code, words):
    before = files()
    failed(call("points", noisy, "out.ply", *options), code, words)
    assert files() == before


def test_wrong_files(noisy):
    failed(run("nope.ply", "out.ply"), 1, "nope.ply: no such file")
    failed(run(noisy, "out.las"), 1, "the extension of points must be one of")
    failed(run(noisy, "nowhere/out.ply"), 1, "nowhere")
    gr.write_points("flat.csv", BLOBS)
    failed(run("flat.csv", "out.ply"), 1, "three coordinates, got 2")
    failed(run(noisy, "noisy2.ply", "--reference", "noisy2.ply"), 1, "no such file")
    gr.write_points("clean.ply", CLEAN)
    failed(run(noisy, "clean.ply", "--reference", "clean.ply"), 2, "would overwrite clean.ply, which is read")
    assert np.array_equal(gr.read_points("clean.ply").points, CLEAN)
    assert files() == {"noisy.ply", "flat.csv", "clean.ply"}
