"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import trimesh
from cases import rng

import gpureg as gr
from gpureg.cli.curve import curve
from gpureg.cli.denoise import denoise
from gpureg.cli.figures import figures
from gpureg.cli.mesh import mesh
from gpureg.cli.points import points
from gpureg.cli.simplify import simplify

README = Path(__file__).parent.parent / "README.md"
MATHEMATICS = README.parent / "docs" / "mathematics.md"
pytestmark = pytest.mark.skipif(not README.exists(), reason="the README is not beside the tests")


def test_python_examples_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    data = pytest.importorskip("skimage.data", reason="scikit-image, of the extra 'plot', is not installed")
    monkeypatch.chdir(tmp_path)
    scene: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.S)
    assert len(blocks) == 10
    # the first four as they stand
    exec(blocks[0], scene)
    before, after = (gr.plot.quality(scene[x], data.astronaut(), channel_axis=-1)[0] for x in ("noisy", "clean"))
    assert after > before + 8  # measured 22.7 and 31.6 dB
    assert scene["flat"].shape == (512, 512, 3) and (tmp_path / "clean.png").exists()
    exec(blocks[1], scene)
    assert np.array_equal(scene["result"].value[::5], scene["f0"][::5].astype(np.float32))
    assert np.abs(scene["result"].value - scene["f0"]).mean() < 0.1  # measured 0.06
    exec(blocks[2], scene)
    assert scene["result"].iterations == 4
    exec(blocks[3], scene)
    assert np.array_equal(scene["whole"][~scene["torn"]], scene["image"][~scene["torn"]])
    assert ((scene["points"][:, 0] > 0.5) == scene["classes"]).mean() > 0.9
    assert scene["smooth"].shape == (2000,)
    assert (tmp_path / "neighbours.npz").exists()
    exec(blocks[4], scene)
    assert scene["result"].lower_bound <= scene["result"].energy[-1]
    assert len(scene["path"]) == 3

    # photons on a ramp, and what the camera adds
    light = np.add.outer(np.linspace(2, 60, 128), np.linspace(2, 60, 128))
    image = 100 + 2.0 * rng(9).poisson(light) + rng(11).normal(0, 4, light.shape)
    scan = np.where(rng(13).random(image.shape) < 0.1, np.nan, image)
    volume = np.stack([image[:16, :16]] * 8, axis=-1)
    scene |= {"image": image, "smooth": 100 + 2 * light, "scan": scan, "volume": volume, "truth": 100 + 2 * light}
    exec(blocks[5], scene)
    # measured over 40 seeds: 2.00, standard deviation 0.19; four of them
    assert abs(scene["camera"].gain - 2) < 0.8
    assert gr.plot.quality(scene["clean"], scene["truth"])[0] > gr.plot.quality(image, scene["truth"])[0] + 6
    scene["superpixels"] = np.indices(image.shape).sum(axis=0) // 16
    exec(blocks[6], scene)
    assert scene["found"].value.shape == image.shape
    assert 1 <= scene["coarser"].n_regions <= scene["found"].n_regions
    assert scene["rag"].n_vertices == 16
    scene["denoiser"] = lambda image, h: gr.denoise_nl_means(image, h=20 * h, sigma=8, radius=3)
    exec(blocks[7], scene)
    assert 0 < scene["found"].ratio < 1.02
    assert scene["best"].parameters["h"] >= 1
    exec(blocks[8], scene)
    assert {"result.png", "weights.png", "energy.png"} <= {path.name for path in tmp_path.iterdir()}
    scene["mesh"] = trimesh.creation.icosphere(3)
    exec(blocks[9], scene)
    assert type(scene["small"]) is trimesh.Trimesh and len(scene["small"].vertices) == 100
    assert scene["labels"].max() == 1


@pytest.mark.parametrize(
    ("command", "count"),
    [(denoise, 5), (simplify, 2), (mesh, 2), (curve, 1), (points, 2), (figures, 2)],
    ids=lambda c: str(c),
)
def test_console_examples_name_options_that_exist(command: click.Command, count: int) -> None:
    known = {option for parameter in command.params for option in parameter.opts}
    calls = re.findall(rf"^\$ gpureg {command.name} (.*)$", README.read_text("utf-8"), re.M)
    assert len(calls) == count
    for call in calls:
        assert set(re.findall(r"--[a-z-]+", call)) <= known, call


def test_examples_of_the_mathematics_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GPUREG_BACKEND", "numpy")
    blocks = re.findall(r"```python\n(.*?)```", MATHEMATICS.read_text("utf-8"), re.S)
    assert blocks
    for block in blocks:
        exec(block, {})


def test_the_mathematics_names_tests_and_operators_that_exist() -> None:
    text = MATHEMATICS.read_text("utf-8")
    sources = "".join(path.read_text("utf-8") for path in Path(__file__).parent.glob("test_*.py"))
    for name in set(re.findall(r"`(test_\w+)`", text)):
        assert f"def {name}(" in sources, name
    for name in set(re.findall(r"`tests/(\w+\.py)`", text)):
        assert (Path(__file__).parent / name).exists(), name
    import gpureg

    for name in gpureg.operators.__all__:
        assert f"`{name}`" in text or f"`{name}(" in text, name
    for number in range(1, 25):
        assert f"| E{number} |" in text


def test_backend_table_names_every_backend() -> None:
    from gpureg import backends

    text = README.read_text("utf-8")
    for name in backends.names():
        assert f"| `{name}` |" in text
