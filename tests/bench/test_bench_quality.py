"""``python -m bench.quality`` at tiny size: its tables, its memory, its figure, and the peers it tunes."""

from __future__ import annotations

import json
import sys
import types

import numpy as np
import pytest

from bench.quality import cost, methods, real, scenes, synthetic, tuned
from bench.quality.run import main
from gpureg.files import pictures


def test_psnr():
    """A constant difference of d: 20 log10(255/d)."""
    clean = np.zeros((3, 4))
    assert scenes.psnr(clean + 25.5, clean) == pytest.approx(20)


def test_the_search_finds_the_top_and_looks_once_at_a_place():
    seen = []

    def hill(at):
        seen.append((at["x"], at["y"]))
        return -((at["x"] - 8) ** 2) - (at["y"] - 1) ** 2 + at["x"] * at["y"] / 10

    grid = {"x": range(10), "y": range(7)}
    best = tuned.climb(grid, hill)
    assert best == max(({"x": x, "y": y} for x in grid["x"] for y in grid["y"]), key=hill)
    looked = seen[: -len(grid["x"]) * len(grid["y"])]
    assert len(set(looked)) == len(looked) < 40


@pytest.mark.parametrize("who", tuned.FILTERS)
@pytest.mark.parametrize("shape", [(24, 20), (24, 20, 3)], ids=["grey", "colour"])
def test_a_filter_is_tuned(who, shape, monkeypatch):
    """Every filter takes grey and colour, and gains 3 dB at a step with noise of 20 (measured: 4.7 to 18)."""
    if not tuned.installed(who):
        pytest.skip(f"{who} needs scikit-image, a wavelet PyWavelets too")
    apply, grid = tuned.FILTERS[who]
    small = {name: [values[len(values) // 2]] for name, values in grid.items()}
    small[next(reversed(grid))] = list(grid[next(reversed(grid))])[::6]
    monkeypatch.setitem(tuned.FILTERS, who, (apply, small))
    clean = np.full(shape, 60.0)
    clean[:, 9:] = 180
    noisy = scenes.noisy_of(clean, 20)
    settings = tuned.tuned(who, clean, noisy, 20)
    assert scenes.psnr(tuned.apply(who, noisy, 20, settings), clean) > scenes.psnr(noisy, clean) + 3
    assert settings.keys() == grid.keys()


@pytest.fixture
def house(monkeypatch, tmp_path):
    """One small picture, a BM3D that adds 10 to it, and of ours only the default at work."""
    clean = np.kron(np.array([[60, 180], [200, 90]], np.uint8), np.ones((12, 12), np.uint8))
    (tmp_path / "images").mkdir()
    pictures.write_picture(tmp_path / "images" / "house.png", pictures.Picture(clean))
    monkeypatch.setenv("GPUREG_DATA", str(tmp_path))
    for name in [name for name in scenes.SCENES if name != "house"]:
        monkeypatch.delitem(scenes.SCENES, name)
    monkeypatch.setitem(scenes.SCENES, "house", scenes.Scene("grey", "house.png"))
    calls = []

    def bm3d(values, sigma):
        calls.append(sigma)
        return clean + 10.0

    monkeypatch.setitem(sys.modules, "bm3d", types.SimpleNamespace(bm3d=bm3d))
    for who in methods.OURS:
        if who != methods.DEFAULT:
            monkeypatch.setitem(methods.OURS, who, lambda noisy: noisy.values)
    return types.SimpleNamespace(folder=tmp_path, calls=calls)


def ask(house, *arguments):
    """Run the command on the small picture, with its files; the report."""
    files = ["--json", str(house.folder / "out.json"), "--peers", str(house.folder / "peers.json")]
    assert main(["--only", "house", "--sigma", "20", "--seeds", "2", "--filters", "BM", *files, *arguments]) == 0
    return json.loads((house.folder / "out.json").read_text())


def test_the_table(house, capsys):
    """Filters that are known stay, wavelets do not count, and the differences are ours less theirs, of both draws."""
    saved = {"tv_chambolle": 20.0, "bilateral": 19.0, "wavelet": 99.0}
    known = {who: {seed: {"psnr": x, "seconds": 1.0, "run": "1"} for seed in "01"} for who, x in saved.items()}
    (house.folder / "peers.json").write_text(json.dumps({"house 20": known}))
    (row,) = ask(house)["rows"]
    clean = scenes.picture("house")
    noisy = [scenes.psnr(scenes.noisy_of(clean, 20, seed), clean) for seed in (0, 1)]
    assert [row["methods"]["noisy"][seed]["psnr"] for seed in "01"] == pytest.approx(noisy)
    ours = np.mean([row["methods"]["ours"][seed]["psnr"] for seed in "01"])
    bm3d = 20 * np.log10(25.5)
    assert house.calls == [20, 20]
    said = capsys.readouterr().out
    gains = [ours - bm3d, ours - np.mean(noisy), ours - 20]
    assert "| 20.00 tv_chambolle | " + " | ".join([f"{bm3d:.2f}", *[f"{np.mean(noisy):.2f}"] * 5]) in said
    assert " | ".join([f"{ours:.2f}", *(f"{x:+.2f}" for x in gains)]) in said
    assert " | ".join(f"{x:+.2f}, {x:+.2f} house 20" for x in gains) in said
    assert "| 1* |" in said


def test_peers_that_are_known_are_not_called_again(house):
    ask(house)
    first = json.loads((house.folder / "peers.json").read_text())
    ask(house)
    assert len(house.calls) == 2
    assert json.loads((house.folder / "peers.json").read_text()) == first
    first["house 20"]["BM3D"]["0"]["run"] = "an earlier one"
    (house.folder / "peers.json").write_text(json.dumps(first))
    ask(house, "--time-again")
    assert len(house.calls) == 3


def test_a_report_shown_again(house, capsys):
    """The same text, and a figure of all methods."""
    pytest.importorskip("matplotlib")
    found = ask(house)
    text = capsys.readouterr().out
    picture = house.folder / "cost.png"
    assert main(["--from", str(house.folder / "out.json"), "--plot", str(picture)]) == 0
    assert capsys.readouterr().out == text
    assert picture.read_bytes().startswith(b"\x89PNG")
    (panel,) = cost.panels(found["rows"], found["machine"]["date"])
    assert {point.who for point in panel.points} == {"BM3D", *methods.OURS}
    assert [point.seconds for point in panel.points] == sorted(point.seconds for point in panel.points)
    # those that return the noisy picture are one mark; the true sigma is nobody's choice
    marks = [set(point.who.split(" = ")) for point in cost._drawn(panel.points)]
    assert sorted(map(len, marks)) == [1, 1, 4] and {"passes=1", "fast", "balanced", "best"} in marks


def test_missing_pictures_and_names(house, monkeypatch, capsys):
    monkeypatch.setitem(scenes.SCENES, "lost", scenes.Scene("grey", "lost.png"))
    with pytest.raises(FileNotFoundError, match=r"no picture lost\.png: set GPUREG_DATA"):
        scenes.picture("lost")
    with pytest.raises(SystemExit):
        main(["--only", "nothing"])
    assert "no image has 'nothing' in its name or group; there are house, lost, real" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([])
    assert "there is no picture lost: set GPUREG_DATA" in capsys.readouterr().err


@pytest.mark.parametrize("make", [synthetic.head, synthetic.filaments])
def test_volumes_follow_from_their_seeds(make):
    volume = make((12, 20, 24))
    assert volume.shape == (12, 20, 24)
    assert 0 <= volume.min() < 20 < 100 < volume.max() <= 255
    assert np.array_equal(volume, make((12, 20, 24)))


def test_a_series_moves():
    """The picture moves by 0.4 rows and 0.7 columns a frame: a ramp falls by as much outside the disk."""
    y, x = np.indices((40, 44)).astype(float)
    frames = synthetic.series(100 + y, 100 + x, frames=3, size=16)
    assert frames.shape == (3, 16, 16)
    assert np.diff(frames[:, 0, 0]) == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize("light", [4.0, 40.0])
def test_the_transform_of_photons_and_back(light):
    """Noise of 1, and a mean that comes back: 4 standard errors of 40,000 draws are 0.02.

    The closed form is 0.1 percent off at 4 photons.
    """
    roots = real.anscombe(real.photons(np.full(40_000, light), 1))
    assert roots.std() == pytest.approx(1, rel=0.05)
    truth = real.OFFSET + real.GAIN * light
    by_root = np.sqrt(light)  # a root off by 1 is a light off by this
    back = real.unbiased_inverse(np.full(1, roots.mean()))[0]
    assert back == pytest.approx(truth, abs=real.GAIN * (0.02 * by_root + 0.01 * light))


def test_a_jpeg_of_an_even_picture_is_the_picture():
    assert np.array_equal(real.jpeg(np.full((16, 16), 99.7)), np.full((16, 16), 100.0))
