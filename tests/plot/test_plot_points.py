"""Pictures of point clouds."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="matplotlib, of the extra 'plot', is not installed")

from PIL import Image

import gpureg as gr

RNG = np.random.default_rng(2)
FLAT = RNG.uniform(0, 1, (500, 2)) * [3, 1]
SPACE = RNG.uniform(0, 1, (500, 3)) * [3, 2, 1]


def drawn(tmp_path, *args, **kwargs) -> np.ndarray:
    gr.plot.points(*args, path=tmp_path / "a.png", **kwargs)
    with Image.open(tmp_path / "a.png") as opened:
        return np.asarray(opened.convert("RGB"), float)


def size(picture) -> tuple[int, int]:
    there = (picture < 250).any(axis=-1)
    return tuple(int(np.ptp(np.flatnonzero(there.any(axis=axis)))) for axis in (0, 1))


def test_points_of_the_plane_are_seen_as_they_are(tmp_path):
    width, height = size(drawn(tmp_path, [FLAT]))
    assert width / height == pytest.approx(3, rel=0.1)


@pytest.mark.parametrize(("view", "up", "ratio"), [((0, 0), "z", 2), ((90, 0), "z", 3), ((0, 0), "y", 1.5)])
def test_the_camera(tmp_path, view, up, ratio):
    width, height = size(drawn(tmp_path, [SPACE], view=view, up=up))
    assert width / height == pytest.approx(ratio, rel=0.1)


def test_colours(tmp_path):
    """Classes have colours of their own; red, green and blue are as given; numbers get a bar."""
    classes = np.repeat([0, 1], 250)
    one = FLAT[:, 0].argsort()
    points = FLAT[one]
    picture = drawn(tmp_path, [points], values=[classes])
    left, right = picture[:, : picture.shape[1] // 2], picture[:, picture.shape[1] // 2 :]
    mean = [part[(part < 250).any(axis=-1)].mean(axis=0) for part in (left, right)]
    assert np.abs(mean[0] - mean[1]).max() > 50
    red = drawn(tmp_path, [points], values=[np.tile([1.0, 0, 0], (500, 1))])
    covered = red[(red < 250).any(axis=-1)]
    assert (covered[:, 0] > 200).all() and covered[:, 1].min() < 10
    bar = drawn(tmp_path, {"a": points, "b": points}, values=[points[:, 0], points[:, 1]], caption="two")
    assert bar.shape[1] > picture.shape[1]


@pytest.mark.parametrize(
    ("points", "settings", "error", "words"),
    [
        ([], {}, ValueError, "no cloud of points"),
        (FLAT, {}, TypeError, "sequence of clouds"),
        ([FLAT, SPACE], {}, ValueError, "all clouds must have shape"),
        ([RNG.random((5, 4))], {}, ValueError, "all clouds must have shape"),
        ([FLAT], {"values": []}, ValueError, "an array for each of the 1 clouds"),
        ([FLAT], {"values": [np.ones(3)]}, ValueError, "for each of 500 points"),
        ([FLAT], {"values": [np.full(500, np.nan)]}, ValueError, "must be finite"),
        ([SPACE], {"view": (0, 100)}, ValueError, "view must be"),
        ([SPACE], {"up": "w"}, ValueError, "up must be"),
        ([FLAT], {"path": "a.doc"}, ValueError, "extension"),
    ],
)
def test_wrong_input(points, settings, error, words):
    with pytest.raises(error, match=words):
        gr.plot.points(points, **settings)
