"""`gpureg noise`, and what `gpureg denoise` does and says of noise that is not white."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile
from cases import rng
from commands import call, denoise, done, failed
from PIL import Image

SCENE = np.kron(rng(0).uniform(60, 180, (4, 4)), np.ones((32, 32)))


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    noisy = SCENE + rng(1).normal(0, 12, SCENE.shape)
    Image.fromarray(np.clip(noisy, 0, 255).round().astype(np.uint8)).save("white.png")
    salted = np.where(rng(2).random(SCENE.shape) < 0.04, 255, np.clip(noisy, 0, 254)).round().astype(np.uint8)
    Image.fromarray(salted).save("salt.png")
    light = 100 + 3.0 * rng(3).poisson(SCENE) + rng(4).normal(0, 2, SCENE.shape)
    tifffile.imwrite("light.tif", light.round().astype(np.uint16))
    colour = np.clip(SCENE[..., None] + rng(5).normal(0, [4, 4, 40], (*SCENE.shape, 3)), 0, 255)
    Image.fromarray(colour.round().astype(np.uint8)).save("colour.png")
    stack = np.stack([SCENE + rng(6).normal(0, s, SCENE.shape) for s in (5, 10, 20)]).astype(np.float32)
    tifffile.imwrite("series.tif", stack, imagej=True, metadata={"axes": "TYX"})
    Image.fromarray(np.full((4, 4), 7, np.uint8) + np.eye(4, dtype=np.uint8)).save("tiny.png")
    return tmp_path


def test_the_noise_in_words(files):
    text = done(call("noise", "white.png"))
    assert text.startswith("white.png\n  noise: standard deviation 1") and text.count("\n") == 2
    assert "3.9 % of the pixels are salt and pepper" in done(call("noise", "salt.png"))
    light = done(call("noise", "light.tif", "--offset", "100"))
    assert "grows with the value, 3" in light or "grows with the value, 2.9" in light
    assert "camera: gain" in light
    assert "the noise cannot be told: only 16 pixels count" in done(call("noise", "tiny.png"))
    many = done(call("noise", "*.png"))
    assert [line for line in many.splitlines() if not line.startswith(" ")] == [
        f"{name}.png" for name in ("colour", "salt", "tiny", "white")
    ]


def test_the_noise_as_json(files):
    def numbers(name):
        raise AssertionError(f"{name} is no JSON")

    report = json.loads(done(call("noise", "tiny.png", "--json")), parse_constant=numbers)
    assert report["state"] == "cannot tell" and report["channels"][0]["sigma"] is None
    slices = json.loads(done(call("noise", "series.tif", "--each", "T", "--json")))["slices"]
    assert [part["channels"][0]["sigma"] for part in slices] == pytest.approx([5, 10, 20], rel=0.1)
    assert json.loads(done(call("noise", "white.png", "salt.png", "--json")))[1]["channels"][0]["has_impulses"]


def test_wrong_calls(files):
    failed(call("noise", "missing.png"), 1, "missing.png")
    failed(denoise("light.tif", "o.tif", "--offset", "100"), 2, "--offset needs --sigma photon")
    failed(denoise("light.tif", "o.tif", "--sigma", "much"), 2, "is neither a number >= 0")
    failed(denoise("light.tif", "o.tif", "--each", "C"), 2, "--each C")
    failed(denoise("colour.png", "o.png", "--sigma", "4,-4,40"), 2, "finite and >= 0 in each channel")


def test_noise_that_grows_and_channels(files):
    text = done(denoise("light.tif", "o.tif"))
    assert "growth   the noise grows with the value" in text
    assert "gain 3" in done(denoise("light.tif", "o.tif", "--sigma", "photon", "--offset", "100"))
    text = done(denoise("colour.png", "o.png"))
    assert "channels 0 and 1 together" in text and "channel 2" in text
    each = done(denoise("colour.png", "each.png", "--each", "C"))
    assert "channels" not in each.split("filter")[1].split("\n")[0]
    given = json.loads(done(denoise("colour.png", "given.png", "--sigma", "4,4,40", "--json")))
    assert given["sigma"] == pytest.approx(np.sqrt((16 + 16 + 1600) / 3))
    assert "impulses" in done(denoise("salt.png", "o.png"))
