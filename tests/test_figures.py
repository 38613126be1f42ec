"""Figures 1 and 2 of the paper: what they show holds on a small picture, and they are written."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'bench', is not installed")
pytest.importorskip("skimage", reason="scikit-image, of the extra 'bench', is not installed")

from PIL import Image

from bench.figures import __main__ as command
from bench.figures import figure_4, levelling, solvers

SIDE = 64


@pytest.fixture(scope="module")
def runs():
    return levelling.runs(SIDE, "auto", degrees=(2.0, 0.7, 0.01))


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
    f0 = levelling.camera(SIDE)
    for run in runs:
        assert f0.min() - 0.01 <= run.value.min() <= run.value.max() <= f0.max() + 0.01


def test_counts_of_a_known_picture():
    picture = np.zeros((10, 10))
    picture[:, 5:] = 100.4
    picture[0, 0] = picture[9, 9] = 7
    assert levelling.count(picture) == levelling.Counts(levels=3, main_levels=2, flat_zones=4)


def test_the_command_writes_pictures_and_numbers(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(levelling.SIDES, True, 32)
    runs = levelling.runs
    monkeypatch.setattr("bench.figures.figure_1.runs", lambda side, backend: runs(side, backend, 20))
    monkeypatch.setattr("bench.figures.figure_2.runs", lambda side, backend: runs(side, backend, 20))
    monkeypatch.setattr("bench.figures.figure_1.MOST", 20)
    monkeypatch.setitem(figure_4.SIDES, True, 32)
    for name, value in (("SIDES", 24), ("MOST", 40), ("LIMIT", 10)):
        monkeypatch.setitem(getattr(solvers, name), True, value)
    assert command.main([str(tmp_path / "new"), "--quick", "--backend", "numpy"]) == 0
    written = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert written == [
        f"{name}.{kind}"
        for name in (*(f"figure_{k}" for k in (1, 2, 4, 5, 6, 7, 8, 9)), "solvers")
        for kind in ("json", "png")
    ]
    assert capsys.readouterr().out.split() == [str(tmp_path / "new" / name) for name in written[1::2]]
    for name, degrees in (("figure_1", 6), ("figure_2", 4)):
        with Image.open(tmp_path / "new" / f"{name}.png") as opened:
            assert np.asarray(opened.convert("L"), float).std() > 20
        numbers = json.loads((tmp_path / "new" / f"{name}.json").read_text("utf-8"))
        assert len(numbers["runs"]) == 3 * degrees
        for run in numbers["runs"]:
            assert 1 <= run["main_levels"] <= run["levels"] <= run["flat_zones"] <= 32 * 32
            assert run["seconds"] > 0 and run["iterations"] == 20
    chain = json.loads((tmp_path / "new" / "figure_4.json").read_text("utf-8"))
    assert chain["iterations"] == 30 and 0 < chain["percent"] <= 10
    assert chain["psnr of the fine partition"] > chain["psnr of the regularized one"] > 15
    smoothed = json.loads((tmp_path / "new" / "figure_6.json").read_text("utf-8"))
    free, fitted = smoothed["lam = 0"], smoothed["with the fit term"]
    # the paper's words of figures 5 and 6: without the fit term the mesh shrinks
    assert free["share of the volume"] < 0.85 < fitted["share of the volume"] < 1.01  # measured 0.78 and 0.90
    assert free["vertex error in edges"] > 1.5 * fitted["vertex error in edges"]  # measured 0.47 and 0.22
    assert fitted["normal angle error"] < 0.3 * smoothed["noisy"]["normal angle error"]  # measured 0.2
    shrunk = json.loads((tmp_path / "new" / "figure_5.json").read_text("utf-8"))
    without, fitted = shrunk["λ = 0, 30 iterations"], shrunk["λ = 0.5, 100"]
    assert without["share of the area"] < fitted["share of the area"] - 0.05  # measured 0.81 and 0.92
    coast = json.loads((tmp_path / "new" / "figure_7.json").read_text("utf-8"))
    kept = coast["p = 0.5, directions"]
    assert kept["share of the vertices"] < 0.5 and abs(kept["share of the area"] - 1) < 0.02
    assert coast["Douglas and Peucker"]["vertices"] <= kept["vertices"]
    surface = json.loads((tmp_path / "new" / "figure_8.json").read_text("utf-8"))
    fewer = surface["to convergence"]
    assert fewer["vertices"] < 0.2 * surface["initial"]["vertices"] and fewer["closed"]
    assert abs(fewer["share of the volume"] - 1) < 0.02
    assert surface["193 vertices asked for"]["vertices"] == 193
    bones = json.loads((tmp_path / "new" / "figure_9.json").read_text("utf-8"))
    assert 0 < bones["after"]["branches"] < bones["before"]["branches"]
    courses = json.loads((tmp_path / "new" / "solvers.json").read_text("utf-8"))
    assert list(courses) == ["p = 1", "p = 1.5", "p = 2", "p = 3"]
    for panel in courses.values():
        assert len(panel["courses"]) == 5
        for name, seen in panel["courses"].items():
            assert np.all(np.diff(seen["seconds"]) > 0)
            if "certified" in name:
                # no energy that any solver found is below what the certificate says
                bounds = np.array(seen["energy"]) - np.array(seen["gap"], float)
                assert bounds.max() <= panel["least"] * (1 + 1e-12)
