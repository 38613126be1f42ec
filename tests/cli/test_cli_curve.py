"""gpureg curve, from the outside: files of curves in and out, words, exit codes; and pictures of curves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import call, done, failed

import gpureg as gr
from gpureg.curves.files import CurveInFile

T = np.linspace(0, 2 * np.pi, 200, endpoint=False)
RNG = np.random.default_rng(8)
CIRCLE = 10 * np.stack([np.cos(T), np.sin(T)], axis=1)
NOISY = CIRCLE + RNG.normal(0, 0.1, CIRCLE.shape)
SIDE = np.linspace(0, 1, 25, endpoint=False)
SQUARE = np.concatenate(
    [np.stack(s, 1) for s in ((SIDE, 0 * SIDE), (0 * SIDE + 1, SIDE), (1 - SIDE, 0 * SIDE + 1), (0 * SIDE, 1 - SIDE))]
)
NONE = np.empty((200, 0))


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def noisy() -> str:
    gr.write_curves("noisy.csv", [CurveInFile(NOISY, True, NONE)])
    return "noisy.csv"


def run(source: object, target: object, *options: object):
    return call("curve", source, target, "--backend", "numpy", *options)


def report(source: object, target: object, *options: object) -> dict:
    result = run(source, target, "--json", *options)
    done(result)
    return json.loads(result.stdout, parse_constant=pytest.fail)


def files() -> set[str]:
    return {path.name for path in Path.cwd().iterdir()}


def test_denoise(noisy):
    gr.write_curves("clean.csv", [CurveInFile(CIRCLE, True, NONE)])
    told = report(noisy, "out.csv", "--reference", "clean.csv")
    [found] = gr.read_curves("out.csv").curves
    expected = gr.denoise_curve(NOISY, backend="numpy")
    # the reader and the door take means of coordinates in arrays that lie differently in memory
    assert np.allclose(found.points, expected, rtol=0, atol=1e-12)
    assert told["sigma"][0] == pytest.approx(0.1, rel=0.2) and told["method"] == "denoise"
    assert told["area"]["after"] == pytest.approx(abs(gr.metrics.curve_area(expected)))
    assert told["reference"]["after"] < 0.5 * told["reference"]["before"]
    assert told["hausdorff"] == pytest.approx(gr.metrics.curve_hausdorff(NOISY, expected))
    lines = done(run(noisy, "out.csv", "--reference", "clean.csv")).splitlines()
    assert [line.split()[0] for line in lines] == ["noise", "filter", "ends", "quality", "errors", "done"]
    assert done(run(noisy, noisy, "--quiet")) == ""


def test_simplify():
    gr.write_curves("square.svg", [CurveInFile(SQUARE, True, np.empty((100, 0)))])
    told = report("square.svg", "out.svg", "--simplify")
    [found] = gr.read_curves("out.svg").curves
    assert sorted(map(tuple, found.points.tolist())) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert told["vertices"] == {"before": 100, "after": 4} and told["hausdorff"] < 1e-12
    assert "left     12 of 100 vertices, 12 %" in done(
        run("square.svg", "out.svg", "--n-vertices", 12, "--filter", "positions")
    )


def test_several_curves_of_both_kinds(noisy):
    """Closed and open ones of a GeoJSON file, in degrees; altitudes stay with their vertices."""
    line = np.stack([np.linspace(0, 5, 60), np.linspace(50, 55, 60)], 1) + RNG.normal(0, 0.02, (60, 2))
    island = NOISY * 0.1 + [2, 52]
    curves = [CurveInFile(island, True, NONE), CurveInFile(line, False, np.arange(60.0)[:, None])]
    gr.write_curves("a.geojson", curves)
    told = report("a.geojson", "b.geojson")
    assert told["unit"] == "degrees of latitude" and told["curves"] == 2 and told["closed"] == 1
    shape, path = gr.read_curves("b.geojson").curves
    c = np.cos(np.radians(np.concatenate([island, line])[:, 1].mean()))
    expected = gr.denoise_curve(island * [c, 1], backend="numpy") / [c, 1]
    assert np.allclose(shape.points, expected, atol=1e-12)
    assert np.array_equal(path.more, curves[1].more)
    assert np.array_equal(path.points[[0, -1]], line[[0, -1]])
    done(run("a.geojson", "c.geojson", "--simplify", "--lam", 0.5))
    simple = gr.read_curves("c.geojson").curves[1]
    kept = simple.more[:, 0].astype(int)
    assert len(kept) < 60 and np.allclose(simple.points, line[kept])
    assert "unit" not in report("a.geojson", "b.geojson", "--no-degrees")
    gr.write_curves("far.csv", [CurveInFile(100 * NOISY, True, NONE)])
    failed(run("far.csv", "x.csv", "--degrees"), 2, "latitudes must lie in -90..90")


def test_skeleton(noisy):
    told = report(noisy, "out.csv", "--skeleton", "bones.csv")
    branches = gr.read_curves("bones.csv", closed=False).curves
    assert len(branches) == told["skeleton"]["branches"] >= 1
    [smooth] = gr.read_curves("out.csv").curves
    assert Path("bones.csv").read_text("utf-8").startswith("x,y,radius\n")
    bone = gr.skeleton(smooth.points)
    assert sum(len(b.points) for b in branches) == sum(map(len, bone.branches()))
    # every place lies as far from the polygon's vertices as its radius says
    places = np.concatenate([branch.points for branch in branches])
    nearest = np.linalg.norm(places[:, None] - smooth.points, axis=2).min(axis=1)
    assert np.allclose(nearest, np.concatenate([branch.more[:, 0] for branch in branches]))
    gr.write_curves("line.csv", [CurveInFile(NOISY[:50], False, NONE[:50])])
    failed(run("line.csv", "x.csv", "--open", "--skeleton", "y.csv"), 2, "needs a closed curve, and there is none")
    assert not {"x.csv", "y.csv"} & files()


def test_pictures(noisy):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    from PIL import Image

    assert "picture  both.png" in done(run(noisy, "out.csv", "--picture", "both.png"))
    assert "picture  bones.png" in done(run(noisy, "out.csv", "--skeleton", "b.svg", "--picture", "bones.png"))
    drawn = [np.asarray(Image.open(name).convert("L"), float) for name in ("both.png", "bones.png")]
    assert min(picture.std() for picture in drawn) > 10
    figure = gr.plot.curves([[SQUARE, CIRCLE], SQUARE], upright=False)
    assert len(figure.axes) == 2 and figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1]
    both = gr.plot.skeleton({"a": gr.skeleton(CIRCLE), "b": [gr.skeleton(SQUARE)]})
    assert [axes.get_title() for axes in both.axes] == ["a", "b"]


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: gr.plot.curves(SQUARE), TypeError),
        (lambda: gr.plot.curves([]), ValueError),
        (lambda: gr.plot.curves([np.zeros((4, 3))]), ValueError),
        (lambda: gr.plot.curves([SQUARE], closed=[True, False]), ValueError),
        (lambda: gr.plot.skeleton([SQUARE]), TypeError),
        (lambda: gr.plot.curves([SQUARE], path="a.doc"), ValueError),
    ],
)
def test_wrong_calls_draw_no_picture(call, error):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
    with pytest.raises(error):
        call()
    assert files() == set()


def test_the_report_says_which_curves_are_closed(noisy):
    assert report(noisy, "out.csv")["ends"] == [
        {"closed": True, "why": "near", "gap": pytest.approx(np.linalg.norm(NOISY[-1] - NOISY[0]))}
    ]
    track = np.stack([np.linspace(0, 5, 60), np.linspace(50, 55, 60)], 1)
    gr.write_curves("track.csv", [CurveInFile(track, False, NONE[:60])])
    told = report("track.csv", "out.csv")
    assert told["closed"] == 0 and told["ends"][0]["why"] == "apart" and "area" not in told
    assert np.array_equal(gr.read_curves("out.csv").curves[0].points[[0, -1]], track[[0, -1]])
    lines = done(run("track.csv", "out.csv", "--closed")).splitlines()
    assert lines[2] == "ends     closed as given; its ends are 7.07 apart"
    gr.write_curves("a.geojson", [CurveInFile(NOISY, True, NONE), CurveInFile(track, False, NONE[:60])])
    words = done(run("a.geojson", "b.geojson", "--no-degrees"))
    gap = np.linalg.norm(NOISY[-1] - NOISY[0])
    said = f"1 closed (as the file says, {gap:.3g} apart), 1 open (as the file says, 7.07 apart)"
    assert f"\nends     {said}\n" in words


def test_what_was_found_is_told():
    track = np.stack([np.linspace(0, 10, 200), np.sin(np.linspace(0, 10, 200))], 1) + RNG.normal(0, 0.03, (200, 2))
    track[60] += 3
    track[120:] += [40, 0]
    track = np.insert(track, 30, track[30], axis=0)
    gr.write_curves("track.csv", [CurveInFile(track, False, NONE[:1].repeat(201, 0))])
    told = report("track.csv", "out.csv")["found"]
    assert told == [{"outliers": [61], "gaps": [120], "repeats": 1, "opened": False}]
    words = "1 outlier(s), put between their neighbours; 1 gap(s), not smoothed across; 1 repeat(s), counted once"
    assert f"found    {words}" in done(run("track.csv", "out.csv"))
    # a line on one point
    features = [{"type": "LineString", "coordinates": c} for c in (SQUARE.tolist(), [[0, 0], [0, 0]])]
    Path("a.geojson").write_text(json.dumps({"type": "GeometryCollection", "geometries": features}), "utf-8")
    assert report("a.geojson", "b.geojson")["untreated"] == ["the document: its vertices coincide"]
    assert "vertices coincide: as they were" in done(run("a.geojson", "b.geojson"))
    assert "left out, since OUT has another format" in done(run("a.geojson", "b.svg"))


def test_simplify_by_heights_and_valid():
    zigzag = np.stack([np.arange(40.0), np.arange(40) % 2 + 2.0], 1)
    below = np.stack([np.arange(40.0), np.where(np.arange(40) % 2, 2.9, 0)], 1)
    gr.write_curves("two.svg", [CurveInFile(zigzag, False, NONE[:40]), CurveInFile(below, False, NONE[:40])])
    told = report("two.svg", "out.svg", "--tolerance", 0.03)
    assert (
        told["filter"] == "vertices removed up to a height of 0.03 of a curve's diagonal" and told["tolerance"] == 0.03
    )
    assert told["crossings"]["before"] == 0 < told["crossings"]["after"] and "p" not in told
    assert "new: --valid prevents them" in done(run("two.svg", "o.svg", "--tolerance", 0.03))
    held = report("two.svg", "out.svg", "--tolerance", 0.03, "--valid")
    assert held["crossings"] == {"before": 0, "after": 0, "new": 0, "between": True} and held["refused"] > 0
    told = report("two.svg", "out.svg", "--simplify", "--method", "process")
    assert (told["p"], len(told["lam"])) == (0.5, 2)


def test_many_files(noisy):
    """A folder of tracks; a broken one is named, and the others are done."""
    line = np.stack([np.linspace(0, 0.1, 60), np.linspace(50, 50.1, 60)], 1) + RNG.normal(0, 0.0002, (60, 2))
    for name in ("a.gpx", "b.gpx"):
        gr.write_curves(name, [CurveInFile(line, False, NONE[:60])])
    Path("c.gpx").write_text("<gpx", "utf-8")
    result = run("*.gpx", noisy, "out", "--json")
    assert result.exit_code == 1 and "1 of 4 files failed:\n  c.gpx: damaged" in result.stderr
    told = json.loads(result.stdout)
    assert [file["output"] for file in told["files"]] == [str(Path("out") / n) for n in ("a.gpx", "b.gpx", "noisy.csv")]
    assert {path.name for path in Path("out").iterdir()} == {"a.gpx", "b.gpx", "noisy.csv"}
    assert np.array_equal(gr.read_curves("out/a.gpx").curves[0].points[0], line[0])
    words = done(run("a.gpx", "b.gpx", "out", "--reference", "."))
    assert words.startswith("done     2 of 2 files in ") and words.endswith("-> out\n")
    failed(run("a.gpx", "b.gpx", "new", "--picture", "x.png"), 2, "--picture is one file: it needs a single IN")
    failed(run("a.gpx", "b.gpx", "new.gpx"), 2, "new.gpx is named like a file")
    failed(call("curve", "a.gpx"), 2, "Missing OUT: where to write a.gpx?")
    assert not Path("new").exists()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--tolerance", "0.1", "--p", "0.5"], 2, "p is for method='process'"),
        (["--method", "process"], 2, "give --simplify too"),
        (["--simplify", "--sigma", "1"], 2, "--sigma is for denoising"),
        (["--simplify", "--no-keep-ends"], 2, "--no-keep-ends is for denoising"),
        (["--filter", "positions"], 2, "give --simplify too"),
        (["--simplify", "--lam", "0"], 2, "lam must be > 0"),
        (["--n-vertices", "2"], 2, "n_vertices must be at least 3"),
        (["--skeleton", "out.csv"], 2, "would both be written to out.csv"),
        (["--skeleton", "bones.png"], 1, "the extension of curves must be one of"),
        (["--picture", "a.doc"], 2, "extension must be one of"),
        (["--reference", "nope.csv"], 1, "nope.csv: no such file"),
        (["--p", "0"], 2, "p must be finite and > 0"),
        (["--backend", "abacus"], 2, "abacus"),
    ],
)
def test_wrong_options(noisy, options, code, words):
    before = files()
    failed(call("curve", noisy, "out.csv", *options), code, words)
    assert files() == before


def test_wrong_files(noisy):
    failed(run("nope.csv", "out.csv"), 1, "nope.csv: no such file")
    failed(run(noisy, "out.dxf"), 1, "the extension of curves must be one of")
    gr.write_curves("clean.csv", [CurveInFile(CIRCLE, True, NONE)])
    failed(run(noisy, "clean.csv", "--reference", "clean.csv"), 2, "would overwrite clean.csv, which is read")
    gr.write_curves("two.csv", [CurveInFile(CIRCLE, True, NONE), CurveInFile(SQUARE, True, NONE[:100])])
    failed(run(noisy, "out.csv", "--reference", "two.csv"), 2, "--reference has 2 curves, IN has 1")
    failed(run(noisy, "out.csv", "--skeleton", noisy), 2, "would overwrite noisy.csv, which is read")
    assert files() == {"noisy.csv", "clean.csv", "two.csv"}
