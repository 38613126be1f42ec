"""Meshes of several makers: they go out as the kind that came in, with attributes; copies of vertices are one."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.shapes.surface import border_vertices, surface_of

SPHERE = trimesh.creation.icosphere(2)
RNG = np.random.default_rng(5)
NOISY = np.array(SPHERE.vertices) + RNG.normal(0, 0.03, SPHERE.vertices.shape)
FACES = np.array(SPHERE.faces)
COLOURS = RNG.integers(0, 256, (len(NOISY), 4), np.uint8)
CLEAN = gr.denoise_mesh((NOISY, FACES), backend="numpy")[0]


def as_trimesh():
    mesh = trimesh.Trimesh(NOISY, FACES, vertex_colors=COLOURS, process=False)
    mesh.vertex_attributes["number"] = np.arange(len(NOISY))
    return mesh


def as_pyvista():
    pv = pytest.importorskip("pyvista", reason="pyvista is not installed")
    mesh = pv.PolyData.from_regular_faces(NOISY, FACES)
    mesh.point_data["number"] = np.arange(len(NOISY))
    return mesh


def as_open3d():
    o3d = pytest.importorskip("open3d", reason="open3d is not installed")
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(NOISY), o3d.utility.Vector3iVector(FACES))
    mesh.vertex_colors = o3d.utility.Vector3dVector(COLOURS[:, :3] / 255)
    mesh.compute_vertex_normals()
    return mesh


KINDS = {"trimesh": as_trimesh, "pyvista": as_pyvista, "open3d": as_open3d}


def vertices_of(mesh) -> np.ndarray:
    return np.asarray(mesh.points if hasattr(mesh, "points") else mesh.vertices, np.float64)


def numbers_of(mesh) -> np.ndarray:
    """Which vertex that came in each has the whole numbers, or else the colours, of."""
    if hasattr(mesh, "point_data"):
        return np.asarray(mesh.point_data["number"])
    if hasattr(mesh, "vertex_attributes"):
        return np.asarray(mesh.vertex_attributes["number"])
    colours = np.rint(np.asarray(mesh.vertex_colors) * 255).astype(int)
    assert len({tuple(colour) for colour in COLOURS[:, :3].tolist()}) == len(COLOURS)
    return np.array([np.flatnonzero((COLOURS[:, :3] == colour).all(axis=1))[0] for colour in colours])


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_kind_comes_out(kind):
    mesh = KINDS[kind]()
    clean = gr.denoise_mesh(mesh, backend="numpy")
    assert type(clean) is type(mesh)
    assert np.array_equal(vertices_of(mesh), NOISY)  # what came in is as it was
    assert np.array_equal(vertices_of(clean), CLEAN)
    assert np.array_equal(surface_of(clean).faces, FACES)
    assert np.array_equal(numbers_of(clean), np.arange(len(NOISY)))
    if kind == "trimesh":
        assert np.array_equal(clean.visual.vertex_colors, COLOURS)


@pytest.mark.parametrize("kind", KINDS)
def test_attributes_follow_the_vertices_that_are_left(kind):
    mesh = KINDS[kind]()
    simple = gr.simplify_mesh(mesh, n_vertices=40, backend="numpy")
    vertices, faces = gr.simplify_mesh((NOISY, FACES), n_vertices=40, backend="numpy")
    assert type(simple) is type(mesh)
    assert np.array_equal(vertices_of(simple), vertices)
    assert np.array_equal(surface_of(simple).faces, faces)
    if kind == "open3d":
        return  # it has colours alone, which are interpolated
    # a whole number is that of the nearest vertex of the nearest triangle: edges of the sphere are about 0.3
    numbers = numbers_of(simple)
    assert len(set(numbers.tolist())) == len(vertices) == 40
    assert np.linalg.norm(NOISY[numbers] - vertices, axis=1).max() < 0.3


def test_normals_of_open3d_are_those_of_the_new_surface():
    noisy = as_open3d()
    clean = gr.denoise_mesh(noisy, backend="numpy")
    found = np.asarray(clean.vertex_normals).copy()
    clean.compute_vertex_normals()
    assert np.abs(found - np.asarray(clean.vertex_normals)).max() < 1e-12  # sums in another order
    assert np.abs(found - np.asarray(noisy.vertex_normals)).max() > 0.01


def test_polygons_of_pyvista_stay_if_no_vertex_is_removed():
    pv = pytest.importorskip("pyvista", reason="pyvista is not installed")
    sheet = pv.Plane(i_resolution=8, j_resolution=8)
    sheet.points[:, 2] += RNG.normal(0, 0.01, sheet.n_points)
    sheet = sheet.compute_normals(split_vertices=False, consistent_normals=False)
    sheet.cell_data["part"] = np.arange(64)
    smooth = gr.denoise_mesh(sheet, filter="positions", lam=1, backend="numpy")
    assert np.array_equal(smooth.faces, sheet.faces) and np.array_equal(smooth.cell_data["part"], np.arange(64))
    quads = smooth.regular_faces
    across = np.cross(*(smooth.points[quads[:, k]] - smooth.points[quads[:, k - 2]] for k in (2, 3)))
    expected = across / np.linalg.norm(across, axis=1, keepdims=True)
    assert np.abs(np.asarray(smooth.cell_data["Normals"]) - expected).max() < 1e-5
    with pytest.warns(UserWarning, match="64 polygons of more than three corners, which are triangles now"):
        simple = gr.simplify_mesh(sheet, n_vertices=30, backend="numpy")
    assert set(np.asarray(simple.cell_data["part"]).tolist()) <= set(range(64))


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int64])
def test_pairs_keep_their_type(dtype):
    vertices = (NOISY * 100).astype(dtype)
    moved, faces = gr.denoise_mesh((vertices.tolist() if dtype is np.int64 else vertices, FACES), backend="numpy")
    assert moved.dtype == (np.float64 if dtype is np.int64 else dtype)
    assert np.array_equal(faces, FACES)


def test_a_trimesh_with_faces_out_of_range_gets_a_sentence():
    wrong = trimesh.Trimesh(NOISY[:3], [[0, 1, 7]], process=False)
    with pytest.raises(ValueError, match=r"0\.\.2, got 7"):
        surface_of(wrong)


@pytest.mark.parametrize(
    ("mesh", "error", "words"),
    [
        ("a.ply", TypeError, "a mesh must be .* got str"),
        (NOISY, TypeError, "got ndarray"),
        ((NOISY[:, :2], FACES), ValueError, r"shape \(n, 3\)"),
        ((NOISY[:4], [[0, 1, 2, 3]]), ValueError, "must be triangles"),
        ((NOISY, np.empty((0, 3), int)), ValueError, "no face"),
        ((np.full((3, 3), np.nan), [[0, 1, 2]]), ValueError, "finite"),
    ],
)
def test_what_is_no_mesh(mesh, error, words):
    with pytest.raises(error, match=words):
        surface_of(mesh)


def test_copies_become_one_in_the_order_of_the_first():
    soup = NOISY[FACES].reshape(-1, 3)
    whole, which = surface_of(soup, np.arange(len(soup)).reshape(-1, 3)).welded()
    first = list(dict.fromkeys(FACES.ravel().tolist()))
    assert np.array_equal(whole.vertices, NOISY[first])
    assert np.array_equal(whole.vertices[which], soup)
    # the same faces with other coordinates still are the same
    moved, _ = surface_of((soup + np.array([1, 2, 3])) * -2, np.arange(len(soup)).reshape(-1, 3)).welded()
    assert np.array_equal(moved.faces, whole.faces)
    surface = surface_of(NOISY, FACES)
    same, which = surface.welded()
    assert same is surface and np.array_equal(which, np.arange(len(NOISY)))


def test_border_of_an_open_mesh():
    assert not border_vertices(FACES, len(NOISY)).any()
    border = border_vertices(FACES[1:], len(NOISY))
    assert sorted(np.flatnonzero(border).tolist()) == sorted(FACES[0].tolist())
