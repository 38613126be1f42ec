"""Figures of quality that the project promises, on pictures of the test data, and the table of bench/quality.py."""

from __future__ import annotations

import json

import numpy as np
import pytest

import gpureg as gr
from bench import quality
from gpureg.files import pictures


@pytest.fixture
def camera(data_folder):
    """The camera picture and its noisy copy at sigma 20."""
    clean = quality.picture("camera")
    return clean, quality.noisy_of(clean, 20)


def test_local_total_variation(camera):
    """Digital TV at the lam that suits this picture and noise; measured: 29.868 dB, 4e-5 dB from convergence."""
    clean, noisy = camera
    grid = gr.GridGraph(clean.shape, 1, "cityblock")
    result = gr.regularize(noisy / 255, grid, p=1, lam=28, max_iter=400)
    assert quality.psnr(255 * result.value, clean) >= 29.8


def test_one_step_nonlocal_means(camera):
    """h of 0.6 sigma per sample and a centre as heavy as its heaviest neighbour; measured: 30.05 dB."""
    clean, noisy = camera
    denoised = gr.denoise_nl_means(noisy, patch_radius=2, radius=10, h=0.6 * 20 * 5, sigma=20, centre="largest")
    assert quality.psnr(denoised, clean) >= 30.0


def test_total_variation_on_the_nearest_patches(camera):
    """p = 1 in 4 iterations on the graph of the 20 nearest patches; measured: 29.99 dB."""
    clean, noisy = camera
    f0, s = noisy / 255, 20 / 255
    graph = gr.patch_graph(f0, 20, patch_radius=3, radius=10)
    weights = gr.weights.patch(3, 7 * s, sigma=s)
    result = gr.regularize(f0.ravel(), graph, p=1, lam=40, weights=weights, max_iter=4)
    assert quality.psnr(255 * result.value.reshape(f0.shape), clean) >= 29.9
    # the door chooses the like from the noise alone
    assert quality.psnr(gr.denoise_image(noisy, p=1, k=20), clean) >= 29.8


def test_averaged_patches_gain(camera):
    """As many parameters as before: patches of 5 x 5, h of 0.5 sigma; measured: 29.78 plain, 30.36 averaged."""
    clean, noisy = camera
    settings = {"patch_radius": 2, "radius": 7, "h": 0.5 * 20 * 5, "sigma": 20, "centre": "largest"}
    plain = gr.denoise_nl_means(noisy, **settings)
    averaged = gr.denoise_nl_means(noisy, average_patches=True, **settings)
    assert quality.psnr(averaged, clean) > quality.psnr(plain, clean) + 0.4
    assert quality.psnr(averaged, clean) >= 30.3


# The best that scikit-image's nonlocal means (fast and slow), total variation and bilateral filters reach when they are
# told sigma and tuned by the true PSNR (bench/quality.py): the rows where our margin is least, and most.
@pytest.mark.parametrize(
    ("name", "sigma", "best"),
    [("camera", 20, 30.10), ("brick", 10, 38.90), ("coins", 10, 32.77), ("kodim08", 10, 32.93), ("house", 40, 28.83)],
)
def test_no_parameters_beat_tuned_filters(data_folder, name, sigma, best):
    """Never more than 0.1 dB below them; measured margins: 0.36, -0.09, 0.11, 0.15, 1.29."""
    clean = quality.picture(name)
    noisy = quality.noisy_of(clean, sigma)
    denoised = gr.denoise_image(noisy, channel_axis=None if clean.ndim == 2 else -1)
    assert quality.psnr(denoised, clean) >= best - 0.1


def test_psnr():
    """A constant difference of d: 20 log10(255/d)."""
    clean = np.zeros((3, 4))
    assert quality.psnr(clean + 25.5, clean) == pytest.approx(20)


def test_the_search_finds_the_top_and_looks_once_at_a_place():
    seen = []

    def hill(at):
        seen.append((at["x"], at["y"]))
        return -((at["x"] - 8) ** 2) - (at["y"] - 1) ** 2 + at["x"] * at["y"] / 10

    grid = {"x": range(10), "y": range(7)}
    best = quality.climb(grid, hill)
    assert best == max(({"x": x, "y": y} for x in grid["x"] for y in grid["y"]), key=hill)
    looked = seen[: -len(grid["x"]) * len(grid["y"])]
    assert len(set(looked)) == len(looked) < 40


@pytest.mark.parametrize("who", quality.PEERS)
@pytest.mark.parametrize("shape", [(24, 20), (24, 20, 3)], ids=["grey", "colour"])
def test_a_peer_is_tuned(who, shape, monkeypatch):
    """Every filter takes grey and colour, and gains 3 dB at a step with noise of 20 (measured: 4.7 to 18)."""
    if not quality.installed(who):
        pytest.skip(f"{who} needs scikit-image, a wavelet PyWavelets too")
    apply, grid = quality.PEERS[who]
    small = {name: [values[len(values) // 2]] for name, values in grid.items()}
    small[next(reversed(grid))] = list(grid[next(reversed(grid))])[::6]
    monkeypatch.setitem(quality.PEERS, who, (apply, small))
    clean = np.full(shape, 60.0)
    clean[:, 9:] = 180
    noisy = quality.noisy_of(clean, 20)
    found = quality.tuned(who, clean, noisy, 20)
    assert found["psnr"] > quality.psnr(noisy, clean) + 3
    assert found["settings"].keys() == grid.keys()


@pytest.fixture
def house(monkeypatch, tmp_path):
    """A table of one small picture."""
    clean = np.kron(np.array([[60, 180], [200, 90]], np.uint8), np.ones((12, 12), np.uint8))
    (tmp_path / "images").mkdir()
    pictures.write_picture(tmp_path / "images" / "house.png", pictures.Picture(clean))
    monkeypatch.setenv("GPUREG_DATA", str(tmp_path))
    monkeypatch.setattr(quality, "PICTURES", {"house": "house.png"})
    return tmp_path


def test_the_table(house, capsys):
    """Saved peers are not computed again, wavelets do not count, and the difference is ours less the best."""
    saved = {"house 20": {"tv_chambolle": {"psnr": 20.0}, "bilateral": {"psnr": 19.0}, "wavelet": {"psnr": 99.0}}}
    (house / "peers.json").write_text(json.dumps(saved))
    arguments = ["--sigma", "20", "--filters", "tv_chamb", "--json", str(house / "out.json")]
    assert quality.main([*arguments, "--peers", str(house / "peers.json")]) == 0
    line = json.loads((house / "out.json").read_text())["rows"]["house 20"]
    assert json.loads((house / "peers.json").read_text()) == saved
    ours = line["ours"]["psnr"]
    assert (
        ours
        > line["noisy"]["psnr"]
        == pytest.approx(quality.psnr(quality.noisy_of(c := quality.picture("house"), 20), c))
    )
    said = capsys.readouterr().out
    assert "20.00 tv_chambolle" in said
    assert f"worst {ours - 20:+.2f} dB (house 20), mean {ours - 20:+.2f} dB" in said


def test_missing_pictures_and_names(house, monkeypatch, capsys):
    monkeypatch.setitem(quality.PICTURES, "lost", "lost.png")
    with pytest.raises(FileNotFoundError, match=r"no picture lost\.png: set GPUREG_DATA"):
        quality.picture("lost")
    with pytest.raises(SystemExit):
        quality.main(["--only", "nothing"])
    assert "no picture has 'nothing' in its name; there are house, lost" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        quality.main([])
    assert "there is no picture lost: set GPUREG_DATA" in capsys.readouterr().err
