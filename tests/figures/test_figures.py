"""The figures of the paper: what they say holds of what they show, and they are written, or nothing is."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")
pytest.importorskip("skimage", reason="scikit-image, of the extra 'plot', is not installed")

from click.testing import CliRunner
from PIL import Image

import gpureg as gr
from bench import courses
from gpureg.cli import main
from gpureg.figures import FIGURES, Inputs, fig1, fig3, fig4, fig5, levelling, made

SIDE = 64
RNG = np.random.default_rng(1)


@pytest.fixture(scope="module")
def runs():
    return levelling.smoothed(Inputs().grey(SIDE).pixels, "auto", degrees=(2.0, 0.7, 0.01))


@pytest.mark.parametrize("graph", levelling.GRAPHS)
def test_the_picture_is_levelled_as_p_falls(runs, graph):
    """At lam = 0 and 800 iterations: fewer flat zones with every p, and at last fewer levels."""
    counts = [run.counts for run in runs if run.graph == graph]
    zones = [c.flat_zones for c in counts]
    assert zones == sorted(zones, reverse=True)
    assert zones[-1] < 0.6 * zones[0]  # measured: 0.05, 0.34, 0.52
    assert counts[-1].main_levels < 0.6 * counts[0].main_levels  # measured: 0.20, 0.06, 0.34
    assert counts[-1].levels < counts[0].levels


def test_the_runs_are_the_papers(runs):
    assert {run.result.iterations for run in runs} == {800}
    assert [run.graph for run in runs[::3]] == ["G_0", "G_8, w_1", "G_8, w_2^5"]
    # No p moves values beyond those of the data (maximum principle: each sweep takes means), but by rounding.
    f0 = Inputs().grey(SIDE).pixels
    values = np.stack([run.value for run in runs])
    assert f0.min() - 0.01 <= values.min() <= values.max() <= f0.max() + 0.01


def test_counts_of_a_known_picture():
    picture = np.zeros((10, 10))
    picture[:, 5:] = 100.4
    picture[0, 0] = picture[9, 9] = 7
    assert levelling.count(picture) == levelling.Counts(levels=3, main_levels=2, flat_zones=4)


def test_contrast_kept():
    step = np.zeros((10, 10))
    step[:, 5:] = 100
    assert fig1.contrast_kept(step, step) == 1
    assert fig1.contrast_kept(0.25 * step, step) == 0.25
    assert fig1.contrast_kept(-step, step) == -1


def test_made_shapes():
    """Closed surfaces, and of the volume that they are built of."""
    animal, bracket = made.animal(10), made.bracket(4)
    assert gr.metrics.is_watertight(animal) and gr.metrics.is_watertight(bracket)
    assert gr.metrics.volume(animal) > 2
    # a block of 4 x 3 x 2 cells of 4, less what stands free, 3 x 2 x 2, and less the hole, 1 x 1 x 1
    assert gr.metrics.volume(bracket) == pytest.approx(4**3 * (24 - 12 - 1))
    # the hole goes through: a torus' Euler characteristic
    assert len(bracket[0]) - len(bracket[1]) // 2 == 0
    coast = made.coast(300)
    assert coast.shape == (300, 2) and np.linalg.norm(coast, axis=1).min() > 0.5


def made_by(folder, *options) -> str:
    """What the command says that writes figures into a folder."""
    done = CliRunner().invoke(main, ["figures", str(folder), *options], standalone_mode=False)
    assert done.exception is None, done.exception
    return done.output


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """All figures, as small as they can be, by the command: the folder and what it said."""
    folder = tmp_path_factory.mktemp("figures") / "new"
    with pytest.MonkeyPatch.context() as patch:
        smoothed = levelling.smoothed
        patch.setattr(levelling, "smoothed", lambda picture, backend: smoothed(picture, backend, 20))
        patch.setattr(fig1, "MOST", 20)
        for module, side in ((levelling, 32), (fig4, 32)):
            patch.setitem(module.SIDES, True, side)
        levelling.runs.cache_clear()
        said = made_by(folder, "--quick")
        levelling.runs.cache_clear()
    return folder, said


def test_the_command_writes_all(quick):
    folder, _ = quick
    assert sorted(path.name for path in folder.iterdir()) == [
        f"fig{k}.{kind}" for k in FIGURES for kind in ("json", "png")
    ]


@pytest.mark.parametrize("k", FIGURES)
def test_a_figure_is_a_picture_numbers_and_words(quick, k):
    folder, said = quick
    numbers = numbers_of(quick, k)
    assert numbers["title"].startswith(f"Figure {k}. ") and numbers["title"] in said
    assert str(folder / f"fig{k}.png") in said
    # the sentence is in what is said, broken into lines
    assert numbers["see"] in said.replace("\n", " ") and numbers["settings"]
    with Image.open(folder / f"fig{k}.png") as opened:
        assert np.asarray(opened.convert("L"), float).std() > 10


def numbers_of(quick, k):
    return json.loads((quick[0] / f"fig{k}.json").read_text("utf-8"))


@pytest.mark.parametrize(("k", "degrees"), [(1, 6), (2, 4)])
def test_figures_1_and_2(quick, k, degrees):
    runs = numbers_of(quick, k)["runs"]
    assert len(runs) == 3 * degrees
    counts = [(1, run["main_levels"], run["levels"], run["flat_zones"], 32 * 32) for run in runs]
    assert [tuple(sorted(found)) for found in counts] == counts
    assert min(run["seconds"] for run in runs) > 0
    assert {run["iterations"] for run in runs} == {20}


def test_weights_keep_the_contrast(quick):
    plain, weighted = numbers_of(quick, 1)["until convergence"]
    assert weighted["contrast kept"] > plain["contrast kept"] + 0.2  # measured 0.9 and 0.5


def test_figure_3(quick):
    found = numbers_of(quick, 3)
    assert (found["lam"], found["iterations"]) == (0.01, 4)
    two, local, nonlocal_ = (way["psnr"] for way in found["ways"])
    assert found["psnr of the noisy picture"] + 3 < max(two, local) < nonlocal_


def test_figure_4(quick):
    chain = numbers_of(quick, 4)
    assert chain["iterations"] == 30 and 0 < chain["percent"] <= 10
    assert chain["psnr of the fine partition"] > chain["psnr of the regularized one"] > 15
    assert chain["regions of the regularized one"] < chain["regions"]


def test_figures_5_and_6(quick):
    """The paper's words: without the fit term what is smoothed shrinks."""
    shrunk = numbers_of(quick, 5)
    free, fitted = shrunk["lam = 0, 30 iterations"], shrunk["lam = 4, 100 iterations"]
    assert free["share of the length"] < 0.5 < 0.85 < fitted["share of the length"]  # measured 0.43 and 0.90
    assert fitted["mean error in segments"] < shrunk["noisy"]["mean error in segments"] < free["mean error in segments"]
    smoothed = numbers_of(quick, 6)
    free, fitted = smoothed["lam = 0"], smoothed["with the fit term"]
    assert free["share of the volume"] < 0.95 < fitted["share of the volume"] < 1  # measured 0.938 and 0.971
    assert free["vertex error in edges"] > 1.5 * fitted["vertex error in edges"]  # measured 0.353 and 0.192


def test_figures_7_to_9(quick):
    coast = numbers_of(quick, 7)
    one, tenth = coast["p = 1"], coast["p = 0.1"]
    # vertices aggregate for p < 1, and the area stays
    assert tenth["share of the vertices"] < 0.5 < one["share of the vertices"]
    assert abs(tenth["share of the area"] - 1) < 0.02 < abs(one["share of the area"] - 1)
    assert coast["Douglas and Peucker"]["vertices"] <= coast["p = 0.5, directions"]["vertices"]
    surface = numbers_of(quick, 8)
    assert surface["w = 1"]["vertices"] < 0.2 * surface["initial"]["vertices"] and surface["w = 1"]["closed"]
    normals = surface["w by the normals"]
    assert (
        normals["closed"]
        and normals["Hausdorff distance in edges"] < 0.5 < 1 < surface["w = 1"]["Hausdorff distance in edges"]
    )
    bones = numbers_of(quick, 9)
    assert 0 < bones["simplified"]["branches"] < bones["its skeleton"]["branches"]


def test_ones_own_files(tmp_path, monkeypatch):
    """A picture of 16 bits in grey, a mesh and a curve take the place of what is there, as they are."""
    for module, side in ((levelling, 24), (fig3, 24), (fig4, 24)):
        monkeypatch.setitem(module.SIDES, True, side)
    smoothed = levelling.smoothed
    monkeypatch.setattr(levelling, "smoothed", lambda picture, backend: smoothed(picture, backend, 5))
    monkeypatch.setattr(fig1, "MOST", 5)
    picture = (RNG.random((34, 40)) * 65535).astype(np.uint16)
    Image.fromarray(picture).save(tmp_path / "own.png")
    gr.write_mesh(tmp_path / "own.ply", made.bracket(3))
    gr.write_curves(tmp_path / "own.csv", [gr.CurveInFile(made.coast(80), True, np.empty((80, 0)))])
    files = [f"--{kind}={tmp_path}/own.{end}" for kind, end in (("image", "png"), ("mesh", "ply"), ("curve", "csv"))]
    assert made_by(tmp_path / "out", "--quick", "--no-noise", "--quiet", *files) == ""
    shown = dict(enumerate("png png png png csv ply csv ply csv".split(), start=1))
    texts = {k: (tmp_path / "out" / f"fig{k}.json").read_text("utf-8") for k in shown}
    assert [k for k, end in shown.items() if f"own.{end}" not in texts[k]] == []
    assert "psnr of the noisy picture" not in json.loads((tmp_path / "out" / "fig3.json").read_text("utf-8"))
    five = json.loads((tmp_path / "out" / "fig5.json").read_text("utf-8"))
    assert "original" not in five and five["noisy"]["share of the area"] == 1


def test_a_sheet_and_an_eight(tmp_path):
    """A mesh without a volume and a curve without an area: no division by nothing, the rest is told."""
    plate = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    flat = np.array(plate.faces)[np.array(plate.triangles_center)[:, 2] > 0.49]
    gr.write_mesh(tmp_path / "sheet.ply", (np.array(plate.vertices), flat))
    t = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    eight = np.stack([np.sin(t), np.round(np.sin(2 * t), 12)], axis=1)
    gr.write_curves(tmp_path / "eight.csv", [gr.CurveInFile(eight, True, np.empty((80, 0)))])
    files = [f"--mesh={tmp_path}/sheet.ply", f"--curve={tmp_path}/eight.csv"]
    made_by(tmp_path / "out", "--quick", "--only=6", "--only=7", "--only=8", *files)
    assert sorted(path.suffix for path in (tmp_path / "out").iterdir()) == [".json"] * 3 + [".png"] * 3

    def refuse(word):
        raise ValueError(f"{word} is no JSON")

    for path in (tmp_path / "out").glob("*.json"):
        json.loads(path.read_text("utf-8"), parse_constant=refuse)


def test_an_stl_is_the_mesh_that_it_is(tmp_path):
    """Its corners are one vertex: as separate triangles they shrank to nothing."""
    ball = trimesh.creation.icosphere(3)
    numbers = []
    for name in ("ball.ply", "ball.stl"):
        gr.write_mesh(tmp_path / name, (np.array(ball.vertices), np.array(ball.faces)))
        made_by(tmp_path / "out", "--only=6", "--only=8", f"--mesh={tmp_path}/{name}")
        numbers.append([json.loads((tmp_path / "out" / f"fig{k}.json").read_text("utf-8")) for k in (6, 8)])
    of_ply, of_stl = ([found.get("vertices") for found in figures] for figures in numbers)
    assert of_stl == of_ply
    # vertices come in another order, so that their noise is another
    shares = [found["lam = 0"]["share of the volume"] for found, _ in numbers]
    assert shares[0] == pytest.approx(shares[1], abs=0.05)
    assert numbers[0][1]["initial"]["vertices"] == numbers[1][1]["initial"]["vertices"] == 642


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "10"], "10 is not in the range"),
        (["--only", "3", "--image", "none.png"], "none.png"),
        (["--only", "3", "--image", "series.tif"], "the figures need a picture"),
        (["--only", "3", "--image", "nan.tif"], "not all of its values are finite"),
        (["--only", "1", "--image", "tiny.png"], "32 x 32 pixels and more"),
        (["--only", "3", "--image", "grey.png"], "all pixels have the value"),
        (["--only", "6", "--mesh", "broken.ply"], "broken.ply"),
        (["--only", "5", "--curve", "open.svg"], "a closed curve in the plane"),
        (["--only", "6", "--backend", "cuda"], "cuda"),
    ],
)
def test_wrong_calls_leave_no_figure(tmp_path, arguments, words):
    import tifffile

    tifffile.imwrite(
        tmp_path / "series.tif", np.zeros((3, 20, 20), np.uint8), photometric="minisblack", metadata={"axes": "TYX"}
    )
    tifffile.imwrite(tmp_path / "nan.tif", np.full((20, 20), np.nan, np.float32))
    Image.fromarray(np.full((1, 1), 9, np.uint8)).save(tmp_path / "tiny.png")
    Image.fromarray(np.full((40, 40), 9, np.uint8)).save(tmp_path / "grey.png")
    (tmp_path / "broken.ply").write_text("no mesh", "utf-8")
    angle = np.linspace(0, np.pi, 20)
    half = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    gr.write_curves(tmp_path / "open.svg", [gr.CurveInFile(half, False, np.empty((20, 0)))])
    named = [str(tmp_path / word) if "." in word else word for word in arguments]
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["figures", str(out), "--quick", *named])
    assert done.exit_code in (1, 2)
    assert words in done.output
    assert not out.exists() or list(out.iterdir()) == []


def test_a_folder_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("mine", "utf-8")
    done = CliRunner().invoke(main, ["figures", str(tmp_path / "file"), "--quick"])
    assert done.exit_code == 1 and "the folder cannot be created" in done.output
    assert (tmp_path / "file").read_text("utf-8") == "mine"


def test_an_interrupted_run_says_what_is_there(tmp_path, monkeypatch):
    def interrupt(inputs):
        raise KeyboardInterrupt

    monkeypatch.setitem(FIGURES, 9, interrupt)
    done = CliRunner().invoke(main, ["figures", str(tmp_path), "--quick", "--only", "5", "--only", "9"])
    assert done.exit_code == 130 and "interrupted; written: fig5.png" in done.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig5.json", "fig5.png"]


def test_a_figure_that_fails_leaves_the_old_one(tmp_path, monkeypatch):
    (tmp_path / "fig5.png").write_bytes(b"old")
    monkeypatch.setattr(fig5, "FREE", -1)
    done = CliRunner().invoke(main, ["figures", str(tmp_path), "--quick", "--only", "5"])
    assert done.exit_code != 0
    assert [path.name for path in tmp_path.iterdir()] == ["fig5.png"]
    assert (tmp_path / "fig5.png").read_bytes() == b"old"


def test_the_courses_of_the_solvers(tmp_path, monkeypatch, capsys):
    for name, value in (("SIDES", 24), ("MOST", 40), ("LIMIT", 10)):
        monkeypatch.setitem(getattr(courses, name), True, value)
    assert courses.main([str(tmp_path / "new"), "--quick", "--backend", "numpy"]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "new" / "solvers.png")]
    panels = json.loads((tmp_path / "new" / "solvers.json").read_text("utf-8"))
    assert list(panels) == ["p = 1", "p = 1.5", "p = 2", "p = 3"]
    assert {title: len(panel["courses"]) for title, panel in panels.items()} == dict.fromkeys(panels, 5)
    found = [(panel["least"], name, seen) for panel in panels.values() for name, seen in panel["courses"].items()]
    assert [name for _, name, seen in found if not np.all(np.diff(seen["seconds"]) > 0)] == []
    # no energy that any solver found is below what the certificate says
    bounds = [
        (least, np.max(np.array(seen["energy"]) - np.array(seen["gap"], float)))
        for least, name, seen in found
        if "certified" in name
    ]
    assert [(least, bound) for least, bound in bounds if not bound <= least * (1 + 1e-12)] == []
