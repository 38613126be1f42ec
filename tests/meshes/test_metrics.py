"""Distances between meshes and between curves, against closed forms and against every pair of elements."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from gpureg import metrics

SPHERE = trimesh.creation.icosphere(2)
TRIANGLE = ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


@pytest.mark.parametrize(
    "mesh",
    [SPHERE, trimesh.creation.torus(2, 0.5), trimesh.creation.box((1, 2, 3))],
    ids=["sphere", "torus", "box"],
)
def test_area_volume_and_closedness(mesh):
    assert metrics.area(mesh) == pytest.approx(mesh.area, rel=1e-12)
    assert metrics.volume(mesh) == pytest.approx(mesh.volume, rel=1e-12)
    assert metrics.is_watertight(mesh)
    soup = mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    assert metrics.is_watertight(soup)
    assert not metrics.is_watertight((mesh.vertices, mesh.faces[1:]))
    turned = np.array(mesh.faces)
    turned[0] = turned[0][::-1]
    assert not metrics.is_watertight((mesh.vertices, turned))


def test_normal_angle_error():
    lifted = ([[0.0, 0, 0], [1, 0, 0], [0, 1, math.tan(math.radians(20))]], TRIANGLE[1])
    assert metrics.normal_angle_error(lifted, TRIANGLE) == pytest.approx(20, abs=1e-9)
    assert metrics.normal_angle_error(SPHERE, SPHERE) == 0
    flat = ([*TRIANGLE[0], [2.0, 0, 0]], [[0, 1, 2], [0, 1, 3]])  # the second face has no area, and no normal
    assert metrics.normal_angle_error(flat, ([*lifted[0], [2.0, 0, 0]], flat[1])) == pytest.approx(20, abs=1e-9)


def test_vertex_error():
    moved = np.array(TRIANGLE[0]) + np.array([0, 0, 0.5])
    assert metrics.vertex_error((moved, TRIANGLE[1]), TRIANGLE) == pytest.approx(0.5 / ((2 + math.sqrt(2)) / 3))


@pytest.mark.parametrize(
    ("point", "distance"),
    [((0.2, 0.2, 3), 3), ((2, 0, 0), 1), ((0.5, -2, 0), 2), ((1, 1, 0), math.sqrt(0.5)), ((0, 2, 1), math.sqrt(2))],
)
def test_distance_from_a_triangle(point, distance):
    assert metrics.distance_to_surface([point], TRIANGLE)[0] == pytest.approx(distance, abs=1e-12)


def test_distance_is_the_least_over_all_faces():
    # triangles whose sizes differ a thousandfold, and one without area
    rng = np.random.default_rng(0)
    vertices = rng.random((300, 3))
    vertices[:150] = vertices[150:] + rng.normal(0, 1, (150, 3)) * 10.0 ** rng.uniform(-3, 0, 150)[:, None]
    faces = np.stack([np.arange(100), np.arange(150, 250), rng.integers(0, 300, 100)], axis=1)
    faces = faces[(faces[:, 2] != faces[:, 0]) & (faces[:, 2] != faces[:, 1])]
    points = rng.random((200, 3)) * 2 - 0.5
    each = [metrics.distance_to_surface(points, (vertices, face[None])) for face in faces]
    found = metrics.distance_to_surface(points, (vertices, np.concatenate([faces, [[0, 0, 1]]])))
    np.testing.assert_allclose(found, np.min(each, axis=0), atol=1e-12)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1, 1e6])
def test_distances_grow_with_the_scale(scale):
    """Small meshes too: with products below 1e-12 taken for 0 the Stanford bunny was 0.16 edges from itself."""
    sphere = trimesh.creation.icosphere(3)
    points = np.random.default_rng(0).normal(size=(300, 3))
    expected = metrics.distance_to_surface(points, (sphere.vertices, sphere.faces))
    small = metrics.distance_to_surface(scale * points, (scale * sphere.vertices, sphere.faces))
    np.testing.assert_allclose(small, scale * expected, rtol=1e-9, atol=1e-14 * scale)
    assert (
        metrics.hausdorff((scale * sphere.vertices, sphere.faces), (scale * sphere.vertices, sphere.faces))
        < 1e-14 * scale
    )


def test_hausdorff_is_two_sided():
    plane = ([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    part = ([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    # the far corner of the large one is 3 away from the small one
    assert metrics.hausdorff(part, plane) == metrics.hausdorff(plane, part) == pytest.approx(3)
    assert metrics.hausdorff(SPHERE, SPHERE) < 1e-15
    lifted = np.array(SPHERE.vertices) + np.array([0, 0, 0.1])
    assert metrics.hausdorff(SPHERE, (lifted, SPHERE.faces)) == pytest.approx(0.1, rel=0.05)


def test_curves():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert metrics.curve_area(ring) == pytest.approx(3)  # the regular dodecagon's
    assert metrics.curve_area(ring[::-1]) == pytest.approx(-3)
    assert metrics.curve_length(ring) == pytest.approx(24 * math.sin(math.pi / 12))
    assert metrics.curve_length(ring, closed=False) == pytest.approx(22 * math.sin(math.pi / 12))
    assert metrics.curve_hausdorff(ring, 2 * ring) == pytest.approx(1)
    line = np.array([[0.0, 0], [10, 0]])
    bent = np.array([[0.0, 0], [5, 3], [10, 0]])
    assert metrics.curve_hausdorff(line, bent, closed=False) == pytest.approx(3)
    assert metrics.curve_hausdorff(line, [[0.0, 0], [0, 0], [10, 0]], closed=False) == 0


WRONG = [
    (lambda: metrics.normal_angle_error(SPHERE, TRIANGLE), "the same faces"),
    (lambda: metrics.normal_angle_error((np.zeros((3, 3)), [[0, 1, 2]]), TRIANGLE), "no face has an area"),
    (lambda: metrics.distance_to_surface([[0, 0]], TRIANGLE), "\\(n, 3\\)"),
    (lambda: metrics.distance_to_surface([[0, 0, 0]], (np.zeros((3, 3)), [[0, 1, 2]])), "no face of the mesh"),
    (lambda: metrics.curve_area(np.zeros((4, 3))), "\\(n, 2\\)"),
    (lambda: metrics.curve_hausdorff(np.zeros((4, 3)), np.zeros((4, 2))), "same space"),
]


@pytest.mark.parametrize(("call", "message"), WRONG)
def test_a_wrong_call_says_what_is_allowed(call, message):
    with pytest.raises(ValueError, match=message):
        call()
