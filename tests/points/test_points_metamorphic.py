"""What must not change the functions for points: unit, place, order, copies, other bodies, a point far away."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import gpureg as gr

RNG = np.random.default_rng(21)
ON = {"backend": "numpy", "dtype": np.float64}
BALL = RNG.normal(size=(300, 3))
BALL /= np.linalg.norm(BALL, axis=1, keepdims=True)
BALL += RNG.normal(0, 0.02, BALL.shape)
ANGLE = np.linspace(0, 2 * np.pi, 200, endpoint=False)
RING = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1) + RNG.normal(0, 0.006, (200, 2))
HEIGHT = BALL[:, 2] + RNG.normal(0, 0.1, 300)

# a function of points, points, and whether the result moves with them
DOORS = {
    "surface": (lambda x: gr.denoise_points(x, **ON), BALL, True),
    "normals": (lambda x: gr.denoise_points(x, filter="normals", **ON), BALL, True),
    "positions": (lambda x: gr.denoise_points(x, filter="positions", **ON), BALL, True),
    "curve": (lambda x: gr.denoise_points(x, **ON), RING, True),
    "noise": (lambda x: gr.estimate_point_noise(x, of="point"), BALL, False),
    "noise of a curve": (lambda x: gr.estimate_point_noise(x, of="point"), RING, False),
}
EACH = pytest.mark.parametrize(("work", "x", "moves"), DOORS.values(), ids=DOORS)
SIZE = {3: 0.05, 2: 0.03}  # of the distance to the nearest point


@EACH
def test_another_unit(work, x, moves):
    """A power of two scales all numbers without rounding."""
    assert np.array_equal(work(x * 2.0**9), work(x) * 2.0**9)


@EACH
def test_another_place(work, x, moves):
    """Coordinates of maps, in metres: 4e6 has digits down to 5e-10, which noise of 0.02 in a body of 1 does not see."""
    place = np.array([5e5, 4e6, 300.0])[: x.shape[1]]
    assert_allclose(work(x + place) - (place if moves else 0), work(x), atol=1e-6 * SIZE[x.shape[1]], rtol=0)


@EACH
def test_another_order(work, x, moves):
    order = RNG.permutation(len(x))
    # sums in another order: measured 1e-13, and in float32, as of the noise, 3e-9
    assert_allclose(work(x[order]), work(x)[order], atol=1e-6 * SIZE[x.shape[1]], rtol=0)


@EACH
def test_repeated_points(work, x, moves):
    """Copies to the bit, and up to 1e-9 of the spacing, as in scans that were put together; three of one in a row."""
    copies = np.concatenate([x, x[::3], x[:2], x[:2]])
    found, alone = work(copies), work(x)
    which = np.r_[np.arange(len(x)), np.arange(len(x))[::3], 0, 1, 0, 1]
    assert_allclose(found, alone[which], atol=1e-12)
    near = copies + RNG.uniform(-1, 1, copies.shape) * 1e-10 * SIZE[x.shape[1]]
    assert_allclose(work(near), alone[which], atol=1e-7 * SIZE[x.shape[1]], rtol=0)


@EACH
def test_two_bodies(work, x, moves):
    """Another body, 50 times smaller and without noise, changes nothing: nothing is shared but the call."""
    other = x[:200] / (50 * np.linalg.norm(x[:200], axis=1, keepdims=True)) + 3
    both = work(np.concatenate([x, other]))
    assert_allclose(both[: len(x)], work(x), atol=1e-6 * SIZE[x.shape[1]], rtol=0)
    assert_allclose(both[len(x) :], work(other), atol=1e-6 * SIZE[x.shape[1]] / 50, rtol=0)


@EACH
def test_a_point_far_away(work, x, moves):
    far = np.full((1, x.shape[1]), 1e4)
    if moves:
        with pytest.warns(UserWarning, match=r"1 of \d+ points are outliers"):
            found = work(np.concatenate([x, far]))
        assert np.array_equal(found[-1:], far)
    else:
        found = work(np.concatenate([x, far]))
        assert np.isnan(found[-1])
    assert_allclose(found[:-1], work(x), atol=1e-6 * SIZE[x.shape[1]], rtol=0)


def test_values_and_clusters():
    """The same for values at points, and for clusters, which have no unit."""
    two = np.concatenate([BALL, 0.5 * BALL[:100] + 4])
    labels = gr.cluster_points(two, max_iter=30, **ON)
    assert labels.max() == 1
    values = gr.denoise_points(BALL, HEIGHT, **ON)
    order = RNG.permutation(len(two))
    part = order[order < len(BALL)]
    for x in (two * 2.0**9, two + np.array([5e5, 4e6, 300]), np.concatenate([two, two[::3]])):
        assert np.array_equal(gr.cluster_points(x, max_iter=30, **ON)[: len(two)], labels)
        same = gr.denoise_points(x[: len(BALL)], HEIGHT, **ON)
        assert_allclose(same, values, atol=1e-9)
    # numbered by their first points
    again = gr.cluster_points(two[order], max_iter=30, **ON)
    assert np.array_equal(again == again[0], labels[order] == labels[order[0]])
    assert_allclose(gr.denoise_points(BALL[part], HEIGHT[part], **ON), values[part], atol=1e-9)
    i = np.r_[np.arange(300), np.arange(0, 300, 3)]
    assert_allclose(gr.denoise_points(BALL[i], HEIGHT[i], **ON), values[i], atol=1e-12)
    assert_allclose(gr.denoise_points(BALL, HEIGHT * 2.0**9, **ON), values * 2.0**9, rtol=1e-12)
