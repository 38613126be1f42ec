"""Data of a mesh on a simplified one, and normals beside moved vertices."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

import gpureg as gr
from gpureg.shapes.carried import nearest_in_triangles
from gpureg.shapes.surface import surface_of, vertex_normals

SPHERE = trimesh.creation.icosphere(3)
PLACES = np.array(SPHERE.vertices)
FACES = np.array(SPHERE.faces)
# within this of its own place: a vertex of 100 on the sphere lies off the triangles by their sagitta, edge^2 / 8
NEAR = 0.02
FAST = {"backend": "numpy", "max_iter": 200}


def turns(points) -> np.ndarray:
    """The angle around the axis in turns, 0 to 1."""
    return np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5


def seamed():
    """A sphere with a texture around the axis: vertices of faces that cross the seam have a copy at 1 + u."""
    u = turns(PLACES)[FACES]
    over = (np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0.5)
    pairs, index = np.unique(np.stack([FACES, over], -1).reshape(-1, 2), axis=0, return_inverse=True)
    places = PLACES[pairs[:, 0]]
    uv = np.stack([turns(places) + pairs[:, 1], (places[:, 2] + 1) / 2], axis=1)
    mesh = trimesh.Trimesh(places, index.reshape(-1, 3), process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv)
    return mesh


def test_nearest_points_of_triangles():
    """Against many points of each triangle."""
    rng = np.random.default_rng(0)
    triangles, points = rng.normal(0, 1, (50, 3, 3)), rng.normal(0, 1, (50, 3))
    triangles[:5, 2] = triangles[:5, 1]  # without area
    share, distance = nearest_in_triangles(points, triangles)
    assert share.min() >= 0 and np.abs(share.sum(axis=1) - 1).max() < 1e-12
    found = np.einsum("mk,mkd->md", share, triangles)
    assert np.abs(((found - points) ** 2).sum(axis=1) - distance).max() < 1e-12
    some = rng.dirichlet([0.5] * 3, 3000)
    least = ((np.einsum("sk,mkd->msd", some, triangles) - points[:, None]) ** 2).sum(axis=2).min(axis=1)
    assert (distance <= least + 1e-12).all()
    assert np.abs(distance - least).max() < 0.05  # of 3000 points


def test_all_data_of_a_trimesh_are_carried():
    mesh = trimesh.Trimesh(PLACES, FACES, process=False, metadata={"owner": ["me"]})
    mesh.visual.vertex_colors = np.column_stack([127 * (PLACES + 1), np.full(len(PLACES), 255)]).astype(np.uint8)
    mesh.vertex_attributes |= {"place": PLACES, "north": PLACES[:, 2] > 0, "short": np.zeros(3)}
    mesh.vertex_attributes["normals"] = -PLACES
    mesh.face_attributes["side"] = (PLACES[FACES].mean(axis=1)[:, 0] > 0).astype(np.int16)
    with pytest.warns(UserWarning, match="lost the data 'short' at vertices: 3 values instead of 642"):
        made = gr.simplify_mesh(mesh, n_vertices=100, **FAST)
    assert np.abs(made.vertex_attributes["place"] - made.vertices).max() < NEAR
    assert np.abs(made.visual.vertex_colors[:, :3] / 127.0 - 1 - made.vertices).max() < NEAR + 1 / 127
    assert (made.vertex_attributes["north"] == (made.vertices[:, 2] > 0))[np.abs(made.vertices[:, 2]) > 0.2].all()
    x = made.triangles_center[:, 0]
    assert (made.face_attributes["side"] == (x > 0))[np.abs(x) > 0.3].all()
    assert made.metadata == mesh.metadata and made.metadata["owner"] is not mesh.metadata["owner"]
    # computed again, on the side of the old ones
    assert np.abs(made.vertex_attributes["normals"] + made.vertex_normals).max() < 0.2
    by_face = trimesh.Trimesh(PLACES, FACES, face_colors=np.column_stack([FACES % 251, FACES[:, 0] % 2]), process=False)
    made = gr.simplify_mesh(by_face, n_vertices=100, **FAST)
    assert {tuple(row) for row in made.visual.face_colors} <= {tuple(row) for row in by_face.visual.face_colors}
    assert len(made.visual.face_colors) == len(made.faces)


def test_a_texture_with_a_seam():
    mesh = seamed()
    made = gr.simplify_mesh(mesh, n_vertices=150, **FAST)
    # 150 places; the seam from pole to pole is there twice
    assert len(np.unique(made.vertices, axis=0)) == 150 < len(made.vertices) < 180
    away = np.abs(made.vertices[:, 2]) < 0.8
    off = (made.visual.uv[:, 0] - turns(made.vertices) + 0.5) % 1 - 0.5
    # at the seam a side may end half an edge before the new vertex: 0.2 of the circle of 0.6 at z = 0.8
    assert np.abs(off[away]).max() < 0.2 / (2 * np.pi * 0.6)
    assert np.abs(made.visual.uv[:, 1] - (made.vertices[:, 2] + 1) / 2).max() < 2 * NEAR
    # no face goes once around the texture
    assert np.ptp(made.visual.uv[made.faces][away[made.faces].all(axis=1)], axis=1).max() < 0.25
    assert surface_of(made).welded()[0].faces.shape == made.faces.shape


def test_copies_without_data_are_one():
    mesh = seamed()
    made = gr.simplify_mesh(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False), n_vertices=150, **FAST)
    assert len(made.vertices) == 150 and made.is_watertight


def test_pyvista_normals_and_cells():
    pv = pytest.importorskip("pyvista", reason="pyvista is not installed")
    rough = PLACES * (1 + 0.02 * np.random.default_rng(1).normal(0, 1, (len(PLACES), 1)))
    mesh = pv.PolyData.from_regular_faces(rough, FACES)
    mesh.point_data["Normals"] = PLACES.astype(np.float32)
    mesh.cell_data["Normals"] = np.cross(*np.diff(rough[FACES], axis=1).transpose(1, 0, 2))
    mesh.cell_data["part"] = np.arange(len(FACES))
    mesh.field_data["unit"] = ["mm"]
    smooth = gr.denoise_mesh(mesh, backend="numpy")
    made = gr.simplify_mesh(mesh, n_vertices=100, **FAST)
    for new in (smooth, made):
        expected = trimesh.Trimesh(new.points, new.regular_faces, process=False)
        cells = np.asarray(new.cell_data["Normals"])
        assert np.abs(cells - expected.face_normals).max() < 1e-4
        at = np.asarray(new.point_data["Normals"])
        assert at.dtype == np.float32 and np.abs(np.linalg.norm(at, axis=1) - 1).max() < 1e-5
        assert np.abs(at - vertex_normals(np.asarray(new.points, float), new.regular_faces)).max() < 1e-5
        assert list(new.field_data["unit"]) == ["mm"]
    assert np.abs(np.asarray(smooth.point_data["Normals"]) - PLACES).max() > 1e-3
    assert len(made.cell_data["part"]) == made.n_cells


def test_vertices_that_are_not_finite():
    more = np.concatenate([PLACES, [[np.nan, 0, 0], [np.inf, 0, 1]]])
    with pytest.warns(UserWarning, match="2 vertices are not finite; they belong to no face"):
        moved, _ = gr.denoise_mesh((more, FACES), backend="numpy")
    assert np.array_equal(moved[-2:], more[-2:], equal_nan=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        alone, _ = gr.denoise_mesh((PLACES, FACES), backend="numpy")
    assert np.abs(moved[:-2] - alone).max() < 1e-6  # another centre of the coordinates
    more[5, 1] = np.nan
    with pytest.raises(ValueError, match=r"row 5 is .*nan.* and belongs to \d faces: remove"):
        gr.denoise_mesh((more, FACES))
