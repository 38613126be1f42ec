"""gpureg points, from the outside: files of points in and out, words, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import call, done, failed

import gpureg as gr
from gpureg.points.files import POINT_FORMATS, encode_points, read_all

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


def test_normals_and_points_that_are_not_finite():
    """Normals are new ones on the old side; points without a place stay where they are not, and all of it is said."""
    points, normals = NOISY.copy(), (-CLEAN).astype(np.float32)
    points[5], points[9, 1] = np.nan, np.inf
    columns = dict(zip(("nx", "ny", "nz"), normals.T, strict=True))
    Path("scan.ply").write_bytes(encode_points("scan.ply", points, columns | CHANNELS))
    told = report("scan.ply", "out.ply")
    assert told["points"] == len(NOISY) - 2
    assert told["notes"] == [
        "the normals nx, ny, nz are computed again for the moved points, on their old side",
        "2 points are not finite; they took no part and stay as they are",
    ]
    found = read_all("out.ply")
    assert np.isnan(found.points[5]).all() and found.points[9, 1] == np.inf
    new = np.stack([found.columns[name] for name in ("nx", "ny", "nz")], 1)
    assert np.array_equal(new[[5, 9]], normals[[5, 9]])
    finite = np.isfinite(points).all(axis=1)
    assert (-(new * CLEAN).sum(axis=1))[finite].min() > 0.8 and not np.array_equal(new[finite], normals[finite])
    assert np.array_equal(found.columns["red"], CHANNELS["red"])
    expected = gr.denoise_points(points[finite], backend="numpy")
    assert np.array_equal(found.points[finite], expected)
    done(run("scan.ply", "labels.ply", "--cluster", "--max-iter", 5))
    assert read_all("labels.ply").columns["cluster"][5] == -1
    lines = done(run("scan.ply", "out.csv")).splitlines()
    assert lines[-2].startswith("note     2 points are not finite")
    Path("none.csv").write_text("x,y,z\nnan,0,0\n", "utf-8")
    failed(run("none.csv", "out.csv"), 1, "no point that is finite")


def test_outliers_and_copies_are_told():
    dirty = np.concatenate([NOISY, NOISY[:7], [[3.0, 3, 3]]])
    gr.write_points("dirty.csv", dirty)
    told = report("dirty.csv", "out.csv")
    assert told["outliers"] == 1 and told["repeated"] == 7 and told["noise_unknown"] == 0
    lines = done(run("dirty.csv", "out.csv")).splitlines()
    assert any(line.startswith("left out 1 of 650 points are outliers") for line in lines)
    assert any(line.startswith("repeated 7 points repeat others") for line in lines)
    assert np.array_equal(gr.read_points("out.csv").points[-1], dirty[-1])


def test_many_files():
    """Several files and patterns into a folder; one that is broken does not stop the others."""
    for name in ("a.csv", "b.csv", "c.ply"):
        gr.write_points(name, NOISY[:60])
    Path("broken.csv").write_text("x,y\n1\n", "utf-8")
    result = call("points", "[ab].csv", "c.ply", "new", "--backend", "numpy")
    assert done(result).splitlines()[-1].startswith("done     3 of 3 files in")
    assert np.array_equal(gr.read_points("new/a.csv").points, gr.denoise_points(NOISY[:60], backend="numpy"))
    result = call("points", "*.csv", "new", "--backend", "numpy", "--json")
    assert result.exit_code == 1 and "1 of 3 files failed" in result.stderr and "broken.csv" in result.stderr
    told = json.loads(result.stdout)
    assert [entry["input"] for entry in told["files"]] == ["a.csv", "b.csv"]
    failed(call("points", "a.csv", "b.csv", "all.csv"), 2, "named like a file")
    failed(call("points", "a.csv", "b.csv", "new", "--picture", "x.png"), 2, "--picture is for one file")
    failed(call("points", "a.csv"), 2, "Missing OUT")
